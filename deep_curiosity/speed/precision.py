"""How exact float32 matrix products are under torch's switch, which differs from CPU to CPU.

`torch.set_float32_matmul_precision("medium")` means faster float32 on some CPUs and bfloat16 on
others. Nothing here sets the switch.
"""

from functools import cache

import torch

FLOAT32_ERROR = 1e-5  # relative; float32 itself has a few 1e-7, TF32 some 1e-4, bfloat16 some 1e-3


def matmul_error(device: str | torch.device = "cpu") -> float:
    """Relative error of a float32 matrix product as the switch stands, measured once."""
    return _measured_error(torch.get_float32_matmul_precision(), torch.device(device).type)


def matmul_is_float32(device: str = "cpu") -> bool:
    """Whether matrix products are as exact as float32 allows."""
    return matmul_error(device) < FLOAT32_ERROR


# as `torch.compiler.assume_constant_result` marks it, which loads the compiler: a second of import
vars(matmul_is_float32)["_dynamo_marked_constant"] = True


@cache
def _measured_error(switch: str, device: str) -> float:
    del switch  # the key of the cache
    generator = torch.Generator().manual_seed(0)  # leaves the global stream where it is
    left, right = torch.randn(2, 256, 256, generator=generator)
    exact = left.double() @ right.double()
    product = (left.to(device) @ right.to(device)).cpu()
    return ((product - exact).norm() / exact.norm()).item()
