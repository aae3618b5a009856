"""The fuzzer finds nothing silent, and knows it when it sees it."""

import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from tests.fuzz.public_api import (
    Target,
    call,
    describe,
    fuzz,
    given,
    is_sound,
    transition,
)

SCRIPT = Path(__file__).with_name("public_api.py")


def run(num_calls: int, seed: int) -> subprocess.CompletedProcess:
    """The fuzzer in a process of its own, where nothing else checks types."""
    command = [sys.executable, str(SCRIPT), "--calls", str(num_calls), "--seed", str(seed)]
    return subprocess.run(
        command, env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True
    )


def test_no_call_is_answered_silently_and_refusals_are_clear() -> None:
    done = run(400, seed=0)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 silent non-finite answer" in done.stdout
    assert "0 mismatched batch taken" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_no_call_of_ten_thousand_is_answered_silently(seed: int) -> None:
    done = run(10_000, seed)
    assert done.returncode == 0, done.stdout + done.stderr


def outcome_of(function, **makers) -> str:
    return call(Target("it", function, makers), random.Random(0)).kind


def refuse(message: str) -> None:
    raise ValueError(message)


def test_each_kind_of_outcome_is_told_from_the_others() -> None:
    whole, half = torch.zeros(4, 3), torch.zeros(2, 3)
    assert outcome_of(lambda observation: observation.sum(), observation=given(whole)) == (
        "finite answer"
    )
    assert outcome_of(lambda x: x / 0, x=given(whole + 1)) == "silent non-finite answer"
    assert outcome_of(lambda x: {"a": (1, x - x)}, x=given(torch.tensor(torch.inf))) == (
        "silent non-finite answer"
    )
    assert outcome_of(lambda text: refuse("`x` must be 1, got 2."), text=given("")) == (
        "clear refusal"
    )
    for message in ("must be 1, got 2", "`x` must be 1", "size of tensor a (4) must match, got 3"):
        assert outcome_of(lambda text: refuse(text), text=given(message)) == "unclear refusal"
    assert (
        outcome_of(lambda observation, action: 0.0, observation=given(whole), action=given(half))
        == "mismatched batch taken"
    )


def test_one_silent_answer_or_many_unclear_refusals_are_too_many() -> None:
    makers = {"x": given(1.0)}
    good = [call(Target("a", lambda x: x, makers), random.Random(0))] * 20
    clear = [
        call(Target("a", lambda x: refuse("`x` must be 2, got 1."), makers), random.Random(0))
    ]
    unclear = [call(Target("a", lambda x: refuse("no"), makers), random.Random(0))]
    silent = [call(Target("a", lambda x: x * torch.inf, makers), random.Random(0))]
    assert is_sound(good + 50 * clear + unclear)
    assert not is_sound(good + 40 * clear + unclear)
    assert not is_sound(good + silent)
    assert "50 clear refusal" in describe(good + 50 * clear, 0)


def test_one_seed_makes_one_series_of_calls() -> None:
    first, second, other = (
        [(each.target, each.kind) for each in fuzz(25, seed)] for seed in (3, 3, 4)
    )
    assert first == second != other
    assert {*transition()} >= {"observation", "terminated"}
