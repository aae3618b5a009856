import json
import re
from pathlib import Path

import pytest

from deep_curiosity.agent.config import ConditionedHunger
from deep_curiosity.bonuses.config import BONUS_CONFIGS
from deep_curiosity.configuration import flat
from deep_curiosity.schedules import Schedule
from deep_curiosity.training.command_line import COMMON, help_of, parse, read_settings
from deep_curiosity.training.config import PRESETS, Config
from deep_curiosity.training.log import open_folder

OF_THE_COMMAND_LINE = {"resume", "bonus", "preset", "settings", "stop-when-solved", "new-episode"}


def read(*arguments):
    return parse([str(argument) for argument in arguments], description="A test.").config


def flags(capsys, *arguments):
    """Flags that a help shows."""
    with pytest.raises(SystemExit) as stopped:
        read(*arguments)
    assert stopped.value.code == 0
    return set(re.findall(r"^\W*--([a-z][a-z-]+)", capsys.readouterr().out, re.MULTILINE))


def refusal(capsys, *arguments):
    """What is printed where the command line is refused."""
    with pytest.raises(SystemExit) as stopped:
        read(*arguments)
    assert stopped.value.code not in (None, 0)
    printed = capsys.readouterr()
    return printed.out + printed.err


def dashed(names):
    return {name.replace("_", "-") for name in names}


@pytest.fixture
def run(tmp_path):
    """Folder of a run with settings of its own."""
    config = Config.of(
        "exact", bonus="curiosity", hidden_dim=16, total_steps=300, learning_starts=20, seed=5
    ).override(hunger="conditioned:0.5", features=(0, -1), out=tmp_path / "run")
    return open_folder(config)


def test_without_arguments_it_is_the_default():
    command = parse([], description="A test.")
    assert command.config == Config()
    assert not command.resume


def test_help_shows_what_a_user_turns_and_help_all_the_rest(capsys):
    common = flags(capsys, "--help")
    assert 20 <= len(common) <= 34
    assert common == dashed(COMMON) | OF_THE_COMMAND_LINE
    assert flags(capsys, "-h") == common
    everything = flags(capsys, "--help-all")
    assert everything == dashed(flat(Config())) | OF_THE_COMMAND_LINE
    assert len(everything) > 2 * len(common) - 10


@pytest.mark.parametrize("bonus", BONUS_CONFIGS)
def test_help_is_that_of_the_bonus(capsys, bonus):
    everything = flags(capsys, "--bonus", bonus, "--help-all")
    assert everything == dashed(flat(Config.of(bonus=bonus))) | OF_THE_COMMAND_LINE


@pytest.mark.parametrize("bonus", BONUS_CONFIGS)
def test_every_setting_has_a_sentence_of_help(bonus):
    for name, each in flat(Config.of(bonus=bonus)).items():
        text = help_of(each)
        assert len(text) > 15 and "\n" not in text, name


def test_what_is_hidden_in_the_help_is_read_too():
    config = read("--noise-floor", 0.1, "--polyak=0.5", "--members", "all")
    assert config.bonus.dynamics.noise_floor == 0.1
    assert config.agent.polyak == 0.5
    assert config.bonus.dynamics.members == "all"


def test_the_flags_of_old_are_still_read(tmp_path):
    config = read(
        *("--env-id", "PointMaze", "--env-kwargs", "action_cost", 0.1, "--total-steps", 600),
        *("--seed", 3, "--out", tmp_path / "run", "--bonus", "rnd", "--prior", "learned"),
        *("--hidden-dim", 32, "--num-envs", 4),
    )
    assert config.environment.env_id == "PointMaze"
    assert config.environment.env_kwargs == {"action_cost": 0.1}
    assert config.environment.num_envs == 4
    assert (config.run.total_steps, config.run.seed) == (600, 3)
    assert config.run.out == tmp_path / "run"
    assert config.bonus.kind == "rnd"
    assert (config.agent.prior, config.agent.hidden_dim) == ("learned", 32)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2", 2.0),
        ("linear:1:10", Schedule(1.0, 10.0, "linear")),
        ("battery:energy", ConditionedHunger("battery", entry="energy")),
        ("conditioned:0.5", ConditionedHunger("fixed", 0.5)),
    ],
)
def test_hunger_is_one_word(text, value):
    assert read("--hunger", text).agent.hunger == value


def test_values_that_may_be_absent_or_several_are_read():
    config = read("--features", 0, -1, "--tune-bonus-weight", "past", "--curiosity-ends", 900)
    assert config.bonus.features == (0, -1)
    assert config.bonus.tune_weight == "past"
    assert config.agent.curiosity.ends == 900
    assert read("--bonus-parts", "information_gain", 1).bonus.parts == {"information_gain": 1.0}
    assert read("--bandwidth", 0.3).bonus.marginal.bandwidth == 0.3
    assert read("--bandwidth", "perplexity").bonus.marginal.bandwidth == "perplexity"


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("form", ["--preset {}", "--preset={}"])
def test_a_preset_is_taken_and_a_flag_goes_before_it(preset, form):
    words = form.format(preset).split()
    assert read(*words) == Config.of(preset)
    assert read(*words, "--refresh-interval", 3) == Config.of(preset, refresh_interval=3)


def test_a_bonus_has_none_of_the_settings_of_another():
    assert "noise_floor" not in flat(read("--bonus", "rnd"))
    assert "noise_floor" not in read("--bonus=rnd").to_json()
    with pytest.raises(ValueError, match="`noise_floor` must be left out with the bonus rnd"):
        read("--bonus", "rnd", "--noise-floor", "0.1")
    assert "random_features" in flat(read("--bonus", "rnd", "--random-features", 64))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--bonus", "luck"], "curiosity"),
        (["--preset", "slow"], "paper"),
        (["--hidden-dim", "wide"], "it must be a whole number, got 'wide'"),
        (["--seed", "1.5"], "it must be a whole number, got '1.5'"),
        (["--learning-rate", "fast"], "it must be a number, got 'fast'"),
        (["--out", ""], "it must be a path, got ''"),
        (["--totl-steps", "60"], "--total-steps"),
        (["--history", "3"], "--history"),
    ],
    ids=str,
)
def test_what_cannot_be_read_is_answered(capsys, arguments, message):
    assert message in refusal(capsys, *arguments)


def test_a_value_out_of_range_is_an_error_for_the_caller():
    with pytest.raises(ValueError, match="`num_members` must be at least 2, got 1"):
        read("--num-members", 1)
    with pytest.raises(ValueError, match="`curiosity_steps` must be left out without a bonus"):
        read("--bonus", "none", "--curiosity-steps", 2)


def test_a_run_is_continued_with_its_own_settings(run):
    command = parse(["--resume", str(run)], description="A test.")
    assert command.resume
    assert command.config.to_json() | {"out": str(run)} == command.config.to_json()
    assert command.config.changes() == {
        "total_steps": 300,
        "seed": 5,
        "out": str(run),
        "learning_starts": 20,
        "hidden_dim": 16,
        "hunger": "conditioned:0.5",
        "features": [0, -1],
        "refresh_interval": 10,
        "members": "all",
        "actor_q": "min",
        "actor_batch_fraction": 1.0,
    }


@pytest.mark.parametrize("total_steps", [20_000, 700])
def test_a_continued_run_obeys_its_number_of_steps_even_the_default(run, total_steps):
    assert read("--resume", run, "--total-steps", total_steps).run.total_steps == total_steps


@pytest.mark.parametrize(
    ("arguments", "changed"),
    [
        (["--log-interval", 500], {"log_interval": 500}),
        (["--log-interval", 20, "--evaluation-interval", 40], None),
        (["--evaluation-episodes", 3, "--checkpoint-interval", 7], None),
        (["--threads", 2, "--compile", "off", "--matmul-precision", "high"], None),
        (["--compile", "on", "--no-direct-matmul", "--no-keep-memory"], None),
        (["--hidden-dim", 16, "--seed", 5, "--preset", "exact"], {}),
    ],
    ids=str,
)
def test_a_continued_run_takes_what_is_safe_to_change_and_what_it_has(run, arguments, changed):
    if changed is None:
        words = " ".join(map(str, arguments)).replace("--no-", "--").split("--")[1:]
        pairs = [word.strip().replace("-", "_").partition(" ") for word in words]
        changed = {name: int(text) if text.isdecimal() else text for name, _, text in pairs}
        changed = {name: False if value == "" else value for name, value in changed.items()}
    own = read("--resume", run)
    assert read("--resume", run, *arguments) == own.override(**changed)


def test_a_continued_run_is_told_the_default_preset_apart_from_none(run):
    with pytest.raises(ValueError, match=r"`refresh_interval` must stay .* 10, got 20"):
        read("--resume", run, "--preset", "fast")


def test_a_continued_run_stays_in_its_folder(run, tmp_path):
    assert read("--resume", run, "--out", run).run.out == run
    with pytest.raises(ValueError, match="`out` must be left out where a run is continued"):
        read("--resume", run, "--out", tmp_path / "other")
    with pytest.raises(ValueError, match="`out` must be left out where a run is continued"):
        read("--resume", run, "--out", "runs/latest")  # the default


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seed", 1, "--seed", 2], "`seed` must be given once, got --seed 2 times"),
        (["--bonus", "rnd", "--bonus=icm"], "`bonus` must be given once"),
        (["--env-kwargs", "g", 9, "g", 5], "`env_kwargs` must have every key once, got 'g' twice"),
        (["--hidden_dim", 8, "--hidden-dim", 8], "`hidden_dim` must be given once"),
        (["--direct-matmul", "--no-direct-matmul"], "`direct_matmul` must be given once"),
    ],
    ids=str,
)
def test_an_option_that_is_given_twice_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        read(*arguments)


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    file = tmp_path / "file"
    file.touch()
    for option in ("--out", "--resume"):
        for path in (file, file / "run"):
            with pytest.raises(ValueError, match=rf"`{option[2:]}` must be a folder, got .*file"):
                read(option, path)


def test_settings_are_read_from_pairs_as_python_or_as_text():
    pairs = ["total_steps=500", "hunger=linear:1:10", "features=(0, -1)", "compile=off", "a=1=2"]
    assert read_settings(pairs) == {
        "total_steps": 500,
        "hunger": "linear:1:10",
        "features": (0, -1),
        "compile": "off",
        "a": "1=2",
    }
    with pytest.raises(ValueError, match="`set` must be written as name=value, got '=5'"):
        read_settings(["=5"])
    assert read_settings(["deep=" + "(" * 5_000])["deep"] == "(" * 5_000
    with pytest.raises(ValueError, match="`set` must be written as name=value, got 'seed'"):
        read_settings(["seed"])
    with pytest.raises(ValueError, match="`set` must name a setting once, got 'seed' twice"):
        read_settings(["seed=1", "seed=2"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--hidden-dim", 64], "`hidden_dim` must stay .* 16, got 64"),
        (["--hidden-dim", 256], "`hidden_dim` must stay .* 16, got 256"),
        (["--bonus", "rnd"], "`bonus` must stay .* 'curiosity', got 'rnd'"),
        (["--preset", "paper"], "`refresh_interval` must stay .* 10, got 1"),
        (["--hunger", "1.0"], "`hunger` must stay .* 'conditioned:0.5', got 1.0"),
    ],
    ids=str,
)
def test_a_continued_run_is_refused_other_settings_by_name(run, arguments, message):
    with pytest.raises(ValueError, match=message):
        read("--resume", run, *arguments)


def test_files_and_runs_are_found_below_the_home_folder(run, monkeypatch):
    monkeypatch.setenv("HOME", str(run.parent))
    assert read("--resume=~/run") == read("--resume", "~/run") == read("--resume", run)
    written(run.parent / "best.json", {"seed": 7})
    assert read("--settings=~/best.json").run.seed == 7


def test_a_folder_without_a_run_is_named():
    with pytest.raises(FileNotFoundError, match=r"`resume` must be the folder .*got no/such"):
        read("--resume", Path("no/such"))


def test_arguments_of_the_environment_are_numbers_words_and_truths():
    words = ("a", 50, "b", 0.5, "c", "word", "d", "True", "e", "false", "f", -3, "g", "None")
    values = {"a": 50, "b": 0.5, "c": "word", "d": True, "e": False, "f": -3, "g": None}
    config = read("--env-kwargs", *words)
    assert config.environment.env_kwargs == values
    kinds = [type(value) for value in config.environment.env_kwargs.values()]
    assert kinds == [int, float, str, bool, bool, int, type(None)]
    assert Config.from_json(json.loads(json.dumps(config.to_json()))) == config


def test_a_limit_of_episodes_is_set_in_either_way():
    for words in (("--max-episode-steps", 50), ("--env-kwargs", "max_episode_steps", 50)):
        environment = read(*words).environment
        assert (environment.max_episode_steps, environment.env_kwargs) == (50, {})
    with pytest.raises(ValueError, match=r"`max_episode_steps` must be given once, got 3 and 50"):
        read("--max-episode-steps", 3, "--env-kwargs", "max_episode_steps", 50)
    with pytest.raises(ValueError, match=r"`max_episode_steps` must be at least 1, got -1"):
        read("--env-kwargs", "max_episode_steps", -1)
    with pytest.raises(TypeError, match=r"`max_episode_steps` must be int or None, got 'long'"):
        read("--env-kwargs", "max_episode_steps", "long")


def test_what_is_shown_and_what_ends_an_episode_are_set():
    config = read("--observation-keys", "observation", "goal", "--terminate-on-success")
    assert config.environment.observation_keys == ("observation", "goal")
    assert config.environment.terminate_on_success
    assert Config.from_json(json.loads(json.dumps(config.to_json()))) == config


def test_settings_are_read_from_a_file_and_flags_go_before_it(tmp_path):
    path = tmp_path / "best.json"
    path.write_text('{"learning_rate": 0.01, "batch_size": 64, "bonus": "rnd", "out": "else"}')
    found = read("--settings", path, "--batch-size", 32)
    assert found == Config.of(learning_rate=0.01, batch_size=32, bonus="rnd")
    wrong = "`settings` must name a JSON file"
    twice = '{"seed": 1, "seed": 2}'
    for text, message in (
        ("{", wrong),
        ("[" * 99_999, wrong),
        (twice, f"{wrong}.*a name twice among seed, seed"),
        ("[]", "names and values"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            read("--settings", path)


@pytest.mark.parametrize(
    ("values", "arguments", "name", "expected"),
    [
        ({"random_features": 64}, ("--bonus", "rnd"), "random_features", 64),
        ({"learning_starts": 30_000}, ("--total-steps", 100_000), "learning_starts", 30_000),
        ({"batch_size": 4}, ("--num-members", 2), "batch_size", 4),
        ({"total_steps": 900}, ("--total-steps", 20_000), "total_steps", 20_000),  # the default
        ({"hunger": "linear:0.1:0.9"}, (), "hunger", Schedule.parse("linear:0.1:0.9")),
        ({"bonus": "rnd", "random_features": 64}, ("--bonus", "none"), "hidden_dim", 256),
    ],
)
def test_a_file_is_checked_together_with_the_flags(tmp_path, values, arguments, name, expected):
    path = written(tmp_path / "best.json", values)
    assert flat(read("--settings", path, *arguments))[name].value == expected


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        ({"rate": 1}, TypeError, "`rate` is no setting here"),
        ({"batch_size": "big"}, TypeError, "`batch_size` must be int, got 'big'"),
        ({"batch_size": 4}, ValueError, "`batch_size` must be"),
        ({"bonus": "fame"}, ValueError, "`bonus` must be one of"),
    ],
)
def test_a_file_that_cannot_be_is_refused_by_name(tmp_path, values, error, message):
    with pytest.raises(error, match=message):
        read("--settings", written(tmp_path / "best.json", values))


def written(path, values):
    path.write_text(json.dumps(values))
    return path
