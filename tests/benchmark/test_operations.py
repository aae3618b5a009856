import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from deep_curiosity.benchmark.costs import random_steps
from deep_curiosity.benchmark.operations import (
    count_forward,
    count_input_gradient,
    count_training,
    count_update,
)
from deep_curiosity.training import Config
from deep_curiosity.training.learner import Learner

SIZES = {
    "hidden_dim": 4,
    "batch_size": 10,
    "compile": "off",
    "reward_steps": 1,
}
SMALL = Config.of("exact", num_members=2, components=5, curiosity_steps=1, **SIZES)
PLAIN = Config.of("exact", bonus="none", **SIZES)
# products: policy 3-4-4-4 has 44, critic 5-4-4-1 has 40, model 5-4-4-6 has 60


def test_a_multiplication_and_an_addition_are_two_operations():
    assert count_forward(10, [3, 4, 2]) == 2 * 10 * (12 + 8)


def test_the_first_layer_needs_no_gradient_in_its_input():
    assert count_training(10, [3, 4, 2]) == 20 * ((12 + 8) + (12 + 8) + 8)


def test_what_is_maximised_needs_no_gradient_in_its_weights():
    assert count_input_gradient(10, [3, 4, 2], 1) == 20 * ((12 + 8) + (4 + 8))


def test_operations_of_the_plain_agent():
    target = 20 * (44 + 2 * 40)
    evaluation = 2 * 20 * (40 + 40 + 20)
    improvement = 20 * (44 + 44 + 32) + 2 * 20 * (40 + 28)
    operations = count_update(PLAIN, 3, 2)
    assert operations == {"agent": target + evaluation + improvement}


def test_operations_of_the_curious_agent():
    operations = count_update(SMALL, 3, 2)
    critics = 20 * 3 * 40 + 3 * 20 * (40 + 40 + 20) + (2 * 2 + 1) * 20 * (40 + 28)
    policies = 2 * (20 * 44 + 20 * (44 + 44 + 32))
    bonus = 2 * (20 * 60 + 20 * 6 * 5)
    assert operations["agent"] == critics + policies + bonus
    assert operations["models"] == 2 * 20 * (60 + 60 + 40)
    assert operations["statistics"] == (2 * 20 * 44 + 20 * 60 + bonus) / 10


def test_round_robin_members_cost_as_one_member():
    shared = count_update(SMALL.override(members="round_robin"), 3, 2)
    all_members = count_update(SMALL, 3, 2)
    assert all_members["agent"] - shared["agent"] == 20 * 60 + 20 * 6 * 5
    assert shared["models"] == all_members["models"] / 2


@pytest.mark.parametrize(("members", "saved"), [("all", 2 * 20 * 60), ("round_robin", 20 * 60)])
def test_a_graph_needs_no_pass_of_its_own_for_the_bonus(members, saved):
    config = SMALL.override(members=members)
    eager = count_update(config, 3, 2)
    graph = count_update(config.override(compile="on"), 3, 2)
    assert eager["agent"] - graph["agent"] == saved
    assert eager["models"] == graph["models"] and eager["statistics"] == graph["statistics"]


def test_steps_that_are_summed_cost_nothing():
    one, three = (count_update(SMALL.override(curiosity_steps=n), 3, 2) for n in (1, 3))
    assert three == one


def test_alternate_critics_of_the_reward_cost_as_one():
    both, one = (
        count_update(SMALL.override(actor_q=actor_q), 3, 2)["agent"]
        for actor_q in ("min", "alternate")
    )
    assert both - one == 2 * 20 * (40 + 28)  # of the curious and of the greedy policy


def test_an_actor_that_takes_every_third_row_costs_as_many_rows():
    whole, part = (
        count_update(PLAIN.override(actor_batch_fraction=fraction), 3, 2)["agent"]
        for fraction in (1.0, 1 / 3)
    )
    assert whole - part == (10 - 4) * 2 * ((44 + 44 + 32) + 2 * (40 + 28))


@pytest.mark.parametrize(
    "config",
    [Config.of(bonus="none"), Config.of(refresh_interval=1), Config.of("paper")],
    ids=["plain", "curious", "paper"],
)
def test_torch_counts_as_many_operations(config):
    config = config.override(batch_size=64, compile="off")
    learner = Learner(config, 17, 6)
    learner.replay.extend(*random_steps(100, 17))
    learner.update()
    with FlopCounterMode(display=False) as counter:
        learner.update()
    expected = sum(count_update(config, 17, 6).values())
    # torch leaves out last layers of one column, and takes gradients in observations as well
    assert counter.get_total_flops() == pytest.approx(expected, rel=0.05)


def test_the_one_step_agent_of_the_paper_is_not_counted():
    with pytest.raises(ValueError, match=r"above 0 to be counted, got 0"):
        count_update(SMALL.override(curiosity_discount=0.0), 3, 2)


def test_importing_the_counts_leaves_the_precision_alone():
    assert torch.get_float32_matmul_precision() == "highest"
