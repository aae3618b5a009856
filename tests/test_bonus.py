"""Laws that every bonus obeys."""

import pytest
import torch

from deep_curiosity.baselines import ConstantBonus
from deep_curiosity.bonus import Bonus
from deep_curiosity.curiosity import CuriosityBonus
from deep_curiosity.transitions import Transition

OPTIONS = {"members": 2, "hidden_dims": (8,), "components": 16, "refresh_interval": 2}
BONUSES = {
    "curiosity": lambda: CuriosityBonus(3, 2, **OPTIONS),
    "curiosity in nats": lambda: CuriosityBonus(3, 2, center=False, scale=False, **OPTIONS),
    "curiosity, tuned": lambda: CuriosityBonus(3, 2, bandwidth="perplexity", **OPTIONS),
    "constant": lambda: ConstantBonus(0.5),
}


def random_transition(batch=16):
    observation = torch.randn(batch, 3)
    flag = torch.zeros(batch, dtype=torch.bool)
    return Transition(
        observation,
        torch.rand(batch, 2) * 2 - 1,
        torch.randn(batch),
        observation + 0.1 * torch.randn(batch, 3),
        flag,
        flag,
    )


@pytest.fixture(params=BONUSES)
def make(request):
    return BONUSES[request.param]


@pytest.fixture
def bonus(make):
    """A bonus in use."""
    bonus = make()
    for _ in range(3):
        bonus.loss(random_transition())
        bonus.observe(random_transition())
    return bonus


def ask(bonus, batch):
    return bonus(batch.observation, batch.action)


def test_it_is_a_bonus(bonus):
    assert isinstance(bonus, Bonus)


@pytest.mark.parametrize("batch", [1, 7])
def test_each_pair_has_one_finite_bonus(bonus, batch):
    value = ask(bonus, random_transition(batch))
    assert value.shape == (batch,) and value.isfinite().all() and value.dtype == torch.float32


def test_the_same_question_has_the_same_answer(bonus):
    batch = random_transition()
    assert ask(bonus, batch).equal(ask(bonus, batch))


def test_a_pair_earns_the_same_in_any_company(bonus):
    batch = random_transition()
    alone = torch.cat(
        [bonus(batch.observation[i : i + 1], batch.action[i : i + 1]) for i in range(16)]
    )
    torch.testing.assert_close(ask(bonus, batch), alone, atol=1e-4, rtol=1e-4)


def test_asking_draws_no_random_numbers(bonus):
    random_state = torch.get_rng_state()
    ask(bonus, random_transition_from(random_state))
    bonus.metrics()
    assert torch.get_rng_state().equal(random_state)


def random_transition_from(random_state):
    batch = random_transition()
    torch.set_rng_state(random_state)
    return batch


def test_asking_changes_no_state_and_leaves_no_gradient(bonus):
    before = {name: value.clone() for name, value in bonus.state_dict().items()}
    batch = random_transition()
    action = batch.action.clone().requires_grad_()
    value = bonus(batch.observation, action)
    (value.sum() + 0 * action.sum()).backward()
    bonus.metrics()
    after = bonus.state_dict()
    assert all(torch.equal(after[name].nan_to_num(), before[name].nan_to_num()) for name in before)
    assert all(parameter.grad is None for parameter in bonus.parameters())


def test_loss_is_a_scalar_with_a_gradient_for_every_parameter(bonus):
    loss = bonus.loss(random_transition(256))
    assert loss.shape == () and loss.isfinite() and loss.requires_grad
    loss.backward()
    assert all(parameter.grad.abs().sum() > 0 for parameter in bonus.parameters())


def test_metrics_are_flat_detached_scalars(bonus):
    for name, value in bonus.metrics().items():
        assert isinstance(name, str) and value.shape == () and not value.requires_grad


def test_state_dict_is_all_there_is(make, bonus):
    copy = make()
    copy.load_state_dict(bonus.state_dict())
    batch, newer = random_transition(), random_transition()
    assert ask(copy, batch).equal(ask(bonus, batch))
    for one in (copy, bonus):
        torch.manual_seed(3)
        one.loss(newer)
        one.observe(newer)
    assert ask(copy, batch).equal(ask(bonus, batch))
    now, then = copy.metrics(), bonus.metrics()
    assert all(now[name].nan_to_num().equal(then[name].nan_to_num()) for name in then)


def test_the_same_seed_makes_the_same_bonus(make):
    answers = []
    for _ in range(2):
        torch.manual_seed(5)
        bonus = make()
        bonus.observe(random_transition())
        answers.append(ask(bonus, random_transition()))
    assert answers[0].equal(answers[1])


def test_it_can_be_observed_with_a_policy(bonus):
    bonus.observe(random_transition(), lambda observation: torch.zeros(observation.shape[0], 2))
    assert ask(bonus, random_transition()).isfinite().all()


def test_double_precision_goes_all_the_way(make):
    bonus = make().double()
    batch = Transition(*(f.double() if f.is_floating_point() else f for f in random_transition()))
    assert bonus.loss(batch).dtype == torch.float64
    bonus.observe(batch)
    assert ask(bonus, batch).dtype == torch.float64
