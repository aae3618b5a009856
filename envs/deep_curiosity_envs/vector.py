"""Many environments of one task, stepped by MuJoCo in a single call."""

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from mujoco.rollout import Rollout

from deep_curiosity_envs.checks import check_action, check_count
from deep_curiosity_envs.clock import clock_stopped
from deep_curiosity_envs.mujoco_task import Array, Array32, Array64, MujocoTask

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS  # the input and output of `mujoco.rollout`
CONTROL = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_MOCAP_POS
AUTORESET_MODES = (AutoresetMode.SAME_STEP, AutoresetMode.DISABLED)


class MujocoVectorEnv(VectorEnv[Array32, Array32, Array]):
    """Many environments of one task, each equal to the single environment.

    Environment `i` after `reset(seed=s)` has the episodes of the single environment after
    `reset(seed=s + i)`, as in Gymnasium's `SyncVectorEnv`. Observations, rewards, ends and infos
    are those of the single environment from the same state and actions; but as every control step
    begins without the forces that held the last one, a body that touches another, or the end of
    its joint, agrees to about 1e-6.

    An episode that ends is followed by the next in the same step, its last observation and info
    in `infos["final_obs"]` and `infos["final_info"]`; or, with autoreset disabled, when
    requested by `reset(options={"reset_mask": mask})`.

    A copy, deep or by pickle, goes on as the environment itself would.

    Args:
        task: Class of the task, or another callable that makes one.
        num_envs: Number of environments.
        max_episode_steps: Control steps after which an episode is truncated; None for never.
        autoreset_mode: Same-step or disabled, as Gymnasium has it or in its words.
        **env_kwargs: Arguments of the task.

    Raises:
        ValueError: If `num_envs` or the length is no whole number of at least one, or the mode is
            another.
    """

    def __init__(
        self,
        task: Callable[..., MujocoTask],
        num_envs: int,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **env_kwargs: Any,
    ) -> None:
        self.num_envs = num_envs = check_count("num_envs", num_envs)
        self._max_episode_steps: float = np.inf
        if max_episode_steps is not None:
            self._max_episode_steps = check_count("max_episode_steps", max_episode_steps)
        self._autoreset_mode = _find_autoreset_mode(autoreset_mode)
        self._task = task(**env_kwargs)
        self.metadata = {**self._task.metadata, "autoreset_mode": self._autoreset_mode}
        self.single_observation_space = self._task.observation_space
        self.single_action_space = self._task.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators = [np.random.default_rng() for _ in range(num_envs)]
        self._all_envs = np.ones(num_envs, dtype=bool)
        self._has_begun = np.zeros(num_envs, dtype=bool)
        self._elapsed = np.zeros(num_envs, dtype=int)
        self._allocate()
        self._look_at_arrays()

    def _allocate(self) -> None:
        """Allocate the arrays that MuJoCo reads and writes."""
        model, num_steps = self._task.model, self._task.num_physics_steps
        state_dim = mujoco.mj_stateSize(model, STATE)
        control_dim = mujoco.mj_stateSize(model, CONTROL)
        self._models = [model] * self.num_envs
        self._state = np.zeros((self.num_envs, state_dim))  # time, qpos, qvel
        self._states = np.zeros((self.num_envs, num_steps, state_dim))
        self._control = np.zeros((self.num_envs, num_steps, control_dim))  # ctrl, mocap_pos
        self._userdata = np.zeros((self.num_envs, model.nuserdata))  # MuJoCo does not change it

    def _look_at_arrays(self) -> None:
        """Let MuJoCo and the batched view of the task use the arrays of this object."""
        model = self._task.model
        self._rollout = Rollout(nthread=0)
        self._batched_task = self._task.batched_view(
            self._state[:, 1 : 1 + model.nq],
            self._state[:, 1 + model.nq : 1 + model.nq + model.nv],
            self._control[:, 0, model.nu :].reshape(self.num_envs, model.nmocap, 3),
            self._userdata,
        )

    def __getstate__(self) -> dict[str, Any]:
        state = self.__dict__ | {"success_streak": self._batched_task.success_streak}
        del state["_rollout"], state["_batched_task"]  # which a copy makes anew
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        success_streak = state.pop("success_streak")
        self.__dict__.update(state)
        self._look_at_arrays()
        self._batched_task.success_streak = success_streak

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array32, dict[str, Any]]:
        """Start an episode in every environment, or in those of `options["reset_mask"]`.

        Raises:
            ValueError: If the number of seeds or the shape of the mask does not match `num_envs`.
        """
        mask = np.asarray((options or {}).get("reset_mask", self._all_envs))
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise ValueError(
                f"`reset_mask` must hold {self.num_envs} booleans, got {mask.dtype} {mask.shape}."
            )
        if seed is None or isinstance(seed, int):
            seed = [None if seed is None else seed + index for index in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"`seed` must have {self.num_envs} entries, got {len(seed)}.")
        for index in np.flatnonzero(mask).tolist():
            self._begin_episode(index, seed[index])
        self._batched_task.success_streak.reset(mask)
        self._has_begun |= mask
        self._elapsed[mask] = 0
        return self._batched_task.observe(), _masked(self._batched_task.get_info(), mask)

    def step(self, actions: Array32) -> tuple[Array32, Array64, Array, Array, dict[str, Any]]:
        """Hold the actions for one control step.

        Raises:
            ResetNeeded: If an environment has never been reset.
            ValueError: If the actions hold no real numbers, have another shape than the space, or
                are not finite.
        """
        if not self._has_begun.all():
            waiting = np.flatnonzero(~self._has_begun).tolist()
            raise ResetNeeded(
                f"`reset` must come before `step`, got none in environments {waiting}."
            )
        control = check_action(actions, self.action_space)
        self._simulate(control)
        self._elapsed += 1
        observation, reward, terminated, info = self._batched_task._finish_step(control)
        truncated = self._elapsed >= self._max_episode_steps
        infos = _masked(info, self._all_envs)
        done = terminated | truncated
        if done.any() and self._autoreset_mode is AutoresetMode.SAME_STEP:
            final = _final(observation, info, done)
            observation, _ = self.reset(options={"reset_mask": done})
            infos = _masked(self._batched_task.get_info(), self._all_envs) | final
        return observation, reward, terminated, truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        """Free the resources of MuJoCo."""
        self._rollout.close()
        self._task.close()

    def _simulate(self, control: Array64) -> None:
        self._control[:, :, : control.shape[1]] = control[:, None]
        with clock_stopped():
            self._rollout.rollout(
                self._models,
                [self._task.data],
                self._state,
                self._control,
                control_spec=CONTROL,
                skip_checks=True,
                nstep=self._task.num_physics_steps,
                state=self._states,
            )
        self._state[:] = self._states[:, -1]

    def _begin_episode(self, index: int, seed: int | None) -> None:
        """Reset the single task with this environment's random stream, and copy its state."""
        task = self._task
        task.np_random = self._generators[index]
        task.reset(seed=seed)
        self._generators[index] = task.np_random
        mujoco.mj_getState(task.model, task.data, self._state[index], STATE)
        self._control[index, :, task.model.nu :] = task.mocap_pos.ravel()
        self._userdata[index] = task.userdata


def _find_autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    for known in AUTORESET_MODES:
        if mode in (known, known.value):
            return known
    words = " or ".join(repr(known.value) for known in AUTORESET_MODES)
    raise ValueError(f"`autoreset_mode` must be {words}, got {mode!r}.")


def _masked(info: dict[str, Array], mask: Array) -> dict[str, Array]:
    """Infos as Gymnasium batches them: zero outside the mask, with the mask beside every entry."""
    return {name: value * mask for name, value in info.items()} | {
        f"_{name}": mask.copy() for name in info
    }


def _final(observation: Array32, info: dict[str, Array], done: Array) -> dict[str, Any]:
    """Final observations and infos of the episodes that are done."""
    final_obs = np.full(len(done), None, dtype=object)
    for index in np.flatnonzero(done):
        final_obs[index] = observation[index]
    final = {"final_obs": final_obs, "final_info": _masked(info, done)}
    return final | {f"_{name}": done.copy() for name in final}
