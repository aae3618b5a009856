"""Numbers that look random and are the same in every run."""

from jaxtyping import Int
from torch import Tensor

HASH_OFFSET = 0x9E3779B9  # so that zeros count; the golden ratio's digits
HASH_FACTOR = 0x5851F42D4C957F2D  # odd, of Knuth's generator MMIX


def scrambled(number: Int[Tensor, "*batch"]) -> Int[Tensor, "*batch"]:
    """Mix the bits of 64-bit whole numbers."""
    for _ in range(2):  # round numbers have empty low bits: bring the high ones down
        number = (number ^ (number >> 29)) * HASH_FACTOR
    return number
