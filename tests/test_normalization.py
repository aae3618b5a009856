import pytest
import torch

from deep_curiosity.normalization import RunningMoments


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
