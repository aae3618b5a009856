"""Agent and bonus of a run, made from its settings."""

from deep_curiosity.agent.sac import CuriousSAC
from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.config import BonusConfig
from deep_curiosity.training.config import Config
from deep_curiosity.training.spaces import DESIRED_GOAL, TaskSpaces


def make_agent(config: Config, observation_dim: int, action_dim: int) -> CuriousSAC:
    """Agent of a run."""
    curiosity = config.bonus.kind != "none"
    return CuriousSAC(observation_dim, action_dim, config.agent, curiosity=curiosity)


def make_run_bonus(
    config: Config, observation_dim: int, action_dim: int, spaces: TaskSpaces | None = None
) -> Bonus | None:
    """Bonus of a run, or `None` for plain soft actor-critic.

    With a frame stack, curiosity is by default about the two newest observations. Two, since a
    speed is in their difference; what is older, and the actions, tell little of where an action
    leads. Entries that are chosen are those of the newest one, unless they are of the window. With
    goals in hindsight it is by default about all but the goal that is desired.

    Raises:
        ValueError: If the spaces of the task are missing, of a run with goals in hindsight, or an
            entry is none.
    """
    bonus, stack = config.bonus, config.environment.frame_stack
    if stack > 1:
        size = (observation_dim - (stack - 1) * action_dim) // stack
        before = size + action_dim
        bonus = bonus.about_newest(size).about((*range(-before - size, -before), *range(-size, 0)))
    if config.run.hindsight is not None:
        bonus = _about_no_goal(bonus, observation_dim, spaces)
    hidden_dims = (config.agent.hidden_dim, config.agent.hidden_dim)
    return bonus.make(observation_dim, action_dim, hidden_dims)


def _about_no_goal(
    bonus: BonusConfig, observation_dim: int, spaces: TaskSpaces | None
) -> BonusConfig:
    if spaces is None:
        raise ValueError("`spaces` must be those of the task where `hindsight` is set, got None.")
    goal = spaces.places(DESIRED_GOAL)
    return bonus.about(tuple(place for place in range(observation_dim) if place not in goal))
