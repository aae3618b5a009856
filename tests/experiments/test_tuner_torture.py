import sys
from dataclasses import replace

import pytest

pytest.importorskip("optuna")

from deep_curiosity.experiments import tuner_torture
from deep_curiosity.experiments.statistics import Estimate
from deep_curiosity.experiments.studies import find_search
from deep_curiosity.experiments.tables import read_table, write_table
from deep_curiosity.experiments.tuner_torture import (
    Comparison,
    Plan,
    page,
    search_and_kill,
    torture_search,
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::optuna.exceptions.ExperimentalWarning"),
]
OWN = """
from optuna.distributions import FloatDistribution

from deep_curiosity.experiments.search import Search
from deep_curiosity.experiments.study import Task
from deep_curiosity.training import Config

TASK = Task("pendulum", Config.of(
    env_id="PendulumSwingup", total_steps=60, learning_starts=20, hidden_dim=16, batch_size=32,
    components=16, num_members=2, evaluation_interval=20, evaluation_episodes=1, compile="off",
    matmul_precision="highest",
))
SEARCHES = {"killed": Search(
    [TASK], {"polyak": FloatDistribution(1e-3, 0.1)}, {"pendulum": (0.0, 150.0)}, seeds=1,
)}
"""


def test_a_search_that_is_killed_ends_with_the_trials_of_one_that_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr(tuner_torture, "PAUSE", 0.0)
    path = tmp_path / "killed_search.py"
    path.write_text(OWN)
    _, search = find_search(str(path))
    plan = Plan(str(path), search, trials=3, kills=1, workers=1)
    out = tmp_path / "out"
    comparison = torture_search(plan, tmp_path / "runs", out, seeds=1)
    assert comparison.is_sound and comparison.equal == 3
    assert read_table(tmp_path / "runs" / "killed" / "kills.csv")
    assert [row["trial"] for row in read_table(out / "trials.csv")] == ["0", "1", "2"]
    assert (out / "trials.png").exists() and (out / "trials.json").exists()
    assert [row["agent"] for row in read_table(out / "seeds.csv")] == ["default", "best"]
    assert set(comparison.scores) == {"default", "best"}
    again = search_and_kill(plan, tmp_path / "runs" / "killed")  # nothing is left to be done
    assert again == comparison.kills


class Short(Plan):
    """A search that is over at once."""

    def command(self, folder):
        return [sys.executable, "-c", f"raise SystemExit({self.seed})"]


@pytest.fixture
def plan():
    return Plan("short", find_search("short")[1], trials=3, kills=1)


@pytest.mark.parametrize("status", [0, 3])
def test_a_search_that_ends_before_it_is_killed_is_reported(plan, tmp_path, status, monkeypatch):
    monkeypatch.setattr(tuner_torture, "PAUSE", 0.0)
    short = Short(**vars(plan) | {"seed": status})
    with pytest.raises(RuntimeError, match=f"must last until it is killed, got .*: {status}"):
        search_and_kill(short, tmp_path / "killed")


def test_kills_come_each_after_another_trial_and_those_that_were_done_are_not_repeated(
    plan, tmp_path, monkeypatch
):
    killed = []
    monkeypatch.setattr(tuner_torture, "_kill", lambda *given, **kill: killed.append(kill))
    monkeypatch.setattr(tuner_torture, "search_in_peace", lambda *given: None)
    plan = replace(plan, trials=5, kills=4)
    kills = search_and_kill(plan, tmp_path)
    assert killed == kills and [kill["trials"] for kill in kills] == [1, 2, 3, 4]
    assert search_and_kill(plan, tmp_path) == kills and killed == kills
    write_table(tmp_path / "kills.csv", kills[:3])
    search_and_kill(plan, tmp_path)
    assert killed == [*kills, kills[3]]


def make(plan, trials, equal):
    kills = [{"trials": 2.0, "seconds": 1.25}]
    scores = {"default": Estimate(0.1, 0.0, 0.2), "best": Estimate(0.5, 0.4, 0.6)}
    rows = [(number, "COMPLETE", {}, 0.5, {}) for number in range(trials)]
    return Comparison(plan, kills, rows, equal, {"polyak": 0.012345}, scores, 10)


@pytest.mark.parametrize(
    ("trials", "equal", "is_sound"), [(3, 3, True), (3, 2, False), (2, 2, False), (4, 3, False)]
)
def test_a_trial_that_is_lost_doubled_or_changed_is_found(plan, trials, equal, is_sound):
    assert make(plan, trials, equal).is_sound == is_sound


def test_the_page_tells_kills_trials_and_scores(plan):
    text = page(make(plan, 3, 2), "python it.py")
    assert "1.2 s after trial 2" in text and "2 of its 3 trials" in text
    assert "`polyak` 0.0123" in text and "| best | 0.5 [0.4, 0.6] |" in text
    assert "python it.py" in text and "3 complete" in text
