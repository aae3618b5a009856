import math
from copy import deepcopy

import jaxtyping
import numpy as np
import pytest
import torch
from torch import nn

from deep_curiosity.bonuses.curiosity import CuriosityBonus, Decomposition, check_entries
from deep_curiosity.bonuses.decomposition import PARTS
from deep_curiosity.bonuses.dynamics import DynamicsEnsemble
from deep_curiosity.bonuses.marginal import NextStateMarginal
from deep_curiosity.gaussians import DiagonalMixture, kl_to_mixture_sampled
from deep_curiosity.transitions import Transition

OF_DYNAMICS = ("num_members", "members", "mixture_components", "noise_floor", "features")
SMALL = {"num_members": 3, "members": "all", "hidden_dims": (16,), "refresh_interval": 1}


def random_transition(batch=32, observation_dim=3, action_dim=2):
    observation = torch.randn(batch, observation_dim)
    action = torch.rand(batch, action_dim) * 2 - 1
    next_observation = observation + 0.1 * torch.randn(batch, observation_dim)
    flag = torch.zeros(batch, dtype=torch.bool)
    return Transition(observation, action, torch.randn(batch), next_observation, flag, flag)


def small_bonus(observation_dim=3, action_dim=2, *, components=32, **options):
    """A bonus with a dynamics and a marginal of its own, by the names of their arguments."""
    options = SMALL | options
    of_dynamics = {name: options.pop(name) for name in OF_DYNAMICS if name in options}
    of_marginal = {"bandwidth": options.pop("bandwidth")} if "bandwidth" in options else {}
    dynamics = DynamicsEnsemble(
        observation_dim, action_dim, hidden_dims=options.pop("hidden_dims"), **of_dynamics
    )
    entries = options.get("entries")
    dim = dynamics.predicted_dim if entries is None else max(len(entries), 1)
    marginal = NextStateMarginal(dim, components=components, **of_marginal)
    return CuriosityBonus(dynamics, marginal, **options)


def scored(bonus, batch):
    """Bonus of the rows of a first batch that are no components, by the members that had them."""
    members = bonus.dynamics.members
    bonus.dynamics.members = "all"
    value = bonus(batch.observation, batch.action)[1::2]
    bonus.dynamics.members = members
    return value


def watchful_bonus(**options):
    """A bonus that has observed a batch, and the batch."""
    bonus, batch = small_bonus(**options), random_transition()
    bonus.observe(batch)
    return bonus, batch


class FixedDynamics(nn.Module):
    """Members whose answer is the action times a slope of each, of one width."""

    noise_floor = 0.05

    round_robin = DynamicsEnsemble.round_robin

    def __init__(self, slopes, std=0.1, members="all"):
        super().__init__()
        self.slopes, self.log_std = torch.tensor(slopes), math.log(std)
        self.num_members, self.members = len(slopes), members

    def forward(self, observation, action):
        loc = (self.slopes.view(-1, 1, 1) * action).unsqueeze(-2)
        log_var = torch.full_like(loc, 2 * self.log_std)
        return DiagonalMixture(loc, log_var, torch.zeros(loc.shape[:-1]))

    def check_features(self, observation):
        pass

    def observe(self, transition):
        pass

    def metrics(self):
        return {}


def bonus_of(*slopes, dim=2, members="all", **options):
    """A bonus about an environment of known answers, with observations as long as actions."""
    bonus = small_bonus(dim, dim, **options)
    bonus.dynamics = FixedDynamics(slopes, members=members)
    return bonus


def copied(state):
    return {name: value.clone() for name, value in state.items()}


def assert_unchanged(module, before):
    now = module.state_dict()
    assert all(value.equal(before[name]) or value.isnan().all() for name, value in now.items())


def test_bonus_is_zero_when_every_member_predicts_the_marginal():
    bonus = bonus_of(0.0, 0.0)
    batch = random_transition(16, 2, 2)
    bonus.observe(batch)
    nats = bonus.nats(batch.observation, batch.action)
    torch.testing.assert_close(nats, torch.zeros(16), atol=1e-6, rtol=0)
    assert bonus(batch.observation, batch.action).abs().max() < 1e-2


def test_bonus_of_known_answers_is_the_mean_divergence_of_the_members():
    bonus = bonus_of(1.0, 3.0)
    batch = random_transition(16, 2, 2)
    bonus.observe(batch)
    prediction = bonus.dynamics(batch.observation, batch.action)
    members = [DiagonalMixture(*(field[i] for field in prediction)) for i in range(2)]
    expected = torch.stack([bonus.marginal.kl_upper(member) for member in members]).mean(0)
    torch.testing.assert_close(bonus.nats(batch.observation, batch.action), expected)


def test_where_one_seldom_ends_up_the_bonus_is_larger():
    bonus = bonus_of(1.0, 1.0)
    batch = random_transition(64, 2, 2)
    batch = batch._replace(action=0.05 * batch.action)
    bonus.observe(batch)
    usual, rare = torch.zeros(1, 2), torch.ones(1, 2)
    assert bonus(usual, rare).item() > bonus(usual, usual).item() + 0.1


def test_standardised_bonus_has_mean_zero_and_the_weight_as_deviation():
    bonus, batch = watchful_bonus(weight=0.3)
    value = scored(bonus, batch)
    assert value.mean().item() == pytest.approx(0, abs=1e-4)
    assert value.std(correction=0).item() == pytest.approx(0.3, rel=1e-3)


def test_it_is_so_over_all_data_and_not_on_the_components_alone():
    torch.manual_seed(0)
    data = random_transition(4_000)
    bonus = small_bonus(components=256, weight=1.0, refresh_interval=1)
    for _ in range(30):
        rows = torch.randint(4_000, (128,))
        bonus.observe(Transition(*(field[rows] for field in data)))
    value = bonus(data.observation, data.action)
    assert value.mean().item() == pytest.approx(0, abs=0.1)
    assert value.std().item() == pytest.approx(1, abs=0.1)


def test_what_is_scored_is_no_component_until_the_next_renewal():
    bonus = bonus_of(1.0, 1.0, components=128, refresh_interval=1)
    batches = [random_transition(32, 2, 2) for _ in range(3)]
    for number, batch in enumerate(batches):
        bonus.observe(batch)
        components = bonus.marginal.loc[: bonus.marginal.num_seen]
        asked = batch.action[1::2] if number == 0 else batch.action
        assert not torch.isin(asked, components).any()
    earlier = torch.cat([batch.action for batch in batches[:2]])
    assert torch.isin(earlier, components).all()


def test_behind_a_first_batch_of_one_the_next_is_due_at_once():
    """One row cannot be both component and scored, and without statistics there is no bonus."""
    bonus, batch = small_bonus(refresh_interval=20), random_transition()
    bonus.observe(random_transition(1))
    assert bonus.ready and bonus(batch.observation, batch.action).tolist() == [0.0] * 32
    assert not bonus.should_skip
    bonus.observe(batch)
    assert bonus.should_skip and bonus(batch.observation, batch.action).std() > 0.05


def test_no_tail_earns_more_than_five_deviations():
    bonus, batch = watchful_bonus(weight=1.0)
    far = 1e4 * batch.observation
    assert bonus(far, batch.action).abs().max() <= 5 + 1e-5


def test_weight_is_a_tenth_by_default():
    bonus, batch = watchful_bonus()
    assert scored(bonus, batch).std(correction=0).item() == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize("center", [True, False])
@pytest.mark.parametrize("scale", [True, False])
def test_centring_and_scaling_are_switches(center, scale):
    bonus, batch = watchful_bonus(center=center, scale=scale, weight=0.5)
    nats = bonus.nats(batch.observation, batch.action)
    mean, std = nats[1::2].mean().item(), nats[1::2].std(correction=0).item()
    nats = nats if not (center or scale) else nats.clamp(mean - 5 * std, mean + 5 * std)
    assert abs(mean) > 0.1 and abs(std - 1) > 0.05  # so that neither switch is idle
    expected = 0.5 * (nats - mean * center) / (std if scale else 1)
    torch.testing.assert_close(
        bonus(batch.observation, batch.action), expected, atol=1e-3, rtol=1e-3
    )


def test_bonus_is_differentiable_in_the_action():
    torch.manual_seed(1)
    bonus = small_bonus(noise_floor=0.5).double()
    batch = random_transition(8)
    batch = Transition(*(f.double() if f.is_floating_point() else f for f in batch))
    bonus.observe(batch)
    action = batch.action[:3].clone().requires_grad_()
    observation = batch.observation[:3].clone().requires_grad_()
    assert torch.autograd.gradcheck(bonus, (observation, action))
    bonus(observation, action).sum().backward()
    assert action.grad.abs().min() > 0


def test_bonus_gives_no_gradient_to_the_models():
    bonus, batch = watchful_bonus()
    action = batch.action.clone().requires_grad_()
    bonus(batch.observation, action).sum().backward()
    assert all(parameter.grad is None for parameter in bonus.parameters())
    assert all(parameter.requires_grad for parameter in bonus.parameters())


def test_bonus_leaves_the_state_dict_unchanged():
    bonus, batch = watchful_bonus()
    before = copied(bonus.state_dict())
    bonus(batch.observation, batch.action)
    bonus.nats(batch.observation, batch.action)
    bonus.decompose(batch.observation, batch.action)
    bonus.metrics()
    assert_unchanged(bonus, before)


def test_loss_reaches_every_parameter():
    bonus = small_bonus()
    bonus.loss(random_transition(256)).backward()
    assert all(parameter.grad.abs().sum() > 0 for parameter in bonus.parameters())


def test_parts_add_up_to_the_total():
    bonus, batch = watchful_bonus()
    for _ in range(5):
        noise = torch.randn(8, 3, 32, 1, 3)
        power, gain, total, cross, entropy = bonus.decompose(
            batch.observation, batch.action, noise
        )
        torch.testing.assert_close(power + gain, total, atol=1e-4, rtol=0)
        torch.testing.assert_close(cross - entropy, total, atol=1e-4, rtol=0)


def test_information_gain_of_equal_members_is_zero():
    bonus = bonus_of(1.0, 1.0, 1.0)
    batch = random_transition(16, 2, 2)
    bonus.observe(batch)
    parts = bonus.decompose(batch.observation, batch.action)
    torch.testing.assert_close(parts.information_gain, torch.zeros(16), atol=1e-5, rtol=0)
    assert parts.predictive_power.mean() > 0.1


def test_information_gain_of_two_members_far_apart_is_one_bit():
    bonus = bonus_of(-5.0, 5.0)
    batch = random_transition(16, 2, 2)
    batch = batch._replace(action=torch.full((16, 2), 0.8))
    bonus.observe(batch)
    parts = bonus.decompose(batch.observation, batch.action)
    torch.testing.assert_close(parts.information_gain, torch.full((16,), math.log(2)))


def test_members_that_never_agree_with_where_they_lead_have_power_but_no_gain():
    bonus = bonus_of(2.0, 2.0)
    batch = random_transition(32, 2, 2)
    bonus.observe(batch)
    parts = bonus.decompose(batch.observation, batch.action, torch.randn(500, 2, 32, 1, 2))
    assert parts.predictive_power.mean() > 1 > 1e-4 > parts.information_gain.abs().max()


def test_total_is_the_sampled_divergence_averaged_over_members():
    bonus, batch = watchful_bonus()
    noise = torch.randn(8, 3, 32, 1, 3)
    loc, log_var, _ = bonus.dynamics(batch.observation, batch.action)
    marginal = bonus.marginal
    expected = kl_to_mixture_sampled(
        loc,
        log_var,
        marginal.loc,
        marginal.component_log_var,
        marginal.log_weight,
        samples=loc + (0.5 * log_var).exp() * noise,
    )
    total = bonus.decompose(batch.observation, batch.action, noise).total
    torch.testing.assert_close(total, expected.mean(0).squeeze(-1), atol=1e-4, rtol=1e-4)


def test_parts_are_positive_and_the_bonus_bounds_their_sum():
    bonus, batch = watchful_bonus()
    noise = torch.randn(400, 3, 32, 1, 3)
    parts = bonus.decompose(batch.observation, batch.action, noise)
    assert parts.predictive_power.mean() > 0 and parts.information_gain.mean() > 0
    assert parts.total.mean() <= bonus.nats(batch.observation, batch.action).mean() + 0.05


def noisy_and_rare_transitions(batch):
    """Nine actions in ten lead to pure noise, the rest to one place."""
    observation = 0.1 * torch.randn(batch, 2)
    action = torch.rand(batch, 1) * 2 - 1
    place = torch.tensor([2.0, -2.0]) + 0.05 * torch.randn(batch, 2)
    next_observation = torch.where(action > 0.8, place, torch.randn(batch, 2))
    flag = torch.zeros(batch, dtype=torch.bool)
    return Transition(observation, action, torch.zeros(batch), next_observation, flag, flag)


def test_pure_noise_earns_nothing_once_its_variance_is_learned():
    bonus = small_bonus(
        2,
        1,
        num_members=2,
        hidden_dims=(32, 32),
        components=256,
        refresh_interval=10,
        center=False,
        scale=False,
    )
    optimizer = torch.optim.Adam(bonus.parameters(), lr=5e-3, fused=True)
    batch = noisy_and_rare_transitions(5_000)
    bonus.observe(batch)
    for _ in range(300):
        rows = torch.randint(5_000, (256,))
        optimizer.zero_grad()
        bonus.loss(Transition(*(field[rows] for field in batch))).backward()
        optimizer.step()
    bonus.observe(batch)
    bonus.every.interval = 1
    bonus.observe(batch)
    observation = torch.zeros(50, 2)
    noise = bonus.nats(observation, torch.linspace(-0.9, 0.6, 50).unsqueeze(-1))
    place = bonus.nats(observation, torch.full((50, 1), 0.95))
    assert noise.mean().item() < 0.5
    assert place.mean().item() > 2 > 4 * noise.mean().item()


def trained_one_step(bonus, optimizer, batch):
    optimizer.zero_grad()
    bonus.loss(batch).backward()
    optimizer.step()
    bonus.observe(batch)


def test_a_bonus_restored_from_its_state_dict_goes_on_bit_for_bit():
    bonus, copy = small_bonus(refresh_interval=3), small_bonus(refresh_interval=3)
    optimizer = torch.optim.Adam(bonus.parameters(), fused=True)
    copied_optimizer = torch.optim.Adam(copy.parameters(), fused=True)
    for _ in range(4):
        trained_one_step(bonus, optimizer, random_transition())
    copy.load_state_dict(bonus.state_dict())
    copied_optimizer.load_state_dict(deepcopy(optimizer.state_dict()))
    for one, its_optimizer in ((bonus, optimizer), (copy, copied_optimizer)):
        torch.manual_seed(1)
        for _ in range(5):
            trained_one_step(one, its_optimizer, random_transition())
    probe = random_transition()
    assert copy(probe.observation, probe.action).equal(bonus(probe.observation, probe.action))
    assert_unchanged(copy, bonus.state_dict())


def test_marginal_is_refreshed_at_every_interval_only():
    bonus = small_bonus(refresh_interval=3)
    refreshed = []
    for _ in range(8):
        before = bonus.marginal.loc.clone()
        bonus.observe(random_transition())
        refreshed.append(not bonus.marginal.loc.equal(before))
    assert refreshed == [True, False, False, True, False, False, True, False]


def test_all_components_are_predicted_anew_at_every_renewal():
    bonus = small_bonus(refresh_interval=1, components=64)
    bonus.observe(random_transition(64)), bonus.observe(random_transition(64))
    before = bonus.marginal.loc.clone()
    with torch.no_grad():
        bonus.dynamics.network.layers[-1].bias.add_(1.0)
    bonus.observe(random_transition(1))
    assert (bonus.marginal.loc != before).all()


def test_whitening_is_renewed_with_the_marginal():
    bonus = small_bonus(refresh_interval=2)
    counts = []
    for _ in range(5):
        bonus.observe(random_transition(32))
        counts.append(bonus.dynamics.observation_moments.count.item())
    assert counts == [32, 32, 64, 64, 96]


def test_the_marginal_follows_the_policy():
    batch = random_transition(32, 2, 2)
    usual, fresh = bonus_of(1.0, 1.0), bonus_of(1.0, 1.0)
    usual.observe(batch)
    fresh.observe(batch, lambda observation: observation.tanh() + 7)
    assert usual.marginal.loc[:16].equal(batch.action[::2])
    assert fresh.marginal.loc[:16].equal(batch.observation[::2].tanh() + 7)


def test_every_member_has_its_say_in_the_marginal():
    bonus = bonus_of(1.0, 2.0, 4.0)
    batch = random_transition(30, 2, 2)._replace(action=torch.ones(30, 2))
    bonus.observe(batch), bonus.observe(batch)
    values, counts = bonus.marginal.loc[:30, 0].unique(return_counts=True)
    assert values.tolist() == [1, 2, 4] and counts.tolist() == [10, 10, 10]


def spoiled(name, bad):
    batch = random_transition()
    value = getattr(batch, name).clone()
    value[3, 1] = bad
    return batch._replace(**{name: value})


BAD_BATCHES = {
    "nan observation": lambda: spoiled("observation", math.nan),
    "infinite observation": lambda: spoiled("observation", math.inf),
    "nan action": lambda: spoiled("action", math.nan),
    "nan next observation": lambda: spoiled("next_observation", math.nan),
    "infinite next observation": lambda: spoiled("next_observation", -math.inf),
    "observation too long": lambda: random_transition(observation_dim=4),
    "action too long": lambda: random_transition(action_dim=3),
    "action too short": lambda: random_transition(action_dim=1),
    "whole numbers": lambda: random_transition()._replace(action=torch.zeros(32, 2).long()),
    "double precision": lambda: Transition(
        *(f.double() if f.is_floating_point() else f for f in random_transition())
    ),
    "empty": lambda: random_transition(0),
    "rows missing": lambda: random_transition()._replace(action=torch.zeros(31, 2)),
}


@pytest.mark.parametrize("reason", BAD_BATCHES)
def test_a_bad_batch_is_rejected_and_changes_nothing(reason):
    bonus, _ = watchful_bonus()
    before = copied(bonus.state_dict())
    with pytest.raises((ValueError, TypeError)):
        bonus.observe(BAD_BATCHES[reason]())
    assert_unchanged(bonus, before)


BAD_POLICIES = {
    "too long": lambda observation: torch.zeros(observation.shape[0], 3),
    "rows missing": lambda observation: torch.zeros(1, 2),
    "nan": lambda observation: torch.full((observation.shape[0], 2), math.nan),
    "absurd": lambda observation: torch.full((observation.shape[0], 2), 1e13),
}


@pytest.mark.parametrize("reason", BAD_POLICIES)
@pytest.mark.parametrize("watchful", [True, False])
def test_a_bad_policy_is_rejected_and_changes_nothing(reason, watchful):
    bonus, batch = watchful_bonus() if watchful else (small_bonus(), random_transition())
    before = copied(bonus.state_dict())
    with pytest.raises((ValueError, TypeError), match=r"`policy\(observation\)` must"):
        bonus.observe(batch, BAD_POLICIES[reason])
    assert_unchanged(bonus, before)


def test_an_error_names_argument_rule_and_value():
    bonus, _ = watchful_bonus()
    with pytest.raises(
        ValueError, match=r"`observation` must be finite, got \[.*nan.*\] in row 3"
    ):
        bonus.observe(BAD_BATCHES["nan observation"]())
    with pytest.raises(ValueError, match=r"`action` must have shape \(batch, 2\), got \(32, 3\)"):
        bonus.observe(BAD_BATCHES["action too long"]())


@pytest.mark.parametrize("question", ["forward", "nats", "decompose"])
def test_nothing_can_be_computed_before_anything_is_observed(question):
    batch = random_transition()
    with pytest.raises(RuntimeError, match="`observe`"):
        getattr(small_bonus(), question)(batch.observation, batch.action)


def test_a_pair_of_wrong_shape_is_rejected():
    bonus, batch = watchful_bonus()
    with pytest.raises(ValueError, match=r"`action` must have shape \(batch, 2\), got \(32, 3\)"):
        bonus(batch.observation, torch.zeros(32, 3))
    with pytest.raises(ValueError, match=r"`observation` must have shape \(batch, 3\)"):
        bonus(torch.zeros(32, 4), batch.action)


def test_metrics_are_flat_and_leave_the_random_stream_alone():
    bonus, batch = watchful_bonus()
    bonus.loss(batch)
    random_state = torch.get_rng_state()
    metrics = bonus.metrics()
    assert torch.get_rng_state().equal(random_state)
    for name, value in metrics.items():
        assert value.ndim == 0 and not value.requires_grad, name
        assert name.startswith("model_") or value.isfinite(), name
    assert bonus.metrics()["information_gain"].equal(metrics["information_gain"])


def test_metrics_agree_with_what_they_summarise():
    bonus = bonus_of(1.0, 3.0)
    batch = random_transition(64, 2, 2)
    bonus.observe(batch)
    metrics = bonus.metrics()
    nats = bonus.nats(batch.observation, batch.action)
    torch.testing.assert_close(metrics["nats"], nats.mean())
    std = nats[1::2].std(correction=0)
    torch.testing.assert_close(metrics["nats_std"], std, rtol=1e-4, atol=1e-4)
    total = metrics["predictive_power"] + metrics["information_gain"]
    assert metrics["nats"] - metrics["bound_gap"] - 0.2 < total < metrics["nats"] + 0.2
    torch.testing.assert_close(
        metrics["conditional_entropy"],
        torch.tensor(math.log(2 * math.pi * math.e) + 2 * math.log(0.1)),
    )
    torch.testing.assert_close(
        metrics["cross_entropy"] - metrics["conditional_entropy"], metrics["nats"]
    )
    assert metrics["floor_share"].item() == pytest.approx(0.25)  # (0.05 / 0.1)^2
    assert metrics["bound_gap"] >= 0
    assert 1 <= metrics["marginal_perplexity"] <= 32
    assert 0 < metrics["information_lower"] <= math.log(32)
    assert metrics["information_lower"] < metrics["information_upper"]


def test_metrics_before_the_first_batch_are_those_of_the_models():
    assert set(small_bonus().metrics()) == {"model_held_out_nll", "model_coverage_90"}


def test_metrics_keep_their_values():
    """A logger may write them later, when the bonus has moved on."""
    bonus, _ = watchful_bonus()
    bonus.loss(random_transition(400))
    metrics = bonus.metrics()
    before = copied(metrics)
    for _ in range(3):
        bonus.loss(random_transition(400))
        bonus.observe(random_transition())
    assert all(value.equal(before[name]) for name, value in metrics.items())


def test_the_five_lines_of_the_docstring_run_in_a_loop_of_ones_own():
    bonus = CuriosityBonus.default(3, 2, hidden_dims=(16,))
    optimizer = torch.optim.Adam(bonus.parameters(), lr=1e-3)

    def policy(observation):
        return torch.tanh(torch.randn(observation.shape[0], 2))

    for _ in range(12):
        transition = random_transition(64)
        loss = bonus.loss(transition)
        optimizer.zero_grad(), loss.backward()
        optimizer.step()
        bonus.observe(transition, policy)
        reward = transition.reward + bonus(transition.observation, transition.action)
        assert reward.shape == (64,) and reward.isfinite().all() and not reward.requires_grad
        assert (reward != transition.reward).all()


def test_rows_may_come_one_at_a_time():
    """One row has no variance: whitening by it would blow up whatever comes next."""
    bonus = small_bonus()
    for _ in range(4):
        assert bonus.loss(random_transition(1)).abs() < 1e5
        bonus.observe(random_transition(1))
        probe = random_transition()
        assert bonus.nats(probe.observation, probe.action).max() < 1e5
        assert bonus(probe.observation, probe.action).abs().max() < 1e3


def test_a_feature_that_starts_to_move_late_does_not_drown_the_others():
    """As a contact, a goal or a score does; its first batch reaches the loss before `observe`."""
    bonus, still, moving = small_bonus(), random_transition(), random_transition()
    still.observation[:, 2] = still.next_observation[:, 2] = 0
    for _ in range(5):
        bonus.observe(still)
    assert bonus.loss(moving).abs() < 1e5
    assert bonus.nats(moving.observation, moving.action).max() < 1e5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("weight", -0.1),
        ("weight", math.nan),
        ("weight", math.inf),
        ("refresh_interval", 0),
        ("num_members", 1),
        ("noise_floor", 0.0),
        ("components", 1),
        ("bandwidth", -1.0),
    ],
)
def test_what_is_out_of_range_is_rejected_by_name_and_value(name, value):
    with pytest.raises(ValueError, match=rf"`{name}`.*got {value}"):
        small_bonus(**{name: value})


class Coin(nn.Module):
    """Its next state is 1 with the probability that the action says, and 0 otherwise."""

    noise_floor, num_members, members = 0.05, 2, "all"
    round_robin = DynamicsEnsemble.round_robin

    def forward(self, observation, action):
        heads = 0.5 * (1 + action.squeeze(-1)).expand(2, -1)
        loc = torch.tensor([0.0, 1.0]).view(2, 1).expand(*heads.shape, 2, 1)
        log_weight = torch.stack([1 - heads, heads], -1).clamp(min=1e-6).log()
        return DiagonalMixture(loc, torch.full_like(loc, 2 * math.log(0.05)), log_weight)

    def observe(self, transition):
        pass

    def metrics(self):
        return {}


@pytest.fixture
def coin_bonus():
    bonus = small_bonus(1, 1, components=2_000)
    bonus.dynamics = Coin()
    bonus.observe(random_transition(2_000, 1, 1)._replace(action=torch.zeros(2_000, 1)))
    return bonus


def test_a_coin_is_worth_what_its_entropy_leaves(coin_bonus):
    heads = torch.tensor([0.0, 0.1, 0.5, 0.8, 1.0])
    nats = coin_bonus.nats(torch.zeros(5, 1), 2 * heads.unsqueeze(-1) - 1)
    entropy = torch.special.entr(heads) + torch.special.entr(1 - heads)
    torch.testing.assert_close(nats - nats[2], math.log(2) - entropy, atol=0.05, rtol=0)


def test_parts_of_a_coin_add_up_and_equal_members_gain_nothing(coin_bonus):
    heads = torch.tensor([0.0, 0.5, 0.9])
    action = 2 * heads.unsqueeze(-1) - 1
    parts = coin_bonus.decompose(torch.zeros(3, 1), action, torch.randn(400, 2, 3, 2, 1))
    torch.testing.assert_close(parts.information_gain, torch.zeros(3), atol=1e-4, rtol=0)
    nats = coin_bonus.nats(torch.zeros(3, 1), action)
    torch.testing.assert_close(parts.total, nats, atol=0.5, rtol=0)
    torch.testing.assert_close(parts.total - parts.total[1], nats - nats[1], atol=0.1, rtol=0)


def test_metrics_bound_the_entropy_of_a_coin(coin_bonus):
    metrics = coin_bonus.metrics()
    spikes = math.log(0.05) + 0.5 * math.log(2 * math.pi * math.e)
    assert metrics["conditional_entropy"].item() == pytest.approx(math.log(2) + spikes, abs=0.01)
    assert metrics["bound_gap"] >= 0


@pytest.mark.parametrize("batch", [1, 2, 7, 32])
def test_members_in_round_robin_answer_for_their_own_rows(batch):
    bonus = bonus_of(1.0, 3.0, -2.0, members="round_robin", weight=1.0, center=False, scale=False)
    bonus.observe(random_transition(64, 2, 2))
    pairs = random_transition(batch, 2, 2)
    each = bonus.marginal.kl_upper(
        bonus.dynamics(pairs.observation, pairs.action)
    )  # members batch
    expected = torch.stack([each[row % 3, row] for row in range(batch)])
    torch.testing.assert_close(bonus(pairs.observation, pairs.action), expected)


def test_members_in_round_robin_are_right_on_average():
    bonus, batch = watchful_bonus(members="round_robin", weight=1.0, center=False, scale=False)
    pair = batch.observation[:1], batch.action[:1]
    repeated = [part.expand(3 * 4, -1) for part in pair]
    assert bonus(*repeated).mean().item() == pytest.approx(bonus.nats(*pair).item(), rel=1e-4)


RAW = {"weight": 1.0, "center": False, "scale": False}


@pytest.mark.parametrize(
    "parts",
    [
        {"predictive_power": 1.0, "information_gain": 1.0},
        {"negative_entropy": 1.0, "cross_entropy": 1.0},
        {"predictive_power": 0.5, "information_gain": 0.5, "cross_entropy": 0.5}
        | {"negative_entropy": 0.5},
    ],
)
@pytest.mark.parametrize("mixture_components", [1, 2])
def test_parts_of_one_kind_make_up_the_divergence(parts, mixture_components):
    bonus, batch = watchful_bonus(parts=parts, mixture_components=mixture_components, **RAW)
    pair = batch.observation, batch.action
    torch.testing.assert_close(bonus(*pair), bonus.nats(*pair))


@pytest.mark.parametrize(
    ("part", "name", "sign"),
    [
        ("predictive_power", "predictive_power", 1),
        ("information_gain", "information_gain", 1),
        ("cross_entropy", "cross_entropy", 1),
        ("negative_entropy", "conditional_entropy", -1),
    ],
)
@pytest.mark.parametrize("members", ["all", "round_robin"])
def test_a_part_alone_is_what_sampling_says(part, name, sign, members):
    bonus, batch = watchful_bonus(parts={part: 2.0}, noise_floor=0.3, members=members, **RAW)
    noise = torch.randn(400, 3, 32, 1, 3)
    sampled = getattr(bonus.decompose(batch.observation, batch.action, noise), name).mean()
    bonus.dynamics.members = "all"  # as in what is sampled
    closed = bonus(batch.observation, batch.action).mean()
    torch.testing.assert_close(closed, 2 * sign * sampled, atol=0.1, rtol=0.1)


def test_information_gain_needs_all_members_even_where_rows_are_shared_out():
    parts = {"information_gain": 1.0}
    bonus, batch = watchful_bonus(parts=parts, members="round_robin", **RAW)
    whole = small_bonus(parts=parts, **RAW)
    whole.load_state_dict(bonus.state_dict())
    pair = batch.observation, batch.action
    assert bonus(*pair).equal(whole(*pair))


def test_a_part_that_needs_one_member_is_computed_by_one_for_each_row():
    bonus = bonus_of(1.0, 3.0, -2.0, parts={"cross_entropy": 1.0}, members="round_robin", **RAW)
    bonus.observe(random_transition(64, 2, 2))
    pairs = random_transition(7, 2, 2)
    entropy = math.log(2 * math.pi * math.e) + 2 * math.log(0.1)
    each = (
        bonus.marginal.kl_upper(bonus.dynamics(pairs.observation, pairs.action)) + entropy
    )  # members batch
    expected = torch.stack([each[row % 3, row] for row in range(7)])
    torch.testing.assert_close(bonus(pairs.observation, pairs.action), expected)


def test_standardisation_is_that_of_the_parts_rewarded():
    bonus, batch = watchful_bonus(parts={"information_gain": 1.0}, weight=0.3)
    value = scored(bonus, batch)
    assert value.mean().item() == pytest.approx(0, abs=1e-4)
    assert 0.01 < value.std(correction=0).item() <= 0.3


@pytest.mark.parametrize("part", PARTS)
def test_every_part_has_the_right_gradient_in_the_action(part):
    torch.manual_seed(1)
    bonus = small_bonus(noise_floor=0.5, parts={part: 1.0}, mixture_components=2).double()
    batch = random_transition(8)
    batch = Transition(*(f.double() if f.is_floating_point() else f for f in batch))
    bonus.observe(batch)
    action = batch.action[:3].clone().requires_grad_()
    assert torch.autograd.gradcheck(bonus, (batch.observation[:3], action))
    bonus(batch.observation[:3], action).sum().backward()
    assert action.grad.abs().sum() > 0


def test_all_parts_are_logged_whichever_is_rewarded():
    whole, _ = watchful_bonus()
    for parts in ({"information_gain": 1.0}, {"cross_entropy": 1.0}):
        part = small_bonus(parts=parts)
        part.load_state_dict(whole.state_dict())
        metrics, expected = part.metrics(), whole.metrics()
        for name in (*Decomposition._fields[:2], *Decomposition._fields[3:], "nats"):
            assert metrics[name].equal(expected[name])


def test_curiosity_about_entries_is_that_of_their_marginal():
    """Of the one entry that an action moves, or of the other, which it leaves alone."""
    for entry in (0, 1, -1):
        bonus = bonus_of(1.0, 2.0, entries=[entry])
        alone = bonus_of(1.0, 2.0, dim=1)
        batch = random_transition(16, 2, 2)
        bonus.observe(batch)
        column = slice(entry % 2, entry % 2 + 1)
        single = batch._replace(
            observation=batch.observation[:, column],
            action=batch.action[:, column],
            next_observation=batch.next_observation[:, column],
        )
        alone.observe(single)
        torch.testing.assert_close(
            bonus.nats(batch.observation, batch.action),
            alone.nats(single.observation, single.action),
        )
        metrics, expected = bonus.metrics(), alone.metrics()
        for name in ("nats", "cross_entropy", "marginal_perplexity", "bound_gap"):
            torch.testing.assert_close(metrics[name], expected[name])


def test_what_is_of_no_interest_has_no_gradient():
    bonus = bonus_of(1.0, 2.0, entries=(1,))
    batch = random_transition(16, 2, 2)
    bonus.observe(batch)
    action = batch.action.clone().requires_grad_()
    bonus(batch.observation, action).sum().backward()
    assert (action.grad[:, 0] == 0).all() and (action.grad[:, 1] != 0).all()


def test_all_entries_are_of_interest_by_default():
    whole, batch = watchful_bonus()
    named = small_bonus(entries=range(3))
    named.load_state_dict(whole.state_dict())
    pair = batch.observation, batch.action
    torch.testing.assert_close(named(*pair), whole(*pair))


def test_curiosity_about_a_function_measures_its_value():
    bonus, batch = watchful_bonus(features=lambda x: torch.tanh(x[:, :2].sum(-1, keepdim=True)))
    assert bonus.marginal.loc.shape == (32, 1)
    action = batch.action.clone().requires_grad_()
    value = bonus(batch.observation, action)
    value.sum().backward()
    assert value.isfinite().all() and action.grad.abs().sum() > 0
    parts = bonus.decompose(batch.observation, batch.action, torch.randn(400, 3, 32, 1, 1))
    assert parts.total.mean() <= bonus.nats(batch.observation, batch.action).mean() + 0.05


@pytest.mark.parametrize("entries", [(), (0, 3), (-4,), (0, 0), (2, -1)])
def test_what_are_no_entries_is_rejected(entries):
    with pytest.raises(ValueError, match="`entries` must name different entries of 3, got"):
        small_bonus(entries=entries)


@pytest.mark.parametrize("entry", [1.5, "0", True])
def test_entries_that_are_no_whole_numbers_are_rejected(entry):
    jaxtyping.config.update("jaxtyping_disable", True)  # as for a user, whom nothing else tells
    with pytest.raises(TypeError, match=rf"`entries` must be whole numbers, got {entry!r}"):
        small_bonus(entries=(entry,))


def test_entries_may_be_whole_numbers_of_any_kind():
    jaxtyping.config.update("jaxtyping_disable", True)
    assert small_bonus(entries=np.array([0, -1])).entries == [0, 2]


@pytest.mark.parametrize("value", ["present", math.inf, True])
def test_a_goal_that_is_neither_the_past_nor_a_number_is_rejected_by_name(value):
    jaxtyping.config.update("jaxtyping_disable", True)
    with pytest.raises(ValueError, match=rf"`tune_weight` must be 'past'.*got {value!r}"):
        small_bonus(tune_weight=value)


def test_the_marginal_starts_where_one_has_been_of_late_and_statistics_do_not():
    batch, late = random_transition(32, 2, 2), random_transition(20, 2, 2)
    usual, recent = bonus_of(1.0, 1.0), bonus_of(1.0, 1.0)
    usual.observe(batch), recent.observe(batch, visited=late)
    assert usual.marginal.loc[:16].equal(batch.action[::2])
    assert recent.marginal.loc[:10].equal(late.action[::2])
    assert recent.marginal.num_seen == 10
    assert recent.probe_observation.equal(usual.probe_observation)
    nats = recent.nats(batch.observation, batch.action)[1::2]
    torch.testing.assert_close(recent.standardization.moments.mean, nats.mean().unsqueeze(0))
    recent.observe(batch, lambda observation: observation.tanh() + 7, late)
    assert recent.marginal.loc[:20].equal(torch.cat([late.action[::2], late.action[1::2]]))
    recent.observe(batch)
    assert recent.marginal.loc[20:].equal((late.observation.tanh() + 7)[:12])


def test_whitening_ignores_where_one_has_been_of_late():
    bonus, alone = small_bonus(), small_bonus()
    batch = random_transition()
    bonus.observe(batch, visited=random_transition()), alone.observe(batch)
    for name in ("observation_moments", "change_moments"):
        assert_unchanged(getattr(bonus.dynamics, name), getattr(alone.dynamics, name).state_dict())


@pytest.mark.parametrize("reason", BAD_BATCHES)
def test_bad_visited_states_are_rejected_and_change_nothing(reason):
    bonus, batch = watchful_bonus()
    before = copied(bonus.state_dict())
    with pytest.raises((ValueError, TypeError)):
        bonus.observe(batch, visited=BAD_BATCHES[reason]())
    assert_unchanged(bonus, before)


def staying(observation):
    return torch.zeros(len(observation), 2)


@pytest.mark.parametrize(("goal", "rises"), [(1e3, True), (-1e3, False)])
def test_a_weight_with_a_goal_in_nats_rises_while_the_policy_earns_less(goal, rises):
    bonus, batch = watchful_bonus(tune_weight=goal, refresh_interval=1)
    assert bonus.metrics()["weight"].item() == pytest.approx(0.1)  # nothing earned, no policy
    for _ in range(5):
        bonus.observe(batch, staying)
    weight = bonus.metrics()["weight"].item()
    assert (weight > 0.1) is rises
    standardised = bonus.standardization(bonus._weigh(bonus._ask(batch.observation, batch.action)))
    expected = weight / 0.1 * standardised
    torch.testing.assert_close(bonus(batch.observation, batch.action), expected)


def test_a_weight_that_follows_the_past_is_earned_in_standard_deviations():
    bonus, batch = watchful_bonus(tune_weight="past", refresh_interval=1)
    bonus.tuned_weight.past.fill_(10.0)
    bonus.observe(batch, staying)
    earned = 10 - bonus.tuned_weight.log_factor.item() / 3e-4
    assert abs(earned) < 10
    assert "weight" not in watchful_bonus()[0].metrics()


def test_a_marginal_of_another_length_is_rejected():
    dynamics = DynamicsEnsemble(3, 2, hidden_dims=(8,))
    with pytest.raises(
        ValueError, match=r"`marginal` must be over the 3 features .*got one over 2"
    ):
        CuriosityBonus(dynamics, NextStateMarginal(2))
    with pytest.raises(
        ValueError, match=r"`marginal` must be over the 1 features .*got one over 3"
    ):
        CuriosityBonus(dynamics, NextStateMarginal(3), entries=(0,))


def parts():
    return {"dynamics": DynamicsEnsemble(3, 2, hidden_dims=(8,)), "marginal": NextStateMarginal(3)}


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"dynamics": None}, TypeError, "`dynamics` must be a DynamicsEnsemble, got NoneType"),
        ({"marginal": nn.ReLU()}, TypeError, "`marginal` must be a NextStateMarginal, got ReLU"),
        ({"entries": 0}, TypeError, "`entries` must be whole numbers in a list, got 0"),
        ({"entries": "01"}, TypeError, "`entries` must be whole numbers, got '0'"),
        ({"tune_weight": np.array([1, 2])}, ValueError, r"`tune_weight` must be .*, got array"),
        ({"tune_weight": "future"}, ValueError, "`tune_weight` must be .*, got 'future'"),
        ({"weight": torch.tensor(0.1)}, TypeError, "`weight` must be an int or a float, got"),
        ({"center": "no"}, TypeError, "`center` must be True or False, got 'no'"),
        ({"scale": None}, TypeError, "`scale` must be True or False, got None"),
    ],
)
def test_parts_of_another_kind_are_rejected_by_name(options, error, message):
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(error, match=message):
        CuriosityBonus(**parts() | options)


def test_entries_may_be_given_once():
    jaxtyping.config.update("jaxtyping_disable", True)  # which takes sequences alone
    assert check_entries(iter([0, -1]), 3) == check_entries(np.array([0, -1]), 3) == [0, 2]


@pytest.mark.parametrize("shape", [(16,), (4, 3, 31, 1, 3), (0, 3, 32, 1, 3), ()])
def test_noise_of_another_shape_is_rejected(shape):
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    bonus, batch = watchful_bonus()
    rule = r"`noise` must have shape \(samples, 3, 32, 1, 3\), got"
    with pytest.raises(ValueError, match=rule):
        bonus.decompose(batch.observation, batch.action, torch.zeros(shape))
    with pytest.raises(TypeError, match="`noise` must be a Tensor, got list"):
        bonus.decompose(batch.observation, batch.action, [0.0])


def test_the_default_bonus_is_that_of_its_parts():
    torch.manual_seed(1)
    by_name = CuriosityBonus.default(3, 2)
    torch.manual_seed(1)
    of_parts = CuriosityBonus(DynamicsEnsemble(3, 2), NextStateMarginal(3))
    batch = random_transition()
    for bonus in (by_name, of_parts):
        torch.manual_seed(2)
        bonus.loss(batch)
        bonus.observe(batch)
    assert_unchanged(by_name, of_parts.state_dict())
    pair = batch.observation, batch.action
    assert by_name(*pair).equal(of_parts(*pair))


def root_features(observation):
    """NaN where an observation is negative, which no check of observations finds."""
    return observation.sqrt()


@pytest.mark.parametrize("watchful", [True, False])
@pytest.mark.parametrize("visited", [True, False])
def test_features_that_are_refused_change_nothing(watchful, visited):
    bonus = CuriosityBonus.default(
        3, 2, hidden_dims=(8,), refresh_interval=1, features=root_features
    )
    good, bad = random_transition(), random_transition()
    for batch in (good, bad):
        batch.observation.abs_(), batch.next_observation.abs_()
    bad.observation[3, 1] = -1.0
    if watchful:
        bonus.observe(good)
    before = copied(bonus.state_dict())
    with pytest.raises(ValueError, match=r"`features` must be finite, got .* in row 3"):
        bonus.observe(good, visited=bad) if visited else bonus.observe(bad)
    assert_unchanged(bonus, before)


def test_features_that_are_none_are_refused_before_anything_learns_of_them():
    bonus = CuriosityBonus.default(3, 2, hidden_dims=(8,), features=root_features)
    good, bad = random_transition(), random_transition()
    for batch in (good, bad):
        batch.observation.abs_(), batch.next_observation.abs_()
    bonus.observe(good)
    bad.next_observation[3, 1] = -1.0
    message = r"`features` must be finite, got .*nan"
    with pytest.raises(ValueError, match=message):
        bonus.loss(bad)
    with pytest.raises(ValueError, match=message):
        bonus(bad.next_observation, bad.action)
    assert bonus.loss(good).isfinite()


@pytest.mark.parametrize("batch_size", [2, 5])
def test_small_batches_are_paid_a_bonus_of_about_its_weight(batch_size):
    torch.manual_seed(0)
    states = [torch.zeros(3)]
    for _ in range(1_000):
        states.append(torch.tanh(0.9 * states[-1] + 0.3 * torch.randn(3)))
    state, flag = torch.stack(states), torch.zeros(1_000, dtype=torch.bool)
    action = torch.rand(1_000, 1) * 2 - 1
    data = Transition(state[:-1], action, flag.float(), state[1:], flag, flag)
    bonus = CuriosityBonus.default(3, 1, hidden_dims=(16,), bonus_weight=1.0)
    for _ in range(600):
        row = torch.randint(1_000, (batch_size,))
        bonus.observe(Transition(*(field[row] for field in data)))
    value = bonus(data.observation, data.action)
    assert abs(value.mean()) < 0.5
    assert 0.6 < value.std() < 1.6


def test_second_derivatives_in_the_action_are_those_of_differences():
    torch.manual_seed(0)
    bonus = CuriosityBonus.default(3, 1, hidden_dims=(16,), components=256).double()
    state, action = torch.randn(41, 3).double(), torch.rand(41, 1).double() * 2 - 1
    flag = torch.zeros(40, dtype=torch.bool)
    bonus.observe(
        Transition(state[:-1], action[:-1], flag.double(), state[1:], flag, flag)
    )  # most of the components are empty

    def slope(action):
        action = action.requires_grad_()
        return torch.autograd.grad(bonus(state[:5], action).sum(), action, create_graph=True)[0]

    asked, step = action[:5].clone(), 1e-5
    (second,) = torch.autograd.grad(slope(asked).sum(), asked)
    differences = (slope(action[:5] + step) - slope(action[:5] - step)) / (2 * step)
    torch.testing.assert_close(second, differences.detach(), rtol=1e-3, atol=1e-5)


def test_a_class_derived_from_it_is_made_of_parts_and_not_by_default():
    class Mine(CuriosityBonus):
        pass

    with pytest.raises(TypeError, match=r"`default` must be called of CuriosityBonus.*got Mine"):
        Mine.default(3, 1)
    whole = CuriosityBonus.default(3, 1, hidden_dims=(8,))
    assert isinstance(Mine(whole.dynamics, whole.marginal), Mine)
