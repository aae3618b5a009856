"""The paper's exact algorithm on finite worlds, equation by equation, in NumPy and in nats."""
