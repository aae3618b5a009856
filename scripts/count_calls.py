"""Counts the calls into our own code in one update, and the hops from a step to its gradient.

The update is that of the default curious agent on random transitions, eager, one that renews no
marginal.
"""

import torch

from deep_curiosity.agent.networks import PRIORS
from deep_curiosity.arguments import read_arguments
from deep_curiosity.benchmark.calls import (
    CONFIG,
    describe_calls,
    describe_hops,
    find_hops,
    record_update,
)
from deep_curiosity.cli import answering


def main() -> None:
    """Print the counts for each action prior, and the hops."""
    torch.set_num_threads(1)
    for prior in PRIORS:
        recorder = record_update(CONFIG.override(prior=prior))
        print(f"Update with the {prior} prior: {describe_calls(recorder)}\n")
    print(f"From environment.step to torch.autograd.grad: {describe_hops(find_hops())}")


if __name__ == "__main__":
    with answering():
        read_arguments(main, description=__doc__)
