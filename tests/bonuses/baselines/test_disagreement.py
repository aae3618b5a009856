import math

import pytest
import torch

from deep_curiosity.bonuses.baselines import DisagreementBonus
from deep_curiosity.bonuses.baselines.base import SCORE_FLOOR
from tests.bonuses.baselines.ensembles import predict, transition

SMALL = {"num_members": 2, "hidden_dims": (8,), "refresh_interval": 1, "weight": 1.0}
RAW = {"center": False, "scale": False}


def test_disagreement_is_the_log_of_the_mean_variance_of_the_predictions():
    bonus = DisagreementBonus(3, 2, **SMALL, **RAW)
    predict(bonus, torch.tensor([0.0, 1.0, 2.0]), torch.tensor([2.0, 1.0, 6.0]))
    value = bonus(torch.zeros(1, 3), torch.zeros(1, 2))
    assert value.item() == pytest.approx(math.log((1 + 0 + 4) / 3), abs=1e-5)


def test_members_that_agree_earn_least():
    bonus = DisagreementBonus(3, 2, **SMALL, **RAW)
    predict(bonus, torch.ones(3), torch.ones(3))
    value = bonus(torch.randn(5, 3), torch.randn(5, 2))
    torch.testing.assert_close(value, torch.full((5,), math.log(SCORE_FLOOR)))


def test_members_come_to_agree_where_they_are_trained_and_not_elsewhere():
    bonus = DisagreementBonus(3, 2, **SMALL | {"num_members": 3, "hidden_dims": (32,)}, **RAW)
    batch = transition(256)
    bonus.observe(batch)
    optimizer = torch.optim.Adam(bonus.parameters(), lr=3e-3)
    for _ in range(300):
        optimizer.zero_grad()
        bonus.loss(batch).backward()
        optimizer.step()
    near = bonus(batch.observation, batch.action).mean()
    far = bonus(batch.observation + 8, batch.action).mean()
    assert far > near + math.log(10)  # logs of scores


def test_one_member_cannot_disagree():
    with pytest.raises(ValueError, match="`num_members` must be at least 2"):
        DisagreementBonus(3, 2, num_members=1)
