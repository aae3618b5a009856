import numpy as np
import pytest

from deep_curiosity.experiments.paper.figures import open_figure
from deep_curiosity.experiments.paper.neighbours import measure, plot_environment, solve_all
from deep_curiosity.tabular.environments import LEFT, RIGHT, chain, reliable_unreliable


def test_methods_end_where_the_table_says_in_the_second_illustration():
    mdp = reliable_unreliable()
    rows = {
        method: measure("reliable", method, mdp, *found)
        for method, found in solve_all(mdp, seed=0, num_steps=200).items()
    }
    assert len(rows) == 9
    assert rows["curious"].bits_state_and_action == pytest.approx(0.5, abs=1e-6)
    far_sighted = rows["curious, far-sighted"].bits_state_and_action
    assert 0.58 < far_sighted < np.log2(3) - 1
    assert all(row.pay == 0 for row in rows.values())
    assert [row.converged for row in rows.values()] == [None] * 3 + [True] * 6


def test_reward_and_information_of_a_constant_policy_by_hand():
    row = measure("chain", "right", chain(2, slip=0.1), np.eye(2)[[RIGHT, RIGHT]])
    assert row.pay == pytest.approx(0.9)
    assert row[2:5] == pytest.approx((0, 0, 0), abs=1e-12)


def test_rewards_are_written_beside_the_bars(tmp_path):
    mdp = chain(2)
    policies = {"left": np.eye(2)[[LEFT, LEFT]], "uniform": np.full((2, 2), 0.5)}
    rows = [measure("chain", method, mdp, policy) for method, policy in policies.items()]
    with open_figure(tmp_path / "figure.png", 3.0, 2.0) as figure:
        axis = figure.subplots()
        plot_environment(axis, rows)
    texts = [text.get_text() for text in axis.texts]
    assert texts == ["reward per step", f"{rows[1].pay:.3f}", f"{rows[0].pay:.3f}"]
