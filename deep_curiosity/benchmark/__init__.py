"""Benchmark: how fast, how near the arithmetic floor, how large, and how all of it grows."""
