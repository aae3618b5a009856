"""What a run has learned, for use: policy, model and bonus in NumPy, and files of them."""
