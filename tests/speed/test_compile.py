import pickle
import sys
from copy import deepcopy

import pytest
import torch

from deep_curiosity import CuriousSAC
from deep_curiosity.speed.compile import seal_modules
from tests.speed.programs import output_of

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a C++ compiler")

LEARN_TWICE = """
from copy import deepcopy
import torch
from deep_curiosity import CuriosityBonus, CuriousSAC
from deep_curiosity.nn.networks import Adam
from deep_curiosity.speed.compile import compiled
from deep_curiosity.speed.config import SpeedConfig
from deep_curiosity.speed.machine import choose_matmul_precision
from deep_curiosity.transitions import Transition

torch.set_num_threads(1)
torch.set_float32_matmul_precision(choose_matmul_precision("auto", DEVICE))
torch.manual_seed(0)
agent = CuriousSAC.default(
    3, 2, **dict(hidden_dim=32, prior="learned", policy_mixture_components=2) | EXACT | OPTIONS
)
bonus = CuriosityBonus.default(
    3, 2, hidden_dims=(32, 32), num_members=2, model_mixture_components=2, components=64,
    **dict(refresh_interval=10, members="all") | BONUS
)
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
    def step(transition):
        loss = bonus.loss(transition)
        optimizer.step(loss)
        return loss.detach()
    update = agent.update
    if compile:
        speed = SpeedConfig(device=DEVICE, **SPEED)
        step, update = (compiled(function, speed=speed) for function in (step, update))
    torch.manual_seed(1)
    for number, fields in enumerate(batches):
        transition = Transition(*fields)
        renews = not bonus.should_skip  # which looks at values
        unwatched = number < 10 or not compile or renews
        if DEVICE == "cuda":
            torch.cuda.set_sync_debug_mode("default" if unwatched else "error")
        step(transition)
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


EXACT = {
    "actor_q": "min",
    "actor_batch_fraction": 1.0,
    "learning_rate": 3e-4,
    "polyak": 0.005,
    "temperature": 1.0,
    "curiosity_coefficient": 1.0,
}
SEALED = """
from copy import deepcopy
import torch
from deep_curiosity import CuriousSAC
from deep_curiosity.agent.config import AgentConfig
from deep_curiosity.speed.compile import compiled
from deep_curiosity.transitions import Transition

torch.set_num_threads(1)
torch.manual_seed(0)
agent = CuriousSAC.default(3, 2, hidden_dim=16)
eager = deepcopy(agent)
update = compiled(agent.update)
flags = torch.zeros(32, dtype=torch.bool)
observation, next_observation = torch.randn(2, 32, 3)
action, reward = torch.rand(32, 2) * 2 - 1, torch.randn(32)
batch = Transition(observation, action, reward, next_observation, flags, flags)
bonus = torch.randn(32)

def learn(function):
    torch.manual_seed(1)
    return function(batch, bonus)["policy_loss"].item()

for _ in range(3):
    learn(update), learn(eager.update)
for part, name, value in (
    (agent, "config", AgentConfig()), (agent.optimizers["policy"], "learning_rate", 0.1)
):
    try:
        setattr(part, name, value)
    except AttributeError as error:
        print(error)
for name, value in (("hunger", 3.0), ("temperature", 0.5), ("curiosity_coefficient", 4.0)):
    unchanged = learn(deepcopy(eager).update)
    for one in (agent, eager):
        setattr(one, name, value)
    result, expected = learn(update), learn(eager.update)
    print(name, abs(result - expected) < 1e-5, abs(result - unchanged) > 1e-3)
"""


GRADIENTS = """
import torch
from deep_curiosity import CuriosityBonus
from deep_curiosity.speed.compile import compiled
from deep_curiosity.transitions import Transition

torch.set_num_threads(1)
torch.manual_seed(0)
flags = torch.zeros(64, dtype=torch.bool)
observation, next_observation = torch.randn(2, 64, 3)
action = torch.rand(64, 2) * 2 - 1
batch = Transition(observation, action, torch.zeros(64), next_observation, flags, flags)
for options in (dict(features=(0, -1)), dict(members="round_robin")):
    options = dict(num_members=2, components=64, members="all") | options
    bonus = CuriosityBonus.default(3, 2, hidden_dims=(32, 32), **options)
    bonus.observe(batch)

    def gradient(observation, action):
        action = action.detach().requires_grad_()
        return torch.autograd.grad(bonus(observation, action).sum(), action)[0]

    fused, eager = compiled(gradient)(observation, action), gradient(observation, action)
    print(((fused - eager).norm() / eager.norm()).item())
"""


ENTRIES = """dict(
    features=(0, -1),
    bonus_parts={'predictive_power': 1.0, 'negative_entropy': 0.3},
)"""
ROBUST = """dict(
    features=torch.nn.Linear(3, 4),
    whitening='robust',
    bonus_parts={'cross_entropy': 1.0},
    members='round_robin',
)"""
MAXIMISED = {"curiosity_discount": 0.0}
slow = pytest.mark.slow


def error_of(device="cpu", options=None, bonus="{}", speed=None):
    """Largest relative error of compiled updates against eager ones."""
    settings = f"DEVICE, OPTIONS, BONUS = {device!r}, {options or {}}, {bonus}"
    settings = f"import torch\n{settings}\nEXACT, SPEED = {EXACT}, {speed or {}}\n"
    (error,) = output_of(settings + LEARN_TWICE)
    return float(error)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu_compiled_updates_give_the_same_numbers_and_wait_for_nothing():
    one_component = {"policy_mixture_components": 1}  # torch 2.11 reorders its samples
    assert error_of("cuda", one_component) < 1e-4


@pytest.mark.parametrize(
    ("options", "bonus", "within"),
    [
        ({"actor_batch_fraction": 0.5, "actor_q": "alternate"}, "{}", 1e-5),
        (MAXIMISED, "{}", 1e-5),
        (MAXIMISED, ENTRIES, 5e-5),
        (MAXIMISED, ROBUST, 5e-5),
        (
            {
                "hunger": "conditioned:1.0",
                "curiosity_coefficient": "adaptive",
                "curiosity_episodic": False,
                "actor_batch_fraction": 0.5,
            },
            "{}",
            1e-5,
        ),
    ],
)
@slow
def test_compiled_and_eager_updates_give_the_same_numbers(options, bonus, within):
    assert error_of(options=options, bonus=bonus) < within


@slow
def test_the_compiled_gradient_of_a_bonus_in_the_action_is_the_eager_one():
    assert all(float(error) < 1e-5 for error in output_of(GRADIENTS))


@pytest.mark.parametrize(
    "speed",
    [
        {"direct_matmul": False},
        {"deduplicate": False},
        {"direct_matmul": False, "deduplicate": False},
    ],
)
@slow
def test_switches_of_the_compiler_leave_the_results_as_they_are(speed):
    assert error_of(speed=speed) < 1e-5


def test_what_cannot_be_compiled_runs_as_it_is_where_that_is_asked_for():
    said, values, error = output_of(FALL_BACK)
    assert said == "looks_at_values runs uncompiled: Unsupported"
    assert values == "[2.0, 2.0, 2.0, 2.0, 2.0]"
    assert error == "Unsupported"


@slow
def test_one_process_compiles_as_many_agents_as_it_likes():
    (scaled,) = output_of(MANY)
    assert scaled == "[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]"


@slow
def test_a_settled_graph_is_called_without_looking_it_up_and_refuses_other_shapes():
    total, refused = output_of(SETTLED)
    assert total == "[10.0, 10.0] 0"
    assert refused == "True"


@slow
def test_what_a_graph_does_not_follow_cannot_be_set_and_the_rest_takes_effect():
    config, learning_rate, *effects = output_of(SEALED)
    assert config.startswith("`config` of this CuriousSAC is part of a compiled update")
    assert learning_rate.startswith("`learning_rate` of this Adam is part of a compiled update")
    assert effects == [
        f"{name} True True" for name in ("hunger", "temperature", "curiosity_coefficient")
    ]


@pytest.fixture
def sealed():
    agent = CuriousSAC.default(3, 2, hidden_dim=8)
    seal_modules(agent)
    return agent


def test_a_sealed_module_refuses_plain_attributes_by_name_alone(sealed):
    with pytest.raises(AttributeError, match=r"`config` of this CuriousSAC .*compiled"):
        sealed.config = None
    with pytest.raises(AttributeError, match=r"`learning_rate` of this Adam .*got 0\.1"):
        sealed.optimizers["policy"].learning_rate = 0.1
    sealed.hunger, sealed.temperature, sealed.curiosity_coefficient = 0.5, 0.25, 0.125
    assert (sealed.hunger, sealed.temperature) == (0.5, 0.25)
    assert sealed.curiosity_coefficient == 0.125
    assert not sealed.eval().training
    sealed.load_state_dict(CuriousSAC.default(3, 2, hidden_dim=8).state_dict())


def test_to_seal_twice_is_to_seal_once(sealed):
    kind = type(sealed)
    seal_modules(sealed)
    assert type(sealed) is kind and isinstance(sealed, CuriousSAC)


@pytest.mark.parametrize("copied", [deepcopy, lambda module: pickle.loads(pickle.dumps(module))])
def test_a_copy_of_a_sealed_module_is_not_sealed_and_pickles(sealed, copied):
    copy = copied(sealed)
    assert not any(hasattr(part, "_sealed_from") for part in copy.modules())
    assert type(copy) is CuriousSAC
    copy.optimizers["policy"].learning_rate = 0.1
    assert sealed.optimizers["policy"].learning_rate != 0.1
    again = pickle.loads(pickle.dumps(copy))
    assert again.optimizers["policy"].learning_rate == 0.1
    for name, value in sealed.state_dict().items():
        assert again.state_dict()[name].nan_to_num().equal(value.nan_to_num())
