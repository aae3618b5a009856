"""Our own agent as a runner, with a stopwatch in every stage of a step."""

import time
from collections import defaultdict
from contextlib import ExitStack
from typing import Any

import numpy as np
import torch

from deep_curiosity.speed.machine import fitted_machine, matmul_rate, wait_for
from deep_curiosity.training.collector import Collector
from deep_curiosity.training.config import Config
from deep_curiosity.training.environments import action_dim, make_environment, observation_dim
from deep_curiosity.training.learner import Learner, compiles

NUM_RANDOM_STEPS = 1_000  # taken once, and repeated until replay is as full as it is to be
STAGES = ("acting", "environment", "storing", "sampling", "statistics", "learning")
"""Of a step with its update, in the order in which they come; the last three are the update."""


class Stopwatch:
    """Seconds spent in methods, in whose place it puts itself."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    def watch(self, owner: object, method: str, stage: str) -> None:
        """Add the time of every call of a method to a stage; a microsecond a call."""
        function = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            started = time.perf_counter()
            result = function(*args, **kwargs)
            self.seconds[stage] += time.perf_counter() - started
            return result

        setattr(owner, method, timed)


class OwnAgent:
    """Our learner and collector in the order of the training loop.

    The process is fitted to the machine, as in a run, for as long as the runner lives.

    Args:
        config: Settings of the run, of a single environment.
    """

    def __init__(self, config: Config) -> None:
        torch.manual_seed(config.run.seed)
        self._machine = ExitStack()
        self._machine.enter_context(fitted_machine(config.speed))
        environment = make_environment(config.environment)
        self.collector = Collector(environment, config.run.seed)
        self.learner = Learner(config, observation_dim(environment), action_dim(environment))
        self._stopwatch = Stopwatch()
        self._watch()

    def _watch(self) -> None:
        """Put the stopwatch into every stage."""
        learner, watch = self.learner, self._stopwatch.watch
        watch(learner, "before_step", "acting")
        watch(learner, "act", "acting")
        watch(self.collector, "step", "environment")
        watch(learner, "store", "storing")
        watch(learner.replay, "sample_rows", "sampling")
        watch(learner, "_learn", "learning")
        watch(learner, "update", "update")
        if not compiles(learner.config):  # a graph cannot be looked into
            watch(learner.agent, "update", "agent")
        if learner.bonus is not None:
            watch(learner.bonus, "observe", "statistics")

    def fill(self, num_transitions: int) -> None:
        """Take some random steps, and repeat them in replay."""
        steps = []
        for _ in range(min(num_transitions, NUM_RANDOM_STEPS)):
            action = self.learner.act(self.collector.observation, explore_uniformly=True)
            steps.append(self.collector.step(action)[0])
        fields = [np.concatenate(field) for field in zip(*steps, strict=True)]
        for start in range(0, num_transitions, NUM_RANDOM_STEPS):
            rows = slice(num_transitions - start)
            self.learner.replay.extend(*(field[rows] for field in fields))

    def step(self, num_steps: int) -> None:
        """Take environment steps, each followed by one update."""
        self._stopwatch.seconds.clear()
        collector, learner = self.collector, self.learner
        for number in range(num_steps):
            learner.before_step(number, collector.observation, collector.present_info)
            action = learner.act(collector.observation)
            step, _ = collector.step(action)
            learner.store(step)
            learner.update()
        wait_for(learner.config.speed.device)

    def seconds(self) -> dict[str, float]:
        """Time that each stage took in the newest call of `step`, and the whole `update`."""
        return dict(self._stopwatch.seconds)

    def matrix_rate(self) -> float:
        """Operations per second of matrix products, as precision and machine now stand."""
        return matmul_rate()
