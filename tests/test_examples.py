"""Every example is an agent that works, and without its marked lines a plain one that works."""

import runpy
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch

MARK = "# + bonus"
EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
WHOLE_AGENTS = [path for path in EXAMPLES if path.stem.startswith("cleanrl")]
NUM_STEPS = 500
TINY = (
    f"--env-id Pendulum-v1 --total-steps {NUM_STEPS} --learning-starts 460 --hidden-dims 16 16 "
    "--batch-size 32 --evaluation-episodes 1"
)

every_example = pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
every_whole_agent = pytest.mark.parametrize("path", WHOLE_AGENTS, ids=lambda path: path.stem)


class Repeat(gymnasium.Env):
    """Reward 1 at every step; an episode is one step long, which ends as `terminates` says."""

    observation_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, *, terminates):
        self.terminates = terminates

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.sample(), {}

    def step(self, action):
        return self.sample(), 1.0, self.terminates, not self.terminates, {}

    def sample(self):
        return self.np_random.uniform(-1, 1, 2).astype(np.float32)


@pytest.fixture
def play(tmp_path, monkeypatch):
    """Runs the text of an example on the command line, and gives the names it leaves behind."""

    def run(text, arguments=""):
        path = tmp_path / "agent.py"
        path.write_text(text)
        options = f"{TINY} --out {tmp_path / 'run'} {arguments}"
        monkeypatch.setattr(sys, "argv", [str(path), *options.split()])
        return runpy.run_path(str(path), run_name="__main__")

    return run


@pytest.fixture(params=[True, False], ids=["terminated", "truncated"])
def terminates(request):
    gymnasium.register("Repeat-v0", Repeat, kwargs={"terminates": request.param})
    yield request.param
    del gymnasium.registry["Repeat-v0"]


def plain(text):
    return "".join(line for line in text.splitlines(True) if not line.rstrip().endswith(MARK))


@every_example
def test_curiosity_is_five_lines_at_most(path):
    marked = [line for line in path.read_text().splitlines() if line.endswith(MARK)]
    assert 1 <= len(marked) <= 5


@every_whole_agent
def test_curiosity_is_exactly_five_lines_of_a_whole_agent(path):
    assert path.read_text().count(f"  {MARK}\n") == 5


@every_example
def test_as_it_is_an_example_runs(path, play):
    play(path.read_text())


@every_example
def test_without_the_marked_lines_a_plain_agent_runs(path, play):
    text = plain(path.read_text())
    assert "deep_curiosity" not in text
    play(text)


@every_whole_agent
def test_replay_holds_what_the_environment_gave(path, play):
    held = play(path.read_text())["replay"].held
    observation, action, reward, next_observation, terminated, truncated = (
        field[:NUM_STEPS] for field in held
    )
    angle = torch.atan2(observation[:, 1], observation[:, 0])
    torque = 2 * action[:, 0]
    cost = angle.square() + 0.1 * observation[:, 2].square() + 0.001 * torque.square()
    assert torch.allclose(reward, -cost, atol=1e-4)
    assert action.abs().max() <= 1
    assert not terminated.any()
    assert truncated.nonzero().flatten().tolist() == [199, 399]
    goes_on = ~truncated[:-1]
    assert torch.equal(next_observation[:-1][goes_on], observation[1:][goes_on])
    assert (next_observation - observation)[truncated].norm(dim=-1).max() < 2  # no jump to a reset


@every_whole_agent
def test_the_bonus_reaches_the_critic(path, play):
    text, short = path.read_text(), "--total-steps 140 --learning-starts 50"
    indifferent = text.replace("+ bonus.compute(", "+ 0 * bonus.compute(")
    assert indifferent != text  # and samples the same random numbers
    first, again, without = (
        play(version, short)["critic"].state_dict() for version in (text, text, indifferent)
    )
    for name, value in first.items():
        assert torch.equal(value, again[name])
        # a lone bias moves by Adam's step, which is the same for any reward of one sign
        assert value.numel() == 1 or not torch.allclose(value, without[name])


@every_whole_agent
def test_only_termination_ends_the_value(path, play, terminates):
    options = "--env-id Repeat-v0 --learning-rate 0.01 --learning-starts 250"
    left = play(plain(path.read_text()), options)
    pairs = left["replay"].sample(100)
    value = left["critic"](pairs.observation, pairs.action).mean().item()
    if terminates:
        assert value == pytest.approx(1, abs=0.1)
    else:
        assert value > 2
