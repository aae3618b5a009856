"""Texts and tables of the page that the benchmark writes, section by section."""

from collections.abc import Sequence
from pathlib import Path

from deep_curiosity.benchmark.agents import ACTION_DIM, NUM_FILLED, OBSERVATION_DIM, Row
from deep_curiosity.benchmark.own_agent import STAGES
from deep_curiosity.benchmark.peers import ADDRESSES
from deep_curiosity.benchmark.switches import ALL_ON
from deep_curiosity.benchmark.tables import (
    grouped,
    median,
    rate_over,
    ratio,
    read_rows,
    size_name,
    slope,
    summarize,
)
from deep_curiosity.bonuses.config import CuriosityConfig
from deep_curiosity.experiments.tables import markdown_table
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.training.config import PRESETS

AS_USED, SAME_PRECISION = "Stable-Baselines3", "Stable-Baselines3, our precision"
"""Stable-Baselines3 as its users run it, and with our precision of matrix products."""
STAGES_TEXT = """\
Milliseconds of each stage of a step and its update (medians). Acting begins with setting the
agent's hunger. The update is sampling, statistics and learning. Statistics include the marginal,
which is not renewed at every update: a mean. Learning is one graph where compiled; models and
agent can be told apart only where it is not."""
FLOOR_TEXT = """\
The floor is the time of the update's matrix products, counted from the sizes of the layers
(`deep_curiosity/benchmark/operations.py`), at the rate of a batched product of four matrices of
256 x 256, measured in the same process after every round by `torch.bmm`. A graph has fewer of them
than the same update uncompiled: there one pass serves the models' learning and the bonus. And it
calls the kernel itself (`deep_curiosity/speed/matmul.py`)."""


def agents_section(out: Path) -> str:
    """Rates, ratios and memory; the stages of a step; the floor."""
    rows = read_rows(out / "agents.csv")
    processes = {row["runner"]: row for row in read_rows(out / "processes.csv")}
    return f"""## Agents

HalfCheetah-v5, batch 256, two layers of 256, one update for every environment step, {NUM_FILLED}
transitions in replay. Every runner has a process of its own, and only one computes at a time.
Stable-Baselines3's SAC (SB3) is taken as its users run it, with torch's own precision of matrix
products, and with the precision that ours runs with; SBX's (JAX) and MaxInfoRL's are beside it
where they are installed (`deep_curiosity/benchmark/peers.py`). "Curious" is the default with the
learned prior. By default the policy learns from every second transition of a batch, where it
maximises one of reward's two critics, each transition trains one model and its bonus comes from
one model, and the marginal is renewed at every {CuriosityConfig.refresh_interval}th update.
"Exact" is the preset of that name: policy and models learn from all transitions, the policy
maximises the smaller of two critics, as that of SB3 does, every bonus is the mean of all models,
and the marginal is renewed at every {PRESETS["exact"]["refresh_interval"]}th update. The
first update is counted from the start of the process, imports and cold compilation included;
memory is the largest resident memory of the process. A million transitions of replay take
{replay_megabytes():.0f} MB.

![Environment steps per second](agents.png)

{rates_table(rows, processes)}

{STAGES_TEXT}

{stages_table(rows)}

{FLOOR_TEXT}

{floor_table(rows)}
"""


def narrow_section(out: Path) -> str:
    """The same of narrow networks."""
    rows = read_rows(out / "narrow.csv")
    processes = {row["runner"]: row for row in read_rows(out / "narrow_processes.csv")}
    return f"""## Narrow networks

The same agents with two layers of 64 (`--hidden-dim 64`), as for tasks of few dimensions. Matrix
products are a smaller part of these updates, and what lies around them is a larger one.

![Environment steps per second](narrow.png)

{rates_table(rows, processes)}

{stages_table(rows)}

{floor_table(rows)}
"""


def rates_table(rows: Sequence[Row], processes: dict[str, Row]) -> str:
    """Steps per second, ratios to other libraries' agents, time to the first update, memory."""
    groups = {str(name): own for (name,), own in grouped(rows, "runner").items()}
    references = {"SB3": AS_USED, "SB3, our precision": SAME_PRECISION} | {
        name: name for name in groups if name.startswith(tuple(ADDRESSES))
    }
    lines = []
    for name, own in groups.items():
        process = processes[name]
        ratios = [
            summarize(own, rate_over(rows, reference)) if reference in groups else ""
            for reference in references.values()
        ]
        lines.append(
            [
                name,
                summarize(own, "steps_per_second"),
                *ratios,
                f"{process['first_update_seconds']:.1f}",
                f"{process['peak_megabytes']:.0f}",
            ]
        )
    header = ["agent", "steps per second", *(f"to {name}" for name in references)]
    return markdown_table([*header, "first update, s", "peak MB"], lines)


def stages_table(rows: Sequence[Row]) -> str:
    """Medians of the stages of a step."""
    columns = [*STAGES, "models", "agent", "update"]
    lines = []
    for (name,), own in grouped(_ours(rows), "runner").items():
        if own[0]["agent_ms"] != "":
            own = [row | {"models_ms": row["learning_ms"] - row["agent_ms"]} for row in own]
        known = [column for column in columns if own[0].get(f"{column}_ms", "") != ""]
        medians = {column: f"{median(own, f'{column}_ms'):.3f}" for column in known}
        lines.append([str(name), *(medians.get(column, "") for column in columns)])
    header = ["agent", *STAGES, "of it models", "of it agent", "whole update"]
    return markdown_table(header, lines)


def floor_table(rows: Sequence[Row]) -> str:
    """Operations, rate, floor, and how far above it an update is."""
    lines = [
        [
            str(name),
            f"{median(own, 'gigaflop'):.3f}",
            summarize(own, "gigaflop_per_second"),
            summarize(own, "floor_ms"),
            summarize(own, "update_ms"),
            summarize(own, ratio("update_ms", "floor_ms")),
        ]
        for (name,), own in grouped(_ours(rows), "runner").items()
    ]
    header = ["agent", "GFLOP", "GFLOP/s", "floor, ms", "update, ms", "update / floor"]
    return markdown_table(header, lines)


def switches_section(out: Path) -> str:
    """Steps per second without each optimisation."""
    rows = read_rows(out / "switches.csv")
    lines = []
    for (agent,), own in grouped(rows, "agent").items():
        share = rate_over(own, ALL_ON, column="switched_off")
        for (name,), same in grouped(own, "switched_off").items():
            gains = summarize([{"gain": 1 / share(row)} for row in same], "gain")
            lines.append([str(agent), str(name), summarize(same, "steps_per_second"), gains])
    header = ["agent", "switched off", "steps per second", "gain"]
    return f"""## Switches

Environment steps per second of the compiled agents as above with one setting of `SpeedConfig`
(`deep_curiosity/speed/config.py`) switched off at a time; the gain is the rate with all of them on
over that. `direct_matmul` and `deduplicate` act in compiled updates only: switching `compile` off
switches them off as well.

![Environment steps per second with each switch off](switches.png)

{markdown_table(header, lines)}
"""


def bonus_section(out: Path) -> str:
    """The bonus against the ensemble."""
    rows = read_rows(out / "bonus.csv")
    lines = [
        [
            str(how),
            f"{components:.0f}",
            summarize(own, "ensemble_ms"),
            summarize(own, "bonus_ms"),
            summarize(own, ratio("bonus_ms", "ensemble_ms")),
            summarize(own, ratio("round_robin_ms", "ensemble_ms")),
            f"{own[0]['megabytes']:.1f}" if own[0]["megabytes"] != "" else "",
        ]
        for (how, components), own in grouped(rows, "how", "components").items()
    ]
    header = [
        "",
        "components",
        "ensemble, ms",
        "full bonus, ms",
        "full bonus / ensemble",
        "one model a pair / ensemble",
        "full bonus, MB",
    ]
    return f"""## Bonus

256 pairs at {OBSERVATION_DIM} dimensions, 5 models, no gradient: the full bonus, which includes
the ensemble's pass, against that pass alone; and the bonus from one model for each pair, as the
default agent computes it. Memory is the most that tensors of one call take at a time.

![Time and memory of the bonus](bonus.png)

{markdown_table(header, lines)}
"""


def growth_section(out: Path) -> str:
    """How an update grows."""
    rows = read_rows(out / "scaling.csv")
    lines = []
    for (size,), own in grouped(rows, "size").items():
        costs = {
            float(str(v)): median(same, "update_ms")
            for (v,), same in grouped(own, "value").items()
        }
        values, middle = list(costs), list(costs.values())
        shown = ", ".join(f"{value:.0f}: {cost:.3g}" for value, cost in costs.items())
        last = slope(values[-2:], middle[-2:])
        lines.append([size_name(str(size)), shown, f"{slope(values, middle):.2f}", f"{last:.2f}"])
    return f"""## Scaling

Milliseconds of one eager update of the curious agent with the learned prior (medians), as one size
grows and the others are those above; and the slope on logarithmic axes, through all points and of
the last two.

![Cost against size](scaling.png)

{markdown_table(["size", "ms of an update", "slope", "last slope"], lines)}
"""


def vector_section(out: Path) -> str:
    """Native against Gymnasium's vector environment."""
    rows = read_rows(out / "vector.csv")
    lines = [
        [
            str(task),
            f"{num:.0f}",
            summarize(own, lambda row: row["native_steps_per_second"] / 1e3),
            summarize(own, lambda row: row["sync_steps_per_second"] / 1e3),
            summarize(own, ratio("native_steps_per_second", "sync_steps_per_second")),
        ]
        for (task, num), own in grouped(rows, "task", "num_envs").items()
    ]
    header = ["task", "environments", "native", "SyncVectorEnv", "ratio"]
    return f"""## Vector environments

Thousands of environment steps per second, of all environments together under random actions, in
one call of MuJoCo and one by one in Gymnasium's `SyncVectorEnv`; both reset an environment in the
step in which its episode ends.

![Steps per second against environments](vector.png)

{markdown_table(header, lines)}
"""


def slow_section(out: Path) -> str:
    """A task whose step waits, in processes and one after another."""
    rows = read_rows(out / "slow.csv")
    lines = [
        [
            f"{sleep:g}",
            f"{num:.0f}",
            summarize(own, "async_steps_per_second"),
            summarize(own, "sync_steps_per_second"),
            summarize(own, ratio("async_steps_per_second", "sync_steps_per_second")),
        ]
        for (sleep, num), own in grouped(rows, "sleep_ms", "num_envs").items()
    ]
    header = ["a step sleeps, ms", "environments", "a process each", "one by one", "ratio"]
    return f"""## Slow environments

Environment steps per second, of all environments together under random actions, of a task whose
step sleeps before it is taken: `--vectorization async` beside `sync`, as runs have them. No agent
learns meanwhile. What is missing to a step for every sleep is the way to a process and back, and
whatever else the machine does. What sleeps needs no core, so there may be more processes than
cores; a simulator that computes gains up to the number of cores.

![Steps per second against environments](slow.png)

{markdown_table(header, lines)}
"""


def adapters_section(out: Path) -> str:
    """What adapters add to the bonus itself."""
    rows = read_rows(out / "adapters.csv")

    def overhead(row: Row) -> float:
        return 100 * (row["curious_ms"] - row["plain_ms"] - row["direct_ms"]) / row["step_ms"]

    columns = ("curious_ms", "plain_ms", "direct_ms", "step_ms")
    lines = [
        [str(adapter), *(summarize(own, column) for column in columns), summarize(own, overhead)]
        for (adapter,), own in grouped(rows, "adapter").items()
    ]
    header = ["adapter", "curious sample", "plain sample", "bonus alone", "training step"]
    return f"""## Adapters

Milliseconds of a sample that carries the bonus, of the library's own sample, of the bonus alone on
a batch at hand (trained and computed), and of a whole training step of soft actor-critic on a
curious sample; HalfCheetah-v5, batch 256, two layers of 256, eager. What is left of a curious
sample without the other two is the adapter's overhead, in percent of the training step.

{markdown_table([*header, "overhead, %"], lines)}
"""


def cuda_section(out: Path) -> str:
    """Agents and updates on a GPU and on the CPU beside it."""
    agents, updates = read_rows(out / "cuda_agents.csv"), read_rows(out / "cuda_updates.csv")
    processes = {str(row["runner"]): row for row in read_rows(out / "cuda_processes.csv")}
    lines = [
        [
            str(name),
            summarize(own, "steps_per_second"),
            summarize(own, rate_over(agents, f"{AS_USED}, cpu")),
            summarize(own, rate_over(agents, f"{AS_USED}, cuda")),
            f"{processes[str(name)]['first_update_seconds']:.1f}",
        ]
        for (name,), own in grouped(agents, "runner").items()
    ]
    header = ["agent", "steps per second", "to SB3, cpu", "to SB3, cuda", "first update, s"]
    sizes = [size for (size,) in grouped(updates, "batch_size")]
    growth = [
        [
            str(where),
            *(summarize(same, "update_ms") for same in grouped(own, "batch_size").values()),
        ]
        for (where,), own in grouped(updates, "where").items()
    ]
    columns = ["batch", *(f"{size:.0f}" for size in sizes)]
    return f"""## GPU

The agents as above, one environment of HalfCheetah-v5, one update for every step, on a GPU and on
one thread of the CPU beside it. Acting waits for the update before it, as an action must come back
from the GPU.

![Environment steps per second on both devices](cuda_agents.png)

{markdown_table(header, lines)}

Milliseconds of one update of the curious agent with the learned prior, as the batch grows.

![An update against the batch](cuda_updates.png)

{markdown_table(columns, growth)}
"""


def replay_megabytes(num_transitions: int = 1_000_000) -> float:
    """Of transitions of HalfCheetah-v5 in replay."""
    replay = ReplayBuffer(1, OBSERVATION_DIM, ACTION_DIM)
    replay.add(
        [0.0] * OBSERVATION_DIM, [0.0] * ACTION_DIM, 0.0, [0.0] * OBSERVATION_DIM, False, False
    )
    rows = replay.state_dict()["rows"]
    return num_transitions * rows.nbytes / 1e6


def _ours(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row.get("update_ms") not in ("", None)]
