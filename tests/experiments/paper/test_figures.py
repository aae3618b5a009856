import matplotlib
import pytest

from deep_curiosity.experiments.paper.figures import open_figure


def test_figure_is_saved_in_its_style_and_the_settings_are_restored(tmp_path):
    before = dict(matplotlib.rcParams)
    with open_figure(tmp_path / "figure.png", 2.0, 1.0) as figure:
        assert not figure.subplots().spines["top"].get_visible()
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert dict(matplotlib.rcParams) == before


def test_figure_that_fails_leaves_no_file(tmp_path):
    before = dict(matplotlib.rcParams)
    with pytest.raises(ZeroDivisionError), open_figure(tmp_path / "figure.png", 2.0, 1.0):
        _ = 1 / 0
    assert not list(tmp_path.iterdir())
    assert dict(matplotlib.rcParams) == before
