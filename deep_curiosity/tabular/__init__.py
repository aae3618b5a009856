"""The paper's exact algorithm for finite environments, in NumPy and in nats."""
