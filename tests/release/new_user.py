"""What a new user's program does: trains on a task of its own, and uses what was learned."""

import sys

import numpy as np
import onnxruntime
from own_task import Corridor

import deep_curiosity as dc

steps = int(sys.argv[1])
run = dc.train(
    make_env=Corridor,
    max_episode_steps=200,
    total_steps=steps,
    learning_starts=300,
    hidden_dim=32,
    evaluation_episodes=1,
    out="runs/python",
)
environment = Corridor()
observation, _ = environment.reset(seed=0)
policy = dc.load("runs/python")
action, _ = policy.predict(observation)
assert environment.action_space.contains(action), action
observation, *_ = environment.step(action)
print("next place", run.model.predict(observation, action))

exported = dc.load("runs/own0")
session = onnxruntime.InferenceSession("own.onnx")
vectors = np.random.default_rng(0).normal(size=(5, 2)).astype(np.float32)
(actions,) = session.run(None, {"observation": vectors})
expected, _ = exported.predict({"place": vectors[:, :1], "speed": vectors[:, 1:]})
np.testing.assert_allclose(actions, expected, atol=1e-6)
print("the exported policy acts as the run's own")
