"""Curiosity for the agents of Stable-Baselines3: a buffer class to hand in, and a callback."""
# ruff: noqa: E402

from deep_curiosity.requirements import require, warn_if_untested

# before the library is imported for the first time, below
require("stable_baselines3", extra="sb3")
warn_if_untested("stable_baselines3", lowest="2.7", below="3")

from deep_curiosity.integrations.stable_baselines3.callback import CuriosityCallback
from deep_curiosity.integrations.stable_baselines3.hindsight import CuriousHerReplayBuffer
from deep_curiosity.integrations.stable_baselines3.integration import (
    StableBaselinesIntegration,
    StableBaselinesOnPolicyIntegration,
)
from deep_curiosity.integrations.stable_baselines3.replay import (
    CuriousDictReplayBuffer,
    CuriousNStepReplayBuffer,
    CuriousReplayBuffer,
)
from deep_curiosity.integrations.stable_baselines3.rollout import (
    CuriousDictRolloutBuffer,
    CuriousRolloutBuffer,
)

__all__ = [
    "CuriosityCallback",
    "CuriousDictReplayBuffer",
    "CuriousDictRolloutBuffer",
    "CuriousHerReplayBuffer",
    "CuriousNStepReplayBuffer",
    "CuriousReplayBuffer",
    "CuriousRolloutBuffer",
    "StableBaselinesIntegration",
    "StableBaselinesOnPolicyIntegration",
]
