"""Laws that every task obeys."""

import copy
import importlib
import math
import os
import pickle
import subprocess
import sys

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import deep_curiosity_envs
from deep_curiosity_envs import TASK_IDS

NUM_STEPS = 420  # longer than any episode

NAMED_KINDS = {
    mujoco.mjtObj.mjOBJ_BODY: "nbody",
    mujoco.mjtObj.mjOBJ_JOINT: "njnt",
    mujoco.mjtObj.mjOBJ_GEOM: "ngeom",
    mujoco.mjtObj.mjOBJ_SITE: "nsite",
    mujoco.mjtObj.mjOBJ_CAMERA: "ncam",
    mujoco.mjtObj.mjOBJ_LIGHT: "nlight",
    mujoco.mjtObj.mjOBJ_ACTUATOR: "nu",
    mujoco.mjtObj.mjOBJ_TEXTURE: "ntex",
    mujoco.mjtObj.mjOBJ_MATERIAL: "nmat",
    mujoco.mjtObj.mjOBJ_SENSOR: "nsensor",
    mujoco.mjtObj.mjOBJ_TENDON: "ntendon",
}

PROBE_GL = """
import mujoco
mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8).render()
"""

WITHOUT_RENDERER = """
import sys, warnings
sys.path.insert(0, {!r})
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always", UserWarning)
    import deep_curiosity_envs
print(*(warning.message for warning in caught if "MUJOCO_GL" in str(warning.message)))
import gymnasium
env = gymnasium.make("deep_curiosity/PendulumSwingup-v0", render_mode="rgb_array")
env.reset(seed=0)
env.step(env.action_space.high)
try:
    env.render()
except RuntimeError as error:
    print(error)
"""

RENDER_ALL = """
import gymnasium
from deep_curiosity_envs import TASK_IDS
for task_id in TASK_IDS:
    env = gymnasium.make(task_id, render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    for _ in range(10):
        env.step(env.action_space.high)
    after = env.render()
    assert before.shape == (480, 480, 3) and before.dtype == "uint8", task_id
    assert before.std() > 0 and (before != after).any(), task_id
    env.close()
    env.close()
"""


@pytest.fixture(params=TASK_IDS)
def task_id(request):
    return request.param


def make(task_id, **kwargs):
    return gymnasium.make(task_id, disable_env_checker=True, **kwargs)


def random_actions(env, num_steps=NUM_STEPS):
    shape = (num_steps, *env.action_space.shape)
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def trajectory(env, actions, seed):
    """Observations, rewards and infos of one episode that may go on beyond its end."""
    observation, info = env.reset(seed=seed)
    steps = [(observation.tobytes(), 0.0, False, info)]
    for action in actions:
        observation, reward, terminated, _, info = env.step(action)
        steps.append((observation.tobytes(), reward, terminated, info))
    return steps


def run_python(script, gl_backend):
    environment = os.environ | {"MUJOCO_GL": gl_backend, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-W", "error", "-c", script]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)


@pytest.fixture(scope="module")
def gl_backend():
    for backend in ("egl", "osmesa"):
        if run_python(PROBE_GL, backend).returncode == 0:
            return backend
    pytest.skip("no OpenGL library for offscreen rendering")


def test_gymnasium_accepts_the_task(task_id):
    check_env(gymnasium.make(task_id).unwrapped, skip_render_check=True)


def test_importing_twice_registers_once_and_in_silence(task_id):
    spec = gymnasium.spec(task_id)
    importlib.reload(deep_curiosity_envs)
    assert gymnasium.spec(task_id) is spec


def test_id_makes_the_exported_class(task_id):
    name = task_id.removeprefix("deep_curiosity/").removesuffix("-v0")
    assert type(make(task_id).unwrapped) is getattr(deep_curiosity_envs, name)


def test_same_seed_and_actions_give_the_same_bits(task_id):
    first, second = make(task_id), make(task_id)
    actions = random_actions(first, 100)
    second.reset(seed=1)
    second.step(actions[0])  # earlier episodes must not matter
    assert trajectory(first, actions, seed=7) == trajectory(second, actions, seed=7)


def test_other_seed_gives_another_episode(task_id):
    env = make(task_id)
    assert (env.reset(seed=0)[0] != env.reset(seed=1)[0]).any()
    assert (env.reset()[0] != env.reset()[0]).any()


def test_instances_do_not_share_state(task_id):
    env, other = make(task_id), make(task_id)
    actions = random_actions(env, 50)
    alone = trajectory(env, actions, seed=0)
    env.reset(seed=0)
    other.reset(seed=1)
    for action, expected in zip(actions, alone[1:], strict=True):
        other.step(-action)
        assert env.step(action)[0].tobytes() == expected[0]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_as_the_task_would_and_leaves_it_alone(task_id, copied):
    env = make(task_id)
    env.reset(seed=0)
    first, *later = random_actions(env, 20)
    env.step(first)
    twin, before = copied(env), env.unwrapped.observe()
    courses = [[env.step(action)[0].tobytes() for action in later] for env in (twin, env)]
    assert courses[0] == courses[1]
    assert (twin.unwrapped.observe() != before).any()
    assert trajectory(twin, later, seed=3) == trajectory(make(task_id), later, seed=3)
    assert twin.unwrapped.qpos.base is not env.unwrapped.qpos.base


def test_random_episodes_stay_in_the_spaces_and_pay_at_most_one(task_id):
    env = make(task_id)
    env.reset(seed=0)
    for action in random_actions(env):
        observation, reward, terminated, truncated, info = env.step(action)
        assert env.observation_space.contains(observation)
        assert type(reward) is float
        assert 0.0 <= reward <= env.unwrapped.max_reward_per_step
        assert type(info["is_success"]) is bool
        if terminated or truncated:
            _, info = env.reset()
            assert info["is_success"] is False


def test_full_effort_stays_in_the_spaces(task_id):
    env = make(task_id)
    observation, _ = env.reset(seed=0)
    for step in range(NUM_STEPS):
        action = env.action_space.high if step // 25 % 2 else env.action_space.low
        observation = env.unwrapped.step(action)[0]
        assert env.observation_space.contains(observation)


def test_episode_is_truncated_at_its_length(task_id):
    env = make(task_id)
    env.reset(seed=0)
    length = env.spec.max_episode_steps
    idle = np.zeros(env.action_space.shape, np.float32)
    truncated = [env.step(idle)[3] for _ in range(length)]
    assert truncated == [False] * (length - 1) + [True]


def test_action_cost_is_the_mean_square_of_the_clipped_action(task_id):
    free, costly = make(task_id).unwrapped, make(task_id, action_cost=0.1).unwrapped
    free.reset(seed=0)
    costly.reset(seed=0)
    action = np.full(free.action_space.shape, 0.5, np.float32)
    action[-1] = 3.0
    expected_cost = 0.1 * np.mean(np.minimum(action, 1.0) ** 2)
    assert free.step(action)[1] - costly.step(action)[1] == pytest.approx(expected_cost)


@pytest.mark.parametrize("action_cost", [-0.1, math.nan, math.inf, "0.1", None, [0.1]])
def test_bad_action_cost_is_rejected(task_id, action_cost):
    with pytest.raises(ValueError, match="`action_cost` must be a finite number and not") as error:
        make(task_id, action_cost=action_cost)
    assert str(error.value).endswith(f"got {action_cost!r}.")


def test_action_of_another_shape_is_rejected(task_id):
    env = make(task_id)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"`action` must have shape .*, got shape \(7,\)"):
        env.step(np.zeros(7, np.float32))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_action_that_is_not_finite_is_rejected(task_id, value):
    env = make(task_id)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=rf"`action` must be finite, got \[.*{value}"):
        env.step(np.full(env.action_space.shape, value, np.float32))


@pytest.mark.parametrize("value", ["0.5", 0.5j, None], ids=repr)
def test_action_that_holds_no_real_numbers_is_rejected(task_id, value):
    env = make(task_id)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="`action` must hold real numbers, got "):
        env.step(np.full(env.action_space.shape, value))


def test_every_element_has_a_name(task_id):
    model = make(task_id).unwrapped.model
    for kind, count in NAMED_KINDS.items():
        for index in range(getattr(model, count)):
            assert mujoco.mj_id2name(model, kind, index), f"{kind.name} {index} has no name"


def test_every_motor_is_driven_between_minus_one_and_one(task_id):
    model = make(task_id).unwrapped.model
    assert (model.actuator_ctrlrange == [-1.0, 1.0]).all()


def test_unknown_render_mode_is_rejected(task_id):
    task = type(make(task_id).unwrapped)
    with pytest.raises(ValueError, match=r"`render_mode` must be None .* got 'human'"):
        task(render_mode="human")


def test_render_without_a_render_mode_draws_nothing(task_id):
    assert make(task_id).unwrapped.render() is None


def test_render_without_opengl_says_what_to_set(task_id, monkeypatch):
    def fail(*args):
        raise AttributeError("no library")

    monkeypatch.setattr(mujoco, "Renderer", fail)
    env = make(task_id, render_mode="rgb_array")
    env.reset(seed=0)
    env.step(env.action_space.high)
    with pytest.raises(RuntimeError, match="`MUJOCO_GL` must be set to egl"):
        env.render()
    env.close()


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
@pytest.mark.parametrize("error", ["ImportError", "AttributeError"])
def test_training_needs_no_renderer(tmp_path, backend, error):
    library = tmp_path / "OpenGL"
    library.mkdir()
    (library / "__init__.py").write_text(f"raise {error}('no library')")
    result = run_python(WITHOUT_RENDERER.format(str(tmp_path)), backend)
    assert result.returncode == 0, result.stderr
    warning, drawn = result.stdout.splitlines()
    message = "`MUJOCO_GL` must name an OpenGL library that is installed, got "
    assert warning == (
        f"{message}'{backend}' (no library): nothing can be drawn." * (error == "AttributeError")
    )
    assert drawn.startswith("MuJoCo could not start OpenGL.")


def test_every_task_renders_its_motion(gl_backend):
    result = run_python(RENDER_ALL, gl_backend)
    assert result.returncode == 0, result.stderr
