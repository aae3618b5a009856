import math
import subprocess
import sys

import numpy as np
import pytest
import torch

from deep_curiosity.training import Config, continue_run, train
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.hunger import (
    BanditHunger,
    FunctionHunger,
    RandomHunger,
    ScheduledHunger,
    make_hunger_controller,
)
from deep_curiosity.training.infos import joined
from deep_curiosity.training.learner import Learner
from deep_curiosity.training.log import read_progress
from deep_curiosity.training.playback import load_policy

NOTHING = np.zeros((1, 3))
GOES_ON = np.array([False])


def arms_held(bandit, reward_of, num_steps):
    """Hunger at each step of an environment whose reward is a function of the hunger."""
    held = []
    for step in range(num_steps):
        (hunger,) = bandit.hunger(step, NOTHING, {})
        held.append(hunger)
        bandit.record(np.array([reward_of(hunger)]), GOES_ON)
    return np.array(held)


def test_a_function_that_works_in_place_leaves_what_replay_holds():
    def centred(observation, info):
        observation -= observation.mean()
        return 1.0

    observation = np.array([[1.0, 3.0]])
    assert FunctionHunger(centred, 1.0).hunger(0, observation, {}) == [1.0]
    assert observation.tolist() == [[1.0, 3.0]]


def test_a_bandit_goes_where_reward_is():
    torch.manual_seed(0)
    held = arms_held(BanditHunger(segment=10), lambda hunger: hunger, 1_000)
    assert set(held[:30]) == {0.0, 0.5, 1.0}
    assert (held[500:] == 1.0).mean() > 0.6


def test_a_bandit_follows_reward_to_another_arm():
    torch.manual_seed(0)
    bandit = BanditHunger(segment=10)
    arms_held(bandit, lambda hunger: hunger, 500)
    held = arms_held(bandit, lambda hunger: 1 - hunger, 1_000)
    assert (held[500:] == 0.0).mean() > 0.6


def test_a_bandit_that_earns_nothing_tries_all_arms_alike():
    torch.manual_seed(0)
    held = arms_held(BanditHunger(segment=10), lambda hunger: 0.0, 900)
    shares = [(held == arm).mean() for arm in (0.0, 0.5, 1.0)]
    assert shares == pytest.approx([1 / 3] * 3, abs=0.05)


def test_a_restored_bandit_goes_on_as_if_it_had_not_stopped():
    torch.manual_seed(0)
    bandit = BanditHunger(segment=7)
    arms_held(bandit, lambda hunger: hunger, 100)
    restored = BanditHunger(segment=7)
    restored.load_state_dict(bandit.state_dict())
    courses = []
    for each in (bandit, restored):
        torch.manual_seed(1)
        courses.append(arms_held(each, lambda hunger: 1 - hunger, 200))
    assert np.array_equal(*courses)


def test_a_random_hunger_is_held_for_an_episode_in_each_environment():
    torch.manual_seed(0)
    random = RandomHunger(num_envs=2, hungers=(0.0, 0.25, 0.5, 0.75, 1.0))
    courses = []
    for _ in range(60):
        courses.append(random.hunger(0, np.zeros((2, 3)), {}).copy())
        for step in range(5):
            random.record(np.zeros(2), np.array([step == 4, False]))
    courses = np.array(courses)
    assert set(courses[:, 0]) == {0.0, 0.25, 0.5, 0.75, 1.0}
    assert len(set(courses[:, 1])) == 1


def test_a_random_hunger_is_sampled_where_an_episode_begins():
    torch.manual_seed(0)
    random = RandomHunger(num_envs=2, hungers=tuple(np.linspace(0, 1, 1_000)))
    before = random.hunger(0, np.zeros((2, 3)), {}).copy()
    random.begin(1)
    assert (random.hunger(0, np.zeros((2, 3)), {}) == before).tolist() == [True, False]


def test_an_empty_battery_makes_hungry_in_training_and_evaluation():
    charge = np.array([1.0, 0.75, 0.5, 0.0])
    observation, info = np.stack((np.full(4, 5.0), charge), axis=1), {"charge": charge}
    for entry in ("battery", "battery:-1", "battery:1", "battery:charge"):
        hunger_controller = make_hunger_controller(Config.of(hunger=entry), 2, 1)
        assert hunger_controller.hunger(0, observation, info).tolist() == [0.0, 0.5, 1.0, 1.0]
        assert hunger_controller.in_evaluation(observation, info).tolist() == [0.0, 0.5, 1.0, 1.0]


@pytest.mark.parametrize("entry", ["battery:1", "battery:-1"])
def test_the_battery_of_a_window_is_that_of_its_newest_observation(tiny, entry):
    config = tiny.override(hunger=entry, frame_stack=2)
    window = np.array([[7.0, 1.0, 0.0, 7.0, 0.75]])  # observation, action, observation
    controller = make_hunger_controller(config, window.shape[1], 1)
    assert controller.hunger(0, window, {}).tolist() == [0.5]
    learner = Learner(config, window.shape[1], 1)
    learner.before_step(0, window, {})
    assert learner.agent.hunger == 0.5


def test_a_battery_must_be_in_the_observation():
    with pytest.raises(ValueError, match="`battery` must be an entry of an observation of 3, got"):
        make_hunger_controller(Config.of(hunger="battery:3"), observation_dim=3, action_dim=1)


def test_a_policy_knows_its_battery_where_nothing_is_installed_to_train():
    code = (
        "import sys; sys.modules['gymnasium'] = sys.modules['mujoco'] = None;"
        "import deep_curiosity.training.hunger, deep_curiosity.trained.policy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_battery_must_be_in_the_info():
    hunger_controller = make_hunger_controller(
        Config.of(hunger="battery:fuel"), observation_dim=3, action_dim=1
    )
    with pytest.raises(ValueError, match=r"`battery` .* \['energy'\], got 'fuel'"):
        hunger_controller.hunger(0, NOTHING, {"energy": 1.0})


def test_a_battery_must_be_in_the_info_of_every_environment():
    hunger_controller = make_hunger_controller(
        Config.of(hunger="battery:fuel"), observation_dim=3, action_dim=1
    )
    infos = joined([{"fuel": 1}, {"fuel": 0.75}])
    assert hunger_controller.hunger(0, np.zeros((2, 3)), infos).tolist() == [0.0, 0.5]
    for fuel in (0.5, 1):
        infos = joined([{"fuel": fuel}, {"energy": fuel}])
        with pytest.raises(ValueError, match=r"`battery` .* number 1 has none, got 'fuel'"):
            hunger_controller.hunger(0, np.zeros((2, 3)), infos)


@pytest.mark.parametrize("fuel", [None, "full", {"left": 0.5}, math.nan])
@pytest.mark.parametrize("num_envs", [1, 2])
def test_a_battery_must_be_a_number(fuel, num_envs):
    hunger_controller = make_hunger_controller(
        Config.of(hunger="battery:fuel"), observation_dim=3, action_dim=1
    )
    infos = joined([{"fuel": fuel}] * num_envs)
    with pytest.raises(ValueError, match="`battery` must be a finite number in every info, got"):
        hunger_controller.hunger(0, np.zeros((num_envs, 3)), infos)


@pytest.mark.parametrize("value", [1.0, "conditioned:1.0"])
@pytest.mark.parametrize("num_envs", [1, 2])
def test_the_caller_may_set_the_hunger(tiny, value, num_envs):
    given = []

    def hunger(observation, info):
        given.append((observation, info["energy"]))
        return 0.25 + 0.5 * (observation[:, -1] < 0.95)

    config = tiny.override(env_id="BatteryRover", env_kwargs={}, hunger=value, num_envs=num_envs)
    train(config, hunger=hunger, show_progress=False)
    assert {len(observation) for observation, _ in given} == {1, num_envs}  # 1 in evaluations
    for observation, energy in given:
        assert observation[:, -1] == pytest.approx(energy)
    logged = {float(row["agent/hunger"]) for row in read_progress(config.run.out)}
    assert 0.75 in logged


@pytest.mark.parametrize(
    ("hunger", "message"),
    [
        (np.zeros(3), r"`hunger` must return one number or 1, got \(3,\)"),
        (2.0, r"`hunger` must return finite numbers in \[0, 1\], got 2.0"),
        (math.nan, r"`hunger` must return finite numbers in \[0, 1\], got nan"),
    ],
    ids=["shape", "range", "nan"],
)
def test_a_hunger_out_of_bounds_is_named(tiny, hunger, message):
    config = tiny.override(hunger="conditioned:1.0")
    with pytest.raises(ValueError, match=message):
        train(config, hunger=lambda observation, info: hunger, show_progress=False)


def test_hunger_is_set_by_one_alone(tiny):
    config = tiny.override(hunger="bandit")
    with pytest.raises(
        ValueError, match=r"`hunger` must be a number or conditioned:VALUE where .* got bandit"
    ):
        train(config, hunger=lambda observation, info: 1.0, show_progress=False)
    assert not tiny.run.out.exists()


def test_a_run_goes_on_with_the_function_that_it_had(tiny, tmp_path):
    def hungry(observation, info):
        return 0.25

    with_one, without = (tiny.override(out=tmp_path / name) for name in ("with", "without"))
    train(with_one, hunger=hungry, show_progress=False)
    train(without, show_progress=False)
    more = tiny.run.total_steps + 20
    with pytest.raises(ValueError, match="`hunger` must be given again, since a function of the"):
        continue_run(with_one.run.out, total_steps=more, show_progress=False)
    with pytest.raises(ValueError, match="`hunger` must be left out, since no function has set"):
        continue_run(without.run.out, total_steps=more, hunger=hungry, show_progress=False)
    continue_run(with_one.run.out, total_steps=more, hunger=hungry, show_progress=False)
    logged = [row["agent/hunger"] for row in read_progress(with_one.run.out)]
    assert set(map(float, logged)) == {0.25}
    environment = make_environment(tiny.environment)
    with pytest.warns(UserWarning, match="`hunger` was a function of the caller's own .* at 1.0"):
        load_policy(with_one.run.out, with_one, environment)


def test_a_function_is_not_bounded_where_the_agent_is_not_conditioned():
    controller = FunctionHunger(lambda observation, info: 7.0, math.inf)
    assert controller.hunger(0, NOTHING, {}).tolist() == [7.0]


@pytest.mark.parametrize("shape", ["linear", "exponential"])
def test_a_schedule_goes_from_the_first_hunger_to_the_last(shape):
    config = Config.of(hunger=f"{shape}:0.5:8", total_steps=100, learning_starts=10, num_envs=2)
    hunger_controller = make_hunger_controller(config, 3, 1)
    assert isinstance(hunger_controller, ScheduledHunger)
    assert hunger_controller.hunger(0, np.zeros((2, 3)), {}).tolist() == [0.5, 0.5]
    assert hunger_controller.hunger(100, np.zeros((2, 3)), {}) == pytest.approx(8.0)


def test_what_goes_with_time_is_set_before_a_step(tiny):
    config = tiny.override(
        hunger="linear:1:3",
        temperature="exponential:1.0:0.01",
        curiosity_coefficient=1.0,
        curiosity_ends=50,
        total_steps=100,
    )
    learner = Learner(config, 3, 1)
    learner.before_step(49, np.zeros((1, 3)), {})
    assert learner.agent.curiosity_coefficient == 1.0
    learner.before_step(50, np.zeros((1, 3)), {})
    assert learner.agent.hunger == pytest.approx(2.0)
    assert learner.agent.temperature == pytest.approx(0.1)
    assert learner.agent.curiosity_coefficient == 0.0


def test_what_is_restored_has_its_hunger_set_anew(tiny):
    learner, hungrier = Learner(tiny, 3, 1), Learner(tiny.override(hunger=2.0), 3, 1)
    for each in (learner, hungrier):
        each.before_step(0, np.zeros((1, 3)), {})
    learner.load_state_dict(hungrier.state_dict())
    assert learner.agent.hunger == 2.0
    learner.before_step(1, np.zeros((1, 3)), {})
    assert learner.agent.hunger == 1.0


@pytest.mark.parametrize("num_envs", [1, 2])
def test_the_policy_acts_as_hungry_as_it_is(tiny, num_envs):
    said = [0.0, 1.0]
    learner = Learner(
        tiny.override(hunger="conditioned:1.0", num_envs=num_envs),
        3,
        1,
        hunger=lambda observation, info: said[0],
    )
    with torch.no_grad():
        layers = learner.agent.policy.network.layers
        for layer in layers:
            layer.bias.zero_()
        layers[0].weight[0, -1] = 100.0  # hunger alone moves the action
        layers[-1].weight[..., 0] = 1.0
        layers[-1].bias[..., 1] = -9.0
    actions = []
    for _ in range(2):
        observation = np.zeros((num_envs, 3))
        learner.before_step(0, observation, {})
        actions.append(learner.act(observation))
        said.reverse()
    assert actions[0].shape == (num_envs, 1)
    assert (abs(actions[0] - actions[1]) > 0.5).all()
    said[0] = 1.0
    greedy = learner.evaluation_policy(torch.zeros(1, 3), {})
    assert greedy.item() == pytest.approx(actions[1].flat[0], abs=0.1)


@pytest.mark.parametrize("hunger", ["random", "bandit"])
def test_a_resumed_run_goes_on_with_its_controller(tiny, tmp_path, hunger):
    whole = tiny.override(hunger=hunger, total_steps=60)
    train(whole, show_progress=False)
    halves = whole.override(out=tmp_path / "halves")
    train(halves.override(total_steps=30), show_progress=False)
    continue_run(halves.run.out, total_steps=60, show_progress=False)
    one, other = (load_checkpoint(run.run.out)["learner"] for run in (whole, halves))
    assert one["hunger"] == other["hunger"] != {}
    assert torch.equal(one["replay"]["rows"], other["replay"]["rows"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"hunger": "bandit", "bonus": "none"},
            "`hunger` must be a positive number or a schedule without a bonus, got bandit",
        ),
        (
            {"hunger": "conditioned:2.0"},
            r"`hunger` must lie in \[0, 1\] where conditioned, got 2.0",
        ),
        ({"hunger": "linear:0:10"}, "`first` must be finite and positive, got 0.0"),
        ({"hunger": "linear:1:0"}, "`last` must be finite and positive, got 0.0"),
        ({"hunger": "battery:7"}, "`battery` must be an entry of"),
        ({"temperature": "linear:0.02:-1"}, "`last` must be finite and positive, got -1.0"),
    ],
    ids=str,
)
def test_a_hunger_or_temperature_that_cannot_be_is_named(tiny, change, message):
    with pytest.raises(ValueError, match=message):
        train(tiny.override(**change), show_progress=False)
    assert not tiny.run.out.exists()


def test_a_run_that_is_not_conditioned_is_played_at_no_other_hunger(tiny):
    train(tiny, show_progress=False)
    environment = make_environment(tiny.environment)
    with pytest.raises(ValueError, match="`hunger` can only be chosen where the agent is cond"):
        load_policy(tiny.run.out, tiny, environment, hunger=0.5)
    action = load_policy(tiny.run.out, tiny, environment)(torch.zeros(2, 3), {})
    assert action.shape == (2, 1)
    environment.close()


@pytest.mark.slow
def test_curiosity_past_the_end_of_the_episode_is_a_setting(tiny):
    rover = tiny.override(
        env_id="BatteryRover",
        env_kwargs={},
        max_episode_steps=None,
        total_steps=300,
        learning_starts=250,
    )
    weights = []
    for episodic in (True, False):
        out = tiny.run.out.with_name(f"{episodic}")
        train(rover.override(curiosity_episodic=episodic, out=out), show_progress=False)
        state = load_checkpoint(out)["learner"]
        assert state["replay"]["rows"][:, -2].any()  # a battery was empty
        weights.append(state["agent"]["critics.network.layers.0.weight"])
    assert not torch.equal(*weights)
