import math

import numpy as np
import pytest
import torch

from deep_curiosity.training.learner import Learner


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, ["computed for 8", "learns"]),
        # no critic learns the bonus: the policy maximises it, as the models now stand
        ({"curiosity_discount": 0.0}, ["learns", "computed for 8"]),
    ],
)
def test_the_bonus_is_computed_for_a_batch_once_and_before_its_models_learn(
    tiny, monkeypatch, changes, expected
):
    learner = Learner(tiny.override(batch_size=8, actor_batch_fraction=1.0, **changes), 3, 1)
    for observation, next_observation in np.random.default_rng(0).normal(size=(40, 2, 3)):
        learner.replay.add(observation, np.zeros(1), 0.0, next_observation, False, False)
    bonus, calls = learner.bonus, []
    forward, loss = bonus.forward, bonus.loss

    def computed(observation, *args):
        calls.append(f"computed for {len(observation)}")
        return forward(observation, *args)

    def learns(transition):
        calls.append("learns")
        return loss(transition)

    monkeypatch.setattr(bonus, "forward", computed)
    monkeypatch.setattr(bonus, "loss", learns)
    learner.update()
    assert calls == expected


def test_later_steps_count_by_the_bonus_that_they_last_had(tiny, monkeypatch):
    """What was never drawn ends the sum; each update keeps the bonus of its first steps."""
    learner = Learner(tiny.override(batch_size=8, curiosity_steps=3), 3, 1)
    for observation, next_observation in np.random.default_rng(0).normal(size=(40, 2, 3)):
        learner.replay.add(observation, np.zeros(1), 0.0, next_observation, False, False)
    given, drawn = [], []
    update, sample_rows = learner.agent.update, learner.replay.sample_rows
    monkeypatch.setattr(
        learner.agent, "update", lambda batch, bonus: given.append(bonus) or update(batch, bonus)
    )
    monkeypatch.setattr(
        learner.replay,
        "sample_rows",
        lambda *sizes: drawn.append(sample_rows(*sizes)) or drawn[-1],
    )
    last = torch.full((40,), math.nan)
    for number in range(30):
        learner.update()
        first, later = drawn[number][2][:24].split([8, 16])
        torch.testing.assert_close(given[number][8:], last[later], equal_nan=True)
        last[first] = given[number][:8]
        torch.testing.assert_close(learner.replay.bonus[:40], last, equal_nan=True)
    assert given[0][8:].isnan().all() and not given[-1].isnan().all()
