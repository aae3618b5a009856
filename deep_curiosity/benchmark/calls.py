"""Calls into our own code in one update: how far a reader has to follow it."""

import inspect
import os
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

import torch

from deep_curiosity.benchmark.costs import random_steps
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.training.collector import Collector
from deep_curiosity.training.config import Config
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.learner import Learner

PACKAGE = Path(__file__).parents[1]
CONFIG = Config.of(env_id="PendulumSwingup", hidden_dim=64, compile="off")
OBSERVATION_DIM, ACTION_DIM = 3, 1  # of this task
NUM_TRANSITIONS = 600  # in replay
NUM_SETTLING = 5  # updates before: the one after them renews no marginal


class Function(NamedTuple):
    """A function of our own."""

    file: str
    """Path from the folder of the package."""
    name: str
    """With the classes and functions that it is defined in, before Python 3.11 without."""


class CallRecorder:
    """Counts calls of the functions in a folder for as long as it is entered.

    What this file itself calls is left out.

    Args:
        folder: Functions of files below it are counted.
        landmarks: Functions, counted or not, at whose calls the stack is kept.
    """

    def __init__(
        self, folder: Path = PACKAGE, landmarks: Iterable[Callable[..., Any]] = ()
    ) -> None:
        self.counts: Counter[Function] = Counter()
        """Calls of each function."""
        self.depth = 0
        """Most functions that were on the stack at a time."""
        self._stacks: dict[CodeType, list[list[Function]]] = defaultdict(list)
        self._landmarks = {_code(landmark) for landmark in landmarks}
        self._stack: list[Function] = []
        self._prefix = f"{folder}{os.sep}"
        self._before: Any = None

    @property
    def files(self) -> set[str]:
        """Files whose functions were called."""
        return {function.file for function in self.counts}

    def stacks(self, landmark: Callable[..., Any]) -> list[list[Function]]:
        """Counted functions that were on the stack at each call of a landmark, outermost first."""
        return self._stacks[_code(landmark)]

    def __enter__(self) -> "CallRecorder":
        self._before = sys.getprofile()
        sys.setprofile(self._record)
        return self

    def __exit__(self, *error: object) -> None:
        sys.setprofile(self._before)

    def _record(self, frame: FrameType, event: str, argument: object) -> None:
        """Follow the interpreter into a function and out of it."""
        code = frame.f_code
        counted = code.co_filename.startswith(self._prefix) and code.co_filename != __file__
        if event == "call":
            if counted:
                file = code.co_filename.removeprefix(self._prefix)
                name = getattr(code, "co_qualname", code.co_name)  # since Python 3.11
                self._stack.append(Function(file, name))
                self.counts[self._stack[-1]] += 1
                self.depth = max(self.depth, len(self._stack))
            if code in self._landmarks:
                self._stacks[code].append(list(self._stack))
        elif event == "return" and counted:
            self._stack.pop()


def record_update(config: Config = CONFIG) -> CallRecorder:
    """Record one update on random transitions, eager, in which no marginal is renewed."""
    learner = make_learner(config)
    with CallRecorder() as recorder:
        learner.update()
    return recorder


def find_hops(config: Config = CONFIG) -> list[Function]:
    """Our functions on the way of one transition, from `environment.step` to its gradient.

    They are those on the stack when the environment is stepped, innermost first, and then when
    the transition is written, sampled, taken apart and differentiated, each of them once. Of
    all gradients of an update it is the one whose stack is the deepest.
    """
    learner = make_learner(config)
    environment = make_environment(config.environment)
    collector = Collector(environment, config.run.seed)
    action = learner.act(collector.observation)
    on_the_way = (ReplayBuffer.extend, ReplayBuffer.sample_rows, ReplayBuffer.sequences)
    landmarks = (environment.step, *on_the_way, torch.autograd.grad)
    with CallRecorder(landmarks=landmarks) as recorder:
        step, _ = collector.step(action)
        learner.store(step)
        learner.update()
    environment.close()
    hops = recorder.stacks(environment.step)[0][::-1]
    for landmark in on_the_way:
        hops += recorder.stacks(landmark)[0]
    deepest = max(recorder.stacks(torch.autograd.grad), key=len)
    return list(dict.fromkeys(hops + deepest))


def make_learner(config: Config) -> Learner:
    """A learner with random transitions in replay, after its first updates."""
    learner = Learner(config, OBSERVATION_DIM, ACTION_DIM)
    learner.replay.extend(*random_steps(NUM_TRANSITIONS, OBSERVATION_DIM, ACTION_DIM))
    for _ in range(NUM_SETTLING):
        learner.update()
    return learner


def describe_calls(recorder: CallRecorder) -> str:
    """Number of calls, files and greatest depth, and below them every function by file."""
    by_file: dict[str, Counter[str]] = defaultdict(Counter)
    for function, count in recorder.counts.items():
        by_file[function.file][function.name] = count
    lines = [
        f"{recorder.counts.total()} calls, {len(recorder.files)} files, depth {recorder.depth}"
    ]
    for file, names in sorted(by_file.items(), key=lambda item: -item[1].total()):
        lines.append(f"{names.total():5d} {file}")
        lines += [f"{count:9d} {name}" for name, count in names.most_common()]
    return "\n".join(lines)


def describe_hops(hops: list[Function]) -> str:
    """Number of hops and files, and below them where each leads; the first line is the start."""
    num_files = len({hop.file for hop in hops})
    lines = [f"{len(hops) - 1} hops, {num_files} files"]
    lines += [f"{number:5d} {hop.file}: {hop.name}" for number, hop in enumerate(hops)]
    return "\n".join(lines)


def _code(function: Callable[..., Any]) -> CodeType:
    """Code of a function or method, below its decorators."""
    code: CodeType = inspect.unwrap(function).__code__
    return code
