from dataclasses import replace

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from deep_curiosity.benchmark.costs import random_steps
from deep_curiosity.benchmark.operations import climb, fit, forward, update_operations
from deep_curiosity.training import Settings
from deep_curiosity.training.learner import Learner
from deep_curiosity.training.config import EXACT

SMALL = Settings(
    hidden_dim=4,
    batch_size=10,
    members=2,
    components=5,
    compile="off",
    **EXACT,
)
# products: policy 3-4-4-4 has 44, critic 5-4-4-1 has 40, model 5-4-4-6 has 60


def test_a_multiplication_and_an_addition_are_two_operations():
    assert forward(10, [3, 4, 2]) == 2 * 10 * (12 + 8)


def test_the_first_layer_needs_no_gradient_in_its_input():
    assert fit(10, [3, 4, 2]) == 20 * ((12 + 8) + (12 + 8) + 8)


def test_what_is_climbed_needs_no_gradient_in_its_weights():
    assert climb(10, [3, 4, 2], 1) == 20 * ((12 + 8) + (4 + 8))


def test_operations_of_the_plain_agent():
    target = 20 * (44 + 2 * 40)
    evaluation = 2 * 20 * (40 + 40 + 20)
    improvement = 20 * (44 + 44 + 32) + 2 * 20 * (40 + 28)
    operations = update_operations(replace(SMALL, bonus="none"), 3, 2)
    assert operations == {"agent": target + evaluation + improvement}


def test_operations_of_the_curious_agent():
    operations = update_operations(SMALL, 3, 2)
    critics = 20 * 4 * 40 + 4 * 20 * (40 + 40 + 20) + 4 * 20 * (40 + 28)
    policy = 20 * 44 + 20 * (44 + 44 + 32)
    bonus = 2 * (20 * 60 + 20 * 6 * 5)
    assert operations["agent"] == critics + policy + bonus
    assert operations["models"] == 2 * 20 * (60 + 60 + 40)
    assert operations["statistics"] == (20 * 44 + 20 * 60 + bonus) / 10


def test_a_member_for_each_row_costs_as_one_member():
    shared = update_operations(replace(SMALL, member_per_row=True), 3, 2)
    all_members = update_operations(SMALL, 3, 2)
    assert all_members["agent"] - shared["agent"] == 20 * 60 + 20 * 6 * 5
    assert shared["models"] == all_members["models"] / 2


@pytest.mark.parametrize(("member_per_row", "spared"), [(False, 2 * 20 * 60), (True, 20 * 60)])
def test_a_graph_needs_no_pass_of_its_own_for_the_bonus(member_per_row, spared):
    settings = replace(SMALL, member_per_row=member_per_row)
    eager = update_operations(settings, 3, 2)
    graph = update_operations(replace(settings, compile="on"), 3, 2)
    assert eager["agent"] - graph["agent"] == spared
    assert eager["models"] == graph["models"] and eager["statistics"] == graph["statistics"]


def test_a_critic_for_each_row_costs_as_one_critic_of_each_pair():
    both, one = (
        update_operations(replace(SMALL, critic_per_row=per_row), 3, 2)["agent"]
        for per_row in (False, True)
    )
    assert both - one == 2 * 20 * (40 + 28)


def test_an_actor_that_takes_every_third_row_costs_as_many_rows():
    whole, thinned = (
        update_operations(replace(SMALL, bonus="none", actor_stride=stride), 3, 2)["agent"]
        for stride in (1, 3)
    )
    assert whole - thinned == (10 - 4) * 2 * ((44 + 44 + 32) + 2 * (40 + 28))


@pytest.mark.parametrize("changes", [{"bonus": "none"}, {}, EXACT], ids=str)
def test_torch_counts_as_many_operations(changes):
    settings = replace(Settings(batch_size=64, compile="off", **changes), refresh_interval=1)
    learner = Learner(settings, 17, 6)
    learner.store(random_steps(100, 17))
    learner.update()
    with FlopCounterMode(display=False) as counter:
        learner.update()
    expected = sum(update_operations(settings, 17, 6).values())
    # torch leaves out last layers of one column, and takes gradients in observations as well
    assert counter.get_total_flops() == pytest.approx(expected, rel=0.05)


def test_the_paper_s_one_step_agent_is_not_counted():
    with pytest.raises(ValueError, match=r"above 0 to be counted, got 0"):
        update_operations(replace(SMALL, curiosity_discount=0.0), 3, 2)


def test_importing_the_counts_leaves_the_precision_alone():
    assert torch.get_float32_matmul_precision() == "highest"
