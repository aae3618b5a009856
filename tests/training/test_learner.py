import numpy as np
import pytest

from deep_curiosity.training.learner import Learner


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, ["computed for 24", "learns"]),
        ({"curiosity_steps": 1, "reward_steps": 1}, ["computed for 8", "learns"]),
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
