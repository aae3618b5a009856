"""Laws that every bonus obeys."""

from copy import deepcopy

import pytest
import torch

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.baselines import (
    ConstantBonus,
    HashCountBonus,
    ICMBonus,
    NearestNeighboursBonus,
)
from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.bonuses.dynamics import DynamicsEnsemble
from deep_curiosity.bonuses.marginal import NextStateMarginal
from deep_curiosity.bonuses.registry import BONUSES as BY_NAME
from deep_curiosity.bonuses.registry import make_bonus
from deep_curiosity.transitions import Transition

CURIOSITY = {"num_members": 2, "components": 16, "refresh_interval": 2}
SMALL = {"hidden_dims": (8,), "refresh_interval": 1}


def curiosity(members="all", **options):
    return CuriosityBonus.default(3, 2, hidden_dims=(8,), members=members, **CURIOSITY | options)


def curiosity_in_nats():
    dynamics = DynamicsEnsemble(3, 2, hidden_dims=(8,), num_members=2, members="all")
    marginal = NextStateMarginal(3, components=16)
    return CuriosityBonus(dynamics, marginal, center=False, scale=False, refresh_interval=2)


BONUSES = {
    "curiosity": curiosity,
    "curiosity, round-robin": lambda: curiosity("round_robin"),
    "curiosity in nats": curiosity_in_nats,
    "curiosity, tuned": lambda: curiosity(bandwidth="perplexity"),
    "curiosity, robust": lambda: curiosity(whitening="robust"),
    "curiosity about an entry": lambda: curiosity(features=(-1,)),
    "curiosity about features": lambda: curiosity(
        features=torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.Tanh())
    ),
    "information gain of curiosity": lambda: curiosity(bonus_parts={"information_gain": 1.0}),
    "constant": lambda: ConstantBonus(0.5),
    "disagreement": lambda: make_bonus("disagreement", 3, 2, num_members=2, **SMALL),
    "information-gain": lambda: make_bonus("information-gain", 3, 2, num_members=2, **SMALL),
    "rnd": lambda: make_bonus("rnd", 3, 2, random_features=8, **SMALL),
    "icm": lambda: make_bonus("icm", 3, 2, feature_dim=4, **SMALL),
    "prediction error": lambda: ICMBonus(3, 2, features="state", **SMALL),
    "nearest-neighbours": lambda: make_bonus(
        "nearest-neighbours", 3, 2, memory=64, neighbours=3, refresh_interval=1
    ),
    "hash-count": lambda: make_bonus("hash-count", 3, 2, bits=8, refresh_interval=1),
}


def test_laws_hold_for_every_bonus_by_name():
    assert set(BY_NAME) <= set(BONUSES)


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


def compute(bonus, batch):
    return bonus(batch.observation, batch.action, batch.next_observation)


def test_it_is_a_bonus(bonus):
    assert isinstance(bonus, Bonus)


@pytest.mark.parametrize("batch", [0, 1, 7])
def test_each_pair_has_one_finite_bonus(bonus, batch):
    value = compute(bonus, random_transition(batch))
    assert value.shape == (batch,) and value.isfinite().all() and value.dtype == torch.float32


def test_the_same_pairs_have_the_same_bonus(bonus):
    batch = random_transition()
    assert compute(bonus, batch).equal(compute(bonus, batch))


def test_a_pair_earns_the_same_in_any_company(bonus):
    if isinstance(bonus, CuriosityBonus) and bonus.dynamics.members == "round_robin":
        pytest.skip("which member answers depends on the place in the batch")
    batch = random_transition()
    alone = torch.cat(
        [compute(bonus, Transition(*(field[i : i + 1] for field in batch))) for i in range(16)]
    )
    torch.testing.assert_close(compute(bonus, batch), alone, atol=1e-4, rtol=1e-4)


def test_computing_it_samples_no_random_numbers(bonus):
    random_state = torch.get_rng_state()
    compute(bonus, random_transition_from(random_state))
    bonus.metrics()
    assert torch.get_rng_state().equal(random_state)


def random_transition_from(random_state):
    batch = random_transition()
    torch.set_rng_state(random_state)
    return batch


def test_computing_it_changes_no_state_and_leaves_no_gradient(bonus):
    before = {name: value.clone() for name, value in bonus.state_dict().items()}
    batch = random_transition()
    action = batch.action.clone().requires_grad_()
    value = compute(bonus, batch._replace(action=action))
    (value.sum() + 0 * action.sum()).backward()
    bonus.metrics()
    after = bonus.state_dict()
    assert all(torch.equal(after[name].nan_to_num(), before[name].nan_to_num()) for name in before)
    assert all(parameter.grad is None for parameter in bonus.parameters())


def test_loss_is_a_scalar_with_a_gradient_for_every_parameter(bonus):
    loss = bonus.loss(random_transition(256))
    assert loss.shape == () and loss.isfinite() and loss.requires_grad
    loss.backward()
    learned = [parameter for parameter in bonus.parameters() if parameter.requires_grad]
    assert all(parameter.grad.abs().sum() > 0 for parameter in learned)


def test_metrics_are_flat_detached_scalars(bonus):
    for name, value in bonus.metrics().items():
        assert isinstance(name, str) and value.shape == () and not value.requires_grad


def test_state_dict_is_all_there_is(make, bonus):
    copy = make()
    copy.load_state_dict(bonus.state_dict())
    batch, newer = random_transition(), random_transition()
    assert compute(copy, batch).equal(compute(bonus, batch))
    for one in (copy, bonus):
        torch.manual_seed(3)
        one.loss(newer)
        one.observe(newer)
    assert compute(copy, batch).equal(compute(bonus, batch))
    now, then = copy.metrics(), bonus.metrics()
    assert all(now[name].nan_to_num().equal(then[name].nan_to_num()) for name in then)


def test_the_same_seed_makes_the_same_bonus(make):
    answers = []
    for _ in range(2):
        torch.manual_seed(5)
        bonus = make()
        bonus.observe(random_transition())
        answers.append(compute(bonus, random_transition()))
    assert answers[0].equal(answers[1])


def test_it_can_be_observed_with_a_policy(bonus):
    bonus.observe(random_transition(), lambda observation: torch.zeros(observation.shape[0], 2))
    assert compute(bonus, random_transition()).isfinite().all()


def test_double_precision_goes_all_the_way(make):
    bonus = make().double()
    batch = Transition(*(f.double() if f.is_floating_point() else f for f in random_transition()))
    assert bonus.loss(batch).dtype == torch.float64
    bonus.observe(batch)
    assert compute(bonus, batch).dtype == torch.float64


def test_next_observations_are_required_by_name_or_left_aside(bonus):
    batch = random_transition()
    if bonus.scores_outcomes:
        with pytest.raises(ValueError, match="`next_observation` must be given"):
            bonus(batch.observation, batch.action)
    else:
        assert bonus(batch.observation, batch.action).equal(compute(bonus, batch))


def test_bonuses_of_predictions_have_a_gradient_in_the_action(make):
    bonus = make()
    if bonus.scores_outcomes or isinstance(bonus, ConstantBonus):
        pytest.skip("what has happened cannot be changed, and a constant does not change")
    for _ in range(3):
        bonus.observe(random_transition())
    action = torch.rand(16, 2).requires_grad_()
    bonus(torch.randn(16, 3), action).sum().backward()
    assert action.grad.abs().sum() > 0


@pytest.mark.parametrize("field", ["observation", "action", "next_observation"])
def test_what_is_not_finite_is_rejected_and_changes_nothing(bonus, field):
    if isinstance(bonus, ConstantBonus):
        pytest.skip("it looks at nothing")
    before = {name: value.clone() for name, value in bonus.state_dict().items()}
    broken = random_transition()
    getattr(broken, field)[3, 0] = float("nan")
    for method in (bonus.loss, bonus.observe):
        if method == bonus.observe and bonus.every.interval > 1:
            bonus.observe(random_transition())  # so that the next call looks at its batch
            before = {name: value.clone() for name, value in bonus.state_dict().items()}
        with pytest.raises(ValueError, match=f"`{field}` must be finite"):
            method(broken)
    after = bonus.state_dict()
    assert all(after[name].nan_to_num().equal(before[name].nan_to_num()) for name in before)


def state_of(bonus):
    return {name: value.clone() for name, value in bonus.state_dict().items()}


def test_a_batch_that_is_skipped_would_have_left_no_trace(make):
    bonus = make()
    skipping = deepcopy(bonus)
    num_shown = 0
    for _ in range(7):
        transition = random_transition()
        bonus.observe(transition)
        if skipping.should_skip:
            skipping.skip()
        else:
            skipping.observe(transition)
            num_shown += 1
        state, other = bonus.state_dict(), skipping.state_dict()
        torch.testing.assert_close(state, other, rtol=0, atol=0, equal_nan=True)
    interval = bonus.every.interval if hasattr(bonus, "every") else 7
    assert num_shown == (0 if isinstance(bonus, ConstantBonus) else -(-7 // interval))


@pytest.mark.parametrize("num_observed", range(4))
def test_to_ask_whether_to_skip_changes_nothing(make, num_observed):
    bonus = make()
    for _ in range(num_observed):
        bonus.observe(random_transition())
    before = state_of(bonus)
    answers = {bonus.should_skip for _ in range(10)}
    assert len(answers) == 1
    torch.testing.assert_close(state_of(bonus), before, rtol=0, atol=0, equal_nan=True)


def test_what_remembers_states_must_observe_before_it_is_ready(make):
    bonus, copy = make(), make()
    remembers = CuriosityBonus, NearestNeighboursBonus, HashCountBonus
    assert bonus.ready is not isinstance(bonus, remembers)
    bonus.observe(random_transition())
    assert bonus.ready
    copy.load_state_dict(bonus.state_dict())
    assert copy.ready
    assert compute(copy, random_transition()).isfinite().all()


def test_it_can_be_observed_with_where_the_agent_has_been_of_late(make):
    bonus, batch = make(), random_transition()
    bonus.observe(batch, visited=random_transition(9))
    bonus.observe(batch, lambda observation: torch.zeros(len(observation), 2), batch)
    assert compute(bonus, batch).isfinite().all()


def test_where_the_agent_has_been_of_late_matters_to_curiosity_and_counts_alone(make):
    bonus = make()
    other = deepcopy(bonus)
    batch, visited = random_transition(), random_transition()
    for one, late in ((bonus, None), (other, visited)):
        torch.manual_seed(2)
        one.observe(batch, visited=late)
    same = [
        value.nan_to_num().equal(other.state_dict()[name].nan_to_num())
        for name, value in bonus.state_dict().items()
    ]
    assert all(same) is not isinstance(bonus, CuriosityBonus | HashCountBonus)
