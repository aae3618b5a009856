import pytest

from deep_curiosity.experiments.grid import cells_of
from deep_curiosity.experiments.progress import TAIL, Progress, latest_step


@pytest.mark.parametrize(
    ("text", "step"),
    [
        ("step,eval/return\n", 0),
        ("step,eval/return\n500,1.5\n1000,2.5\n", 1000),
        ("step,eval/return\n500,1.5\n10", 500),  # a row that is being written
        ("step,eval/return\n500,1.5\n\0\0\0\n", 500),
        ("step,eval/return\n" + "500,1.5\n" * TAIL + "1000,1.5\n", 1000),
    ],
    ids=["header", "rows", "cut", "damaged", "long"],
)
def test_the_step_of_a_run_is_that_of_its_newest_whole_row(tmp_path, text, step):
    (tmp_path / "progress.csv").write_text(text)
    assert latest_step(tmp_path) == step


def test_a_run_that_has_not_begun_is_at_step_zero(tmp_path):
    assert latest_step(tmp_path / "missing") == 0


def test_the_line_counts_runs_and_the_steps_of_all(small_study, tmp_path, capsys):
    cells = cells_of(small_study, tmp_path / "runs")  # four runs of 40 steps
    for cell, step in zip(cells, (10, 20, 500, 0), strict=True):
        cell.folder.mkdir(parents=True)
        (cell.folder / "progress.csv").write_text(f"step\n{step}\n")
    with Progress(cells) as progress:
        assert [progress.step_of(number) for number in range(4)] == [10, 20, 40, 0]
        progress.end(3)
        progress.show(running=2, failed=1)
    shown = capsys.readouterr().err
    assert "0 of 4 done, 2 running, 1 failed" in shown
    assert "| 110/160 [" in shown
