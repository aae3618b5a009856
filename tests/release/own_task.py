"""A task of a user's own, registered by the module that has it."""

import gymnasium
import numpy as np


class Corridor(gymnasium.Env):
    """Go right for two metres, at most 2 cm a step; the only reward is at the end."""

    observation_space = gymnasium.spaces.Dict(
        {
            "place": gymnasium.spaces.Box(-3, 3, (1,), np.float64),
            "speed": gymnasium.spaces.Box(-2, 2, (1,), np.float64),
        }
    )
    action_space = gymnasium.spaces.Box(-2, 2, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        """Begin at the left, more or less."""
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-0.1, 0.1, 1)
        return self.observe(np.zeros(1)), {}

    def step(self, action):
        """Move."""
        self.place = np.clip(self.place + 0.01 * np.asarray(action, np.float64), -3, 3)
        reached = bool(self.place[0] > 2)
        return self.observe(action), float(reached), reached, False, {"is_success": reached}

    def observe(self, action):
        """Place in metres, and the newest action."""
        return {"place": self.place.copy(), "speed": np.asarray(action, np.float64)}


gymnasium.register("Corridor-v0", Corridor, max_episode_steps=200)
