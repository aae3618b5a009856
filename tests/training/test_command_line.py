import re
from pathlib import Path

import pytest

from deep_curiosity.agent.config import ConditionedHunger
from deep_curiosity.bonuses.config import BONUS_CONFIGS
from deep_curiosity.configuration import flat
from deep_curiosity.schedules import Schedule
from deep_curiosity.training.command_line import COMMON, help_of, parse
from deep_curiosity.training.config import PRESETS, Config
from deep_curiosity.training.log import open_folder
from deep_curiosity.training.run import merge_config

OF_THE_COMMAND_LINE = {"resume", "bonus", "preset", "settings", "stop-when-solved"}


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
    assert 20 <= len(common) <= 32
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


def test_a_bonus_has_none_of_the_settings_of_another(capsys):
    assert "noise_floor" not in flat(read("--bonus", "rnd"))
    assert "noise_floor" not in read("--bonus=rnd").to_json()
    assert "noise-floor" in refusal(capsys, "--bonus", "rnd", "--noise-floor", 0.1)
    assert "random_features" in flat(read("--bonus", "rnd", "--random-features", 64))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--bonus", "luck"], "curiosity"),
        (["--preset", "slow"], "paper"),
        (["--hidden-dim", "wide"], "int"),
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
    config = read("--resume", run, "--total-steps", total_steps)
    assert merge_config(config, read("--resume", run)).run.total_steps == total_steps


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
    config = read("--resume", run, *arguments)
    with pytest.raises(ValueError, match=message):
        merge_config(config, read("--resume", run))


def test_a_folder_without_a_run_is_named():
    with pytest.raises(FileNotFoundError, match=r"a run must have a config.json, got no/such"):
        read("--resume", Path("no/such"))


def test_settings_are_read_from_a_file_and_flags_go_before_it(tmp_path):
    path = tmp_path / "best.json"
    path.write_text('{"learning_rate": 0.01, "batch_size": 64, "bonus": "rnd", "out": "else"}')
    found = read("--settings", path, "--batch-size", 32)
    assert found == Config.of(learning_rate=0.01, batch_size=32, bonus="rnd")
    for text, message in (("{", "`settings` must name a JSON file"), ("[]", "names and values")):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            read("--settings", path)
