import math

import numpy as np
import pytest
import torch

from deep_curiosity.training import Config, continue_run, train
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.hunger import BanditHunger, RandomHunger, ScheduledHunger, FunctionHunger, make_hunger_controller
from deep_curiosity.training.learner import Learner
from deep_curiosity.training.playback import load_policy
from deep_curiosity.training.log import read_progress

NOTHING = np.zeros((1, 3))
GOES_ON = np.array([False])


def arms_held(bandit, reward_of, num_steps):
    """Hunger at each step of a world that pays what the hunger earns."""
    held = []
    for step in range(num_steps):
        (hunger,) = bandit.hunger(step, NOTHING, {})
        held.append(hunger)
        bandit.record(np.array([reward_of(hunger)]), GOES_ON)
    return np.array(held)


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


def test_a_bandit_that_earns_nothing_lets_all_arms_take_turns():
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


def test_draws_are_held_for_an_episode_in_each_world():
    torch.manual_seed(0)
    drawn = RandomHunger(num_envs=2, hungers=(0.0, 0.25, 0.5, 0.75, 1.0))
    courses = []
    for _ in range(60):
        courses.append(drawn.hunger(0, np.zeros((2, 3)), {}).copy())
        for step in range(5):
            drawn.record(np.zeros(2), np.array([step == 4, False]))
    courses = np.array(courses)
    assert set(courses[:, 0]) == {0.0, 0.25, 0.5, 0.75, 1.0}
    assert len(set(courses[:, 1])) == 1


def test_an_empty_battery_makes_hungry_in_training_and_evaluation():
    charge = np.array([1.0, 0.75, 0.5, 0.0])
    observation, info = np.stack((np.full(4, 5.0), charge), axis=1), {"charge": charge}
    for entry in (-1, 1, "charge"):
        hunger_controller = make_hunger_controller(Config.of(hunger_control="battery", battery=entry), 2)
        assert hunger_controller.hunger(0, observation, info).tolist() == [0.0, 0.5, 1.0, 1.0]
        assert hunger_controller.in_evaluation(observation, info).tolist() == [0.0, 0.5, 1.0, 1.0]


def test_a_battery_must_be_in_the_observation():
    with pytest.raises(ValueError, match="`battery` must be an entry of an observation of 3, got"):
        make_hunger_controller(Config.of(hunger_control="battery", battery=3), observation_dim=3)


def test_a_battery_must_be_in_the_info():
    hunger_controller = make_hunger_controller(Config.of(hunger_control="battery", battery="fuel"), observation_dim=3)
    with pytest.raises(ValueError, match=r"`battery` .* \['energy'\], got 'fuel'"):
        hunger_controller.hunger(0, NOTHING, {"energy": 1.0})


@pytest.mark.parametrize("control", ["constant", "dial"])
@pytest.mark.parametrize("num_envs", [1, 2])
def test_the_caller_may_say_how_hungry_the_agent_is(tiny, control, num_envs):
    told = []

    def hunger(observation, info):
        told.append((observation, info["energy"]))
        return 0.25 + 0.5 * (observation[:, -1] < 0.95)

    settings = tiny.override(env_id="BatteryRover", env_kwargs={}, hunger_control=control, num_envs=num_envs)
    train(settings, hunger=hunger, show_progress=False)
    assert {len(observation) for observation, _ in told} == {1, num_envs}  # 1 in evaluations
    for observation, energy in told:
        assert observation[:, -1] == pytest.approx(energy)
    logged = {float(row["agent/hunger"]) for row in read_progress(settings.run.out)}
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
def test_a_hunger_that_cannot_be_is_named(tiny, hunger, message):
    settings = tiny.override(hunger_control="dial")
    with pytest.raises(ValueError, match=message):
        train(settings, hunger=lambda observation, info: hunger, show_progress=False)


def test_hunger_is_said_by_one_alone(tiny):
    settings = tiny.override(hunger_control="bandit")
    with pytest.raises(ValueError, match=r"`hunger_control` must be .* got 'bandit'"):
        train(settings, hunger=lambda observation, info: 1.0, show_progress=False)
    assert not tiny.run.out.exists()


def test_what_is_sensed_is_not_bounded_without_a_dial():
    sensed = FunctionHunger(lambda observation, info: 7.0, math.inf)
    assert sensed.hunger(0, NOTHING, {}).tolist() == [7.0]


@pytest.mark.parametrize("control", ["linear", "exponential"])
def test_a_schedule_goes_from_hunger_to_final_hunger(control):
    settings = Config.of(
        hunger_control=control, hunger=0.5, final_hunger=8.0, total_steps=100, num_envs=2
    )
    hunger_controller = make_hunger_controller(settings, 3)
    assert isinstance(hunger_controller, ScheduledHunger)
    assert hunger_controller.hunger(0, np.zeros((2, 3)), {}).tolist() == [0.5, 0.5]
    assert hunger_controller.hunger(100, np.zeros((2, 3)), {}) == pytest.approx(8.0)


def test_what_goes_with_time_is_set_before_a_step(tiny):
    settings = tiny.override(hunger_control="linear",
        final_hunger=3.0,
        temperature_control="exponential",
        temperature=1.0,
        final_temperature=0.01,
        curiosity_ends=50,
        total_steps=100,)
    learner = Learner(settings, 3, 1)
    learner.turn(49, np.zeros(3), {})
    assert learner.agent.curiosity_weight == 1.0
    learner.turn(50, np.zeros(3), {})
    assert learner.agent.hunger == pytest.approx(2.0)
    assert learner.agent.temperature == pytest.approx(0.1)
    assert learner.agent.curiosity_weight == 0.0


def test_what_is_restored_is_told_anew_how_hungry_it_is(tiny):
    learner, hungrier = Learner(tiny, 3, 1), Learner(tiny.override(hunger=2.0), 3, 1)
    for each in (learner, hungrier):
        each.turn(0, np.zeros(3), {})
    learner.load_state_dict(hungrier.state_dict())
    assert learner.agent.hunger == 2.0
    learner.turn(1, np.zeros(3), {})
    assert learner.agent.hunger == 1.0


@pytest.mark.parametrize("num_envs", [1, 2])
def test_the_policy_acts_as_hungry_as_the_dial_says(tiny, num_envs):
    settings = tiny.override(hunger_control="dial", num_envs=num_envs)
    learner = Learner(settings, 3, 1)
    with torch.no_grad():
        layers = learner.agent.policy.network.layers
        for layer in layers:
            layer.bias.zero_()
        layers[0].weight[0, -1] = 100.0  # hunger alone moves the action
        layers[-1].weight[..., 0] = 1.0
        layers[-1].bias[..., 1] = -9.0
    actions = []
    for hunger in (0.0, 1.0):
        object.__setattr__(settings, "hunger", hunger)
        observation = np.zeros(3) if num_envs == 1 else np.zeros((num_envs, 3))
        learner.turn(0, observation, {})
        actions.append(learner.act(observation))
    assert (abs(actions[0] - actions[1]) > 0.5).all()
    greedy = learner.act_deterministically(torch.zeros(1, 3), {})
    assert greedy.item() == pytest.approx(actions[1].flat[0], abs=0.1)


@pytest.mark.parametrize("control", ["draws", "bandit"])
def test_a_resumed_run_goes_on_with_its_keeper(tiny, tmp_path, control):
    dialled = tiny.override(hunger_control=control, total_steps=60)
    train(dialled, show_progress=False)
    halves = dialled.override(out=tmp_path / "halves")
    train(halves.override(total_steps=30), show_progress=False)
    continue_run(halves.run.out, total_steps=60, show_progress=False)
    whole, resumed = (load_checkpoint(run.run.out)["learner"] for run in (dialled, halves))
    assert whole["hunger_controller"] == resumed["hunger_controller"] != {}
    assert torch.equal(whole["replay"]["rows"], resumed["replay"]["rows"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"hunger_control": "bandit", "bonus": "none"},
            "`hunger_control` must be .* got 'bandit'",
        ),
        ({"hunger_control": "dial", "hunger": 2.0}, r"`hunger` must lie in \[0, 1\] on a dial"),
        ({"hunger_control": "linear", "hunger": 0.0}, "`first` must be finite and positive"),
        ({"hunger_control": "linear", "final_hunger": 0.0}, "`final_hunger` must be positive"),
        ({"hunger_control": "battery", "battery": 7}, "`battery` must be an entry of"),
        (
            {"temperature_control": "linear", "final_temperature": -1.0},
            "`final_temperature` must be positive, got -1.0",
        ),
    ],
    ids=str,
)
def test_a_control_that_cannot_be_is_named(tiny, change, message):
    with pytest.raises(ValueError, match=message):
        train(tiny.override(**change), show_progress=False)
    assert not tiny.run.out.exists()


def test_a_run_without_a_dial_is_played_at_no_other_hunger(tiny):
    train(tiny, show_progress=False)
    environment = make_environment(tiny.env_id, tiny.env_kwargs)
    with pytest.raises(ValueError, match="`hunger` can only be chosen where the run has a dial"):
        load_policy(tiny.run.out, tiny, environment, hunger=0.5)
    action = load_policy(tiny.run.out, tiny, environment)(torch.zeros(2, 3), {})
    assert action.shape == (2, 1)
    environment.close()


def test_curiosity_past_the_end_of_the_world_is_asked_for_by_a_setting(tiny):
    rover = tiny.override(env_id="BatteryRover", env_kwargs={}, total_steps=300, learning_starts=250)
    weights = []
    for episodic in (True, False):
        out = tiny.run.out.with_name(f"{episodic}")
        train(rover.override(curiosity_episodic=episodic, out=out), show_progress=False)
        state = load_checkpoint(out)["learner"]
        assert state["replay"]["rows"][:, -2].any()  # a battery was empty
        weights.append(state["agent"]["critics.network.layers.0.weight"])
    assert not torch.equal(*weights)
