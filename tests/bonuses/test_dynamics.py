import math

import jaxtyping
import pytest
import torch
from torch.distributions import Normal

from deep_curiosity.bonuses import dynamics
from deep_curiosity.bonuses.dynamics import DynamicsEnsemble, is_held_out, soft_clamp
from deep_curiosity.gaussians import DiagonalMixture, gaussian_kl
from deep_curiosity.transitions import Transition


def transition(observation, action, next_observation):
    batch = observation.shape[0]
    flag = torch.zeros(batch, dtype=torch.bool)
    return Transition(observation, action, torch.zeros(batch), next_observation, flag, flag)


def random_transition(batch, observation_dim=3, action_dim=2):
    observation = torch.randn(batch, observation_dim)
    change = 0.3 * torch.randn(batch, observation_dim)
    return transition(observation, torch.rand(batch, action_dim) * 2 - 1, observation + change)


def ensemble_of(observation_dim, action_dim, **options):
    """All of two small models by default."""
    default = {"num_members": 2, "members": "all", "hidden_dims": (8,), "whitening": "moments"}
    return DynamicsEnsemble(observation_dim, action_dim, **default | options)


def small_ensemble(**options):
    return ensemble_of(3, 2, **{"num_members": 3} | options)


def gradients(ensemble, batch, seed=0):
    ensemble.zero_grad()
    torch.manual_seed(seed)
    ensemble.loss(batch).backward()
    return torch.cat([parameter.grad.flatten(1) for parameter in ensemble.parameters()], dim=1)


def true_std(observation):
    """Noise of the change in heteroscedastic transitions, in units of the observation."""
    return 0.1 + 0.5 * torch.sigmoid(3 * observation)


def heteroscedastic_transitions(batch):
    """Two features of which the second is counted in a unit 50 times smaller."""
    observation = torch.randn(batch, 2)
    action = torch.rand(batch, 1) * 2 - 1
    change = 0.5 * action - 0.3 * observation + true_std(observation) * torch.randn(batch, 2)
    unit = torch.tensor([1.0, 50.0])
    return transition(observation * unit, action, (observation + change) * unit)


@pytest.fixture(scope="module")
def fitted():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        ensemble = ensemble_of(2, 1, hidden_dims=(32, 32), noise_floor=1e-3)
        batch = heteroscedastic_transitions(20_000)
        ensemble.observe(batch)
        optimizer = torch.optim.Adam(ensemble.parameters(), lr=1e-2, fused=True)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 500)
        for _ in range(500):
            rows = torch.randint(20_000, (512,))
            optimizer.zero_grad()
            ensemble.loss(Transition(*(field[rows] for field in batch))).backward()
            optimizer.step()
            schedule.step()
    return ensemble


def test_the_variance_of_least_loss_is_the_true_one(fitted):
    observation = torch.linspace(-1.5, 1.5, 31).unsqueeze(-1).expand(-1, 2)
    unit = torch.tensor([1.0, 50.0])
    with torch.no_grad():
        prediction = fitted(observation * unit, torch.zeros(31, 1))
    std = (0.5 * prediction.log_var).exp().squeeze(-2) * fitted.observation_moments.scale / unit
    ratio = std / true_std(observation)
    assert (ratio.log().abs() < math.log(1.2)).all()
    assert ratio.mean().item() == pytest.approx(1, abs=0.05)


def test_the_mean_of_least_loss_is_the_true_one(fitted):
    observation = torch.linspace(-1.5, 1.5, 31).unsqueeze(-1).expand(-1, 2)
    unit = torch.tensor([1.0, 50.0])
    action = torch.full((31, 1), 0.5)
    with torch.no_grad():
        loc = fitted(observation * unit, action).loc.squeeze(-2)
    moments = fitted.observation_moments
    next_observation = (loc * moments.scale + moments.mean) / unit
    assert (next_observation - (0.7 * observation + 0.25)).abs().max() < 0.15


def test_coverage_of_a_fitted_ensemble_is_ninety_percent(fitted):
    fitted.held_out_coverage.fill_(math.nan)
    fitted.loss(heteroscedastic_transitions(20_000))
    assert fitted.metrics()["model_coverage_90"].item() == pytest.approx(0.9, abs=0.03)


def test_held_out_loss_of_a_fitted_ensemble_is_the_entropy_of_the_environment(fitted, monkeypatch):
    batch = heteroscedastic_transitions(20_000)
    monkeypatch.setattr(dynamics, "is_held_out", lambda *_: torch.arange(20_000) % 2 == 0)
    fitted.held_out_nll.fill_(math.nan)
    fitted.loss(batch)
    std = true_std(batch.observation / torch.tensor([1.0, 50.0])) * torch.tensor([1.0, 50.0])
    entropy = Normal(0, std / fitted.change_moments.scale).entropy().sum(-1).mean().item()
    assert fitted.metrics()["model_held_out_nll"].item() == pytest.approx(entropy, abs=0.08)


def test_negative_log_likelihood_agrees_with_torch_distributions():
    ensemble, batch = small_ensemble(noise_floor=1e-6), random_transition(16)
    ensemble.observe(random_transition(100))
    nll = ensemble.negative_log_likelihood(batch)
    prediction = ensemble(batch.observation, batch.action)
    target = ensemble.observation_moments.normalize(batch.next_observation)
    own = Normal(prediction.loc, (0.5 * prediction.log_var).exp())
    target = target.unsqueeze(-2)
    ratio = ensemble.change_moments.scale / ensemble.observation_moments.scale
    expected = -(own.log_prob(target) + ratio.log()).sum((-1, -2))  # in units of the change
    torch.testing.assert_close(nll, expected, atol=1e-4, rtol=1e-4)


def test_predictions_by_hand_are_in_whitened_units_of_the_observation():
    ensemble = ensemble_of(1, 1, hidden_dims=(), noise_floor=0.5)
    for parameter in ensemble.parameters():
        parameter.data.zero_()
    ensemble.network.layers[0].bias.data[1, 0, 0] = 2.0  # the second member moves two stds
    observation = torch.tensor([[8.0], [12.0]])  # mean 10, std 2
    ensemble.observe(
        transition(observation, torch.zeros(2, 1), observation + torch.tensor([[2.0], [4.0]]))
    )  # changes have mean 3 and std 1
    prediction = ensemble(torch.tensor([[14.0]]), torch.zeros(1, 1))
    expected = torch.tensor([[[(17 - 10) / 2]], [[(17 + 2 - 10) / 2]]])
    torch.testing.assert_close(prediction.loc.squeeze(-2), expected)
    change_var = soft_clamp(torch.zeros(1), *dynamics.LOG_VAR_RANGE).exp() / 4
    torch.testing.assert_close(prediction.log_var.exp().flatten(), (change_var + 0.25).expand(2))


def test_the_noise_floor_is_a_floor():
    ensemble = small_ensemble(noise_floor=0.3)
    ensemble.network.layers[-1].bias.data.fill_(-1e3)  # as sharp as the model can be
    log_var = ensemble(torch.randn(9, 3), torch.randn(9, 2)).log_var
    torch.testing.assert_close(
        log_var.exp().sqrt(), torch.full_like(log_var, 0.3), rtol=1e-3, atol=0
    )


def test_the_noise_floor_is_no_part_of_the_loss():
    batch = random_transition(32)
    torch.manual_seed(0)
    sharp = small_ensemble(noise_floor=1e-3)
    dull = small_ensemble(noise_floor=1.0)
    dull.load_state_dict(sharp.state_dict())
    assert gradients(sharp, batch).equal(gradients(dull, batch))


def test_each_member_learns_from_a_bootstrap_of_its_own():
    ensemble = small_ensemble()
    for parameter in ensemble.parameters():
        parameter.data.copy_(parameter.data[:1].expand_as(parameter))
    first, second, third = gradients(ensemble, random_transition(64))
    assert not first.allclose(second, rtol=0.01) and not second.allclose(third, rtol=0.01)


def test_bootstraps_average_to_the_plain_loss(every_fifth_held_out):
    ensemble, batch = small_ensemble(), random_transition(50)
    trained = ~every_fifth_held_out
    with torch.no_grad():
        plain = ensemble.negative_log_likelihood(batch)[:, trained].mean(1).sum()
        mean = torch.stack([ensemble.loss(batch) for _ in range(300)]).mean()
    assert mean.item() == pytest.approx(plain.item(), rel=0.02)


@pytest.fixture
def every_fifth_held_out(monkeypatch):
    """Hold out fixed rows of a batch of 50, whatever they contain."""
    held_out = torch.arange(50) % 5 == 0
    monkeypatch.setattr(dynamics, "is_held_out", lambda *_: held_out)
    return held_out


@pytest.mark.parametrize("name", ["observation", "action", "next_observation"])
def test_held_out_rows_never_reach_a_gradient(every_fifth_held_out, name):
    ensemble, batch = small_ensemble(), random_transition(50)
    usual = gradients(ensemble, batch)
    changed = getattr(batch, name).clone()
    changed[every_fifth_held_out] += 3
    assert gradients(ensemble, batch._replace(**{name: changed})).equal(usual)
    changed[~every_fifth_held_out] += 3
    assert not gradients(ensemble, batch._replace(**{name: changed})).allclose(usual)


def test_held_out_rows_are_measured(every_fifth_held_out):
    ensemble, batch = small_ensemble(noise_floor=1e-6), random_transition(50)
    ensemble.loss(batch)
    nll = ensemble.negative_log_likelihood(batch)
    loc, log_var, _ = ensemble(batch.observation, batch.action)
    standard_error = (batch.next_observation.unsqueeze(-2) - loc) * (-0.5 * log_var).exp()
    metrics = ensemble.metrics()
    torch.testing.assert_close(metrics["model_held_out_nll"], nll[:, every_fifth_held_out].mean())
    inside = (standard_error[:, every_fifth_held_out].abs() < 1.6449).float().mean()
    torch.testing.assert_close(metrics["model_coverage_90"], inside)


def test_held_out_measures_are_averaged_over_batches(every_fifth_held_out):
    ensemble, first, second = small_ensemble(), random_transition(50), random_transition(50)
    ensemble.loss(first)
    before = ensemble.metrics()["model_held_out_nll"]
    ensemble.loss(second)
    latest = ensemble.negative_log_likelihood(second)[:, every_fifth_held_out].mean()
    torch.testing.assert_close(
        ensemble.metrics()["model_held_out_nll"], 0.98 * before + 0.02 * latest
    )


def test_a_batch_without_held_out_rows_leaves_the_measures_alone(monkeypatch):
    ensemble, batch = small_ensemble(), random_transition(400)
    ensemble.loss(batch)
    before = ensemble.metrics()
    monkeypatch.setattr(dynamics, "is_held_out", lambda *_: torch.zeros(400, dtype=torch.bool))
    assert ensemble.loss(batch).isfinite() and ensemble.metrics() == before


def test_a_batch_of_held_out_rows_alone_has_no_loss(monkeypatch):
    ensemble, batch = small_ensemble(), random_transition(50)
    monkeypatch.setattr(dynamics, "is_held_out", lambda *_: torch.ones(50, dtype=torch.bool))
    loss = ensemble.loss(batch)
    loss.backward()
    assert loss.item() == 0


def test_one_row_in_twenty_of_a_batch_is_held_out_for_good():
    ensemble, batch = small_ensemble(), random_transition(2_000)
    reached = torch.zeros(2_000, dtype=torch.bool)
    for _ in range(10):
        next_observation = batch.next_observation.clone().requires_grad_()
        ensemble.loss(batch._replace(next_observation=next_observation)).backward()
        reached |= (next_observation.grad != 0).any(-1)
    assert reached.float().mean().item() == pytest.approx(0.95, abs=0.015)


def test_the_same_rows_are_held_out_in_any_order():
    observation = torch.randn(1_000, 4)
    order = torch.randperm(1_000)
    assert is_held_out(observation[order]).equal(is_held_out(observation)[order])
    assert is_held_out(observation[7:8]).equal(is_held_out(observation)[7:8])


@pytest.mark.parametrize(
    "observation",
    [
        torch.randn(20_000, 1, generator=torch.Generator().manual_seed(0)),
        torch.randn(20_000, 17, generator=torch.Generator().manual_seed(1)),
        torch.rand(20_000, 2, generator=torch.Generator().manual_seed(2)) * 1e-3,
        torch.linspace(-1, 1, 20_000).unsqueeze(-1),
        torch.cartesian_prod(*[torch.linspace(-1, 1, 141)] * 2),
    ],
    ids=["gaussian", "wide", "small", "line", "grid"],
)
def test_about_one_row_in_twenty_is_held_out(observation):
    assert is_held_out(observation).float().mean().item() == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize(
    "observation",
    [
        torch.arange(-200, 200.0).unsqueeze(-1),
        torch.cartesian_prod(*[torch.arange(0, 20.0)] * 2),
        torch.cartesian_prod(*[torch.arange(-1, 1.01, 0.25)] * 3),
        torch.eye(256),
    ],
    ids=["numbers", "cells", "quarters", "one-hot"],
)
def test_rows_of_round_numbers_are_held_out_as_rarely_as_others(observation):
    assert is_held_out(observation).float().mean().item() == pytest.approx(0.05, abs=0.04)


@pytest.mark.parametrize("end", [0.0, 1.0, 4.0])
def test_a_next_state_that_many_pairs_lead_to_is_learned(end):
    """A corner, a rest, an end of the room: holding out the state would hold out them all."""
    ensemble = ensemble_of(1, 1, hidden_dims=(8,))
    ends = torch.full((200, 1), end, requires_grad=True)
    ensemble.loss(transition(torch.randn(200, 1), torch.rand(200, 1), ends)).backward()
    assert (ends.grad != 0).float().mean() > 0.5


def test_each_member_may_predict_for_a_batch_of_its_own():
    ensemble = small_ensemble()
    observation, action = torch.randn(3, 5, 3), torch.randn(3, 5, 2)
    prediction = ensemble(observation, action)
    for member in range(3):
        shared = ensemble(observation[member], action[member])
        torch.testing.assert_close(prediction.loc[member], shared.loc[member])
        torch.testing.assert_close(prediction.log_var[member], shared.log_var[member])


def test_metrics_are_unknown_before_the_first_held_out_row():
    assert all(value.isnan() for value in small_ensemble().metrics().values())


def test_soft_clamp_keeps_its_interval_and_never_loses_its_slope():
    value = torch.tensor([-15.0, -3.0, 8.0], requires_grad=True)
    clamped = soft_clamp(value, -9.0, 2.0)
    assert clamped.min() > -9 and clamped.max() < 2.1
    clamped.sum().backward()
    assert (value.grad > 1e-4).all()
    assert clamped[1].item() == pytest.approx(-3, abs=0.02)


@pytest.mark.parametrize(
    ("name", "value"),
    [("num_members", 1), ("num_members", 0), ("noise_floor", 0.0), ("noise_floor", -0.1)],
)
def test_what_is_out_of_range_is_rejected_by_name_and_value(name, value):
    with pytest.raises(ValueError, match=f"`{name}`.*got {value}"):
        small_ensemble(**{name: value})


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_noise_floor_that_is_not_finite_is_rejected(value):
    with pytest.raises(ValueError, match="`noise_floor`"):
        small_ensemble(noise_floor=value)


@pytest.mark.parametrize("dims", [(0, 1), (1, 0)])
def test_a_dimension_below_one_is_rejected(dims):
    with pytest.raises(ValueError, match=r"`(observation|action)_dim` must be at least 1, got 0"):
        DynamicsEnsemble(*dims)


def coin_transitions(batch):
    """The action says how likely a jump of one unit is; otherwise nothing moves."""
    observation, action = torch.randn(batch, 1), torch.rand(batch, 1) * 2 - 1
    jump = (torch.rand(batch, 1) < 0.5 * (1 + action)).float()
    return transition(observation, action, observation + jump + 0.02 * torch.randn(batch, 1))


@pytest.fixture(scope="module")
def gamblers():
    """Ensembles of one and of two mixture components, fitted to the coin."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return [fitted_to_coin(number) for number in (1, 2)]


def fitted_to_coin(mixture_components):
    ensemble = ensemble_of(1, 1, mixture_components=mixture_components, hidden_dims=(32,))
    batch = coin_transitions(8_000)
    ensemble.observe(batch)
    optimizer = torch.optim.Adam(ensemble.parameters(), lr=1e-2, fused=True)
    for _ in range(500):
        rows = torch.randint(8_000, (256,))
        optimizer.zero_grad()
        ensemble.loss(Transition(*(field[rows] for field in batch))).backward()
        optimizer.step()
    return ensemble


def test_two_components_tell_a_coin_that_one_gaussian_blurs(gamblers):
    batch = coin_transitions(4_000)
    with torch.no_grad():
        one, two = (ensemble.negative_log_likelihood(batch).mean() for ensemble in gamblers)
    assert two < one - 1.0


def test_components_have_the_probabilities_of_the_environment(gamblers):
    action = torch.linspace(-0.9, 0.9, 19).unsqueeze(-1)
    observation = torch.zeros(19, 1)
    with torch.no_grad():
        loc, _, log_weight = gamblers[1](observation, action)
    moments = gamblers[1].observation_moments
    jumps = loc.squeeze(-1) * moments.scale + moments.mean > 0.5
    probability = (log_weight.exp() * jumps).sum(-1)
    assert (probability - 0.5 * (1 + action.T)).abs().max() < 0.1


def test_a_calibrated_mixture_covers_ninety_percent(gamblers):
    gamblers[1].held_out_coverage.fill_(math.nan)
    gamblers[1].loss(coin_transitions(20_000))
    assert gamblers[1].metrics()["model_coverage_90"].item() == pytest.approx(0.9, abs=0.05)


def test_mixture_components_begin_apart():
    loc = small_ensemble(mixture_components=3)(torch.zeros(4, 3), torch.zeros(4, 2)).loc
    assert (loc[:, :, 0] - loc[:, :, 2]).abs().mean() > 1


def test_in_round_robin_each_member_learns_from_its_own_rows(monkeypatch):
    monkeypatch.setattr(dynamics, "is_held_out", lambda rows: torch.arange(len(rows)) == 4)
    ensemble, batch = small_ensemble(members="round_robin"), random_transition(8)
    usual = gradients(ensemble, batch)
    changed = batch.next_observation.clone()
    changed[[1, 4]] += 3  # a row of the second member's, and one that is held out
    differs = (gradients(ensemble, batch._replace(next_observation=changed)) != usual).any(1)
    assert differs.tolist() == [False, True, False]


@pytest.mark.parametrize("batch_size", [1, 2, 3])
def test_in_round_robin_small_batches_train_every_member(batch_size):
    ensemble = small_ensemble(members="round_robin")
    trained = torch.zeros(3, dtype=torch.bool)
    for seed in range(20):  # a bootstrap may leave a member out
        batch = random_transition(batch_size)
        trained |= (gradients(ensemble, batch, seed) != 0).any(1)
    assert trained.all()


def test_in_round_robin_the_loss_is_right_on_average(monkeypatch):
    monkeypatch.setattr(dynamics, "is_held_out", lambda rows: torch.zeros(len(rows)) > 0)
    ensemble, batch = small_ensemble(members="round_robin"), random_transition(300)
    with torch.no_grad():
        plain = ensemble.negative_log_likelihood(batch).mean(1).sum()
        order = (torch.randperm(300) for _ in range(100))
        shuffled = [ensemble.loss(Transition(*(field[o] for field in batch))) for o in order]
    assert torch.stack(shuffled).mean().item() == pytest.approx(plain.item(), rel=0.01)


def test_in_round_robin_held_out_rows_are_measured(monkeypatch):
    monkeypatch.setattr(dynamics, "is_held_out", lambda rows: torch.arange(len(rows)) % 4 == 0)
    ensemble, batch = small_ensemble(members="round_robin"), random_transition(12)
    ensemble.loss(batch)
    nll = ensemble.negative_log_likelihood(batch)
    expected = torch.stack([nll[row % 3, row] for row in (0, 4, 8)]).mean()
    torch.testing.assert_close(ensemble.metrics()["model_held_out_nll"], expected)


def test_heavy_tails_leave_the_resolution_where_it_is_if_whitening_is_robust():
    observation = torch.distributions.StudentT(1.0).sample((4_000, 2))
    flag = torch.zeros(4_000, dtype=torch.bool)
    batch = Transition(
        observation, torch.zeros(4_000, 1), torch.zeros(4_000), observation + 1, flag, flag
    )
    nearest = {}
    for whitening in ("moments", "robust"):
        ensemble = ensemble_of(2, 1, hidden_dims=(8,), whitening=whitening)
        ensemble.observe(batch)
        near = torch.tensor([[0.0, 0.0], [2.0, 2.0]])
        prediction = ensemble(near, torch.zeros(2, 1)).loc.mean(0).squeeze(1)
        nearest[whitening] = (prediction[1] - prediction[0]).abs().min()
    assert nearest["robust"] > 1 > 0.3 > nearest["moments"]


@pytest.mark.parametrize("features", [5, "mean", (0, 1)])
def test_features_that_cannot_be_called_are_rejected(features):
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(TypeError, match="`features` must be callable, got"):
        DynamicsEnsemble(3, 2, hidden_dims=(8,), features=features)


def test_a_whitening_that_cannot_be_hashed_is_rejected():
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(ValueError, match=r"`whitening` must be one of .*, got \['x'\]"):
        DynamicsEnsemble(3, 2, hidden_dims=(8,), whitening=["x"])


def test_a_whitening_that_is_none_is_rejected():
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(ValueError, match=r"`whitening` must be one of .*saturating, got 'pca'"):
        DynamicsEnsemble(2, 1, whitening="pca")


def test_identity_as_features_predicts_what_whole_observations_do():
    torch.manual_seed(1)
    whole = ensemble_of(3, 2, hidden_dims=(8,))
    featured = ensemble_of(3, 2, hidden_dims=(8,), features=torch.clone)
    featured.network.load_state_dict(whole.network.state_dict())
    batch = random_transition(64)
    for ensemble in (whole, featured):
        ensemble.observe(batch)
    pair = batch.observation, batch.action
    for one, other in zip(whole(*pair), featured(*pair), strict=True):
        torch.testing.assert_close(one, other)
    torch.testing.assert_close(
        whole.negative_log_likelihood(batch), featured.negative_log_likelihood(batch)
    )


def test_features_of_the_next_state_are_predicted_in_their_own_units():
    ensemble = ensemble_of(
        1, 1, hidden_dims=(32, 32), features=lambda x: torch.cat([x**2, 100 * x], -1)
    )
    observation, action = torch.randn(2_000, 1), torch.rand(2_000, 1) * 2 - 1
    batch = transition(observation, action, observation + action)
    ensemble.observe(batch)
    optimizer = torch.optim.Adam(ensemble.parameters(), lr=5e-3, fused=True)
    for _ in range(400):
        optimizer.zero_grad()
        ensemble.loss(Transition(*(field[:512] for field in batch))).backward()
        optimizer.step()
    prediction = ensemble(observation, action).loc.mean(0).squeeze(1)
    reached = batch.next_observation
    moments = ensemble.feature_moments
    expected = moments.normalize(torch.cat([reached**2, 100 * reached], -1))
    near = (observation.abs() < 1).squeeze(-1)
    assert (prediction - expected)[near].abs().mean() < 0.1


def test_features_are_given_batches_of_vectors_and_frozen():
    shapes = []
    module = torch.nn.Linear(3, 4)
    module.register_forward_pre_hook(lambda _, args: shapes.append(args[0].ndim))
    ensemble = ensemble_of(3, 2, hidden_dims=(8,), features=module, members="round_robin")
    ensemble.loss(random_transition(64)).backward()
    assert set(shapes) == {2}
    assert module.weight.grad is None and not module.weight.requires_grad
    assert "features.weight" in ensemble.state_dict()


def test_features_that_are_no_vectors_or_not_finite_are_rejected():
    with pytest.raises(ValueError, match=r"`features` must map observations \(2, 3\).*got \(2,\)"):
        DynamicsEnsemble(3, 2, features=lambda x: x.sum(-1))
    ensemble = ensemble_of(3, 2, hidden_dims=(8,), features=torch.log)
    before = {name: value.clone() for name, value in ensemble.state_dict().items()}
    with pytest.raises(ValueError, match="`features` must be finite"):
        ensemble.observe(random_transition(64))
    after = ensemble.state_dict()
    assert all(before[name].nan_to_num().equal(after[name].nan_to_num()) for name in before)


def test_layers_of_features_stay_in_evaluation():
    features = torch.nn.Sequential(torch.nn.BatchNorm1d(3), torch.nn.Dropout(0.5))
    owner = torch.nn.ModuleList([small_ensemble(features=features)])
    rows = random_transition(16)
    before = owner[0](rows.observation, rows.action).loc
    for switch in (owner.train, lambda: owner.train(False), owner[0].train):
        assert switch() is owner or switch() is owner[0]
        assert owner[0](rows.observation, rows.action).loc.equal(before)
        assert not any(part.training for part in features.modules())
    assert owner[0].network.training
    assert features[0].running_mean.eq(0).all()


@pytest.mark.parametrize(
    ("features", "kind"),
    [
        (lambda x: x.double(), "torch.float64"),
        (lambda x: x.long(), "torch.int64"),
        (lambda x: x.numpy(), "ndarray"),
        (lambda x: x.tolist(), "list"),
        (lambda x: None, "NoneType"),
    ],
)
def test_features_that_are_no_tensors_of_the_same_dtype_are_rejected(features, kind):
    with pytest.raises(
        TypeError, match=f"`features` must return a tensor of torch.float32, got {kind}"
    ):
        small_ensemble(features=features)


@pytest.mark.parametrize("batch", [1, 2, 7])
def test_in_round_robin_order_each_row_is_predicted_by_one_member(batch):
    ensemble = small_ensemble(mixture_components=2)
    rows = random_transition(batch)
    everyone = ensemble(rows.observation, rows.action)
    one = ensemble.round_robin(rows.observation, rows.action)
    for field, of_all in zip(one, everyone, strict=True):
        expected = torch.stack([of_all[row % 3, row] for row in range(batch)]).unsqueeze(0)
        torch.testing.assert_close(field, expected)


def test_an_unknown_choice_of_members_is_rejected():
    with pytest.raises((ValueError, TypeError), match="members"):
        small_ensemble(members="best")


def fixed_prediction(dynamics, loc, log_var, log_weight=None):
    """An ensemble that predicts the same whitened change everywhere."""
    weight = torch.zeros_like(loc[..., 0]) if log_weight is None else log_weight
    dynamics._whitened_change = lambda observation, action: DiagonalMixture(loc, log_var, weight)
    return dynamics


def test_a_change_in_its_own_units_by_hand():
    dynamics = DynamicsEnsemble(1, 1, num_members=2, whitening="moments")
    dynamics.change_moments.center.fill_(3.0)
    dynamics.change_moments.scale.fill_(2.0)
    loc = torch.tensor([0.5, -1.0]).reshape(2, 1, 1, 1)
    log_var = 2 * torch.tensor([0.25, 1.0]).log().reshape(2, 1, 1, 1)
    mean, var = fixed_prediction(dynamics, loc, log_var).change(
        torch.zeros(1, 1), torch.zeros(1, 1)
    )
    assert mean.flatten().tolist() == pytest.approx([4.0, 1.0])
    assert var.flatten().tolist() == pytest.approx([0.25, 4.0])


def test_a_change_of_saturating_units_is_that_of_the_hyperbolic_sine():
    dynamics = DynamicsEnsemble(1, 1, num_members=2, whitening="saturating")
    dynamics.change_moments.center.fill_(3.0)
    dynamics.change_moments.scale.fill_(2.0)
    loc = torch.tensor([0.7, -2.0]).reshape(2, 1, 1, 1)
    std = torch.tensor([0.5, 0.1]).reshape(2, 1, 1, 1)
    mean, var = fixed_prediction(dynamics, loc, 2 * std.log()).change(
        torch.zeros(1, 1), torch.zeros(1, 1)
    )
    loc, std = loc.double(), std.double()
    first = torch.sinh(loc) * torch.exp(std**2 / 2)  # of a Gaussian, in closed form
    second = (torch.cosh(2 * loc) * torch.exp(2 * std**2) - 1) / 2
    torch.testing.assert_close(mean, (3 + 2 * first).squeeze(-1))
    torch.testing.assert_close(var, 4 * (second - first**2).squeeze(-1), rtol=1e-5, atol=0)


def test_samples_of_a_change_have_the_weights_of_members_and_components():
    dynamics = DynamicsEnsemble(1, 1, num_members=2, mixture_components=2, whitening="moments")
    loc = torch.tensor([[-10.0, 0.0], [10.0, 20.0]]).reshape(2, 1, 2, 1)
    log_weight = torch.tensor([[0.25, 0.75], [0.5, 0.5]]).log().reshape(2, 1, 2)
    fixed_prediction(dynamics, loc, torch.full_like(loc, -20.0), log_weight)
    choice = ((torch.arange(1_000) + 0.5) / 1_000).reshape(-1, 1)
    samples = dynamics.sample_change(
        torch.zeros(1, 1), torch.zeros(1, 1), torch.zeros(1_000, 1, 1), choice
    )
    values, counts = samples.flatten().unique(return_counts=True)
    assert dict(zip(values.tolist(), counts.tolist(), strict=True)) == {
        -10.0: 125, 0.0: 375, 10.0: 250, 20.0: 250
    }  # fmt: skip
    noise = torch.ones(1_000, 1, 1)
    moved = dynamics.sample_change(torch.zeros(1, 1), torch.zeros(1, 1), noise, choice)
    torch.testing.assert_close(
        moved - samples, torch.full_like(samples, math.exp(-10.0)), rtol=0, atol=1e-5
    )


@pytest.mark.parametrize("whitening", ["moments", "robust", "saturating"])
def test_what_is_predicted_is_where_the_state_goes(whitening):
    """Also where a change is far from the usual, and its spread with it."""
    torch.manual_seed(0)
    dynamics = ensemble_of(1, 1, num_members=2, whitening=whitening)
    action = 2 * torch.rand(4_000, 1) - 1
    observation = torch.randn(4_000, 1)
    dynamics.observe(transition(observation, action, observation + 6 * action**3))
    at, push = torch.tensor([[0.0], [1.0]]), torch.ones(2, 1)
    change = dynamics.change_moments.normalize(6 * push)  # as a model that has learned it says it
    bias = dynamics.network.layers[-1].bias.data
    dynamics.network.layers[-1].weight.data.zero_()
    bias[..., 0], bias[..., 1] = change[0, 0], -7.0
    predicted = dynamics(at, push)
    expected = dynamics.observation_moments.normalize(at + 6 * push)
    expected = expected.expand(2, -1, -1)
    torch.testing.assert_close(predicted.loc.squeeze(-2), expected, rtol=0, atol=1e-4)
    step = 1e-3  # by how much the whitened next state moves with the whitened change
    bias[..., 0] += step
    slope = (dynamics(at, push).loc - predicted.loc) / step
    floor = dynamics.noise_floor**2
    spread = (predicted.log_var.exp() - floor).clamp(min=0).sqrt()
    std = (0.5 * dynamics._whitened_change(at, push).log_var).exp()
    torch.testing.assert_close(spread, std * slope, rtol=0.02, atol=1e-4)


@pytest.mark.parametrize("whitening", ["moments", "robust", "saturating"])
def test_a_wide_prediction_is_as_wide_where_units_saturate(whitening):
    """A channel that rests but for a fifth of all rows, where nobody can tell what it does."""
    torch.manual_seed(0)
    dynamics = ensemble_of(1, 1, num_members=2, whitening=whitening)
    noise = torch.where(torch.rand(8_000, 2) < 0.2, 2 * torch.rand(8_000, 2) - 1, 0.0)
    dynamics.observe(transition(noise[:, :1], torch.zeros(8_000, 1), noise[:, 1:]))
    at = torch.tensor([[-0.05], [0.0], [0.05]])  # as a model errs that tells noise from noise
    bias = dynamics.network.layers[-1].bias.data
    dynamics.network.layers[-1].weight.data.zero_()
    bias[..., 0], bias[..., 1] = 0.0, 1.0
    predicted = dynamics(at, torch.zeros(3, 1))
    loc, log_var = predicted.loc[0, :, 0], predicted.log_var[0, :, 0]
    width = dynamics._whitened_change(at, torch.zeros(3, 1)).log_var.mul(0.5).exp()[0, 0, 0]
    ends = torch.stack([-width, width])
    low, high = dynamics.observation_moments.normalize(dynamics.change_moments.denormalize(ends))
    std = log_var.mul(0.5).exp()
    torch.testing.assert_close(std, ((high - low) / 2).expand(3, 1), rtol=0.05, atol=0)
    assert gaussian_kl(loc[0], log_var[0], loc[2], log_var[2]) < 0.05
