import random
from contextlib import nullcontext

import numpy as np
import pytest
import torch

from deep_curiosity.integrations.check import check_integration
from deep_curiosity.integrations.check.experiments import _distance
from deep_curiosity.integrations.trainer import LearnerIntegration
from deep_curiosity.transitions import Transition

QUESTIONS = ["finite", "not constant", "raw", "ends", "targets", "fresh", "actor", "state"]


@pytest.mark.parametrize(
    ("first", "second", "distance"),
    [(1.0, 3.0, 2.0), (np.nan, np.nan, 0.0), (np.nan, 1.0, np.inf), (np.inf, np.inf, 0.0)],
)
def test_a_number_beside_one_that_is_none_is_as_far_as_can_be(first, second, distance):
    both = [[torch.tensor([0.0, value])] for value in (first, second)]
    assert _distance(*both) == distance


@pytest.fixture
def config(tiny):
    return tiny.override(hidden_dim=8, batch_size=16)


@pytest.mark.parametrize("bonus", ["curiosity", "information-gain", "hash-count"])
def test_the_trainers_own_agent_passes(config, bonus):
    report = check_integration(LearnerIntegration(config.override(bonus=bonus)), num_steps=250)
    assert [finding.question for finding in report.findings] == QUESTIONS
    assert report.passed, report
    assert all(finding.passed for finding in report.findings), report


def test_ends_are_not_judged_before_an_episode_has_ended(config):
    report = check_integration(LearnerIntegration(config), num_steps=50)
    assert report["ends"].passed is None and report.passed


def test_a_constant_bonus_fails_by_its_line_and_no_other(config):
    report = check_integration(LearnerIntegration(config.override(bonus="constant")))
    assert [f.question for f in report.findings if f.passed is False] == ["not constant"]
    assert not report.passed


class Broken(LearnerIntegration):
    """An agent whose user made a mistake; copies make it again."""

    def load(self, folder):
        other = type(self)(self.config)
        other.learner.load_state_dict(torch.load(folder / "checkpoint.pt"))
        return other


class Forgetful(Broken):
    def load(self, folder):
        other = super().load(folder)
        other.bonus.load_state_dict(type(self)(self.config).bonus.state_dict())
        return other


class Muddled(Broken):
    """Stores truncation as termination."""

    def __init__(self, config):
        super().__init__(config)
        store = self.learner.store
        self.learner.store = lambda step: store(
            step._replace(
                terminated=step.terminated | step.truncated,
                truncated=np.zeros_like(step.truncated),
            )
        )


class Lost(Broken):
    """Stores the first observation of the next episode as the last one of this."""

    def __init__(self, config):
        super().__init__(config)
        store = self.learner.store
        first = self.environment.reset(seed=3)[0]
        self.learner.store = lambda step: store(
            step._replace(next_observation=first[None]) if step.truncated.any() else step
        )


class Deaf(Broken):
    """Its actor leaves the curiosity critic aside."""

    def __init__(self, config):
        super().__init__(config)
        values = self.learner.agent._values
        self.learner.agent._values = lambda *args: (values(*args)[0], 0.0)


@pytest.mark.parametrize(
    ("broken", "question"),
    [(Forgetful, "state"), (Muddled, "ends"), (Lost, "ends"), (Deaf, "actor")],
)
def test_a_mistake_fails_by_its_line_and_says_what_to_do(config, broken, question):
    report = check_integration(broken(config), num_steps=250)
    assert [f.question for f in report.findings if f.passed is False] == [question], report
    assert f"-> {report[question].advice}" in str(report)


def test_an_agent_that_cannot_learn_is_reported_with_its_error(config):
    agent = LearnerIntegration(config)
    agent.learner.update = lambda: torch.zeros(2) @ torch.zeros(3)
    report = check_integration(agent, num_steps=50)
    assert report["finite"].passed is False and "RuntimeError" in report["finite"].observed


def drawn():
    """What the global streams of random numbers would give next."""
    streams = random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
    numbers = random.random(), np.random.rand(), torch.rand(1).item()  # noqa: NPY002
    random.setstate(streams[0])
    np.random.set_state(streams[1])  # noqa: NPY002
    torch.set_rng_state(streams[2])
    return numbers


class Seeding(LearnerIntegration):
    """Seeds all there is, as agents of other libraries do, and may fail then."""

    def collect(self, num_steps, *, seed):
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002
        if num_steps == 1:
            raise KeyError("nothing to collect")
        return super().collect(num_steps, seed=seed)


@pytest.mark.parametrize("num_steps", [1, 50])
def test_the_global_streams_go_on_as_if_nothing_had_been_drawn(config, num_steps):
    agent = Seeding(config)
    before = drawn()
    with pytest.raises(KeyError) if num_steps == 1 else nullcontext():
        check_integration(agent, num_steps=num_steps)
    assert drawn() == before


class Small(LearnerIntegration):
    """Has room for the newest thirty steps."""

    def stored(self):
        return Transition(*(field[-30:] for field in super().stored()))


def test_more_steps_than_replay_has_room_for_are_refused(config):
    with pytest.raises(ValueError, match=r"`num_steps` must be at most 30, .*replay.* got 50"):
        check_integration(Small(config), num_steps=50)


def test_at_least_one_step_must_be_asked_for(config):
    with pytest.raises(ValueError, match="`num_steps` must be at least 1, got 0"):
        check_integration(LearnerIntegration(config), num_steps=0)


def test_an_agent_that_no_integration_holds_is_refused():
    with pytest.raises(TypeError, match=r"`agent` must be an Integration, .*, got Linear"):
        check_integration(torch.nn.Linear(1, 1))


def test_a_run_without_a_bonus_cannot_be_checked(config):
    with pytest.raises(ValueError, match="`bonus` must not be 'none'"):
        LearnerIntegration(config.override(bonus="none"))
