"""Benchmark: how fast, how near the arithmetic floor, how large, and how all of it grows."""

from deep_curiosity.requirements import require_training

require_training()
