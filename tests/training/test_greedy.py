import numpy as np
import pytest
import torch

from deep_curiosity.training.config import Config
from deep_curiosity.training.greedy import GreedyEpisodes
from deep_curiosity.training.learner import Learner


def test_as_many_episodes_are_greedy_as_asked_and_an_episode_stays_what_it_is():
    torch.manual_seed(0)
    episodes, seen = GreedyEpisodes(2, 0.25), []
    assert not episodes.is_greedy.any()
    for _ in range(2_000):
        before = episodes.is_greedy.copy()
        episodes.record(np.array([True, False]))
        assert episodes.is_greedy[1] == before[1]
        seen.append(episodes.is_greedy[0])
    assert np.mean(seen) == pytest.approx(0.25, abs=0.03)


def test_without_a_share_none_is_greedy_and_no_random_number_is_taken():
    before = torch.get_rng_state()
    episodes = GreedyEpisodes(1, 0.0)
    episodes.record(np.array([True]))
    assert not episodes.is_greedy.any()
    assert torch.get_rng_state().equal(before)


def test_a_resumed_run_knows_which_episodes_are_greedy():
    episodes, other = GreedyEpisodes(3, 0.5), GreedyEpisodes(3, 0.5)
    episodes.is_greedy[:] = [True, False, True]
    other.load_state_dict(episodes.state_dict())
    assert (other.is_greedy == episodes.is_greedy).all()


@pytest.mark.parametrize("numpy_policy", [True, False])
@pytest.mark.parametrize("num_envs", [1, 2])
def test_in_a_greedy_episode_the_greedy_policy_acts(numpy_policy, num_envs):
    config = Config.of(hidden_dim=8, numpy_policy=numpy_policy, num_envs=num_envs)
    learner = Learner(config, 3, 2)
    layer = learner.agent.policy.network.layers[-1]
    with torch.no_grad():
        layer.weight.zero_()
        layer.bias[:] = torch.tensor([[[2.0, 2.0, -9.0, -9.0]], [[-2.0, -2.0, -9.0, -9.0]]])
    observation = np.zeros((num_envs, 3))
    assert (learner.act(observation) < 0).all()
    learner.greedy_episodes.is_greedy[0] = True
    action = learner.act(observation)
    assert (action[0] > 0).all() and (action[1:] < 0).all()
    evaluated = learner.evaluation_policy(torch.zeros(1, 3), {})
    torch.testing.assert_close(evaluated, torch.tanh(torch.full((1, 2), 2.0)))
