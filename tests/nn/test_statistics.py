import math
from fractions import Fraction

import jaxtyping
import pytest
import torch

from deep_curiosity.nn.statistics import (
    HASH_OFFSET,
    NUM_DRAWN,
    WHITENINGS,
    Every,
    InputScaling,
    RobustMoments,
    RunningMoments,
    SaturatingMoments,
    Standardization,
    replaced_by_mean,
    scrambled,
)


def test_moments_of_batches_are_those_of_all_rows():
    moments = RunningMoments(3)
    batches = [torch.randn(size, 3) * 2 + 5 for size in (7, 1, 30, 12)]
    for batch in batches:
        moments.update(batch)
    rows = torch.cat(batches)
    torch.testing.assert_close(moments.mean, rows.mean(0))
    torch.testing.assert_close(moments.var, rows.var(0, correction=0))
    assert moments.count == 50


def test_two_batches_by_hand():
    moments = RunningMoments(1)
    moments.update(torch.tensor([[1.0], [3.0]]))
    moments.update(torch.tensor([[8.0]]))
    assert moments.mean.item() == pytest.approx(4)  # of 1, 3, 8
    assert moments.var.item() == pytest.approx(26 / 3)  # 9 + 1 + 16 over 3


def test_beyond_the_memory_an_update_is_an_exponential_average():
    moments = RunningMoments(1, memory=10.0)
    moments.update(torch.tensor([[0.0]] * 10))
    moments.update(torch.tensor([[4.0]] * 5))  # 5 of 10: half the weight
    assert moments.mean.item() == pytest.approx(2)
    assert moments.var.item() == pytest.approx(4)
    moments.update(torch.tensor([[4.0]] * 5))
    assert moments.mean.item() == pytest.approx(3)


def test_a_batch_larger_than_the_memory_replaces_all():
    moments = RunningMoments(2, memory=4.0)
    moments.update(torch.full((4, 2), 100.0))
    batch = torch.randn(16, 2)
    moments.update(batch)
    torch.testing.assert_close(moments.mean, batch.mean(0))
    torch.testing.assert_close(moments.var, batch.var(0, correction=0))


def test_memory_is_long_by_default():
    moments = RunningMoments(1)
    for _ in range(1_000):
        moments.update(torch.zeros(100, 1))
    moments.update(torch.full((100, 1), 1_001.0))
    assert moments.mean.item() == pytest.approx(1, rel=1e-4)


def test_normalized_rows_are_centred_and_scaled():
    moments = RunningMoments(2)
    rows = torch.randn(500, 2) * torch.tensor([0.01, 300.0]) + torch.tensor([1.0, -9.0])
    moments.update(rows)
    normal = moments.normalize(rows)
    torch.testing.assert_close(normal.mean(0), torch.zeros(2), atol=1e-4, rtol=0)
    torch.testing.assert_close(normal.std(0, correction=0), torch.ones(2), atol=1e-3, rtol=0)


def test_before_any_row_nothing_is_changed():
    value = torch.randn(4, 2)
    torch.testing.assert_close(RunningMoments(2).normalize(value), value)


def test_a_feature_that_never_moves_stays_finite():
    moments = RunningMoments(1)
    moments.update(torch.full((8, 1), 3.0))
    assert moments.scale > 0
    assert moments.normalize(torch.full((1, 1), 3.0)).item() == 0


def test_a_large_offset_does_not_spoil_the_variance():
    moments = RunningMoments(1)
    for _ in range(200):
        moments.update(1_000 + torch.randn(64, 1))
    assert moments.scale.item() == pytest.approx(1, rel=0.02)


def test_all_state_is_in_the_state_dict():
    moments, copy = RunningMoments(2), RunningMoments(2)
    moments.update(torch.randn(9, 2))
    copy.load_state_dict(moments.state_dict())
    batch = torch.randn(5, 2)
    moments.update(batch), copy.update(batch)
    assert copy.mean.equal(moments.mean) and copy.var.equal(moments.var)


@pytest.mark.parametrize("memory", [0.0, -1.0, float("nan")])
def test_a_memory_that_is_not_positive_is_rejected(memory):
    with pytest.raises(ValueError, match="`memory` must be positive"):
        RunningMoments(1, memory=memory)


def test_a_reach_that_is_not_positive_is_rejected():
    with pytest.raises(ValueError, match="`reach` must be positive, got 0"):
        RunningMoments(1, reach=0.0)


@pytest.mark.parametrize("absurd", [1e3, 1e12])
def test_within_reach_one_absurd_row_widens_nothing(absurd):
    rows = torch.randn(4_096, 2)
    rows[1_000] = absurd
    moments = RunningMoments(2, reach=10.0)
    for part in rows.split(256):
        moments.update(part)
    assert moments.scale.tolist() == pytest.approx([1, 1], abs=0.08)
    assert moments.mean.tolist() == pytest.approx([0, 0], abs=0.08)


def test_what_has_moved_for_good_is_followed_within_reach():
    moments = RunningMoments(1, memory=1_280.0, reach=10.0)
    for shift in (0.0, 1e4):
        for _ in range(60):
            moments.update(shift + torch.randn(256, 1))
    assert moments.mean.item() == pytest.approx(1e4, rel=1e-3)
    assert moments.scale.item() < 100


def test_the_mean_of_the_others_stands_for_what_is_absurd():
    value = torch.tensor([1.0, 2.0, 3.0, 1e9])
    is_absurd = torch.tensor([False, False, False, True])
    assert replaced_by_mean(value, is_absurd).tolist() == [1.0, 2.0, 3.0, 2.0]
    assert torch.equal(replaced_by_mean(value, ~(is_absurd | ~is_absurd)), value)
    assert torch.equal(replaced_by_mean(value, is_absurd | ~is_absurd), value)


def robust(rows, batch=256):
    moments = RobustMoments(rows.shape[1])
    for part in rows.split(batch):
        moments.update(part)
    return moments


@pytest.mark.parametrize("batch", [1, 7, 2_000])
def test_quartiles_of_few_rows_are_exact(batch):
    rows = torch.randn(2_000, 3)
    moments = robust(rows, batch)
    low, median, high = rows.quantile(torch.tensor([0.25, 0.5, 0.75]), dim=0)
    torch.testing.assert_close(moments.center, median)
    torch.testing.assert_close(moments.scale, (high - low) / 1.349, atol=1e-4, rtol=0)


def test_heavy_tails_do_not_move_a_robust_scale():
    rows = torch.distributions.Cauchy(3.0, 2.0).sample((40_000, 4))
    moments = robust(rows)
    assert moments.var.sqrt().min() > 30
    torch.testing.assert_close(moments.center, torch.full((4,), 3.0), atol=0.3, rtol=0)
    torch.testing.assert_close(moments.scale, torch.full((4,), 4 / 1.349), atol=0, rtol=0.15)


def test_a_robust_scale_of_a_gaussian_is_its_standard_deviation():
    moments = robust(5 + torch.randn(40_000, 4) * torch.tensor([0.1, 1.0, 10.0, 100.0]))
    torch.testing.assert_close(moments.scale, moments.var.sqrt(), atol=0, rtol=0.07)


def test_rows_kept_are_a_fair_sample_of_all_that_were_observed():
    rows = torch.arange(30_000.0).unsqueeze(-1)
    kept = robust(rows).rows[:, 0]
    assert len(kept.unique()) == NUM_DRAWN
    counts = torch.histc(kept, bins=10, min=0, max=30_000)
    assert (counts - NUM_DRAWN / 10).abs().max() < 60
    places = (kept % 16).long().bincount()  # as of 16 environments side by side
    assert (places - NUM_DRAWN / 16).abs().max() < 50


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_a_feature_that_mostly_rests_is_scaled_by_its_standard_deviation(share):
    rows = torch.randn(8_000, 1) * (torch.rand(8_000, 1) < share)
    moments = robust(rows)
    torch.testing.assert_close(moments.scale, rows.std(0, correction=0), atol=1e-5, rtol=1e-3)


def test_a_feature_that_never_moves_has_a_robust_scale():
    moments = robust(torch.full((600, 1), 3.0))
    assert moments.scale > 0
    assert moments.normalize(torch.full((1, 1), 3.0)).item() == 0


def test_before_a_second_row_a_robust_scale_is_one():
    moments = RobustMoments(2)
    value = torch.randn(4, 2)
    torch.testing.assert_close(moments.normalize(value), value)
    moments.update(value[:1])
    assert moments.scale.tolist() == [1, 1]


def test_robust_state_is_all_in_the_state_dict():
    moments, copy = RobustMoments(2), RobustMoments(2)
    moments.update(torch.randn(3_000, 2))
    copy.load_state_dict(moments.state_dict())
    batch = torch.randn(500, 2)
    moments.update(batch), copy.update(batch)
    assert copy.center.equal(moments.center) and copy.scale.equal(moments.scale)
    assert copy.rows.equal(moments.rows)


def test_every_bit_of_scrambled_numbers_is_a_fair_coin():
    number = scrambled(torch.arange(20_000) + HASH_OFFSET)
    heads = (number.unsqueeze(-1) >> torch.arange(64)) & 1
    assert (heads.double().mean(0) - 0.5).abs().max() < 0.02


def test_no_two_numbers_are_scrambled_alike_and_each_always_alike():
    number = torch.arange(10_000)
    assert len(scrambled(number).unique()) == 10_000
    assert scrambled(number).equal(scrambled(number.clone()))


def test_the_first_call_is_due_and_every_third_after_it():
    every, due = Every(3), []
    for _ in range(8):
        due.append(not every.should_skip)
        every.count()
    assert due == [True, False, False, True, False, False, True, False]


def test_the_query_whether_to_skip_changes_nothing():
    every, queried = Every(3), Every(3)
    for _ in range(7):
        for _ in range(5):
            assert queried.should_skip == every.should_skip
        assert queried.num_calls.equal(every.num_calls)
        every.count(), queried.count()


def test_calls_are_counted_on_from_the_state_dict():
    every, restored = Every(3), Every(3)
    for _ in range(4):
        every.count()
    restored.load_state_dict(every.state_dict())
    for _ in range(6):
        assert restored.should_skip == every.should_skip
        every.count(), restored.count()


@pytest.mark.parametrize("kind", WHITENINGS)
def test_centre_and_scale_follow_from_a_restored_state(kind):
    moments, restored = WHITENINGS[kind](2), WHITENINGS[kind](2)
    moments.update(torch.randn(50, 2) * 3 + 1)
    assert not {"center", "scale"} & moments.state_dict().keys()
    restored.load_state_dict(moments.state_dict())
    value = torch.randn(4, 2)
    assert restored.normalize(value).equal(moments.normalize(value))


@pytest.mark.parametrize("center", [False, True])
@pytest.mark.parametrize("scale", [False, True])
def test_a_standardised_value_is_centred_and_scaled_where_that_is_wanted(center, scale):
    standardization = Standardization(weight=0.5, center=center, scale=scale)
    value = torch.tensor([1.0, 3.0, 8.0])
    standardization.update(value)
    expected = 0.5 * (value - 4 * center) / (math.sqrt(26 / 3) if scale else 1)
    torch.testing.assert_close(standardization(value), expected)


@pytest.mark.parametrize("weight", [-0.1, math.nan, math.inf, 10**400])
def test_a_weight_that_is_negative_or_not_finite_is_rejected(weight):
    with pytest.raises(ValueError, match="`weight` must be finite and not negative, got"):
        Standardization(weight=weight, center=True, scale=True)


def test_a_weight_that_makes_bonuses_infinite_is_rejected():
    with pytest.raises(ValueError, match=r"`weight` must be at most 1e\+37, got 1e\+300"):
        Standardization(weight=1e300, center=True, scale=True)


@pytest.mark.parametrize("weight", [torch.tensor(0.1), Fraction(1, 10), "0.1", True, None])
def test_a_weight_must_be_a_number(weight):
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(TypeError, match="`weight` must be an int or a float, got"):
        Standardization(weight=weight, center=True, scale=True)


@pytest.mark.parametrize("flag", ["no", None, 1])
@pytest.mark.parametrize("name", ["center", "scale"])
def test_a_switch_is_on_or_off(name, flag):
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    with pytest.raises(TypeError, match=f"`{name}` must be True or False, got {flag!r}"):
        Standardization(**{"weight": 0.1, "center": True, "scale": True} | {name: flag})


def test_a_weight_may_be_any_whole_number():
    jaxtyping.config.update("jaxtyping_disable", True)  # which takes no whole numbers for others
    huge = Standardization(weight=10**30, center=False, scale=False)
    assert huge(torch.ones(1)).item() == pytest.approx(1e30)


def saturating(value):
    moments = SaturatingMoments(value.shape[1])
    for batch in value.split(256):
        moments.update(batch)
    return moments


def test_a_saturating_scale_of_a_gaussian_is_its_standard_deviation():
    torch.manual_seed(0)
    moments = saturating(3 + 2 * torch.randn(8_000, 1))
    assert moments.center.item() == pytest.approx(3, abs=0.15)
    assert moments.scale.item() == pytest.approx(2, rel=0.05)


def test_a_thousandth_of_all_rows_leaves_a_saturating_scale_where_it_is():
    torch.manual_seed(0)
    value = torch.randn(8_000, 1)
    value[::1_000] = 1e6
    assert saturating(value).scale.item() == pytest.approx(1, rel=0.1)


def test_a_tenth_of_all_rows_widens_a_saturating_scale():
    torch.manual_seed(0)
    value = 0.01 * torch.randn(8_000, 1)
    value[::8] = 1.0 + 0.01 * torch.randn(1_000, 1)
    assert 0.2 < saturating(value).scale.item() < 0.5


@pytest.mark.parametrize("moves", [0.01, 0.05, 0.1, 0.3])
def test_a_feature_that_mostly_rests_is_measured_where_it_moves(moves):
    """Its unit collapsed where fewer than a ninth of all rows moved."""
    torch.manual_seed(0)
    value = torch.where(torch.rand(8_000, 1) < moves, 2 * torch.rand(8_000, 1) - 1, 0.0)
    assert saturating(value).scale.item() == pytest.approx(1 / math.sqrt(3), rel=0.25)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_what_counts_as_rest_does_not_depend_on_the_unit_of_the_task(unit):
    torch.manual_seed(0)
    moves = torch.rand(8_000, 1) < 0.1
    value = torch.where(moves, torch.randn(8_000, 1), 1e-5 * torch.randn(8_000, 1))
    assert saturating(unit * value).scale.item() / unit == pytest.approx(1, rel=0.25)


def test_an_entry_that_begins_to_move_late_has_its_size_at_once():
    torch.manual_seed(0)
    moments = RunningMoments(1, reach=10.0)
    for _ in range(20):
        moments.update(torch.zeros(256, 1))
    value = torch.where(torch.rand(256, 1) < 0.2, torch.rand(256, 1), 0.0)
    moments.update(value)
    expected = (value.square().mean() / 21).sqrt().item()
    assert moments.scale.item() == pytest.approx(expected, rel=0.2)


def test_a_flag_that_is_rarely_set_has_its_own_size_as_unit():
    flag = torch.zeros(4_000, 1)
    flag[::50] = 1.0
    moments = saturating(flag)
    assert moments.normalize(torch.tensor([[0.0], [1.0]])).flatten().tolist() == pytest.approx(
        [0.0, math.asinh(1.0)], rel=0.01
    )


def test_far_values_count_by_their_logarithm_and_the_map_can_be_inverted():
    moments = saturating(torch.randn(2_000, 1))
    value = torch.tensor([[0.01], [1e2], [1e3], [1e4]])
    unit = moments.normalize(value)
    assert (unit[2:] - unit[1:3]).flatten().tolist() == pytest.approx([math.log(10)] * 2, rel=1e-3)
    back = moments.center + moments.scale * torch.sinh(unit)
    torch.testing.assert_close(back, value, rtol=1e-3, atol=1e-3)


def test_a_bonus_is_silent_until_it_has_statistics_and_cut_at_five_deviations():
    standardization = Standardization(weight=0.5, center=True, scale=True)
    assert standardization(torch.tensor([7.0])).item() == 0
    standardization.update(torch.tensor([-1.0, 1.0]))
    value = standardization(torch.tensor([-100.0, 0.0, 100.0]))
    assert value.tolist() == pytest.approx([-2.5, 0.0, 2.5])


@pytest.mark.parametrize("whitening", WHITENINGS)
def test_what_is_denormalized_is_as_before_it_was_normalized(whitening):
    moments = WHITENINGS[whitening](3)
    moments.update(3 * torch.randn(500, 3) + 5)
    value = 3 * torch.randn(50, 3) + 5
    torch.testing.assert_close(moments.denormalize(moments.normalize(value)), value)


def test_a_network_sees_features_of_a_size_between_a_tenth_and_ten():
    value = torch.randn(4_096, 4) * torch.tensor([0.02, 0.2, 9.0, 400.0]) + 1e-3
    scaling = InputScaling(4)
    assert scaling(value).equal(value)  # before there are statistics
    for batch in value.split(512):
        scaling.update(batch)
    seen = scaling(value)
    assert seen[:, 1:3].equal(value[:, 1:3])
    expected = value.square().mean(0).sqrt().clamp(0.1, 10.0)
    torch.testing.assert_close(seen.square().mean(0).sqrt(), expected, rtol=0.02, atol=0)


def test_no_feature_is_shifted_and_one_that_is_always_the_same_keeps_its_unit():
    scaling = InputScaling(2)
    scaling.update(torch.tensor([[0.01, 1.0], [0.03, 1.0]]))
    assert scaling(torch.tensor([0.0, 1.0])).tolist() == [0.0, 1.0]


def test_what_begins_to_move_late_drowns_no_other_feature():
    scaling = InputScaling(2)
    still = torch.randn(256, 2) * torch.tensor([1.0, 0.0])
    for _ in range(300):
        scaling.update(still)
    assert scaling(torch.tensor([2.0, 5.0])).tolist() == [2.0, 5.0]
    still[0, 1] = 5.0
    scaling.update(still)
    assert scaling(torch.tensor([2.0, 5.0])).tolist() == [2.0, 5.0]  # its size where it moves
    still[0, 1] = 0.01
    for _ in range(2_000):
        scaling.update(still)
    assert scaling.gain[1] > 1
    assert scaling(torch.tensor([2.0, 5.0])).tolist() == [2.0, 1.0]  # ten sizes of 0.1
    moving = torch.randn(256, 2)
    for _ in range(600):
        scaling.update(moving)
    assert scaling(torch.tensor([2.0, 5.0])).tolist() == [2.0, 5.0]


def test_one_absurd_value_is_cut_before_it_reaches_a_network():
    scaling = InputScaling(3)
    units = torch.tensor([1.0, 400.0, 0.0])
    scaling.update(torch.randn(4_096, 3) * units)
    seen = scaling(torch.full((3,), -5e13))
    torch.testing.assert_close(seen[:2], torch.tensor([-1e4, -1e5]), rtol=0.05, atol=0)
    assert seen[2] == -5e13  # of which no size is known yet


def test_no_rows_change_no_statistics():
    scaling, moments = InputScaling(1), RunningMoments(1)
    for each in (scaling, moments):
        each.update(torch.randn(9, 1))
        before = {name: value.clone() for name, value in each.state_dict().items()}
        each.update(torch.zeros(0, 1))
        assert all(value.equal(before[name]) for name, value in each.state_dict().items())


@pytest.mark.parametrize("absurd", [1e6, -3e38])
def test_an_absurd_row_leaves_a_size_where_it_is(absurd):
    scaling = InputScaling(1)
    for _ in range(100):
        scaling.update(torch.randn(256, 1))
    scaling.update(torch.full((1, 1), absurd))
    assert scaling.gain == 1
    first = InputScaling(1)
    first.update(torch.full((2, 1), absurd))  # of which no size is known yet
    for _ in range(12_000):
        first.update(torch.randn(256, 1))
    assert first.gain == 1


def test_a_size_follows_a_replay_that_widens():
    scaling = InputScaling(1)
    for _ in range(2_000):
        scaling.update(0.01 * torch.randn(256, 1))
    assert scaling.gain > 9
    for _ in range(1_000):
        scaling.update(torch.randn(256, 1))
    assert scaling.gain == 1


def test_a_scaling_follows_from_a_restored_state():
    scaling, other = InputScaling(2), InputScaling(2)
    scaling.update(torch.randn(9, 2) * torch.tensor([0.01, 50.0]))
    other.load_state_dict(scaling.state_dict())
    assert other.gain.equal(scaling.gain) and other.bound.equal(scaling.bound)


def rare_flags(share, num_rows=256, values=(1.0, 3.0, 5.0)):
    """Zero but for a share of the rows, which have one of some values."""
    chosen = torch.tensor(values)[torch.randint(len(values), (num_rows, 1))]
    return chosen * (torch.rand(num_rows, 1) < share)


@pytest.mark.parametrize("share", [0.3, 0.02, 0.005, 0.0005])
def test_a_flag_that_is_seldom_set_is_seen_as_it_is(share):
    torch.manual_seed(0)
    scaling = InputScaling(1)
    for _ in range(3_000):
        scaling.update(rare_flags(share))
    value = torch.tensor([[0.0], [1.0], [3.0], [5.0]])
    assert scaling(value).equal(value)


def test_small_units_are_widened_and_noise_of_arithmetic_is_not():
    torch.manual_seed(0)
    scaling = InputScaling(3)
    units = torch.tensor([5e-5, 1e-6, 1e-12])
    for _ in range(50):
        scaling.update(torch.randn(256, 3) * units)
    size = scaling(torch.randn(4_096, 3) * units).square().mean(0).sqrt()
    torch.testing.assert_close(size, torch.tensor([0.1, 0.1, 1e-12]), rtol=0.05, atol=0)


@pytest.mark.parametrize("off", [0.0, -1.0, 0.5])
def test_a_flag_that_is_seldom_set_keeps_its_deviation(off):
    torch.manual_seed(0)
    moments = RunningMoments(1, reach=10.0)
    for _ in range(2_000):
        moments.update(off + (torch.rand(256, 1) < 0.0025).float())
    assert moments.scale.item() == pytest.approx(0.05, rel=0.1)
    assert not moments.is_far(torch.tensor([[off + 1.0]]))
    assert moments.is_far(torch.tensor([[off + 1e3]]))


def test_of_small_batches_old_ones_fade_as_soon_as_of_large_ones():
    for num_rows in (1, 2, 5, 64, 256):
        moments = RunningMoments(1, memory=1_280.0, batches=20.0)
        for _ in range(100):
            moments.update(torch.zeros(num_rows, 1))
        for _ in range(60):
            moments.update(torch.ones(num_rows, 1))
        assert moments.mean > 0.75, num_rows


def test_a_feature_of_two_values_has_the_same_unit_from_batch_to_batch():
    torch.manual_seed(0)
    moments, units = SaturatingMoments(1), []
    for _ in range(400):
        moments.update((torch.rand(256, 1) < 0.5).float())
        units.append((moments.center.item(), moments.scale.item()))
    centers, scales = map(set, zip(*units[20:], strict=True))
    assert len(centers) == 1
    assert max(scales) < 1.1 * min(scales)


def test_states_of_before_flags_were_told_apart_are_loaded():
    for statistics in (RunningMoments(2), InputScaling(2)):
        statistics.update(torch.randn(16, 2))
        state = statistics.state_dict()
        del state["moving"]
        statistics.load_state_dict(state)
        assert statistics.moving.tolist() == [1.0, 1.0]
