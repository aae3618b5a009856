"""The base class of every MuJoCo task here, with the stepping and rendering they share."""

import abc
import copy
import math
from collections.abc import Sequence
from importlib import resources
from typing import Any, ClassVar

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from deep_curiosity_envs.checks import check_action, check_action_cost
from deep_curiosity_envs.clock import clock_stopped
from deep_curiosity_envs.rewards import SuccessStreak

Array = NDArray[Any]
Array32 = NDArray[np.float32]
Array64 = NDArray[np.float64]

CONTROL_STEP = 0.05  # s; 20 decisions per second are enough for poles of half a metre
IMAGE_SIZE = (480, 480)  # height and width in pixels; MuJoCo's default buffer is 480 pixels high


class MujocoTask(gymnasium.Env[Array32, Array32], abc.ABC):
    """A continuous-control task with a sparse reward of at most one per step.

    Actions lie in [-1, 1]; what lies outside is clipped. A step pays `get_reward()`, in [0, 1],
    minus `action_cost` times the mean square of the clipped action, so a return is at most the
    length of the episode. An episode is a success once it has paid in full for `hold_time`; every
    `info` holds `is_success`. An episode is a function of the seed given to `reset` and of the
    actions.

    Observation, reward, termination and info are functions of `qpos`, `qvel`, `mocap_pos` and
    `userdata`, written for any number of environments: their axis, where there is one, comes
    first, so that coordinates are indexed from the right, `self.qpos[..., 0]`. Here these are the
    arrays of the one environment in `data`; `batched_view` returns the same task over the arrays
    of many. State beside the physics is kept in `userdata`, which is zero when an episode begins
    and which `after_step` updates.

    Args:
        model: The compiled MuJoCo model; every actuator has the control range [-1, 1].
        observation_bound: Largest magnitude of every observation coordinate. Velocities beyond
            it, which the task's own forces hardly reach, are clipped.
        action_cost: Reward lost per step at full action.
        render_mode: `"rgb_array"`, or None for a task that is never rendered.

    Raises:
        ValueError: If the action cost is no finite number or negative, the render mode is unknown,
            or the control step is not a whole multiple of the model's physics step.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium declares it on the instance)
        "render_modes": ["rgb_array"],
        "render_fps": round(1 / CONTROL_STEP),
    }
    max_reward_per_step: ClassVar[float] = 1.0
    hold_time: ClassVar[float] = CONTROL_STEP  # s

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        observation_bound: Sequence[float],
        action_cost: float = 0.0,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f'`render_mode` must be None or "rgb_array", got {render_mode!r}.')
        self.action_cost, self.render_mode = check_action_cost(action_cost), render_mode
        self.model, self.data = model, mujoco.MjData(model)
        self._look_at_data()
        bound = np.asarray(observation_bound, dtype=np.float32)
        self.observation_space = gymnasium.spaces.Box(-bound, bound, dtype=np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (model.nu,), dtype=np.float32)
        self.num_physics_steps = count_physics_steps(CONTROL_STEP, model.opt.timestep)
        self.success_streak = SuccessStreak(round(self.hold_time / CONTROL_STEP))
        self._bound = bound
        self._renderer: mujoco.Renderer | None = None

    def _look_at_data(self) -> None:
        """Let the arrays of the one environment be those in `data`."""
        self.qpos, self.qvel, self.mocap_pos = self.data.qpos, self.data.qvel, self.data.mocap_pos
        self.userdata = self.data.userdata

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_renderer": None}  # which a copy makes anew

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._look_at_data()

    @abc.abstractmethod
    def initialize_episode(self) -> None:
        """Place the bodies of one environment; random numbers come from `self.np_random`."""

    def after_step(self, control: Array64) -> None:
        """Update `userdata` after the physics of a control step; by default it stays.

        Args:
            control: The clipped actions, `(*batch, action_dim)`.
        """

    @abc.abstractmethod
    def get_observation(self) -> Array64:
        """Observation of the current state, `(*batch, observation_dim)`."""

    @abc.abstractmethod
    def get_reward(self) -> Array64:
        """Reward of the current state in [0, 1], without the action's cost, `(*batch,)`."""

    def is_success(self) -> Array:
        """Whether the task has been solved in this episode, `(*batch,)`."""
        return self.success_streak.achieved

    def is_terminated(self) -> Array:
        """Whether the current state ends the episode, `(*batch,)`; by default none does."""
        return np.zeros_like(self.success_streak.achieved)

    def get_task_info(self) -> dict[str, Array]:
        """Diagnostics of the current state, beside `is_success`, each `(*batch,)`."""
        return {}

    def observe(self) -> Array32:
        """The observation, clipped to its space."""
        observation = self.get_observation().astype(np.float32, order="C")
        return np.minimum(np.maximum(observation, -self._bound), self._bound)

    def get_info(self) -> dict[str, Array]:
        """The info of the current state: `is_success` and the task's own diagnostics."""
        return {"is_success": self.is_success(), **self.get_task_info()}

    def _finish_step(self, control: Array64) -> tuple[Array32, Array64, Array, dict[str, Array]]:
        """Outcome of a control step in every environment, after its physics.

        Args:
            control: The clipped actions, `(*batch, action_dim)`.

        Returns:
            Observation, reward, whether the episode has terminated, and info.
        """
        self.after_step(control)
        reward = self.get_reward()
        self.success_streak.update(reward == 1.0)
        cost = self.action_cost * np.square(control).sum(-1) / control.shape[-1]
        return self.observe(), reward - cost, self.is_terminated(), self.get_info()

    def batched_view(
        self, qpos: Array64, qvel: Array64, mocap_pos: Array64, userdata: Array64
    ) -> "MujocoTask":
        """The same task over the state arrays of many environments; it has no physics of its own.

        Args:
            qpos: `(num_envs, nq)`.
            qvel: `(num_envs, nv)`.
            mocap_pos: `(num_envs, nmocap, 3)`.
            userdata: `(num_envs, nuserdata)`.
        """
        view = copy.copy(self)
        view.qpos, view.qvel, view.mocap_pos = qpos, qvel, mocap_pos
        view.userdata = userdata
        view.success_streak = SuccessStreak(self.success_streak.num_steps, num_envs=len(qpos))
        return view

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Start an episode that depends on nothing but the random generator's state."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.initialize_episode()
        self.success_streak.reset()
        mujoco.mj_forward(self.model, self.data)
        return self.observe(), _as_scalars(self.get_info())

    def step(self, action: Array32) -> tuple[Array32, float, bool, bool, dict[str, Any]]:
        """Hold the action for one control step.

        Raises:
            ValueError: If the action holds no real numbers, has another shape than the action
                space, or is not finite.
        """
        control = check_action(action, self.action_space)
        self.data.ctrl[:] = control
        with clock_stopped():
            mujoco.mj_step(self.model, self.data, self.num_physics_steps)
        observation, reward, terminated, info = self._finish_step(control)
        return observation, float(reward), bool(terminated), False, _as_scalars(info)

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """Picture of the current state, height by width by RGB; None without a render mode.

        Raises:
            RuntimeError: If MuJoCo finds no OpenGL library to render with.
        """
        if self.render_mode is None:
            return None
        if self._renderer is None:
            self._renderer = make_renderer(self.model)
        mujoco.mj_kinematics(self.model, self.data)  # mj_step leaves bodies one step behind
        self._renderer.update_scene(self.data, camera="overview")
        return self._renderer.render()

    def close(self) -> None:
        """Free the renderer, if there is one; may be called again."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def _as_scalars(info: dict[str, Array]) -> dict[str, Any]:
    return {name: value.item() for name, value in info.items()}


def load_spec(file_name: str) -> mujoco.MjSpec:
    """Editable model from an MJCF file of this package's `assets`."""
    asset = resources.files("deep_curiosity_envs").joinpath("assets", file_name)
    return mujoco.MjSpec.from_string(asset.read_text(encoding="utf-8"))


def count_physics_steps(control_step: float, physics_step: float) -> int:
    """Number of physics steps in a control step, both in seconds.

    Raises:
        ValueError: If it is not a whole number of at least one.
    """
    num_steps = round(control_step / physics_step)
    if num_steps < 1 or not math.isclose(num_steps * physics_step, control_step):
        raise ValueError(
            "`control_step` must be a whole multiple of the physics step, "
            f"got {control_step} s and {physics_step} s."
        )
    return num_steps


def make_renderer(model: mujoco.MjModel) -> "mujoco.Renderer":  # which may be missing
    """Offscreen renderer of a model.

    Raises:
        RuntimeError: If MuJoCo finds no OpenGL library to render with.
    """
    try:
        return mujoco.Renderer(model, *IMAGE_SIZE)
    except Exception as error:  # each OpenGL backend fails with exceptions of its own
        raise RuntimeError(
            "MuJoCo could not start OpenGL. `MUJOCO_GL` must be set to egl or osmesa "
            "before Python starts, with that library installed, where there is no screen."
        ) from error
