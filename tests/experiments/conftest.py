"""A study of two tasks and two agents whose runs take a second, and rows of one without any."""

import pytest

from deep_curiosity.experiments.study import Study, Task


@pytest.fixture
def small_study(tiny):
    config = tiny.override(total_steps=40, evaluation_interval=20, learning_starts=10)
    return Study(
        [Task("pendulum", config, -100.0)],
        {"curiosity": {}, "none": {"bonus": "none"}},
        seeds=2,
        curves=True,
    )


@pytest.fixture
def make_rows():
    """Rows of a study: two seeds of each agent, the second better by one."""

    def make(study, value_of):
        return [
            {"task": task.name, study.label: agent, "seed": seed, "solved": seed}
            | {column: value_of(agent) + seed for column in study.columns}
            for seed in range(2)
            for task in study.tasks
            for agent in study.agents
        ]

    return make
