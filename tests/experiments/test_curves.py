import csv
import json
import re

import pytest

from deep_curiosity.experiments.curves import (
    find_runs,
    known_tags,
    page_data,
    plot_png,
    read_runs,
    write_page,
)
from deep_curiosity.experiments.statistics import bootstrap
from deep_curiosity.training import Config

RETURNS = {  # of two agents on one task, and of one on another
    ("PointMaze", "curiosity"): [1.0, 2.0, 6.0],
    ("PointMaze", "none"): [0.0, 0.5],
    ("PendulumSwingup", "curiosity"): [3.0],
}


def write_run(folder, config, returns):
    """A folder as a run leaves it, with evaluations at steps 500, 1000 and so on."""
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps(config.to_json(), default=str))
    with (folder / "progress.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["step", "eval/return", "eval/success_rate", "time/steps_per_second"])
        for number, value in enumerate(returns, start=1):
            rows.writerow([500 * number, value, "", 80.0])


@pytest.fixture
def folder(tmp_path):
    for (env_id, bonus), returns in RETURNS.items():
        for seed, value in enumerate(returns):
            config = Config.of(env_id=env_id, bonus=bonus, seed=seed)
            write_run(tmp_path / f"{env_id}-{bonus}-{seed}", config, [value, value + 1])
    return tmp_path


@pytest.fixture
def runs(folder):
    return read_runs(find_runs([folder]))


def test_runs_are_found_below_a_folder_each_once(folder):
    one = folder / "PointMaze-none-0"
    assert len(find_runs([folder])) == 6
    assert find_runs([one, folder, one])[0] == one
    assert len(find_runs([one, folder, one])) == 6
    with pytest.raises(FileNotFoundError, match=r"`runs` must be folders of runs, got .*nothing"):
        find_runs([folder / "nothing"])


def test_runs_are_found_behind_links_each_once(folder, tmp_path):
    links = tmp_path / "links"
    links.mkdir()
    (links / "chosen").symlink_to(folder / "PointMaze-none-0", target_is_directory=True)
    assert find_runs([links]) == [links / "chosen"]
    assert find_runs([links / "chosen"]) == [links / "chosen"]
    assert len(find_runs([folder])) == len(find_runs([folder, links])) == 6
    (links / "back").symlink_to(tmp_path, target_is_directory=True)
    assert len(find_runs([links])) == 6


def test_an_agent_is_named_by_what_sets_it_apart_and_seeds_do_not(runs):
    assert {(run.task, run.agent) for run in runs} == set(RETURNS)


def test_runs_that_differ_in_nothing_are_one_agent_named_by_its_bonus(folder):
    (run,) = read_runs([folder / "PendulumSwingup-curiosity-0"])
    assert run.agent == "curiosity"


def test_other_settings_are_named_and_how_long_a_run_is_sets_none_apart(folder):
    config = Config.of(env_id="PointMaze", bonus="none", hidden_dim=64, total_steps=3_000)
    write_run(folder / "wide", config, [1.0])
    agents = {run.agent for run in read_runs(find_runs([folder])) if run.task == "PointMaze"}
    assert agents == {"curiosity, hidden_dim 256", "none, hidden_dim 256", "none, hidden_dim 64"}
    by_bonus = read_runs(find_runs([folder]), ["bonus"])
    assert {run.agent for run in by_bonus} == {"curiosity", "none"}
    with pytest.raises(ValueError, match="`group_by` must be settings of the runs, got width"):
        read_runs(find_runs([folder]), ["width"])


def test_arguments_of_an_environment_make_a_task(folder):
    config = Config.of(env_id="PendulumSwingup", env_kwargs={"action_cost": 0.1})
    write_run(folder / "costly", config, [1.0])
    tasks = {run.task for run in read_runs(find_runs([folder]))}
    assert tasks == {"PointMaze", "PendulumSwingup", "PendulumSwingup, action_cost 0.1"}


def test_tags_are_those_that_have_numbers(runs):
    assert known_tags(runs, []) == ["eval/return"]
    assert known_tags(runs, ["time/steps_per_second"]) == ["time/steps_per_second"]
    with pytest.raises(ValueError, match=r"`tags` must be of eval/return, .*, got eval/succ"):
        known_tags(runs, ["eval/success_rate"])


def test_a_run_that_has_logged_nothing_is_said_to(folder):
    write_run(folder / "new" / "run", Config(), [])
    with pytest.raises(ValueError, match="`runs` must have logged something, got 1 that have not"):
        known_tags(read_runs([folder / "new" / "run"]), [])


def test_the_page_has_means_intervals_and_every_run(runs):
    data = page_data(runs, ["eval/return"])
    panel = data["curves"]["PointMaze"]["eval/return"]
    assert panel["steps"] == [500, 1000]
    curious = panel["agents"]["curiosity"]
    for place, returns in enumerate(([1.0, 2.0, 6.0], [2.0, 3.0, 7.0])):
        expected = bootstrap([returns])
        shown = curious["value"][place], curious["low"][place], curious["high"][place]
        assert shown == tuple(expected)
    assert sorted(curious["runs"].values()) == [[1.0, 2.0], [2.0, 3.0], [6.0, 7.0]]
    assert set(data["curves"]["PendulumSwingup"]["eval/return"]["agents"]) == {"curiosity"}


def test_where_a_run_has_no_row_the_others_are_averaged(folder):
    config = Config.of(env_id="PointMaze", bonus="none", seed=7)
    write_run(folder / "longer", config, [0.25, 1.0, 9.0])
    data = page_data(read_runs(find_runs([folder])), ["eval/return"])
    panel = data["curves"]["PointMaze"]["eval/return"]
    assert panel["steps"] == [500, 1000, 1500]
    assert panel["agents"]["none"]["value"][2] == 9.0
    assert panel["agents"]["curiosity"]["value"][2] is None


def test_where_one_run_alone_logged_the_others_are_on_the_line_between_their_own(tmp_path):
    header = "step,eval/return\n"
    for seed, rows in enumerate(["60,0.0\n100,0.0\n120,0.0", "60,40.0\n120,100.0"]):
        config = Config.of(env_id="PointMaze", seed=seed)
        write_run(tmp_path / f"{seed}", config, [])
        (tmp_path / f"{seed}" / "progress.csv").write_text(f"{header}{rows}\n")
    runs = read_runs(find_runs([tmp_path]))
    panel = page_data(runs, ["eval/return"])["curves"]["PointMaze"]["eval/return"]
    (agent,) = panel["agents"].values()
    assert panel["steps"] == [60, 100, 120] and agent["value"] == [20.0, 40.0, 50.0]
    assert agent["runs"][str(tmp_path / "1")] == [40.0, None, 100.0]


def test_a_run_that_was_stopped_keeps_its_last_value_while_others_go_on(tmp_path):
    """Six of eight are stopped, solved; an agent that solves most must not end at nothing."""
    for seed in range(8):
        config = Config.of(env_id="PointMaze", seed=seed)
        is_solved = seed < 6
        write_run(tmp_path / f"{seed}", config, [0.0, 100.0] if is_solved else [0.0] * 5)
        if is_solved:
            (tmp_path / f"{seed}" / "summary.json").write_text(
                '{"total_steps": 1000, "stopped_by": "callback"}'
            )
    runs = read_runs(find_runs([tmp_path]))
    panel = page_data(runs, ["eval/return"])["curves"]["PointMaze"]["eval/return"]
    (agent,) = panel["agents"].values()
    assert agent["value"] == [0.0, 100.0, 100.0, 100.0, 100.0]
    assert agent["runs"][str(tmp_path / "0")] == [0.0, 100.0, None, None, None]


@pytest.mark.parametrize(
    ("end", "by"),
    [(1_000, "SIGINT"), (500, "callback")],  # the latter went on, and was cut off before it saved
)
def test_a_run_that_a_signal_cut_off_ends_where_it_was(tmp_path, end, by):
    for seed, returns in enumerate([[0.0, 50.0], [0.0, 50.0, 100.0]]):
        write_run(tmp_path / f"{seed}", Config.of(env_id="PointMaze", seed=seed), returns)
    (tmp_path / "0" / "summary.json").write_text(f'{{"total_steps": {end}, "stopped_by": "{by}"}}')
    panel = page_data(read_runs(find_runs([tmp_path])), ["eval/return"])["curves"]["PointMaze"]
    (agent,) = panel["eval/return"]["agents"].values()
    assert agent["value"] == [0.0, 50.0, 100.0]


def test_a_copy_of_a_run_is_no_seed_of_its_own(tmp_path):
    for name, returns in (("a", [1.0]), ("b", [1.0, 3.0]), ("c", [1.0])):
        write_run(tmp_path / name, Config.of(env_id="PointMaze", out=name), returns)
    with pytest.warns(UserWarning, match="passed over: it is the same run as .*b"):
        (run,) = read_runs(find_runs([tmp_path]))
    assert run.folder == tmp_path / "b"


def test_a_copy_that_went_on_is_no_seed_of_its_own(tmp_path):
    config = Config.of(env_id="PointMaze", total_steps=1_000)
    write_run(tmp_path / "first", config, [1.0, 2.0])
    longer = config.override(total_steps=1_500, log_interval=100)
    write_run(tmp_path / "longer", longer, [1.0, 2.0, 3.0])
    with pytest.warns(UserWarning, match="first is passed over: it is the same run as .*longer"):
        (run,) = read_runs(find_runs([tmp_path]))
    assert run.folder == tmp_path / "longer"


def test_runs_of_other_functions_or_other_rounding_are_no_copies(tmp_path):
    config = Config.of(env_id="make_env")
    for name, value in (("mine", 1.0), ("other", 2.0)):
        write_run(tmp_path / name, config, [value])
    fast = Config.of(env_id="PointMaze")
    write_run(tmp_path / "fast", fast, [1.0])
    write_run(tmp_path / "plain", fast.override(direct_matmul=False), [2.0])
    assert len(read_runs(find_runs([tmp_path]))) == 4


def test_the_page_needs_nothing_but_itself(runs, tmp_path):
    path = tmp_path / "out" / "curves.html"
    write_page(path, runs, ["eval/return"])
    page = path.read_text()
    assert not re.findall(r"""(?:src|href)\s*=\s*["']|@import|url\(|fetch\(""", page)
    assert not re.findall(r"/\*(?:STYLE|LIBRARY|DATA)\*/", page)
    (data,) = re.findall(r"^const data = (.*);$", page, re.MULTILINE)
    assert json.loads(data) == page_data(runs, ["eval/return"])


def test_a_name_cannot_end_the_script(folder):
    write_run(folder / "</script>", Config.of(env_id="PointMaze", seed=9), [1.0])
    path = folder / "curves.html"
    write_page(path, read_runs(find_runs([folder])), ["eval/return"])
    assert path.read_text().count("</script>") == 2


def test_the_picture_has_a_panel_for_each_task_and_tag(runs, tmp_path):
    small, large = tmp_path / "small.png", tmp_path / "large.png"
    plot_png(small, [run for run in runs if run.task == "PointMaze"], ["eval/return"])
    plot_png(large, runs, ["eval/return", "time/steps_per_second"])
    (width, height), (wider, higher) = map(png_size, (small, large))
    assert (wider, higher) == (2 * width, 2 * height)


def png_size(path):
    header = path.read_bytes()
    assert header[1:4] == b"PNG"
    return int.from_bytes(header[16:20], "big"), int.from_bytes(header[20:24], "big")


def test_a_run_whose_last_row_is_cut_off_is_read_up_to_there(folder):
    run = folder / "PointMaze-none-0"
    with (run / "progress.csv").open("a") as file:
        file.write("1500,7.5,,8")  # as many columns as there are, but for the end of the number
    with pytest.warns(
        UserWarning, match=r"PointMaze-none-0/progress.csv is read but for its last"
    ):
        (read,) = read_runs([run])
    assert [row["step"] for row in read.rows] == [500, 1000]


def test_a_damaged_run_and_what_is_no_run_are_passed_over(folder):
    damaged = folder / "PointMaze-none-0"
    (damaged / "progress.csv").write_text("step,eval/return\n500\n1000,2.0\n")
    for name, text in (("broken", "no JSON"), ("other", '{"name": "cat"}')):
        (folder / name).mkdir()
        (folder / name / "config.json").write_text(text)
    with pytest.warns(UserWarning) as warned:
        runs = read_runs(find_runs([folder]))
    assert len(runs) == 5 and damaged not in {run.folder for run in runs}
    said = [str(each.message) for each in warned]
    assert [text.partition(" is passed over: ")[0] for text in said] == [
        str(folder / name) for name in ("PointMaze-none-0", "broken", "other")
    ]
    assert said[2].endswith("`config.json` must be that of a run, got one without env_id.")


def test_a_policy_that_was_exported_is_no_run(folder):
    config = Config.of(env_id="PointMaze", bonus="none", hidden_dim=64)
    write_run(folder / "exported", config, [])
    (folder / "exported" / "progress.csv").unlink()
    runs = read_runs(find_runs([folder]))
    assert {run.agent for run in runs} == {"curiosity", "none"} and len(runs) == 6


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"env_kwargs": None}, "env_kwargs is None"),
        ({"env_id": 5}, "env_id is 5"),
        ({"bonus": None}, "bonus is None"),
    ],
    ids=str,
)
def test_a_folder_whose_settings_are_those_of_no_run_is_passed_over(folder, changes, message):
    path = folder / "PointMaze-none-0" / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    with pytest.warns(UserWarning, match=rf"none-0 is passed over: .* whose {message}"):
        assert len(read_runs(find_runs([folder]))) == 5


def test_a_run_with_a_step_that_is_none_is_passed_over(folder):
    path = folder / "PointMaze-none-0" / "progress.csv"
    path.write_text(path.read_text() + "inf,3,,80\n")
    message = (
        r"`step` must be a whole number, got inf in row 4 of .*progress\.csv, which is damaged"
    )
    with pytest.warns(UserWarning, match=message):
        assert len(read_runs(find_runs([folder]))) == 5


def test_what_is_named_twice_is_refused(folder):
    with pytest.raises(ValueError, match="`group_by` must be named once each, got bonus, bonus"):
        read_runs(find_runs([folder]), ["bonus", "bonus"])
    with pytest.raises(ValueError, match="`tags` must be named once each, got eval/return, eval/"):
        known_tags(read_runs(find_runs([folder])), ["eval/return"] * 2)
