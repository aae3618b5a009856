"""The policy in NumPy, for one observation at a time.

Between two updates torch's small products find cold caches: NumPy answers in a quarter of the
time. What it gains is measured in the benchmark's section on switches.
"""

import numpy as np
from jaxtyping import Float32

from deep_curiosity.agent.networks import GaussianPolicy, in_log_std_range
from deep_curiosity.nn.statistics import InputScaling


class NumpyPolicy:
    """A policy of one Gaussian on NumPy views of its weights, which follow updates made in place.

    Args:
        policy: On the CPU, of one mixture component.
        scaling: What brings observations to a size; left out where they are seen as they are.
        number: Which of the policies, where several are stacked; by default the last.

    Raises:
        ValueError: If the policy has several components.
    """

    def __init__(
        self, policy: GaussianPolicy, number: int = -1, *, scaling: InputScaling | None = None
    ) -> None:
        if policy.mixture_components != 1:
            raise ValueError(
                f"`policy` must have one mixture component, got {policy.mixture_components}."
            )
        self._layers = [
            (weight.detach()[number].numpy(), bias.detach()[number, 0].numpy())
            for weight, bias in (layer.parameters() for layer in policy.network.layers)
        ]
        units = None if scaling is None else (scaling.gain.numpy(), scaling.bound.numpy())
        self._units: tuple[np.ndarray, np.ndarray] | None = units
        self._outputs = [np.empty_like(bias) for _, bias in self._layers]

    def act(
        self, observation: Float32[np.ndarray, " observation_dim"], noise: np.ndarray
    ) -> Float32[np.ndarray, " action_dim"]:
        """Action in [-1, 1] for standard normal `noise`, one number for each action dimension."""
        loc, scale = self._gaussian(observation)
        log_std = in_log_std_range(np.tanh(scale))
        action: np.ndarray = np.tanh(loc + np.exp(log_std) * noise)
        return action

    def center(
        self, observation: Float32[np.ndarray, " observation_dim"]
    ) -> Float32[np.ndarray, " action_dim"]:
        """Action in [-1, 1] at the centre of the policy."""
        loc, _ = self._gaussian(observation)
        action: np.ndarray = np.tanh(loc)
        return action

    def _gaussian(
        self, observation: Float32[np.ndarray, " observation_dim"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Centre, and what its width is made of, both until the next call."""
        value = entered = self._scale(observation)
        for (weight, bias), output in zip(self._layers, self._outputs, strict=True):
            if value is not entered:
                np.maximum(value, 0, out=value)
            value = np.dot(value, weight, out=output)
            value += bias
        action_dim = len(value) // 2
        return value[:action_dim], value[action_dim:]

    def _scale(
        self, observation: Float32[np.ndarray, " observation_dim"]
    ) -> Float32[np.ndarray, " observation_dim"]:
        """The observation as the networks see it; a hunger behind it is left as it is."""
        if self._units is None:
            return observation
        gain, bound = self._units
        scaled = (gain * observation[: len(gain)]).clip(-bound, bound)
        return np.concatenate([scaled, observation[len(gain) :]])
