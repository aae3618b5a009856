"""A bonus on data that do not change: whether it is what its text says."""

from copy import deepcopy
from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor

from deep_curiosity import __version__
from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.config import CuriosityConfig
from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.bonuses.learner import BonusLearner
from deep_curiosity.experiments.runs import changed_settings
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.parts import make_run_bonus
from deep_curiosity.training.source import source_commit
from deep_curiosity.transitions import Transition

if TYPE_CHECKING:
    from deep_curiosity.experiments.study import Cell, Result, Row
    from deep_curiosity.training.config import Config

NUM_DRAWS = 10  # of all components, to see how much of D is which were drawn
NUM_JUDGED = 512  # rows whose D is compared between draws


def run_on_fixed_data(cell: "Cell") -> "Result":
    """Let a bonus learn from uniform actions, and measure it over all data.

    A row holds mean and standard deviation of the bonus in units of its weight; and, of curiosity,
    the share of D's variance that is the draw of the marginal's components.
    """
    from deep_curiosity.experiments.study import Result

    config = cell.config
    torch.set_num_threads(1)
    torch.manual_seed(config.run.seed)
    replay = collect_uniformly(config)
    data = replay.all()
    bonus = make_run_bonus(config, replay.observation_dim, replay.action_dim)
    assert bonus is not None
    learner, rows = BonusLearner(bonus), []
    for update in range(1, config.run.total_steps + 1):
        learner.learn(replay.sample(config.run.batch_size))
        if update % config.run.evaluation_interval == 0:
            rows.append({"updates": update} | measure_bonus(bonus, data, config))
    origin = {
        "version": __version__,
        "commit": source_commit(),
        "settings": changed_settings(config),
    }
    return Result(rows, [], origin)


def collect_uniformly(config: "Config") -> ReplayBuffer:
    """As much as replay holds, under uniform actions."""
    environment = make_environment(config.environment)
    sizes = environment.observation_space.shape[0], environment.action_space.shape[0]  # type: ignore[index]
    replay = ReplayBuffer(config.run.replay_capacity, *sizes, seed=config.run.seed)
    environment.action_space.seed(config.run.seed)
    observation, _ = environment.reset(seed=config.run.seed)
    for _ in range(config.run.replay_capacity):
        action = environment.action_space.sample()
        next_observation, reward, terminated, truncated, _ = environment.step(action)
        replay.add(observation, action, float(reward), next_observation, terminated, truncated)
        observation = environment.reset()[0] if terminated or truncated else next_observation
    return replay


@torch.no_grad()
def measure_bonus(bonus: Bonus, data: Transition, config: "Config") -> "Row":
    """Mean and standard deviation over data, in units of the weight, and the share of the draw."""
    observation, action, _, next_observation, *_ = data
    weight = getattr(config.bonus, "weight", 1.0)
    value = bonus(observation, action, next_observation) / weight
    row = {"bonus_mean": value.mean().item(), "bonus_std": value.std().item()}
    if config.bonus.kind == CuriosityConfig.kind:
        row["draw_share"] = draw_share(cast(CuriosityBonus, bonus), observation, action)
    return row


def draw_share(bonus: CuriosityBonus, observation: Tensor, action: Tensor) -> float:
    """Share of D's variance that is which states were drawn for components, 0 to 1."""
    judged = torch.randint(len(observation), (NUM_JUDGED,))
    bonus = deepcopy(bonus)
    components, draws = len(bonus.marginal.loc), []
    for _ in range(NUM_DRAWS):
        drawn = torch.randint(len(observation), (components,))
        predicted = bonus.dynamics.round_robin(observation[drawn], action[drawn])
        bonus.marginal.replace(predicted.loc[0, :, 0], predicted.log_var[0, :, 0])
        nats = bonus.nats(observation[judged], action[judged])
        draws.append(nats - nats.mean())
    stacked = torch.stack(draws)
    of_draw = stacked.var(0).mean()
    of_world = (stacked.mean(0).var() - of_draw / NUM_DRAWS).clamp(min=0.0)
    return (of_draw / (of_draw + of_world)).item()
