import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import deep_curiosity_envs
from deep_curiosity.training import Config, train
from deep_curiosity_envs import ActionCost, NoiseSwitch

PENDULUM = "Pendulum-v1"  # torque within [-2, 2]
CAR = "MountainCarContinuous-v0"


class Images(gymnasium.Env):
    """Shows an image beside a vector."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    observation_space = gymnasium.spaces.Dict(
        image=gymnasium.spaces.Box(0, 255, (4, 4), np.uint8), place=action_space
    )


class WholeActions(gymnasium.Env):
    """Takes whole numbers."""

    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.int8)
    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))


class Named(gymnasium.Env):
    """Shows two vectors by name; it is never drawn."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    observation_space = gymnasium.spaces.Dict(speed=action_space, place=action_space)


class Boxed(gymnasium.Env):
    """Takes actions of any box."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, low, high):
        low, high = np.array(low, np.float32), np.array(high, np.float32)
        self.action_space = gymnasium.spaces.Box(low, high, low.shape)


for task in (Images, WholeActions, Named, Boxed):
    gymnasium.register(f"variants/{task.__name__}-v0", task)


def rollout(env, actions, seed=0):
    """Observations of an episode."""
    return np.array([env.reset(seed=seed)[0], *(env.step(action)[0] for action in actions)])


@pytest.mark.parametrize(("torque", "cost"), [(0.0, 0.0), (1.0, 0.025), (-2.0, 0.1)])
def test_actions_cost_their_square_in_units_of_their_bounds(torque, cost):
    dear, free = ActionCost(PENDULUM, action_cost=0.1), gymnasium.make(PENDULUM)
    dear.reset(seed=3)
    free.reset(seed=3)
    action = np.array([torque], np.float32)
    observation, reward, *_ = dear.step(action)
    expected, free_reward, *_ = free.step(action)
    assert np.array_equal(observation, expected)
    assert reward == pytest.approx(free_reward - cost)


@pytest.mark.parametrize("cost", [-0.1, float("nan"), "0.1", None, [0.1]], ids=repr)
def test_a_cost_that_cannot_be_is_refused(cost):
    with pytest.raises(ValueError, match="`action_cost` must be a finite number and not") as error:
        ActionCost(action_cost=cost)
    assert str(error.value).endswith(f"got {cost!r}.")


@pytest.mark.parametrize("number", ["2", 2.5, True, 0], ids=repr)
def test_a_number_of_channels_that_cannot_be_is_refused(number):
    with pytest.raises(
        ValueError, match="`num_channels` must be a whole number of at least"
    ) as error:
        NoiseSwitch(num_channels=number)
    assert str(error.value).endswith(f"got {number!r}.")


@pytest.mark.parametrize(("variant", "num_entries"), [(ActionCost, 1), (NoiseSwitch, 2)])
def test_what_is_no_action_is_refused_before_the_task_sees_it(variant, num_entries):
    env = variant(PENDULUM)
    start = env.reset(seed=0)[0]
    shape = rf"`action` must have shape \({num_entries},\), got shape "
    for wrong in (num_entries - 1, num_entries + 1):
        with pytest.raises(ValueError, match=shape):
            env.step(np.zeros(wrong, np.float32))
    for value, rule in ((np.nan, "be finite"), (np.inf, "be finite"), ("on", "hold real numbers")):
        action = [*[0.0] * (num_entries - 1), value]
        with pytest.raises(ValueError, match=f"`action` must {rule}, got "):
            env.step(np.array(action))
    assert np.array_equal(env.unwrapped._get_obs(), start[:3])


@pytest.mark.parametrize("variant", [ActionCost, NoiseSwitch])
@pytest.mark.filterwarnings("ignore:.*maximum and minimum values are equal")
@pytest.mark.parametrize(
    ("low", "high"),
    [([[-1, -1], [-1, -1]], [[1, 1], [1, 1]]), ([-1, 0], [1, 0]), (-1, 1), ([], [])],
    ids=str,
)
def test_boxes_of_actions_that_are_no_vectors_with_room_are_refused(variant, low, high):
    rule = "`env_id` must have actions in a bounded box that is flat, not empty and has low < high"
    with pytest.raises(ValueError, match=rf"{rule} everywhere, got Box\("):
        variant("variants/Boxed-v0", low=low, high=high)


def test_channels_flicker_where_the_last_action_is_positive_and_nowhere_else():
    env, plain = NoiseSwitch(CAR, num_channels=3), gymnasium.make(CAR)
    switched = np.array([0, 1, 1, 0, -1, 1], bool)
    last = np.where(switched, 0.5, -0.5)
    push = np.linspace(-1, 1, len(last))
    shown = rollout(env, np.stack([push, last], -1).astype(np.float32))
    assert np.array_equal(shown[:, :2], rollout(plain, push[:, None].astype(np.float32)))
    on = np.concatenate([[False], last > 0])
    assert (shown[on, 2:] != 0).all()
    assert (shown[~on, 2:] == 0).all()
    assert len(np.unique(shown[on, 2:])) == 3 * on.sum()
    assert env.observation_space.contains(shown[-1])


def test_noise_repeats_with_the_seed_and_goes_on_without_one():
    env = NoiseSwitch()
    on = np.ones((4, 2), np.float32)
    first, again, other = (rollout(env, on, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.isin(other[1:, 2:], first[1:, 2:]).any()
    env.reset()
    assert not np.isin(env.step(on[0])[0][2:], other[1:, 2:]).any()


def test_noise_says_nothing_of_what_the_task_draws():
    class Drawing(gymnasium.Env):
        """Shows the random numbers that it draws."""

        action_space = observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            return self.np_random.uniform(-1, 1, 1), {}

        def step(self, action):
            return self.np_random.uniform(-1, 1, 1), 0.0, False, False, {}

    gymnasium.register("variants/Drawing-v0", Drawing)
    env = NoiseSwitch("variants/Drawing-v0", num_channels=1)
    drawn, noise = rollout(env, np.ones((50, 2))).T
    assert not np.isin(noise[1:], drawn).any()


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (lambda: NoiseSwitch("CartPole-v1"), "`env_id` must have actions in a bounded box that"),
        (lambda: ActionCost("CartPole-v1"), "`env_id` must have actions in a bounded box that"),
        (
            lambda: NoiseSwitch("FrozenLake-v1"),
            "`env_id` must have observations of one flat array",
        ),
        (
            lambda: NoiseSwitch("variants/Images-v0"),
            r"`env_id` must have observations of one flat array.*got Dict\('image': Box",
        ),
        (
            lambda: NoiseSwitch("variants/WholeActions-v0"),
            r"`env_id` must have actions of real numbers, got Box\(-1, 1, \(1,\), int8\)",
        ),
    ],
)
def test_tasks_that_cannot_be_changed_so_are_refused(make, rule):
    with pytest.raises(ValueError, match=rule):
        make()


class Counter(gymnasium.Env):
    """Counts its steps in whole numbers; it is never drawn."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, kind="uint8"):
        low, high = (0, 255) if kind == "uint8" else (-9, 9)
        self.observation_space = gymnasium.spaces.Box(low, high, (1,), np.dtype(kind).type)

    def reset(self, *, seed=None, options=None):
        self.steps = np.zeros(1, self.observation_space.dtype)
        return self.steps.copy(), {}

    def step(self, action):
        self.steps += 1
        return self.steps.copy(), 0.0, False, False, {}


@pytest.mark.parametrize("kind", ["uint8", "int64", "float16", "float64"])
def test_channels_are_real_numbers_where_observations_are_whole(kind):
    gymnasium.register("variants/Counter-v0", Counter)
    env = NoiseSwitch("variants/Counter-v0", kind=kind)
    shown = rollout(env, np.ones((3, 2), np.float32))
    assert shown[:, 0].tolist() == [0, 1, 2, 3]
    assert (shown[1:, 1:] % 1 != 0).all()
    assert env.observation_space.contains(env.step(np.ones(2, np.float32))[0])
    assert env.observation_space.dtype.kind == "f"
    gymnasium.registry.pop("variants/Counter-v0")


@pytest.mark.parametrize("variant", [ActionCost, NoiseSwitch])
@pytest.mark.parametrize(
    "env_id",
    [
        "CleverRandom",  # which has no render mode
        "PendulumSwingup",
        "deep_curiosity_envs:deep_curiosity/PointMaze-v0",
        "dm_control/pendulum-swingup-v0",
        "PointMaze_UMaze-v3",
    ],
)
def test_any_name_of_a_task_that_the_trainer_takes_is_taken(variant, env_id):
    for prefix, package in (("dm_control", "shimmy"), ("PointMaze_", "gymnasium_robotics")):
        if env_id.startswith(prefix):
            pytest.importorskip(package)
    env = variant(env_id)
    env.reset(seed=0)
    observation = env.step(np.ones(env.action_space.shape, env.action_space.dtype))[0]
    assert env.observation_space.contains(observation)


@pytest.mark.parametrize("variant", [ActionCost, NoiseSwitch])
def test_what_is_wrong_with_a_name_is_told_of_the_name(variant):
    with pytest.raises(ValueError, match=r"`env_id` must be a registered id .* 'Pendulum-v2'"):
        variant("Pendulum-v2")
    with pytest.raises(ValueError, match=r"`env_id` must name a module .* 'nowhere:Task-v0'"):
        variant("nowhere:Task-v0")
    with pytest.raises(ValueError, match="`env_id` must be text, the name of a task, got 3"):
        variant(3)


def layers(env):
    """Names of the wrappers around a task, from the outermost."""
    return [env.class_name(), *layers(env.env)] if isinstance(env, gymnasium.Wrapper) else []


@pytest.mark.parametrize("variant_id", deep_curiosity_envs.VARIANT_IDS)
@pytest.mark.parametrize("by_id", [True, False])
@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space")
def test_gymnasium_accepts_a_variant_and_makes_the_same_from_its_spec(variant_id, by_id):
    variant = getattr(deep_curiosity_envs, variant_id.removeprefix("deep_curiosity/")[:-3])
    setting = {"action_cost": 0.5} if variant is ActionCost else {"num_channels": 3}
    kwargs = {"env_id": PENDULUM, **setting, "g": 5.0}
    env = gymnasium.make(variant_id, **kwargs) if by_id else variant(**kwargs)
    check_env(env, skip_render_check=True)
    again = gymnasium.make(env.spec)
    assert layers(again).count(variant.__name__) == layers(env).count(variant.__name__) == 1
    assert (again.unwrapped.g, again.spec.max_episode_steps) == (5.0, 200)
    action = np.full(env.action_space.shape, 0.5, np.float32)
    for one in (env, again):
        one.reset(seed=3)
    outcomes = [env.step(action), again.step(action)]
    assert np.array_equal(outcomes[0][0], outcomes[1][0])
    assert outcomes[0][1:] == outcomes[1][1:]


def test_a_switch_over_named_observations_is_made_again_from_its_spec():
    env = NoiseSwitch("variants/Named-v0")
    again = gymnasium.make(env.spec)
    assert again.observation_space == env.observation_space
    assert layers(again).count("FlattenObservation") == 1


def test_variants_of_variants_are_made_again_from_their_spec():
    env = NoiseSwitch("ActionCost", action_cost=0.25)
    again = gymnasium.make(env.spec)
    for variant in ("ActionCost", "NoiseSwitch"):
        assert layers(again).count(variant) == layers(env).count(variant) == 1
    assert again.action_space == env.action_space
    assert again.get_wrapper_attr("action_cost") == 0.25


@pytest.mark.parametrize("variant_id", deep_curiosity_envs.VARIANT_IDS)
def test_variants_are_made_by_their_id_and_keep_the_limit_of_the_task(variant_id):
    env = gymnasium.make(variant_id, env_id=PENDULUM)
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape, np.float32)
    ends = [env.step(action)[3] for _ in range(200)]
    assert ends == [False] * 199 + [True]


def test_a_variant_trains_and_shows_what_is_switched(tmp_path):
    config = Config.of(
        env_id="deep_curiosity/NoiseSwitch-v0",
        env_kwargs={"env_id": CAR, "num_channels": 1},
        total_steps=80,
        learning_starts=40,
        hidden_dim=8,
        batch_size=8,
        evaluation_interval=80,
        evaluation_episodes=1,
        max_episode_steps=20,
        log_interval=40,
        compile="off",
        out=tmp_path / "run",
    )
    assert train(config, show_progress=False)["total_steps"] == 80


@pytest.mark.parametrize("variant", [ActionCost, NoiseSwitch])
def test_a_variant_has_metadata_as_a_class_and_that_of_its_task_as_an_environment(variant):
    """Gymnasium before 1.4 reads the class's, which has to be a dictionary."""
    assert "rgb_array" in variant.metadata["render_modes"]
    task = variant("MountainCarContinuous-v0")
    assert task.metadata == task.unwrapped.metadata
    task.metadata = {"render_fps": 1}
    assert task.metadata == {"render_fps": 1} != task.unwrapped.metadata
