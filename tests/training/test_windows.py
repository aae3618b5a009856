import numpy as np

from deep_curiosity.training.windows import first_window, next_window, window_dim


def test_windows_of_a_batch_by_hand():
    first = first_window(np.array([[1.0, 2.0], [3.0, 4.0]], np.float32), 1, 2)
    assert first.tolist() == [[1, 2, 0, 1, 2], [3, 4, 0, 3, 4]]
    action, observation = np.array([[0.5], [0.25]]), np.array([[5.0, 6.0], [7.0, 8.0]])
    second = next_window(first, action, observation)
    assert second.tolist() == [[1, 2, 0.5, 5, 6], [3, 4, 0.25, 7, 8]]
    assert second.dtype == first.dtype
    assert second.shape[-1] == window_dim(2, 1, 2)


def test_a_window_of_one_is_the_observation():
    assert first_window(np.array([1.0, 2.0]), 3, 1).tolist() == [1, 2]
    assert window_dim(2, 3, 1) == 2
