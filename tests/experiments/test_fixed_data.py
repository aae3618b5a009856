"""What is measured of a bonus on data that do not change."""

import torch

from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.experiments.fixed_data import draw_share, run_on_fixed_data
from deep_curiosity.experiments.grid import cells_of
from deep_curiosity.experiments.study import Study, Task
from deep_curiosity.transitions import Transition


def result_of(tiny, folder, **settings):
    config = tiny.override(total_steps=60, evaluation_interval=30, replay_capacity=200)
    study = Study([Task("pendulum", config)], {"agent": settings}, seeds=1)
    return run_on_fixed_data(cells_of(study, folder)[0])


def test_a_row_is_measured_at_every_interval(tiny, tmp_path):
    rows = result_of(tiny, tmp_path / "runs", refresh_interval=1).rows
    assert [row["updates"] for row in rows] == [30, 60]
    assert abs(rows[-1]["bonus_mean"]) < 1 and 0.3 < rows[-1]["bonus_std"] < 3
    assert 0 <= rows[-1]["draw_share"] <= 1


def test_a_baseline_has_no_draw(tiny, tmp_path):
    rows = result_of(tiny, tmp_path / "runs", bonus="rnd", refresh_interval=1).rows
    assert set(rows[-1]) == {"updates", "bonus_mean", "bonus_std"}


def test_more_components_leave_less_to_the_draw_and_the_bonus_as_it_was(tiny):
    torch.manual_seed(0)
    observation, action = torch.randn(2_000, 2), torch.rand(2_000, 1) * 2 - 1
    shares = []
    for components in (16, 512):
        bonus = CuriosityBonus.default(2, 1, hidden_dims=(8,), components=components)
        flag = torch.zeros(2_000, dtype=torch.bool)
        batch = observation, action, flag.float(), observation + 0.1 * action, flag, flag
        bonus.observe(Transition(*batch))
        before = bonus(observation[:9], action[:9])
        shares.append(draw_share(bonus, observation, action))
        torch.testing.assert_close(bonus(observation[:9], action[:9]), before)
    assert shares[1] < 0.5 * shares[0]
