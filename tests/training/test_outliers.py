import numpy as np
import pytest

from deep_curiosity.training.outliers import FACTOR, UsualSize, usual_size


def rows(*values):
    return np.array([values], np.float32)


def test_what_is_usual_is_left_as_it_is():
    usual = UsualSize(np.ones(2))
    value = rows(3.0, -99.0)
    assert usual.cut(value) is value


@pytest.mark.parametrize("kept", [1.0, FACTOR])
@pytest.mark.parametrize("absurd", [1e6, 1e12, 1e25, -1e30, 3e38])
def test_one_absurd_number_among_usual_ones_is_cut_and_moves_little(absurd, kept):
    usual, random = UsualSize(np.ones(2), kept), np.random.default_rng(0)
    for _ in range(500):
        usual.cut(random.normal(size=(1, 2)).astype(np.float32))
    before = usual.size.copy()
    cut = usual.cut(rows(absurd, 0.5))
    assert cut.dtype == np.float32
    assert cut[0, 0] == pytest.approx(np.sign(absurd) * kept * before[0])
    assert cut[0, 1] == 0.5
    assert (usual.size <= 1.06 * before).all()


def test_the_usual_size_comes_to_the_quantile_of_99_percent():
    usual, random = UsualSize(np.ones(1)), np.random.default_rng(0)
    sizes = []
    for _ in range(20_000):
        usual.cut(random.normal(scale=50, size=(1, 1)))
        sizes.append(usual.size.item())
    assert np.mean(sizes[5_000:]) == pytest.approx(50 * 2.576, rel=0.1)


@pytest.mark.parametrize("scale", [1e3, 1e5, 1e8])
def test_numbers_of_another_order_that_stay_come_to_be_usual(scale):
    usual = UsualSize(np.ones(1))
    value = np.array([[scale]])
    cut = [usual.cut(value).item() < scale for _ in range(400)]
    assert cut[0] and not cut[-1]


def test_one_absurd_number_in_a_hundred_never_comes_to_be_usual():
    usual = UsualSize(np.ones(1))
    for _ in range(50):
        for _ in range(120):
            usual.cut(np.array([[0.5]]))
        assert usual.cut(np.array([[1e9]])).item() < 1.2


def test_a_space_says_what_is_usual_unless_it_allows_everything():
    low = np.array([-1.0, -500.0, -np.inf, -3e38, 0.0], np.float32)
    high = np.array([1.0, 100.0, np.inf, 3e38, 0.0], np.float32)
    assert usual_size(low, high).tolist() == [1.0, 5.0, 1.0, 1.0, 1.0]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_lies_at_its_declared_bound_is_left_as_it_is(dtype):
    bound = np.arange(
        101, 10_001, dtype=dtype
    )  # of which a hundredth, times a hundred, may be less
    size = UsualSize(usual_size(-bound, bound))
    for value in (bound, -bound):
        assert (size.cut(value[None]) == value).all()
