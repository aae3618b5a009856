import subprocess
import sys

import pytest
import torch

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a C++ compiler")

# The type checks of the tests cannot be traced: what is compiled runs in a process of its own.
LEARN_TWICE = """
from copy import deepcopy
import torch
from deep_curiosity import CuriosityBonus, CuriousSAC
from deep_curiosity.speed.compile import compiled
from deep_curiosity.nn.networks import Adam
from deep_curiosity.speed.machine import choose_matmul_precision
from deep_curiosity.transitions import Transition

torch.set_num_threads(1)
torch.set_float32_matmul_precision(choose_matmul_precision("auto", DEVICE))
torch.manual_seed(0)
agent = CuriousSAC(3, 2, hidden_dims=(32, 32), prior="learned", policy_modes=2, **OPTIONS)
bonus = CuriosityBonus(3, 2, hidden_dims=(32, 32), members=2, outcomes=2, components=64, **BONUS)
agent.to(DEVICE), bonus.to(DEVICE)
flags = torch.rand(64) < 0.1
batches = [
    [field.to(DEVICE) for field in (
        torch.randn(64, 3), torch.rand(64, 2) * 2 - 1, torch.randn(64), torch.randn(64, 3),
        flags, ~flags)]
    for _ in range(20)
]

def learn(agent, bonus, compile):
    optimizer = Adam([part for part in bonus.parameters() if part.requires_grad], 1e-3)
    def fit(transition):
        loss = bonus.loss(transition)
        optimizer.step(loss)
        return loss.detach()
    update = agent.update
    if compile:
        fit, update = (compiled(function, device=DEVICE) for function in (fit, update))
    torch.manual_seed(1)
    for number, fields in enumerate(batches):
        transition = Transition(*fields)
        unwatched = number < 10 or not compile or bonus.every.is_due  # a renewal looks at values
        if DEVICE == "cuda":
            torch.cuda.set_sync_debug_mode("default" if unwatched else "error")
        fit(transition)
        bonus.observe(transition, agent.act)
        metrics = update(transition, bonus)
    if DEVICE == "cuda":
        torch.cuda.set_sync_debug_mode("default")
    return [*agent.parameters(), *bonus.parameters(), *metrics.values()]

eager = learn(deepcopy(agent), deepcopy(bonus), compile=False)
fused = learn(agent, bonus, compile=True)
errors = [((a - b).norm() / b.norm().clamp(min=1e-3)).item() for a, b in zip(fused, eager)]
print(max(errors))
"""

FALL_BACK = """
import torch
from deep_curiosity.speed.compile import compiled

def looks_at_values(value):
    return value + 1 if value.sum() > 0 else value - 1

run = compiled(looks_at_values, fall_back=True)
print([run(torch.ones(1)).item() for _ in range(5)])
strict = compiled(looks_at_values)
try:
    strict(torch.ones(1))
except Exception as error:
    print(type(error).__name__)
"""

MANY = """
import torch
from deep_curiosity.speed.compile import compiled

torch._dynamo.config.recompile_limit = 2

class Scale:
    def __init__(self, factor):
        self.factor = factor

    def apply(self, value):
        return self.factor * value

runs = [compiled(Scale(factor).apply) for factor in range(6)]
for _ in range(5):
    scaled = [run(torch.ones(1)).item() for run in runs]
print(scaled)
"""

SETTLED = """
import torch
from torch._dynamo.utils import counters
from deep_curiosity.speed.compile import compiled

class Sum:
    def __init__(self):
        self.total = torch.zeros(2)

    def add(self, value, *, twice):
        self.total.add_(2 * value if twice else value)
        return self.total + 0

add = compiled(Sum().add)
for _ in range(4):
    add(torch.ones(2), twice=True)
torch._dynamo.reset()  # what is looked up from here on would be made anew
frames = counters["frames"]["total"]
print(add(torch.ones(2), twice=True).tolist(), counters["frames"]["total"] - frames)
try:
    add(torch.ones(3), twice=True)
except Exception as error:
    print("expected size 3==2" in str(error))
"""


def output_of(program):
    """Lines that a program of its own prints."""
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-2_000:]
    return run.stdout.splitlines()


ENTRIES = """dict(
    features=(0, -1),
    parts={'predictive_power': 1.0, 'negative_entropy': 0.3},
)"""
ROBUST = """dict(
    features=torch.nn.Linear(3, 4),
    whitening='robust',
    parts={'cross_entropy': 1.0},
    member_per_row=True,
)"""
CLIMBED = {"curiosity_discount": 0.0}
slow = pytest.mark.slow


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu_compiled_updates_give_the_same_numbers_and_wait_for_nothing():
    program = 'DEVICE, OPTIONS = "cuda", {}\n' + LEARN_TWICE.replace("**BONUS", "")
    program = program.replace("policy_modes=2", "policy_modes=1")  # torch 2.11 reorders its draws
    (error,) = output_of(program)
    assert float(error) < 1e-4


@pytest.mark.parametrize(
    ("options", "bonus", "within"),
    [
        ({"actor_stride": 2, "critic_per_row": True}, "{}", 1e-5),
        pytest.param(CLIMBED, "{}", 1e-5, marks=slow),
        pytest.param(CLIMBED, ENTRIES, 5e-5, marks=slow),
        pytest.param(CLIMBED, ROBUST, 5e-5, marks=slow),
        pytest.param(
            {"dial": True, "curiosity_episodic": False, "actor_stride": 2}, "{}", 1e-5, marks=slow
        ),
    ],
)
def test_compiled_and_eager_updates_give_the_same_numbers(options, bonus, within):
    program = f'DEVICE, OPTIONS = "cpu", {options}\n' + LEARN_TWICE.replace(
        "**BONUS", f"**{bonus}"
    )
    (error,) = output_of(program)
    assert float(error) < within


def test_what_cannot_be_compiled_runs_as_it_is_where_that_is_asked_for():
    said, values, error = output_of(FALL_BACK)
    assert said == "looks_at_values runs uncompiled: Unsupported"
    assert values == "[2.0, 2.0, 2.0, 2.0, 2.0]"
    assert error == "Unsupported"


def test_one_process_compiles_as_many_agents_as_it_likes():
    (scaled,) = output_of(MANY)
    assert scaled == "[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]"


def test_a_settled_graph_is_called_without_looking_it_up_and_refuses_other_shapes():
    total, refused = output_of(SETTLED)
    assert total == "[10.0, 10.0] 0"
    assert refused == "True"
