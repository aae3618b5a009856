import math

import jaxtyping
import pytest
import torch

from deep_curiosity.bonuses.baselines import InformationGainBonus
from tests.bonuses.baselines.ensembles import predict, transition

SMALL = {"weight": 1.0, "refresh_interval": 1, "num_members": 2, "hidden_dims": (8,)}


def test_information_gain_is_the_log_ratio_of_variances():
    bonus = InformationGainBonus(3, 2, center=False, scale=False, noise_std=0.5, **SMALL)
    predict(bonus, torch.tensor([0.0, 0, 0, 0]), torch.tensor([2.0, 0, 0, 2]))
    value = bonus(torch.zeros(1, 3), torch.zeros(1, 2))
    assert value.item() == pytest.approx(2 * math.log(1 + 1 / 0.25) / 4)


def test_the_reward_is_an_outcome_as_well():
    bonus = InformationGainBonus(3, 2, **SMALL)
    assert bonus.ensemble.network.layers[-1].bias.shape[-1] == 4
    batch = transition()
    other = batch._replace(reward=batch.reward + torch.randn(len(batch.reward)))
    assert bonus.network_loss(batch) != bonus.network_loss(other)


@pytest.mark.parametrize(("past", "rises"), [(5.0, True), (-5.0, False)])
def test_the_weight_rises_while_the_policy_gains_less_than_it_did(past, rises):
    bonus = InformationGainBonus(3, 2, **SMALL)
    bonus.tuned_weight.past.fill_(past)
    for _ in range(5):
        bonus.observe(transition(), lambda observation: torch.zeros(len(observation), 2))
    assert (bonus.metrics()["weight"] > 1).item() is rises


def test_the_weight_moves_alike_whatever_it_is():
    moved = []
    for weight in (0.01, 1.0, 10.0):
        torch.manual_seed(0)
        bonus = InformationGainBonus(3, 2, **SMALL | {"weight": weight})
        for _ in range(3):
            bonus.observe(transition(), lambda observation: torch.ones(len(observation), 2))
        moved.append(bonus.tuned_weight.log_factor.item())
    assert moved[0] != 0 and moved == pytest.approx(moved[:1] * 3)


def test_the_weight_stays_without_a_policy_or_where_it_is_not_tuned():
    for bonus, policy in (
        (InformationGainBonus(3, 2, **SMALL), None),
        (InformationGainBonus(3, 2, tune_weight=False, **SMALL), lambda o: torch.zeros(len(o), 2)),
    ):
        bonus.tuned_weight.past.fill_(5.0)
        bonus.observe(transition(), policy)
        assert bonus.metrics()["weight"].item() == 1


def test_one_member_cannot_disagree():
    with pytest.raises(ValueError, match="`num_members` must be at least 2"):
        InformationGainBonus(3, 2, num_members=1)


def test_a_weight_is_tuned_or_not():
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(TypeError, match="`tune_weight` must be True or False, got 'no'"):
        InformationGainBonus(3, 2, tune_weight="no")


def test_noise_without_width_is_rejected():
    with pytest.raises(ValueError, match="`noise_std` must be positive and finite, got 0"):
        InformationGainBonus(3, 2, noise_std=0.0)


@pytest.mark.parametrize(
    ("policy", "error", "message"),
    [
        (lambda o: torch.zeros(len(o), 3), ValueError, r"must have shape \(batch, 2\)"),
        (
            lambda o: torch.zeros(1, 2),
            ValueError,
            "must have as many rows as `observation`, .*, got 1",
        ),
        (lambda o: torch.full((len(o), 2), math.nan), ValueError, "must be finite"),
        (lambda o: torch.zeros(len(o), 2).double(), TypeError, "must be a tensor of"),
        (lambda o: [0.0, 0.0], TypeError, "must be a tensor of"),
    ],
)
@pytest.mark.parametrize("watchful", [True, False])
def test_a_bad_policy_is_rejected_and_changes_nothing(policy, error, message, watchful):
    bonus = InformationGainBonus(3, 2, **SMALL)
    if watchful:
        bonus.observe(transition(), lambda observation: torch.zeros(len(observation), 2))
    before = {name: value.clone() for name, value in bonus.state_dict().items()}
    with pytest.raises(error, match=rf"`policy\(observation\)` {message}"):
        bonus.observe(transition(), policy)
    for name, value in bonus.state_dict().items():
        torch.testing.assert_close(value, before[name], rtol=0, atol=0, equal_nan=True)
