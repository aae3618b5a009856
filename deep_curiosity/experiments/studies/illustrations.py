"""The deep agent on the paper's two illustrations, without reward, beside the exact solutions."""

import numpy as np
import torch

from deep_curiosity.experiments.study import Row, Study, Task
from deep_curiosity.tabular.environments import reliable_unreliable
from deep_curiosity.tabular.solvers import solve_stationary
from deep_curiosity.training.config import Config
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.playback import load_agent

NUM_SAMPLES = 20_000  # actions sampled in each state to know the policy by
MARGIN = 0.1  # of an end of the paper's actions in [0, 1]
FAR_SIGHTED = 0.97
CURIOUS = Config.of(
    "exact",
    refresh_interval=2,
    total_steps=8_000,
    hunger=0.0,
    curiosity_coefficient=1.0,
    policy_mixture_components=2,
    model_mixture_components=2,
    num_members=2,
    hidden_dim=64,
    temperature="constant:0.03",
    learning_rate=2e-3,
    model_learning_rate=3e-3,
    components=512,
    learning_starts=1_000,
    replay_capacity=4_000,
    evaluation_interval=8_000,
    evaluation_episodes=1,
    checkpoint_interval=8_000,
    log_interval=1_000,
)
CLEVER = CURIOUS.override(env_id="CleverRandom", curiosity_discount=0.0)
RELIABLE = CURIOUS.override(env_id="ReliableUnreliable")
LONGER = {"replay_capacity": 20_000, "learning_rate": 3e-3, "total_steps": 10_000}


def measure_policy(config: Config, summary: Row) -> list[Row]:
    """Where the mass of the policy lies in both states, in the paper's [0, 1], and the exact one.

    `near_0` and `near_1` are of state 0, `extreme` is the smaller of both states.
    """
    environment = make_environment(config.environment)
    agent = load_agent(config.run.out, config, environment)
    torch.manual_seed(config.run.seed)
    actions = np.stack(
        [
            0.5 * (1 + agent.act(torch.full((NUM_SAMPLES, 1), state)).squeeze(-1).numpy())
            for state in (0.0, 1.0)
        ]
    )
    near_0, near_1 = (actions < MARGIN).mean(1), (actions > 1 - MARGIN).mean(1)
    return [
        {
            "near_0": float(near_0[0]),
            "near_1": float(near_1[0]),
            "extreme": float((near_0 + near_1).min()),
            "pi_stay": 1 - float(actions[0].mean()),
            "exact_pi_stay": exact_pi_stay(config.agent.curiosity.discount),
        }
    ]


def exact_pi_stay(curiosity_discount: float) -> float:
    """`pi(STAY|0)` of the exact solution of the reliable illustration."""
    solution = solve_stationary(
        reliable_unreliable(), temperature=0.05, curiosity_discount=curiosity_discount
    )
    return float(solution.policy[0, 0])


STUDIES = {
    "clever_random": Study(
        [Task("clever random", CLEVER)],
        {"uniform prior": {"prior": "uniform"} | LONGER, "learned prior": {}},
        columns=("extreme", "near_0", "near_1"),
        measure=measure_policy,
    ),
    "reliable": Study(
        [Task("reliable", RELIABLE)],
        {
            "one step": {"curiosity_discount": 0.0},
            "far-sighted": {"curiosity_discount": FAR_SIGHTED},
        },
        columns=("pi_stay", "exact_pi_stay"),
        measure=measure_policy,
    ),
}
