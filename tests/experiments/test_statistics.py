import math

import numpy as np
import pytest
import scipy.stats

from deep_curiosity.experiments.statistics import (
    bootstrap,
    interquartile_mean,
    probability_of_improvement,
    rank_correlation,
)


def test_the_interquartile_mean_leaves_a_quarter_out_at_either_end():
    assert interquartile_mean(np.array([100.0, 1.0, 3.0, 0.0])) == 2.0
    assert interquartile_mean(np.array([-50.0, 1.0, 2.0, 3.0, 400.0])) == 2.0
    assert interquartile_mean(np.array([1.0, 2.0, 6.0])) == 3.0


def test_the_interval_of_equal_values_is_a_point():
    assert bootstrap([[2.0] * 4, [4.0] * 4]) == (3.0, 3.0, 3.0)


def test_runs_are_resampled_within_their_task():
    estimate = bootstrap([[0.0] * 4, [1.0] * 4])
    assert estimate == (0.5, 0.5, 0.5)  # no draw has more of one task than of the other


def test_the_interval_covers_the_mean_of_a_known_distribution_as_often_as_it_says():
    random = np.random.default_rng(1)
    covered = [
        low <= 0.0 <= high
        for _, low, high in (bootstrap([random.normal(size=20).tolist()]) for _ in range(100))
    ]
    assert 0.85 <= np.mean(covered) <= 1.0


def test_more_runs_narrow_the_interval():
    few, many = (bootstrap([[0.0, 1.0] * number]) for number in (3, 50))
    assert many.high - many.low < 0.5 * (few.high - few.low)


def test_an_empty_group_is_refused():
    with pytest.raises(ValueError, match=r"`groups` must hold at least one run.*got \[2, 0\]"):
        bootstrap([[1.0, 2.0], []])


def test_probability_of_improvement_counts_pairs_and_halves_ties():
    assert probability_of_improvement([[3.0, 4.0]], [[1.0, 2.0]]).value == 1.0
    assert probability_of_improvement([[1.0, 1.0]], [[1.0, 1.0]]).value == 0.5
    assert probability_of_improvement([[0.0, 2.0]], [[1.0, 1.0]]).value == 0.5
    two_tasks = probability_of_improvement([[3.0, 4.0], [0.0, 0.0]], [[1.0, 2.0], [1.0, 1.0]])
    assert two_tasks == (0.5, 0.5, 0.5)


def test_probability_of_improvement_is_the_complement_of_its_reverse():
    random = np.random.default_rng(0)
    first, second = random.normal(size=(2, 3, 10)).tolist()
    there, back = (
        probability_of_improvement(*pair) for pair in ((first, second), (second, first))
    )
    assert there.value + back.value == pytest.approx(1.0)
    assert there.low <= there.value <= there.high


def test_probability_of_improvement_knows_no_order_of_the_runs():
    expected = (0.25, 0.0, 1.0)
    for first in ([0.0, 2.0], [2.0, 0.0]):
        assert probability_of_improvement([first], [[1.0, 3.0]]) == expected


def test_its_interval_is_that_of_runs_resampled_one_by_one():
    random = np.random.default_rng(1)
    first = [random.normal(size=size).tolist() for size in (4, 7)]
    second = [[value - 0.3 for value in group] for group in first]

    def resampled(group):
        return random.choice(group, size=len(group))

    drawn = [
        np.mean(
            [
                np.mean(np.sign(np.subtract.outer(resampled(one), resampled(other))) / 2 + 0.5)
                for one, other in zip(first, second, strict=True)
            ]
        )
        for _ in range(4_000)
    ]
    found = probability_of_improvement(first, second)
    assert found[1:] == pytest.approx(np.quantile(drawn, [0.025, 0.975]), abs=0.03)
    assert found.low < found.value < found.high


def test_agents_of_other_seeds_are_refused():
    with pytest.raises(ValueError, match="same tasks and seeds, got \\[2\\] and \\[1\\] runs"):
        probability_of_improvement([[1.0, 2.0]], [[1.0]])


def test_rank_correlation_knows_order_alone():
    assert rank_correlation([1, 2, 3], [10.0, 20.0, 1e9]) == pytest.approx(1.0)
    assert rank_correlation([1, 2, 3], [3.0, 2.0, 1.0]) == pytest.approx(-1.0)


def test_equal_values_share_the_mean_of_their_ranks():
    # ranks 1, 2.5, 2.5 against 1, 2, 3: covariance 1.5 over the root of 2 times 1.5
    assert rank_correlation([1, 2, 3], [0.0, 5.0, 5.0]) == pytest.approx(1.5 / 3**0.5)
    assert rank_correlation([0.0, 0.5, 0.9, 0.97, 0.99], [0, 0, 208.5, 0, 0]) == 0.0
    random = np.random.default_rng(0)
    first, second = random.integers(4, size=(2, 30)).tolist()
    expected = scipy.stats.spearmanr(first, second).statistic
    assert rank_correlation(first, second) == pytest.approx(expected)


@pytest.mark.parametrize("values", [[5, 5, 5], [1.0, math.nan, 3.0]], ids=str)
def test_what_has_no_order_has_no_rank_correlation(values):
    assert math.isnan(rank_correlation([1, 2, 3], values))
    assert math.isnan(rank_correlation(values, [1, 2, 3]))


def test_truth_values_are_compared_like_numbers():
    found = probability_of_improvement([[True, False]], [[False, False]])
    assert found.value == 0.75


def test_what_was_never_reached_may_be_infinite():
    values = [[3.0, 5.0, math.inf]]
    assert probability_of_improvement(values, values).value == 0.5
    assert not np.isnan(probability_of_improvement(values, values)).any()
    low, high = bootstrap(values)[1:]
    assert low == 3 and high == math.inf
