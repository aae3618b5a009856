import jaxtyping
import pytest
import torch

from deep_curiosity.bonuses import BONUSES, BonusLearner, make_bonus
from deep_curiosity.bonuses.frozen import FrozenBonus
from deep_curiosity.transitions import Transition


def batch(size=32):
    flags = torch.zeros(size, dtype=torch.bool)
    observation = torch.randn(size, 3)
    action = torch.rand(size, 2) * 2 - 1
    return Transition(
        observation, action, torch.zeros(size), observation + torch.randn(size, 3), flags, flags
    )


def shown(name):
    bonus = make_bonus(name, 3, 2, hidden_dims=(8,))
    for _ in range(3):
        bonus.observe(batch())
    return bonus


@pytest.mark.parametrize("name", BONUSES)
def test_a_learner_leaves_it_as_it_was(name):
    bonus = shown(name)
    observation, action, _, next_observation, *_ = batch()
    expected = bonus(observation, action, next_observation).detach()
    frozen = FrozenBonus(bonus)
    learner = BonusLearner(frozen)
    before = {key: value.clone() for key, value in frozen.state_dict().items()}
    for _ in range(50):
        learner.learn(batch())
    for key, value in frozen.state_dict().items():
        torch.testing.assert_close(value, before[key], rtol=0, atol=0, equal_nan=True)
    torch.testing.assert_close(frozen(observation, action, next_observation), expected)
    assert frozen.ready and frozen.should_skip
    assert frozen.scores_outcomes == bonus.scores_outcomes
    assert frozen.metrics().keys() == bonus.metrics().keys()
    assert not [each for each in frozen.parameters() if each.requires_grad]


def test_the_gradient_in_the_action_is_the_bonus_own():
    bonus = shown("curiosity")
    observation, action, *_ = batch()
    gradients = []
    for each in (bonus, FrozenBonus(bonus)):
        asked = action.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(each(observation, asked).sum(), asked)
        gradients.append(gradient)
    assert gradients[0].abs().max() > 0
    torch.testing.assert_close(*gradients)


@pytest.mark.parametrize("name", BONUSES)
def test_it_never_changes_though_the_other_learns_on(name):
    bonus = shown(name)
    frozen, learner = FrozenBonus(bonus), BonusLearner(bonus)
    observation, action, _, next_observation, *_ = batch()
    expected = frozen(observation, action, next_observation)
    for _ in range(25):
        learner.learn(batch())
    assert frozen(observation, action, next_observation).equal(expected)
    assert not bonus(observation, action, next_observation).equal(expected)


@pytest.mark.parametrize("other", [None, torch.nn.Linear(3, 1)])
def test_what_is_no_bonus_is_refused_by_name_and_left_as_it_was(other):
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    kind = type(other).__name__
    with pytest.raises(TypeError, match=f"`bonus` must be a Bonus, got {kind}"):
        FrozenBonus(other)
    assert other is None or other.weight.requires_grad


def test_one_that_has_seen_nothing_is_not_ready():
    assert not FrozenBonus(make_bonus("curiosity", 3, 2, hidden_dims=(8,))).ready


@pytest.mark.parametrize("name", BONUSES)
def test_its_loss_is_a_zero_that_can_be_differentiated(name):
    frozen = FrozenBonus(shown(name))
    loss = frozen.loss(batch())
    loss.backward()
    assert loss.item() == 0
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(TypeError, match="`transition` must be a Transition, got tuple"):
        frozen.loss(tuple(batch()))


def test_it_stays_in_evaluation():
    frozen = FrozenBonus(shown("rnd"))
    torch.nn.ModuleList([frozen]).train()
    assert not any(part.training for part in frozen.modules())
