from copy import deepcopy

import jaxtyping
import pytest
import torch

from deep_curiosity.bonuses import BonusLearner
from deep_curiosity.bonuses.baselines import ConstantBonus
from deep_curiosity.bonuses.registry import make_bonus
from deep_curiosity.transitions import Transition


def transition(batch=32):
    flag = torch.zeros(batch, dtype=torch.bool)
    observation = torch.randn(batch, 3)
    action = torch.rand(batch, 2) * 2 - 1
    return Transition(observation, action, torch.randn(batch), observation + 0.1, flag, flag)


def small(**options):
    bonus = make_bonus("disagreement", 3, 2, hidden_dims=(8,), refresh_interval=1)
    return BonusLearner(bonus, **options)


def test_learning_lowers_the_loss():
    learner, batch = small(learning_rate=1e-2), transition()
    learner.bonus.observe(batch)
    losses = [learner.step(batch) for _ in range(30)]
    assert losses[-1] < 0.5 * losses[0]


def test_gradient_steps_keep_their_own_pace():
    learner = small(update_interval=3)
    changed = []
    for _ in range(7):
        before = learner.bonus.ensemble.network.layers[0].weight.clone()
        learner.learn(transition())
        changed.append(not before.equal(learner.bonus.ensemble.network.layers[0].weight))
    assert changed == [True, False, False, True, False, False, True]


def test_it_learns_where_gradients_are_switched_off():
    learner = small()
    before = learner.bonus.ensemble.network.layers[0].weight.clone()
    with torch.no_grad():
        learner.learn(transition())
    assert not before.equal(learner.bonus.ensemble.network.layers[0].weight)


def test_a_bonus_with_nothing_to_learn_needs_no_optimiser():
    learner = BonusLearner(ConstantBonus(0.5))
    learner.learn(transition())
    assert learner.compute(transition()).tolist() == [0.5] * 32


def test_its_state_is_all_there_is():
    learner, copy, batch = small(update_interval=2), small(update_interval=2), transition()
    for _ in range(3):
        learner.learn(batch)
    copy.load_state_dict(learner.state_dict())
    for one in (learner, copy):
        one.learn(batch)
    assert learner.compute(batch).equal(copy.compute(batch))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"learning_rate": 0.0}, "`learning_rate` must be positive and finite, got 0.0"),
        ({"update_interval": 0}, "`update_interval` must be at least 1, got 0"),
    ],
)
def test_what_is_out_of_range_is_rejected(options, message):
    with pytest.raises(ValueError, match=message):
        small(**options)


def test_a_learner_goes_on_from_parameters_that_were_assigned_to_it():
    torch.manual_seed(0)
    first, second = (BonusLearner(make_bonus("rnd", 3, 2, hidden_dims=(8,))) for _ in range(2))
    batch = transition()
    first.learn(batch)
    second.load_state_dict(deepcopy(first.state_dict()), assign=True)
    for learner in (first, second):
        learner.learn(batch)
    assert first.optimizer.count == second.optimizer.count == 2
    for name, value in second.state_dict().items():
        assert value.equal(first.state_dict()[name])


def test_actions_in_another_unit_are_told_of_once():
    learner = BonusLearner(make_bonus("curiosity", 2, 1, hidden_dims=(8,), refresh_interval=1))
    flag = torch.zeros(16, dtype=torch.bool)

    def batch(action):
        state = torch.randn(16, 2)
        return Transition(state, torch.full((16, 1), action), torch.zeros(16), state, flag, flag)

    learner.learn(batch(1.0))
    with pytest.warns(UserWarning, match=r"`action` should lie in \[-1, 1\], got 100: bring"):
        learner.learn(batch(-100.0))
    learner.learn(batch(-100.0))


def test_fresh_actions_in_another_unit_are_told_of_once():
    bonus = make_bonus("curiosity", 3, 2, hidden_dims=(8,), refresh_interval=1)
    learner = BonusLearner(bonus)
    learner.learn(transition(), lambda observation: torch.ones(len(observation), 2))
    with pytest.warns(UserWarning, match=r"`action` should lie in \[-1, 1\], got 50: .*`policy`"):
        learner.learn(transition(), lambda observation: torch.full((len(observation), 2), -50.0))
    learner.learn(transition(), lambda observation: torch.full((len(observation), 2), -50.0))


def test_it_cannot_learn_in_inference_mode_and_says_so():
    learner = small()
    before = deepcopy(learner.state_dict())
    with torch.inference_mode():
        for learn in (learner.learn, learner.step):
            with pytest.raises(RuntimeError, match="`learn` must be called outside of"):
                learn(transition())
        BonusLearner(ConstantBonus(0.5)).learn(transition())  # has nothing to learn
    for name, value in learner.state_dict().items():
        torch.testing.assert_close(value, before[name], rtol=0, atol=0, equal_nan=True)


def test_a_plain_tuple_is_no_transition():
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(TypeError, match="`transition` must be a Transition, got tuple"):
        small().learn(tuple(transition()))
