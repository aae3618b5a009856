"""Our own agent as a runner, with a stopwatch in every part of a step."""

import time
from collections import defaultdict
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from deep_curiosity.training.collector import Collector, EnvironmentSteps
from deep_curiosity.training.environments import action_dim, make_environment, observation_dim
from deep_curiosity.training.learner import Learner
from deep_curiosity.speed.machine import (
    MatmulPrecision,
    matmul_rate,
    prepare_machine,
    should_compile,
    wait_for,
)
from deep_curiosity.training.config import Settings

NUM_RANDOM_STEPS = 1_000  # taken once, and repeated until replay is as full as it is to be
PARTS = ("acting", "environment", "storing", "sampling", "statistics", "learning")
"""Of a step with its update, in the order in which they come; the last three are the update."""


class Stopwatch:
    """Seconds spent in methods, in whose place it puts itself."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    def watch(self, owner: object, method: str, part: str) -> None:
        """Count the calls of a method for a part; a microsecond a call."""
        function = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            started = time.perf_counter()
            result = function(*args, **kwargs)
            self.seconds[part] += time.perf_counter() - started
            return result

        setattr(owner, method, timed)


class OwnAgent:
    """Our learner and collector in the order of the training loop.

    Args:
        settings: Of the run.
        precision: Of matrix products.
    """

    def __init__(self, settings: Settings, precision: MatmulPrecision) -> None:
        torch.manual_seed(settings.seed)
        prepare_machine(replace(settings, matmul_precision=precision))
        environment = make_environment(
            settings.env_id, settings.env_kwargs, history=settings.history
        )
        self.collector = Collector(environment, settings.seed)
        self.learner = Learner(settings, observation_dim(environment), action_dim(environment))
        self._stopwatch = Stopwatch()
        learner, watch = self.learner, self._stopwatch.watch
        watch(learner, "turn", "acting")
        watch(learner, "act", "acting")
        watch(self.collector, "step", "environment")
        watch(learner, "store", "storing")
        watch(learner, "_sample", "sampling")
        watch(learner, "_learn", "learning")
        watch(learner, "update", "update")
        if not should_compile(settings):  # a graph cannot be looked into
            watch(learner.agent, "update", "agent")
        if learner.bonus is not None:
            watch(learner.bonus, "observe", "statistics")

    def fill(self, num_transitions: int) -> None:
        """Take some random steps, and repeat them in replay."""
        steps = []
        for _ in range(min(num_transitions, NUM_RANDOM_STEPS)):
            action = self.learner.act(self.collector.observation, explore_uniformly=True)
            steps.append(self.collector.step(action)[0])
        taken = EnvironmentSteps(*map(np.array, zip(*steps, strict=True)))
        for start in range(0, num_transitions, NUM_RANDOM_STEPS):
            rows = slice(num_transitions - start)
            self.learner.store(EnvironmentSteps(*(field[rows] for field in taken)))

    def step(self, num_steps: int) -> None:
        """Take environment steps, each followed by one update."""
        self._stopwatch.seconds.clear()
        collector = self.collector
        for number in range(num_steps):
            self.learner.turn(number, collector.observation, collector.present_info)
            action = self.learner.act(collector.observation)
            step, _ = collector.step(action)
            self.learner.store(step)
            self.learner.update()
        wait_for(self.learner.settings.device)

    def seconds(self) -> dict[str, float]:
        """Time that each part took in the newest call of `step`, and the whole `update`."""
        return dict(self._stopwatch.seconds)

    def matrix_rate(self) -> float:
        """Operations per second of matrix products, as precision and machine now stand."""
        return matmul_rate()
