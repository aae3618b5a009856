import json
import shutil
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.wrappers import RescaleAction

import deep_curiosity as dc
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.log import read_config
from deep_curiosity.training.playback import load_agent, load_policy, load_usual_observation
from deep_curiosity.training.windows import first_window
from tests.trained.conftest import HIGH, LOW, TASK, Slope

OBSERVATIONS = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
OF_TRAINING = ["gymnasium", "mujoco", "matplotlib", "tensorboard", "tqdm", "tyro", "safetensors"]


def agent_of(folder):
    config = read_config(folder)
    return load_agent(folder, config, make_environment(config.environment))


def in_units_of_the_task(action):
    return np.array(
        [
            RescaleAction(Slope(), *np.array([-1, 1], np.float32)).action(each)
            for each in action.numpy()
        ]
    )


def assert_acts_as_agent(policy, folder, *, curious=False):
    """Compare what a loaded policy does with the centre of the agent's own."""
    action, state = policy.predict(OBSERVATIONS, curious=curious)
    observation = torch.from_numpy(OBSERVATIONS)
    expected = agent_of(folder).act(observation, deterministic=True, greedy=not curious)
    np.testing.assert_allclose(action, in_units_of_the_task(expected), rtol=0, atol=1e-6)
    assert action.dtype == np.float32 and state is None
    return action


@pytest.mark.parametrize("curious", [False, True])
def test_actions_are_those_of_the_agent_in_units_of_the_task(run_of, curious):
    action = assert_acts_as_agent(dc.load(run_of()), run_of(), curious=curious)
    other, _ = dc.load(run_of()).predict(OBSERVATIONS, curious=not curious)
    assert not np.allclose(action, other)


def test_a_policy_that_saw_observations_normalised_does_so(run_of):
    folder = run_of()
    policy = dc.load(folder)
    assert policy.scaling is not None and policy.scaling.count > 0
    assert_acts_as_agent(policy, folder)


def test_a_run_that_saw_observations_as_they_are_is_loaded_so(run_of, tmp_path):
    own = run_of(normalize_observations=False)
    folder = shutil.copytree(own, tmp_path / "older")
    values = json.loads((folder / "config.json").read_text())
    del values["normalize_observations"]  # younger than such a run
    (folder / "config.json").write_text(json.dumps(values))
    policy = dc.load(folder)
    assert not policy.config.agent.normalize_observations and policy.scaling is None
    assert_acts_as_agent(policy, folder)


def test_samples_are_those_of_the_agent(run_of):
    policy, agent = dc.load(run_of()), agent_of(run_of())
    torch.manual_seed(3)
    action, _ = policy.predict(OBSERVATIONS, deterministic=False)
    torch.manual_seed(3)
    expected = agent.act(torch.from_numpy(OBSERVATIONS), greedy=True)
    np.testing.assert_allclose(action, in_units_of_the_task(expected), rtol=0, atol=1e-6)
    assert not np.allclose(action, policy.predict(OBSERVATIONS)[0])


def test_one_observation_is_a_batch_of_one(run_of):
    policy = dc.load(run_of())
    one, _ = policy.predict(OBSERVATIONS[2].tolist())
    assert one.shape == (2,)
    np.testing.assert_allclose(one, policy.predict(OBSERVATIONS)[0][2], rtol=0, atol=1e-6)


@pytest.mark.parametrize("settings", [{}, {"frame_stack": 3}, {"policy_mixture_components": 2}])
def test_an_episode_goes_as_in_the_runs_own_evaluations(run_of, settings):
    folder = run_of(**settings)
    config = read_config(folder)
    wrapped, bare = make_environment(config.environment), gymnasium.make(TASK)
    act, policy = load_policy(folder, config, wrapped), dc.load(folder)
    (shown, _), (observation, _) = wrapped.reset(seed=4), bare.reset(seed=4)
    state, ended = None, False
    while not ended:
        action, state = policy.predict(observation, state)
        shown, expected, *_ = wrapped.step(act(torch.from_numpy(shown[None]), {}).numpy()[0])
        observation, reward, _, ended, _ = bare.step(action)
        assert reward == pytest.approx(expected, abs=1e-5)
    np.testing.assert_allclose(observation, shown[-3:], rtol=0, atol=1e-5)


@pytest.mark.parametrize("frame_stack", [1, 3])
def test_an_absurd_entry_is_taken_at_its_usual_size_as_in_training(run_of, frame_stack):
    folder = run_of(frame_stack=frame_stack)
    policy, usual = dc.load(folder), load_usual_observation(folder)
    observation = OBSERVATIONS.copy()
    observation[1:3, 0] = 1e4, -1e6
    window = first_window(observation, 2, frame_stack)
    shown = np.where(np.abs(window) > 100 * usual, np.sign(window) * usual, window)
    expected = agent_of(folder).act(
        torch.from_numpy(shown.astype(np.float32)), deterministic=True, greedy=True
    )
    action, _ = policy.predict(observation)
    np.testing.assert_allclose(action, in_units_of_the_task(expected), rtol=0, atol=1e-6)
    policy.usual_observation = None  # as of a run that is older than the cut
    raw, _ = policy.predict(observation)
    assert not np.allclose(raw[1:3], action[1:3], rtol=0, atol=1e-2)


def test_a_window_begins_anew_where_an_episode_does(run_of):
    policy = dc.load(run_of(frame_stack=3))
    first, second = OBSERVATIONS[:2], OBSERVATIONS[2:4]
    _, state = policy.predict(first)
    later, _ = policy.predict(second, state, episode_start=[True, False])
    begun, _ = policy.predict(second)
    gone_on, _ = policy.predict(second, state)
    np.testing.assert_array_equal(later[0], begun[0])
    np.testing.assert_array_equal(later[1], gone_on[1])
    assert not np.allclose(begun, gone_on)
    together, _ = policy.predict(second, state, episode_start=True)
    np.testing.assert_array_equal(together, begun)


@pytest.mark.parametrize("start", [[True], [True] * 3, [[True, False]], [0.5, 1], [1, None]])
@pytest.mark.parametrize("frame_stack", [1, 3])
def test_where_episodes_begin_is_said_by_one_flag_or_one_for_each(run_of, frame_stack, start):
    policy = dc.load(run_of(frame_stack=frame_stack))
    _, state = policy.predict(OBSERVATIONS[:2])
    with pytest.raises(ValueError, match="`episode_start` must be False or True, or 2 of them, g"):
        policy.predict(OBSERVATIONS[:2], state, episode_start=start)


def test_a_state_is_that_of_the_call_before(run_of):
    policy = dc.load(run_of(frame_stack=3))
    _, (window, action) = policy.predict(OBSERVATIONS[:2])
    message = r"`state` must be what .* shapes \(2, 13\) and \(2, 2\), got "
    for state in ((window,), (window, action[:1]), (window[:, 1:], action), "ab", 3, window):
        with pytest.raises(ValueError, match=message):
            policy.predict(OBSERVATIONS[:2], state)
    with pytest.raises(ValueError, match=r"`state` must be what .* observations, .*\(1, 13"):
        policy.predict(OBSERVATIONS[:1], (window, action))
    with pytest.raises(ValueError, match="`state` must be finite, got "):
        policy.predict(OBSERVATIONS[:2], (window, np.full_like(action, np.nan)))
    with pytest.raises(TypeError, match="`state` must be of real numbers, got "):
        policy.predict(OBSERVATIONS[:2], (window.astype(str), action))


@pytest.mark.parametrize("name", ["deterministic", "curious"])
def test_a_flag_is_true_or_false(run_of, tmp_path, name):
    with pytest.raises(TypeError, match=f"`{name}` must be True or False, got 'no'"):
        dc.load(run_of()).predict(OBSERVATIONS, **{name: "no"})
    with pytest.raises(TypeError, match="`curious` must be True or False, got 'no'"):
        dc.export(run_of(), tmp_path / "policy.pt2", curious="no")


def test_stable_baselines3_evaluates_it(run_of):
    evaluation = pytest.importorskip("stable_baselines3.common.evaluation")
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    policy = dc.load(run_of(frame_stack=3))
    environment = vec_env.DummyVecEnv([lambda: gymnasium.make(TASK)] * 2)
    returns, lengths = evaluation.evaluate_policy(
        policy, environment, n_eval_episodes=4, return_episode_rewards=True, warn=False
    )
    assert lengths == [15] * 4
    assert np.isfinite(returns).all()


def test_a_conditioned_run_is_asked_at_a_hunger(run_of):
    policy = dc.load(run_of(hunger="conditioned:0.5"))
    greedy, curious = (policy.predict(OBSERVATIONS, hunger=hunger)[0] for hunger in (1, 0.0))
    np.testing.assert_array_equal(policy.predict(OBSERVATIONS)[0], greedy)
    assert not np.allclose(greedy, curious)
    each, _ = policy.predict(OBSERVATIONS, hunger=[0, 1, 1, 1, 0])
    np.testing.assert_allclose(each[[0, 4]], curious[[0, 4]], rtol=0, atol=1e-6)
    np.testing.assert_allclose(each[1:4], greedy[1:4], rtol=0, atol=1e-6)
    for hunger in (1.5, [0.5, 0.5], float("nan")):
        with pytest.raises(ValueError, match=r"`hunger` must be one number in \[0, 1\], or 5 of"):
            policy.predict(OBSERVATIONS, hunger=hunger)


def test_a_battery_makes_hungry(run_of):
    policy = dc.load(run_of(hunger="battery"))
    observation = np.array([[0.3, 0.1, 0.75], [0.3, 0.1, 0.2]])
    expected, _ = policy.predict(observation, hunger=[0.5, 1.0])
    np.testing.assert_array_equal(policy.predict(observation)[0], expected)


def test_a_battery_is_read_off_the_newest_observation_of_a_window(run_of):
    policy = dc.load(run_of(hunger="battery:2", frame_stack=2))
    _, state = policy.predict(np.array([[0.3, 0.1, 1.0]]))
    drained = np.array([[0.3, 0.1, 0.75]])
    expected, _ = policy.predict(drained, state, hunger=0.5)
    np.testing.assert_array_equal(policy.predict(drained, state)[0], expected)


def test_a_hunger_of_the_info_must_be_given(run_of, slope_config):
    folder = run_of(hunger="conditioned:0.5")
    policy = dc.load(folder)
    policy.config = policy.config.override(hunger="battery:charge")
    with pytest.raises(ValueError, match="`hunger` must be given where it depends on 'charge'"):
        policy.predict(OBSERVATIONS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"observation": np.zeros(4)}, r"`observation` must have shape \(3,\) or \(batch, 3\), g"),
        ({"observation": np.zeros((1, 1, 3))}, r"`observation` must have shape \(3,\) or"),
        ({"observation": np.full(3, np.nan)}, r"`observation` must be finite, got \[nan"),
        ({"observation": {"a": np.zeros(3)}}, r"`observation` must be an array .*got a dict"),
        ({"hunger": 0.5}, "`hunger` must be left out for a run that is not conditioned on it"),
    ],
)
def test_what_is_out_of_place_is_refused(run_of, arguments, message):
    with pytest.raises(ValueError, match=message):
        dc.load(run_of()).predict(**{"observation": np.zeros(3)} | arguments)


@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        ([1j, 0, 0], TypeError, "must be of real numbers, got "),
        (np.zeros(3, "datetime64[s]"), TypeError, "must be of real numbers, got "),
        ("abc", TypeError, "must be of real numbers, got 'abc'"),
        (np.ma.array([1.0, 2, 3], mask=[0, 1, 0]), TypeError, "must be of real numbers, got mask"),
        ([[1, 2, 3], [1, 2]], ValueError, r"must be an array of real numbers, got \[\[1, 2, 3\]"),
        ([1e300, 0, 0], ValueError, r"must be finite in float32, got \[1e\+300, 0, 0\]"),
        ([10**400, 0, 0], ValueError, r"must be finite in float32, got \[1000"),
    ],
)
@pytest.mark.parametrize("name", ["observation", "action", "hunger"])
def test_what_is_of_no_real_numbers_is_refused_by_name(run_of, name, value, error, message):
    folder = run_of(hunger="conditioned:0.5")
    predict = dc.load_model(folder).predict if name == "action" else dc.load(folder).predict
    with pytest.raises(error, match=f"`{name}` {message}"):
        predict(**{"observation": np.zeros(3)} | {name: value})


def test_a_plain_agent_has_no_curious_policy(run_of):
    policy = dc.load(run_of(bonus="none"))
    assert policy.predict(OBSERVATIONS)[0].shape == (5, 2)
    with pytest.raises(ValueError, match="`curious` must be False for a run with one policy"):
        policy.predict(OBSERVATIONS, curious=True)


@pytest.mark.parametrize("frame_stack", [1, 3])
def test_a_run_without_spaces_is_given_the_bounds_of_its_actions(run_of, tmp_path, frame_stack):
    folder = shutil.copytree(run_of(frame_stack=frame_stack), tmp_path / "older")
    (folder / "spaces.json").unlink()
    with pytest.raises(ValueError, match="`action_bounds` must be given for a run without"):
        dc.load(folder)
    inf = float("inf")
    for bounds in (
        (1.0, -1.0), (-inf, inf), (float("nan"), 1), (1, 2, 3), ([-1] * 3, [1] * 3), ("a", "b"), 3,
        (-1, None), (-1, [[1, 1]]), (-1, 10**400),
    ):  # fmt: skip
        with pytest.raises(ValueError, match="`action_bounds` must be low and high, finite numbe"):
            dc.load(folder, action_bounds=bounds)
    policy = dc.load(folder, action_bounds=(LOW, HIGH))
    expected = dc.load(run_of(frame_stack=frame_stack)).predict(OBSERVATIONS)[0]
    np.testing.assert_array_equal(policy.predict(OBSERVATIONS)[0], expected)
    with pytest.raises(ValueError, match="`action_bounds` must be left out for a run that has"):
        dc.load(run_of(), action_bounds=(-1, 1))


def test_a_run_of_another_machine_is_loaded_here(run_of, tmp_path):
    folder = shutil.copytree(run_of(), tmp_path / "copied")
    values = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(values | {"device": "cuda"}))
    expected = dc.load(run_of()).predict(OBSERVATIONS)[0]
    np.testing.assert_array_equal(dc.load(folder).predict(OBSERVATIONS)[0], expected)


def test_a_run_is_loaded_that_is_older_than_a_setting(run_of, tmp_path):
    folder = shutil.copytree(run_of(bonus="rnd"), tmp_path / "older")
    values = json.loads((folder / "config.json").read_text())
    del values["random_features"], values["threads"]
    (folder / "config.json").write_text(json.dumps(values))
    policy, same = dc.load(folder), dc.load(run_of(bonus="rnd"))
    assert policy.config == same.config.override(out=folder)
    np.testing.assert_array_equal(policy.predict(OBSERVATIONS)[0], same.predict(OBSERVATIONS)[0])
    (folder / "config.json").write_text(json.dumps(values | {"bonus": "luck"}))
    with pytest.raises(ValueError, match=r"config.json: `bonus` must be one of"):
        dc.load(folder)


def test_a_folder_without_a_run_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"`folder` must be the folder of a run, "):
        dc.load(tmp_path)


def test_a_policy_is_used_without_what_trained_it(run_of):
    code = f"""
import sys
for name in {OF_TRAINING}:
    sys.modules[name] = None
import deep_curiosity as dc
assert "torch" not in sys.modules and "numpy" not in sys.modules
policy = dc.load({str(run_of())!r})
print(policy.predict([0.1, 0.2, 0.3])[0].tolist())
print(dc.load_model({str(run_of())!r}).predict([0.1, 0.2, 0.3], [1.0, 1.0]).mean.tolist())
assert dc.load_bonus({str(run_of())!r}).ready
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    action = json.loads(done.stdout.splitlines()[0])
    expected, _ = dc.load(run_of()).predict([0.1, 0.2, 0.3])
    np.testing.assert_allclose(action, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", dc.__all__)
def test_every_public_name_is_there(name):
    assert getattr(dc, name).__name__ == name
    assert name in dir(dc)


def test_no_other_name_is_there():
    with pytest.raises(AttributeError, match="no attribute 'curiosity_of_another'"):
        dc.curiosity_of_another  # noqa: B018
