"""What an adapter costs beyond calling the bonus directly, against a training step."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require

require("stable_baselines3", extra="sb3")
require("torchrl", extra="torchrl")

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import gymnasium
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import configure
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import DoubleToFloat, EnvBase, GymEnv, TransformedEnv
from torchrl.modules import (
    MLP,
    NormalParamExtractor,
    ProbabilisticActor,
    TanhNormal,
    ValueOperator,
)
from torchrl.objectives import SACLoss, SoftUpdate

from deep_curiosity.benchmark.agents import ACTION_DIM, OBSERVATION_DIM, Row
from deep_curiosity.benchmark.costs import alternate
from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.bonuses.learner import BonusLearner
from deep_curiosity.integrations.stable_baselines3 import CuriousReplayBuffer
from deep_curiosity.integrations.torchrl import CuriosityTransform
from deep_curiosity.transitions import Transition

BATCH_SIZE = 256
HIDDEN_DIMS = (256, 256)
NUM_STEPS = 1_000  # in replay
Calls = Mapping[str, Callable[[], Any]]


def measure_adapters(env_id: str, *, repeats: int, calls: int) -> list[Row]:
    """Milliseconds of a sample through each adapter, and of the same without it, call by call.

    Args:
        env_id: Task with the sizes of the benchmark.
        repeats: Rounds of measurement.
        calls: Calls of each adapter's every function in a round.

    Returns:
        Rows with `curious_ms`, a sample that carries the bonus; `plain_ms`, the library's own
        sample; `direct_ms`, the bonus trained and computed on a batch at hand; and `step_ms`, a
        whole training step with its curious sample.
    """
    adapters = {"Stable-Baselines3": stable_baselines(env_id), "torchrl": torchrl(env_id)}
    return [
        {"adapter": name, "repeat": repeat} | alternate(functions, calls)
        for repeat in range(repeats)
        for name, functions in adapters.items()
    ]


def stable_baselines(env_id: str) -> Calls:
    """What is timed of a training step of Stable-Baselines3's soft actor-critic."""
    environment = gymnasium.make(env_id)
    agent = SAC(
        "MlpPolicy",
        environment,
        learning_starts=NUM_STEPS,
        replay_buffer_class=CuriousReplayBuffer,
        replay_buffer_kwargs={"bonus": curiosity()},
        seed=0,
        device="cpu",
    )
    agent.learn(NUM_STEPS)
    agent.set_logger(configure(format_strings=[]))
    buffer = agent.replay_buffer
    assert isinstance(buffer, CuriousReplayBuffer)
    rows = torch.arange(BATCH_SIZE).numpy()
    return {
        "curious_ms": partial(buffer.sample, BATCH_SIZE),
        "plain_ms": partial(plain_copy(buffer).sample, BATCH_SIZE),
        "direct_ms": directly(buffer.transition(rows, 0 * rows)),
        "step_ms": partial(agent.train, gradient_steps=1, batch_size=BATCH_SIZE),
    }


def torchrl(env_id: str) -> Calls:
    """What is timed of a training step of torchrl's soft actor-critic."""
    environment = TransformedEnv(GymEnv(env_id), DoubleToFloat())
    torch.manual_seed(0)
    held = environment.rollout(NUM_STEPS, break_when_any_done=False)
    transform = CuriosityTransform(
        BonusLearner(curiosity()), add_to_reward=True, action_spec=environment.action_spec
    )
    curious, plain = replay_of(held), replay_of(held)
    curious.append_transform(transform)
    return {
        "curious_ms": curious.sample,
        "plain_ms": plain.sample,
        "direct_ms": directly(transform.reader.read(plain.sample())),
        "step_ms": partial(learn, *torchrl_agent(environment), curious),
    }


def torchrl_agent(environment: EnvBase) -> tuple[SACLoss, SoftUpdate, torch.optim.Optimizer]:
    """Soft actor-critic of torchrl with two layers of 256."""
    network = nn.Sequential(
        MLP(OBSERVATION_DIM, 2 * ACTION_DIM, num_cells=HIDDEN_DIMS, activation_class=nn.ReLU),
        NormalParamExtractor(),
    )
    actor = ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=environment.action_spec,
        distribution_class=TanhNormal,
    )
    critic = ValueOperator(
        MLP(OBSERVATION_DIM + ACTION_DIM, 1, num_cells=HIDDEN_DIMS, activation_class=nn.ReLU),
        in_keys=["observation", "action"],
    )
    loss = SACLoss(actor, critic, loss_function="l2")
    loss.make_value_estimator(gamma=0.99)
    return loss, SoftUpdate(loss, tau=0.005), torch.optim.Adam(loss.parameters(), lr=3e-4)


def learn(
    loss: SACLoss,
    target: SoftUpdate,
    optimizer: torch.optim.Optimizer,
    replay: TensorDictReplayBuffer,
) -> None:
    """One training step of torchrl's soft actor-critic."""
    losses = loss(replay.sample())
    optimizer.zero_grad()
    (losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]).backward()
    optimizer.step()
    target.step()


def replay_of(held: TensorDictBase) -> TensorDictReplayBuffer:
    """A replay buffer of torchrl that holds these steps."""
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(len(held)), batch_size=BATCH_SIZE)
    buffer.extend(held)
    return buffer


def curiosity() -> CuriosityBonus:
    """The default bonus in the sizes of the benchmark."""
    return CuriosityBonus.default(OBSERVATION_DIM, ACTION_DIM)


def directly(transition: Transition) -> Callable[[], Tensor]:
    """The bonus in a loop of one's own: trained and computed on a batch at hand."""
    learner = BonusLearner(curiosity())

    def compute() -> Tensor:
        learner.learn(transition)
        return learner.compute(transition)

    return compute


def plain_copy(curious: ReplayBuffer) -> ReplayBuffer:
    """The library's own buffer with the same contents."""
    plain = ReplayBuffer(
        curious.buffer_size, curious.observation_space, curious.action_space, device="cpu"
    )
    shared = vars(plain).keys() & vars(curious).keys()
    vars(plain).update({name: vars(curious)[name] for name in shared})
    return plain
