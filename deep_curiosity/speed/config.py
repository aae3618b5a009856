"""Where and how fast a run computes: each piece of cleverness has its switch here."""

from dataclasses import dataclass
from typing import Literal

from deep_curiosity.configuration import Group, setting


@dataclass(frozen=True)
class SpeedConfig(Group):
    """Device, threads and compiler."""

    device: str = "cpu"
    """Where replay, updates and bonus live: cpu, or cuda."""
    threads: int = setting(1, at_most=1_024)
    """CPU threads of torch; two are often slower than one for networks of this size."""
    compile: Literal["auto", "on", "off"] = "auto"
    """Compile the updates, which takes half a minute, seconds where a run of the same sizes was
    compiled before; auto does so in long runs, after some."""
    matmul_precision: Literal["auto", "highest", "high", "medium"] = "auto"
    """Torch's switch for float32 matrix products; auto takes the highest, or one that is float32
    on this machine as well and much faster."""
    direct_matmul: bool = True
    """Let products of a compiled update call torch's CPU kernel directly."""
    deduplicate: bool = True
    """Compute once what a compiled update would compute twice."""
    keep_memory: bool = True
    """Let the process keep memory that it frees while it trains, in huge pages where it can."""
    numpy_policy: bool = True
    """Act by NumPy where one environment is stepped on the CPU."""
