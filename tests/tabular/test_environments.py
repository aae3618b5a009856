import numpy as np
import pytest

from deep_curiosity.tabular.environments import (
    FLIP,
    LEFT,
    RIGHT,
    STAY,
    FiniteMDP,
    chain,
    clever_random,
    grid_world,
    random_mdp,
    reliable_unreliable,
)


def test_clever_random_flips_with_the_probability_of_the_action():
    mdp = clever_random(5)
    np.testing.assert_allclose(mdp.transition[0, :, 1], [0, 0.25, 0.5, 0.75, 1])
    np.testing.assert_allclose(mdp.transition[1, :, 0], [0, 0.25, 0.5, 0.75, 1])


def test_reliable_state_obeys_and_unreliable_state_does_not():
    transition = reliable_unreliable().transition
    assert transition[0, STAY, 0] == transition[0, FLIP, 1] == 1
    assert (transition[1] == 0.5).all()


def test_chain_pays_little_on_the_left_and_one_on_the_right():
    mdp = chain(3, slip=0.1, bait=0.2)
    np.testing.assert_array_equal(mdp.reward, [[0.2, 0], [0, 0], [0, 1]])
    np.testing.assert_allclose(mdp.transition[0, LEFT], [0.9, 0.1, 0])
    np.testing.assert_allclose(mdp.transition[1, RIGHT], [0.1, 0, 0.9])
    np.testing.assert_allclose(mdp.transition[2, RIGHT], [0, 0.1, 0.9])


def test_grid_moves_stops_at_walls_and_restarts_from_the_goal():
    mdp = grid_world(2, 3, slip=0.0)
    up, down, left, right = mdp.transition[0]
    np.testing.assert_array_equal(np.argmax([up, down, left, right], axis=1), [0, 3, 0, 1])
    np.testing.assert_array_equal(mdp.transition[-1].argmax(-1), [0, 0, 0, 0])
    assert (mdp.reward[-1] == 1).all() and mdp.reward[:-1].sum() == 0


def test_grid_slips_in_any_direction():
    mdp = grid_world(3, 3, slip=0.4)
    np.testing.assert_allclose(mdp.transition[4, 0, [1, 7, 3, 5]], [0.7, 0.1, 0.1, 0.1])


def test_same_seed_gives_the_same_mdp():
    first, second = (random_mdp(3, 2, np.random.default_rng(1)) for _ in range(2))
    np.testing.assert_array_equal(first.transition, second.transition)


def test_every_mdp_counts_its_states_and_actions():
    for mdp in (clever_random(), reliable_unreliable(), chain(), grid_world()):
        assert mdp.transition.shape == (mdp.num_states, mdp.num_actions, mdp.num_states)
        np.testing.assert_allclose(mdp.transition.sum(-1), 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transition": np.full((2, 1, 3), 1 / 3)}, r"`transition` must have shape \(2, 1, 2\)"),
        ({"transition": np.full((2, 1, 2), 0.4)}, "`transition` must sum to 1"),
        ({"reward": np.array([[0.0], [np.inf]])}, "`reward` must be finite, got inf"),
        ({"start": np.array([0.5, 0.6])}, "`start` must sum to 1"),
        ({"discount": 1.0}, "`discount` must lie in .*, got 1.0"),
    ],
)
def test_malformed_mdp_is_rejected(change, message):
    good = {
        "transition": np.full((2, 1, 2), 0.5),
        "reward": np.zeros((2, 1)),
        "start": np.array([0.5, 0.5]),
    }
    with pytest.raises(ValueError, match=message):
        FiniteMDP(**(good | change))


def test_too_small_an_mdp_is_rejected():
    for build in (lambda: clever_random(1), lambda: chain(1), lambda: grid_world(1, 1)):
        with pytest.raises(ValueError, match="must be at least 2, got 1"):
            build()


def test_an_environment_does_not_change_with_the_arrays_it_was_made_of():
    made_of = reliable_unreliable()
    arrays = made_of.transition.copy(), made_of.reward.copy(), made_of.start.copy()
    mdp = FiniteMDP(*arrays)
    for array in arrays:
        array += 1
    for name in ("transition", "reward", "start"):
        np.testing.assert_array_equal(getattr(mdp, name), getattr(made_of, name))
        with pytest.raises(ValueError, match="read-only"):
            getattr(mdp, name)[0] = 7
