"""Some hundred wrong words for every option of every script, of which nothing is ever run."""

import itertools
import math
import runpy
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from deep_curiosity.benchmark.sections import Benchmark
from deep_curiosity.cli import answering
from deep_curiosity.configuration import MOST_STEPS, flat
from deep_curiosity.training import Config
from deep_curiosity.training.collector import Episode
from deep_curiosity.training.config import PRESETS
from deep_curiosity.training.log import open_folder

ROOT = Path(__file__).parents[1]
WORDS = [
    "",
    "-1",
    "0",
    "0.5",
    "1e400",
    "-1e400",
    "nan",
    "inf",
    "1e300",
    "1e-300",
    "9" * 30,
    "9" * 5_000,
    "½",
    "日本",
    "None",
    "True",
    "[1, 2]",
    "a b",
    "../..",
    "/dev/null",
    "a\0b",
    "x" * 5_000,
]
"""Each of them is wrong for most options."""
LARGEST = {"hidden_dim": 2**14, "num_envs": 2**16, "seed": 2**32 - 1, "threads": 1_024}
EPISODE = Episode(1.0, 5)


class Accepted(Exception):
    """The command line was taken, and this is what would be done."""


def accept(*values, **named):
    raise Accepted(*values, named)


@pytest.fixture
def run_folder(tmp_path):
    return open_folder(Config.of(out=tmp_path / "run", total_steps=900, hunger="random"))


@pytest.fixture
def call(monkeypatch, capsys, run_folder):
    """Function that gives a command line to a script: what it accepted, or what it printed."""
    monkeypatch.chdir(run_folder.parent)
    monkeypatch.setattr("deep_curiosity.cli.train.train", accept)
    monkeypatch.setattr("deep_curiosity.cli.evaluate.load_policy", accept)
    monkeypatch.setattr("deep_curiosity.cli.study.run_study", accept)
    monkeypatch.setattr("deep_curiosity.experiments.paper.page.write_paper", accept)
    monkeypatch.setattr("deep_curiosity.benchmark.run.run_benchmark", accept)
    monkeypatch.setattr("deep_curiosity.benchmark.calls.record_update", accept)
    capsys.readouterr()

    def called(script, *arguments):
        monkeypatch.setattr(sys, "argv", [script, *map(str, arguments)])
        try:
            runpy.run_path(str(ROOT / "scripts" / f"{script}.py"), run_name="__main__")
        except Accepted as accepted:
            return accepted.args, ""
        except SystemExit as stopped:
            printed = capsys.readouterr()
            assert stopped.code == 2, (stopped.code, printed)
            return None, printed.err + printed.out
        raise AssertionError(f"{script} did nothing")

    return called


def refusal(call, script, *arguments):
    accepted, printed = call(script, *arguments)
    assert accepted is None, accepted
    check_message(printed)
    return " ".join(printed.replace("│", " ").split())


def check_message(printed):
    """One message, and no traceback."""
    assert "Traceback" not in printed
    of_parser = printed.count("For full helptext")
    assert printed.count("error: ") + of_parser == 1
    assert of_parser or printed.count("\n") == 1


def check_sane(value):
    """A number that is finite and of this world, or text that can be shown."""
    if isinstance(value, dict | list | tuple):
        for entry in value.values() if isinstance(value, dict) else value:
            check_sane(entry)
    elif isinstance(value, int | float):
        assert math.isfinite(value) and abs(value) <= MOST_STEPS
    else:
        assert value is None or (str(value).isprintable() and str(value))


TRAINED = [name for name in flat(Config()) if not isinstance(flat(Config())[name].value, bool)]
FUZZED = [
    *(("train", name, ()) for name in [*TRAINED, "bonus", "preset", "resume"]),
    *(("evaluate", name, ("run",)) for name in ("episodes", "seed", "hunger", "video")),
    *(("study", name, ("sparse",)) for name in ("seeds", "tasks", "agents", "set", "runs", "out")),
    ("study", "workers", ("sparse",)),
    *(("benchmark", own.name, ()) for own in fields(Benchmark)),
    *(("paper", name, ()) for name in ("out", "seed")),
]
PAIRS = [
    (script, name, first, word)
    for number, (script, name, first) in enumerate(FUZZED)
    for word in itertools.islice(itertools.cycle(WORDS), 3 * number, 3 * number + 3)
]


def test_there_are_more_than_three_hundred_of_them():
    assert len(PAIRS) + len(REFUSED) > 300
    assert {word for *_, word in PAIRS} == set(WORDS)


@pytest.mark.parametrize(
    ("script", "name", "first", "word"),
    PAIRS,
    ids=[f"{number}-{script}-{name}" for number, (script, name, *_) in enumerate(PAIRS)],
)
def test_a_word_is_refused_by_name_or_makes_sense(call, script, name, first, word):
    flag = "--" + name.replace("_", "-")
    accepted, printed = call(script, *first, f"{flag}={word}")
    if accepted is None:
        check_message(printed)
        assert flag in printed or f"`{name}` " in printed
        return
    value = accepted[0]
    if script == "train":
        own = flat(value)
        check_sane({each: setting.value for each, setting in own.items()})
        assert all(own[each].value <= most for each, most in LARGEST.items())
    if script == "benchmark":
        check_sane([value.repeats, value.steps, value.out, value.peers])


REFUSED = [
    ("train", ["--total-steps", 10**30], "`total_steps` must be at most"),
    ("train", ["--total-steps", 0], "`total_steps` must be at least 1"),
    ("train", ["--hidden-dim", 10**9], "`hidden_dim` must be at most 16384"),
    ("train", ["--learning-rate", "1e300"], "`learning_rate` must be at most 1"),
    ("train", ["--learning-rate", "1e-300"], "`learning_rate` must be at least 1e-09"),
    ("train", ["--model-learning-rate", 2], "`model_learning_rate` must be at most 1"),
    ("train", ["--num-envs", 10**6], "`num_envs` must be at most 65536"),
    ("train", ["--num-envs", 20_000], "`total_steps` must be above 20000"),
    ("train", ["--seed", -1], "`seed` must not be negative"),
    ("train", ["--seed", 2**32], "`seed` must be at most 4294967295"),
    ("train", ["--batch-size", 0], "`batch_size` must be at least 1"),
    ("train", ["--batch-size", 10**7], "`batch_size` must be at most 1000000"),
    ("train", ["--replay-capacity", 100], "`replay_capacity` must be at least `batch_size`"),
    ("train", ["--replay-capacity", 10**12], "`replay_capacity` must be at most"),
    ("train", ["--update-to-data", "1e-9"], "`update_to_data` must call for an update"),
    ("train", ["--update-to-data", 10**6], "`update_to_data` must be at most 1000"),
    ("train", ["--target-information-rate", 0], "`target_information_rate` must be positive"),
    ("train", ["--target-information-rate=-5"], "`target_information_rate` must be positive"),
    ("train", ["--temperature", "1e-30"], "`temperature` must be at least"),
    ("train", ["--temperature", "linear:1:1e30"], "`temperature` must be at most"),
    ("train", ["--hunger", "exponential:1:1e30"], "`hunger` must be at most"),
    ("train", ["--hunger", "linear:1:nan"], "`hunger` cannot be read"),
    ("train", ["--hunger", "conditioned:nan"], "`hunger` cannot be read"),
    ("train", ["--polyak", "1e-30"], "`polyak` must be at least"),
    ("train", ["--actor-batch-fraction", "1e-300"], "`actor_batch_fraction` must be at least"),
    ("train", ["--actor-batch-fraction", "0.001"], "`actor_batch_fraction` must leave a row"),
    ("train", ["--frame-stack", 10**5], "`frame_stack` must be at most"),
    ("train", ["--threads", 10**6], "`threads` must be at most"),
    ("train", ["--device", "cpu:7"], "`device` must be cpu or cuda"),
    ("train", ["--device", "cuda:99"], "`device` must be one that torch can use here"),
    ("train", ["--device", "meta"], "`device` must be cpu or cuda"),
    ("train", ["--env-id", ""], "`env_id` must have characters"),
    ("train", ["--bonus-parts", "luck", 1], "`bonus_parts` cannot be weighed"),
    ("train", ["--bonus-parts", "information_gain", 0], "`bonus_parts` cannot be weighed"),
    ("train", ["--bonus-parts", "information_gain", "nan"], "`bonus_parts` must be finite"),
    ("train", ["--env-kwargs", "action_cost"], "--env-kwargs"),
    ("train", ["--features", 1, 1], "`features` must name different entries"),
    ("train", ["--features", 10**9], "`features` must be at most"),
    ("train", ["--bandwidth", "1e-9"], "`bandwidth` must be at least"),
    ("train", ["--noise-floor", "1e-9"], "`noise_floor` must be at least"),
    ("train", ["--marginal-half-life", "1e300"], "`marginal_half_life` must be at most"),
    ("train", ["--tune-bonus-weight", "nan"], "`tune_bonus_weight` must be finite"),
    ("train", ["--bonus-weight", 0, "--tune-bonus-weight", "past"], "`bonus_weight` must be pos"),
    ("train", ["--bonus", "nearest-neighbours", "--neighbours", 9999], "`neighbours` must be at"),
    ("train", ["--bonus", "rnd", "--noise-floor", 1], "bonus rnd; it is a setting of curiosity"),
    ("train", ["--bonus", "none", "--hunger", 0], "`hunger` must be a positive number"),
    ("train", ["--bonus", "none", "--greedy-share", 0], "`greedy_share` must be left out"),
    ("train", ["--bonus", "none", "--curiosity-ends", 900], "`curiosity_ends` must be left out"),
    ("train", ["--curiosity-ends=-5"], "`curiosity_ends` must be at least 1"),
    ("train", ["--curiosity-ends", 500], "`curiosity_ends` must be above `learning_starts`"),
    ("train", ["--curiosity-discount", 0, "--curiosity-steps", 2], "`curiosity_steps`"),
    ("train", ["--compile", "off", "--no-deduplicate"], "`deduplicate` must be left out"),
    ("train", ["--compile", "off", "--no-direct-matmul"], "`direct_matmul` must be left out"),
    ("train", ["--num-envs", 2, "--no-numpy-policy"], "`numpy_policy` must be left out"),
    ("train", ["--totl-steps", 9], "--total-steps"),
    ("train", ["--hiden-dim", 9], "--hidden-dim"),
    ("train", ["--hidden-dim", 9, 10], "10"),
    ("train", ["--hidden-dim"], "--hidden-dim"),
    ("train", ["--critic-layer-norm", "yes"], "yes"),
    ("train", ["word"], "word"),
    ("train", ["--seed", 1, "--seed=2"], "`seed` must be given once"),
    ("train", ["--resume", "run", "--total-steps", 400], "`total_steps` must be above `learning_"),
    ("train", ["--resume", "run", "--hidden-dim", 8], "`hidden_dim` must stay"),
    ("train", ["--resume", "run", "--out", "other"], "`out` must be left out"),
    ("train", ["--resume", "."], "`resume` must be the folder of a run"),
    ("train", ["--resume"], "--resume"),
    ("evaluate", [], "Required options"),
    ("evaluate", ["missing"], "`folder` must be the folder of a run"),
    ("evaluate", ["/dev/null"], "`folder` must be a folder"),
    ("evaluate", ["run", "--episodes", 0], "`episodes` must be at least 1"),
    ("evaluate", ["run", "--hunger", 0, 2], "`hunger` must be at most 1"),
    ("evaluate", ["run", "--seed", 2**40], "`seed` must be at most"),
    ("evaluate", ["run", "--video", "film.txt"], "`video` must be a file .mp4 or .gif"),
    ("evaluate", ["run", "--video", "/dev/null/film.gif"], "`video` must be a folder"),
    ("evaluate", ["run", "run"], "run"),
    (
        "train",
        ["--bonus", "none", "--bonus-weight", 1],
        "`bonus_weight` must be left out with the",
    ),
    ("study", [], "Required options"),
    ("study", ["sparce"], "the nearest is sparse"),
    ("study", ["missing.py"], "`study` must name a file that exists"),
    ("study", ["broken.py"], "`study` must be a file of Python"),
    ("study", ["empty.py"], "`study` must hold STUDIES"),
    ("study", ["json.py"], "`study` must be a file whose name no other module has"),
    ("study", ["sparse", "--seeds", 0], "`seeds` must be at least 1"),
    ("study", ["sparse", "--workers", 10**5], "`workers` must be at most"),
    ("study", ["sparse", "--tasks", "Chess"], "`tasks` must be of the study"),
    ("study", ["sparse", "--tasks", "PointMaze", "PointMaze"], "`tasks` must be"),
    ("study", ["sparse", "--set", "seed=3"], "`seed` must be left to the study"),
    ("study", ["sparse", "--set", "hiden_dim=3"], "the nearest is hidden_dim"),
    ("study", ["sparse", "--set", "self=3"], "`self` is no setting"),
    ("study", ["sparse", "--set", "hidden_dim=1e400"], "`hidden_dim` must be int"),
    ("study", ["sparse", "--set", "total_steps"], "`set` must be written as name=value"),
    (
        "study",
        ["sparse", "--set", "batch_size=8", "batch_size=9"],
        "`set` must name a setting once",
    ),
    ("study", ["sparse", "--out", "table.csv"], "`out` must be a path of a file without"),
    ("study", ["sparse", "--runs", "/dev/null"], "`runs` must be a folder"),
    ("benchmark", ["--repeats", 0], "`repeats` must be at least 1"),
    ("benchmark", ["--only", "speed"], "--only"),
    ("benchmark", ["--only", "vector", "--steps", 20], "`steps` must be left out"),
    ("benchmark", ["--only", "bonus", "--peers", "a", "b:c"], "`peers` must be left out"),
    ("benchmark", ["--peers", "a", "b"], "`peers` must each be a name and module:callable"),
    ("benchmark", ["--out", "/dev/null"], "`out` must be a folder"),
    ("paper", ["--out", "/dev/null/paper"], "`out` must be a folder"),
    ("paper", ["--seed", 1.5], "it must be a whole number, got '1.5'"),
    ("count_calls", ["--fast"], "--fast"),
]


@pytest.mark.parametrize(("script", "arguments", "message"), REFUSED, ids=str)
def test_what_is_absurd_or_would_do_nothing_is_refused(
    call, run_folder, script, arguments, message
):
    (run_folder.parent / "broken.py").write_text("STUDIES = {")
    (run_folder.parent / "empty.py").touch()
    (run_folder.parent / "json.py").touch()
    before = sys.path.copy()
    assert message in refusal(call, script, *arguments)
    assert [path for path in sys.path if path] == [path for path in before if path]


def test_every_default_may_be_given(call):
    config = Config()
    for group in (config.environment, config.run, config.bonus, config.agent, config.speed):
        words = []
        for name, own in flat(group).items():
            flag = name.replace("_", "-")
            if isinstance(own.value, bool):
                words.append(f"--{flag}" if own.value else f"--no-{flag}")
            elif own.value not in ((), {}):
                words.append(f"--{flag}={own.value}")
        (accepted, *_), _ = call("train", *words)
        assert accepted == config


@pytest.mark.parametrize("preset", PRESETS)
def test_what_makes_sense_is_accepted(call, preset):
    (config, *_), _ = call("train", "--preset", preset, "--env-id", "PointMaze", "--seed", 0)
    assert config == Config.of(preset, env_id="PointMaze")


@pytest.mark.parametrize(
    ("script", "arguments"),
    [
        ("evaluate", ["run", "--hunger", 0, 0.5, 1, "--video", "films/a.gif"]),
        ("study", ["sparse", "--seeds", 1, "--set", "log_interval=50", "--out", "a/rate-0.5"]),
        ("benchmark", ["--only", "agents", "--steps", 20, "--peers", "mine", "a.b:c"]),
        ("paper", ["--out", "paper", "--seed", 3]),
        ("count_calls", []),
    ],
)
def test_every_script_accepts_what_it_is_for(call, script, arguments):
    accepted, _ = call(script, *arguments)
    assert accepted is not None


@pytest.mark.parametrize(
    "error",
    [
        FileExistsError("`out` must not hold a run"),
        PermissionError(13, "Permission denied", "a/b"),
        ImportError("shimmy is missing"),
        ValueError("`env_id` must be\na registered id"),
        RuntimeError("`resume` cannot be read"),
    ],
    ids=repr,
)
def test_a_mistake_that_is_found_later_is_one_line_too(capsys, error):
    with pytest.raises(SystemExit) as stopped, answering():
        raise error
    printed = capsys.readouterr().err
    assert stopped.value.code == 2
    assert printed == f"error: {' '.join(str(error).split())}\n"


@pytest.mark.parametrize(
    "error",
    [ZeroDivisionError("division by zero"), TypeError("unsupported operand"), KeyError("a")],
    ids=repr,
)
def test_a_bug_keeps_its_traceback(error):
    with pytest.raises(type(error)) as raised, answering():
        raise error
    assert raised.value is error


def test_ctrl_c_ends_a_command_as_a_shell_expects():
    with pytest.raises(SystemExit) as stopped, answering():
        raise KeyboardInterrupt
    assert stopped.value.code == 130


def test_tables_of_a_study_may_have_the_name_of_a_folder_beside_them(call, tmp_path):
    (tmp_path / "studied" / "mine").mkdir(parents=True)
    accepted, _ = call("study", "sparse", "--out", "studied/mine")
    assert accepted[-1]["out"] == Path("studied/mine")
    (tmp_path / "studied" / "mine.md").mkdir()
    assert "`out` must be a file, got studied/mine.md" in refusal(
        call, "study", "sparse", "--out", "studied/mine"
    )
