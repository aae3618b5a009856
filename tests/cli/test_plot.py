import errno

import pytest
from matplotlib.figure import Figure

from deep_curiosity.cli import main
from deep_curiosity.training import train


def test_runs_become_a_picture_and_a_page(tiny, tmp_path, capsys):
    for seed in (0, 1):
        run = tiny.override(seed=seed, out=tmp_path / "runs" / str(seed))
        train(run, show_progress=False)
    out = tmp_path / "figures" / "v1.2"
    assert main(["plot", str(tmp_path / "runs"), "--out", str(out)]) == 0
    assert "2 runs in " in capsys.readouterr().out
    assert (tmp_path / "figures" / "v1.2.png").stat().st_size > 10_000
    page = (tmp_path / "figures" / "v1.2.html").read_text()
    assert '"PendulumSwingup, action_cost 0.1"' in page
    assert '"curiosity/nats"' in page


def test_runs_below_the_home_folder_are_drawn(tiny, monkeypatch, capsys):
    train(tiny, show_progress=False)
    monkeypatch.setenv("HOME", str(tiny.run.out.parent))
    assert main(["plot", "~/run", "--out", "~/curves"]) == 0
    assert capsys.readouterr().out.startswith("1 runs in ")
    assert (tiny.run.out.parent / "curves.png").exists()


@pytest.mark.parametrize("arguments", [["no/such"], [".", "--tags", "agent/luck"]], ids=str)
def test_what_cannot_be_drawn_is_answered_in_one_line(arguments, tmp_path, monkeypatch, refusal):
    monkeypatch.chdir(tmp_path)
    assert refusal("plot", *arguments).startswith("error: `runs` must be folders of runs, got ")


def test_a_plot_of_no_folder_says_what_is_missing(tmp_path, refusal):
    said = refusal("plot", "--out", tmp_path / "curves")
    assert "`runs` must name a folder at least, got none." in said


@pytest.mark.parametrize("out", ["curves.png", "curves.html", ".."])
def test_a_path_with_the_suffix_of_a_file_is_refused(out, tmp_path, monkeypatch, refusal):
    monkeypatch.chdir(tmp_path)
    said = " ".join(refusal("plot", ".", "--out", out).split())
    assert f"`out` must be a path of a file without its suffix, got {out}" in said


def test_what_is_no_run_is_passed_over_and_a_run_that_is_written_is_drawn(tiny, tmp_path, capsys):
    train(tiny, show_progress=False)
    with (tiny.run.out / "progress.csv").open("a") as file:
        file.write("80,1")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "config.json").write_text("{}")
    (tmp_path / "exported").mkdir()
    for name in ("config.json", "spaces.json"):
        (tmp_path / "exported" / name).write_bytes((tiny.run.out / name).read_bytes())
    with pytest.warns(UserWarning) as warned:
        assert main(["plot", str(tmp_path), "--out", str(tmp_path / "curves")]) == 0
    assert capsys.readouterr().out.startswith("1 runs in ")
    assert len(warned) == 2


def test_files_of_the_users_own_and_the_folder_of_a_run_are_left_alone(tiny, tmp_path, refusal):
    train(tiny, show_progress=False)
    picture, page = tmp_path / "mine.png", tmp_path / "mine.html"
    for path in (picture, page):
        path.write_text("mine")
        answer = refusal("plot", tiny.run.out, "--out", tmp_path / "mine")
        assert "`out` must name new files, or those of a plot, got " in answer
        assert str(path) in answer and path.read_text() == "mine"
    answer = refusal("plot", tiny.run.out, "--out", tiny.run.out / "run")
    assert "`out` must name files outside of the folder of a run, got " in answer


def test_a_plot_takes_the_place_of_the_last_one_once_it_is_whole(
    tiny, tmp_path, monkeypatch, refusal
):
    def fails(figure, path, **options):
        path.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    train(tiny, show_progress=False)
    arguments = ["plot", str(tiny.run.out), "--out", str(tmp_path / "curves")]
    for _ in range(2):
        assert main(arguments) == 0
    before = (tmp_path / "curves.png").read_bytes()
    monkeypatch.setattr(Figure, "savefig", fails)
    answer = refusal(*arguments)
    assert f"`out` must name files that can be written, got {tmp_path / 'curves'}: No sp" in answer
    assert (tmp_path / "curves.png").read_bytes() == before
    assert not [*tmp_path.glob("*partial*")]
