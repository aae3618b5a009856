import numpy as np
import pytest

from deep_curiosity_envs import CleverRandom, ReliableUnreliable


@pytest.mark.parametrize("illustration", [CleverRandom, ReliableUnreliable])
@pytest.mark.parametrize(
    ("action", "rule"),
    [
        ([np.nan], "be finite"),
        ([np.inf], "be finite"),
        ([0.5, 0.5], r"have shape \(1,\)"),
        (0.5, r"have shape \(1,\)"),
        (["often"], "hold real numbers"),
    ],
    ids=str,
)
def test_what_is_no_action_is_refused_and_flips_nothing(illustration, action, rule):
    env = illustration()
    env.reset(seed=0)
    state, random = env.state, env.np_random.bit_generator.state
    with pytest.raises(ValueError, match=f"`action` must {rule}, got "):
        env.step(np.array(action))
    assert env.state == state
    assert env.np_random.bit_generator.state == random


def test_actions_beyond_the_box_are_clipped():
    env = CleverRandom()
    env.reset(seed=0)
    states = [env.state, *(int(env.step(np.array([each]))[0][0]) for each in (7.0, -7.0, 7.0))]
    assert states in ([0, 1, 1, 0], [1, 0, 0, 1])
