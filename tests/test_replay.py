import math
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
import torch

from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.transitions import Transition

STATM = Path("/proc/self/statm")


def add(replay, number, *, terminated=False, truncated=False):
    """Store a step whose every entry carries its number."""
    observation = np.array([number, number + 0.1, number + 0.2])
    action = np.array([number + 0.3, number + 0.4])
    replay.add(observation, action, number + 0.5, observation + 100, terminated, truncated)


def filled(count, capacity=8, **options):
    replay = ReplayBuffer(capacity, 3, 2, **options)
    for number in range(count):
        add(replay, number, terminated=number % 3 == 0, truncated=number % 4 == 0)
    return replay


def numbers(transition):
    return transition.observation[:, 0].tolist()


def equal(some, others):
    return all(one.equal(other) for one, other in zip(some, others, strict=True))


def test_a_step_comes_out_as_it_went_in():
    batch = filled(1).sample(1)
    torch.testing.assert_close(batch.observation, torch.tensor([[0.0, 0.1, 0.2]]))
    torch.testing.assert_close(batch.action, torch.tensor([[0.3, 0.4]]))
    torch.testing.assert_close(batch.reward, torch.tensor([0.5]))
    torch.testing.assert_close(batch.next_observation, torch.tensor([[100.0, 100.1, 100.2]]))
    assert batch.terminated.tolist() == [True] and batch.truncated.tolist() == [True]
    assert batch.terminated.dtype == torch.bool and batch.reward.dtype == torch.float32


def test_rows_taken_apart_are_the_transitions_that_would_have_been_sampled():
    one, other = filled(8), filled(8)
    rows, alive, _ = one.sample_rows(20)
    assert equal(one.sequences(rows, alive).steps, other.sample(20))
    with pytest.raises(ValueError, match="must hold a transition"):
        ReplayBuffer(4, 3, 2).sample_rows(1)


@pytest.mark.parametrize("terminated", [False, True])
@pytest.mark.parametrize("truncated", [False, True])
def test_the_two_ends_of_an_episode_are_kept_apart(terminated, truncated):
    replay = ReplayBuffer(4, 3, 2)
    add(replay, 1, terminated=terminated, truncated=truncated)
    batch = replay.sample(5)
    assert batch.terminated.tolist() == [terminated] * 5
    assert batch.truncated.tolist() == [truncated] * 5


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 16, 21])
def test_the_newest_are_kept_and_come_out_oldest_first(count):
    replay = filled(count)
    assert len(replay) == min(count, 8)
    assert numbers(replay.all()) == list(range(max(0, count - 8), count))


def test_only_what_was_added_is_sampled_and_all_of_it():
    replay = filled(5, capacity=100)
    assert set(numbers(replay.sample(500))) == {0, 1, 2, 3, 4}
    assert set(numbers(filled(11).sample(500))) == set(range(3, 11))


def test_samples_are_uniform():
    sampled = filled(4).sample(40_000).observation[:, 0]
    share = torch.bincount(sampled.long()) / 40_000
    assert (share - 0.25).abs().max() < 0.01


def test_fields_of_a_batch_are_views_of_one_tensor():
    batch = filled(8).sample(6)
    storage = {field.untyped_storage().data_ptr() for field in batch[:4]}
    assert len(storage) == 1 and isinstance(batch, Transition)
    assert batch.reward.shape == batch.terminated.shape == (6,)


def test_a_batch_is_a_copy_of_the_rows():
    replay = filled(1)
    replay.sample(1).observation.fill_(77)
    assert numbers(replay.all()) == [0]


def test_samples_follow_the_seed_and_not_the_global_stream():
    torch.manual_seed(1)
    one = numbers(filled(8, seed=3).sample(50))
    torch.manual_seed(2)
    assert numbers(filled(8, seed=3).sample(50)) == one
    assert numbers(filled(8, seed=4).sample(50)) != one
    random_state = torch.get_rng_state()
    filled(8).sample(50)
    assert torch.get_rng_state().equal(random_state)


@pytest.mark.parametrize("count", [0, 3, 8, 21])
def test_a_restored_replay_goes_on_as_the_old_one(count):
    replay, restored = filled(count), ReplayBuffer(8, 3, 2, seed=99)
    if count:
        replay.sample(7)
    state = replay.state_dict()
    restored.load_state_dict(state)
    for one in (replay, restored):
        add(one, 50)
    assert equal(restored.all(), replay.all())
    assert equal(restored.sample(64), replay.sample(64))


def test_saved_state_stays_as_it_was_saved():
    replay = filled(3)
    state = replay.state_dict()
    for number in range(20, 30):
        add(replay, number)
    restored = ReplayBuffer(8, 3, 2)
    restored.load_state_dict(state)
    assert numbers(restored.all()) == [0, 1, 2]


RESTORES = pytest.mark.parametrize("restore", ["load_state_dict", "take_over"])
BAD_STATES = [
    ("generator", torch.zeros(3), ValueError, "`generator` must be the state of one on cpu, got"),
    ("generator", torch.zeros(3).byte(), ValueError, "`generator` must be the state of one on"),
    ("generator", None, ValueError, "`generator` must be the state of one on cpu, got None"),
    (
        "bonus",
        torch.zeros(9),
        ValueError,
        "`bonus` must have one number for each of 3 rows, got 9",
    ),
    ("bonus", None, TypeError, "`bonus` must be a tensor of torch.float32, got NoneType"),
    ("rows", torch.zeros(2, 11), ValueError, "`rows` must fit .* after 3 additions, got"),
    ("rows", torch.zeros(3), ValueError, r"`rows` must fit .* after 3 additions, got \(3,\)"),
    ("rows", [[0.0] * 11] * 3, TypeError, "`rows` must be a tensor of torch.float32, got list"),
    ("num_added", 3.0, ValueError, "`num_added` must be a whole number from 0 to .*, got 3.0"),
    ("num_taken", 4, ValueError, "`num_taken` must be a whole number from 0 to 3, got 4"),
    ("observation_dim", 4, ValueError, "`observation_dim` must be 3, that of this buffer, got 4"),
    ("action_dim", None, ValueError, "`action_dim` must be 2, that of this buffer, got None"),
    ("num_envs", 2, ValueError, "`num_envs` must be 1, that of this buffer, got 2"),
]


@pytest.mark.parametrize(("name", "value", "error", "message"), BAD_STATES)
def test_a_state_that_is_refused_changes_nothing(name, value, error, message):
    replay, state = filled(6), filled(3).state_dict()
    replay.bonus[:] = torch.arange(8.0)
    before = replay.state_dict()
    with pytest.raises(error, match=message):
        replay.load_state_dict(state | {name: value})
    after = replay.state_dict()
    for part, held in before.items():
        assert held.equal(after[part]) if isinstance(held, torch.Tensor) else held == after[part]


@RESTORES
def test_a_state_that_lacks_something_is_refused_by_its_name(restore):
    jaxtyping.config.update("jaxtyping_disable", True)  # whose own error would come first
    replay, state = filled(6), filled(3).state_dict()
    for bad in ({}, {"rows": state["rows"]}):
        with pytest.raises(ValueError, match=r"`state` must hold rows, .* without .*num_added"):
            getattr(replay, restore)(bad)
    with pytest.raises(TypeError, match=r"`state` must be a dictionary .*, got NoneType"):
        getattr(replay, restore)(None)
    with pytest.raises(ValueError, match="`rows` must"):
        getattr(replay, restore)(state | {"rows": torch.zeros(3)})
    assert numbers(replay.all()) == list(range(6))


def test_state_of_a_replay_of_other_sizes_is_rejected():
    state = filled(12).state_dict()
    for other in (ReplayBuffer(4, 3, 2), ReplayBuffer(16, 3, 2), ReplayBuffer(8, 4, 2)):
        with pytest.raises(ValueError, match="`rows` must fit"):
            other.load_state_dict(state)
        assert len(other) == 0


@RESTORES
def test_a_state_of_other_sizes_is_refused_though_its_rows_are_as_long(restore):
    replay = ReplayBuffer(8, 2, 4)  # 11 numbers in a row, as in that of 3 and 2
    with pytest.raises(
        ValueError, match="`observation_dim` must be 2, that of this buffer, got 3"
    ):
        getattr(replay, restore)(filled(5).state_dict())
    assert len(replay) == 0


@RESTORES
def test_a_state_of_other_environments_is_refused(restore):
    replay = filled(3)
    with pytest.raises(ValueError, match="`num_envs` must be 1, that of this buffer, got 2"):
        getattr(replay, restore)(filled(6, num_envs=2).state_dict())
    assert numbers(replay.all()) == [0, 1, 2]


@RESTORES
def test_an_older_state_that_does_not_say_its_sizes_is_restored(restore):
    state = filled(12).state_dict()
    for name in ("observation_dim", "action_dim", "num_envs"):
        del state[name]
    replay = filled(2)
    getattr(replay, restore)(state)
    assert numbers(replay.all()) == list(range(4, 12))


@pytest.mark.parametrize("terminated", [False, True])
def test_what_is_taken_over_is_cut_off_only_where_it_goes_on(terminated):
    other, replay = ReplayBuffer(8, 3, 2), ReplayBuffer(8, 3, 2)
    add(other, 1, terminated=terminated)
    replay.take_over(other.state_dict())
    assert replay.all().terminated.tolist() == [terminated]
    assert replay.all().truncated.tolist() == [not terminated]


GOOD = {
    "observation": np.zeros(3),
    "action": np.zeros(2),
    "reward": 0.0,
    "next_observation": np.zeros(3),
    "terminated": False,
    "truncated": False,
}


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["observation", "action", "reward", "next_observation"])
def test_what_is_not_finite_is_rejected_and_not_stored(name, bad):
    replay = filled(2)
    value = bad if name == "reward" else np.full_like(GOOD[name], bad)
    with pytest.raises(ValueError, match=f"`{name}` must be finite"):
        replay.add(**GOOD | {name: value})
    assert len(replay) == 2 and numbers(replay.all()) == [0, 1]


@pytest.mark.parametrize("name", ["observation", "action", "next_observation"])
def test_a_wrong_length_is_rejected_and_not_stored(name):
    replay = filled(2)
    with pytest.raises(ValueError, match=f"`{name}` must have . entries, got 5"):
        replay.add(**GOOD | {name: np.zeros(5)})
    assert len(replay) == 2


def test_lengths_that_are_wrong_together_are_rejected_though_the_row_is_full():
    replay = filled(2)
    with pytest.raises(ValueError, match="`observation` must have 3 entries, got 2"):
        replay.add(**GOOD | {"observation": np.zeros(2), "next_observation": np.zeros(4)})
    assert len(replay) == 2


def test_a_number_too_large_for_the_rows_is_rejected():
    with pytest.raises(ValueError, match=r"`reward` must be finite in float32, got 1e\+300"):
        filled(2).add(**GOOD | {"reward": 1e300})


def test_lists_and_single_precision_are_taken_as_well():
    replay = ReplayBuffer(2, 3, 1)
    replay.add([1.0, 2.0, 3.0], np.float32([0.5]), 1.0, np.zeros(3, np.float32), True, False)
    assert replay.all().observation.tolist() == [[1, 2, 3]]


def test_an_empty_replay_cannot_be_sampled():
    with pytest.raises(ValueError, match=r"must hold a transition.*got 0"):
        ReplayBuffer(4, 3, 2).sample(1)


def test_an_empty_batch_cannot_be_sampled():
    with pytest.raises(ValueError, match="`batch_size` must be at least 1, got 0"):
        filled(2).sample(0)


@pytest.mark.parametrize("name", ["capacity", "observation_dim", "action_dim", "num_envs"])
def test_a_size_below_one_is_rejected(name):
    sizes = {"capacity": 4, "observation_dim": 3, "action_dim": 2}
    with pytest.raises(ValueError, match=f"`{name}` must be at least 1, got 0"):
        ReplayBuffer(**sizes | {name: 0})


@pytest.mark.skipif(not STATM.exists(), reason="reads the resident memory from Linux")
def test_a_million_rows_take_no_memory_until_they_are_written():
    def resident():
        return int(STATM.read_text().split()[1]) * 4096 / 2**20

    before = resident()
    replay = ReplayBuffer(1_000_000, 17, 6)  # HalfCheetah: 168 MB when full
    replay.add(np.zeros(17), np.zeros(6), 0.0, np.zeros(17), False, False)
    replay.sample(256)
    assert resident() - before < 8


@pytest.fixture
def torchrl_data():
    return pytest.importorskip("torchrl.data")


@pytest.mark.parametrize("count", [1, 5, 8, 21])
def test_a_round_trip_through_torchrl_keeps_every_transition(torchrl_data, count):
    replay = filled(count)
    back = ReplayBuffer.from_torchrl(replay.to_torchrl(), capacity=8)
    assert equal(back.all(), replay.all())
    add(back, 50), add(replay, 50)
    assert equal(back.all(), replay.all())


def test_a_torchrl_copy_has_the_usual_keys(torchrl_data):
    replay = filled(5)
    held, expected = replay.to_torchrl()[:], replay.all()
    assert held["observation"].equal(expected.observation)
    assert held["next", "observation"].equal(expected.next_observation)
    assert held["next", "reward"].equal(expected.reward.unsqueeze(-1))
    ended = expected.terminated | expected.truncated
    assert held["next", "done"].equal(ended.unsqueeze(-1))
    assert held["next", "terminated"].dtype == torch.bool


def test_a_torchrl_copy_can_be_sampled_and_extended(torchrl_data):
    buffer = filled(5).to_torchrl()
    assert set(buffer.sample()["observation"][:, 0].tolist()) == {0, 1, 2, 3, 4}
    buffer.extend(buffer[:2].clone())
    assert len(buffer) == 7


def test_the_copy_of_a_torchrl_buffer_has_room_for_what_it_holds(torchrl_data):
    back = ReplayBuffer.from_torchrl(filled(5).to_torchrl())
    assert back.capacity == len(back) == 5


def test_a_capacity_below_one_is_not_taken_for_none(torchrl_data):
    with pytest.raises(ValueError, match="`capacity` must be at least 1, got 0"):
        ReplayBuffer.from_torchrl(filled(5).to_torchrl(), capacity=0)


def test_a_smaller_copy_of_a_torchrl_buffer_keeps_the_newest(torchrl_data):
    back = ReplayBuffer.from_torchrl(filled(7).to_torchrl(), capacity=3)
    assert numbers(back.all()) == [4, 5, 6]


def test_a_torchrl_buffer_that_went_round_comes_out_oldest_first(torchrl_data):
    buffer = filled(8).to_torchrl()
    buffer.extend(filled(11).to_torchrl()[5:])  # numbers 8, 9, 10 in place of 0, 1, 2
    back = ReplayBuffer.from_torchrl(buffer)
    assert numbers(back.all()) == list(range(3, 11))


def test_the_copy_is_of_what_a_torchrl_buffer_stores_and_not_of_what_it_samples(torchrl_data):
    transforms = pytest.importorskip("torchrl.envs.transforms")
    buffer = filled(5).to_torchrl()
    key = [("next", "reward")]
    buffer.append_transform(transforms.RewardScaling(1.0, 2.0, key, key, standard_normal=False))
    assert not buffer[:]["next", "reward"].flatten().equal(filled(5).all().reward)
    assert ReplayBuffer.from_torchrl(buffer).all().reward.equal(filled(5).all().reward)


def test_seed_of_the_copy_decides_its_samples(torchrl_data):
    buffer = filled(8).to_torchrl()
    samples = [ReplayBuffer.from_torchrl(buffer, seed=seed).sample(50) for seed in (1, 1, 2)]
    assert equal(samples[0], samples[1]) and not equal(samples[0], samples[2])


@pytest.mark.parametrize("num_envs", [1, 3])
def test_a_torchrl_copy_of_an_empty_buffer_is_empty(torchrl_data, num_envs):
    replay = ReplayBuffer(8, 3, 2, num_envs=num_envs)
    assert len(replay.to_torchrl()) == 0


def side_by_side(num_rounds, *, capacity, num_envs=3):
    """Steps numbered 100 to the environment, each leading to the next; some were none."""
    replay = ReplayBuffer(capacity, 1, 1, num_envs=num_envs)
    zeros, never = np.zeros(num_envs), np.zeros(num_envs, dtype=bool)
    for step in range(num_rounds):
        observation = 100.0 * np.arange(num_envs)[:, None] + step
        sound = np.arange(num_envs) != step - 4  # one after another, from the fifth round on
        truncated = (np.arange(num_envs) + step) % 7 == 6
        fields = observation, zeros[:, None], zeros, observation + 1, never, truncated
        replay.extend(*fields, sound)
    return replay


@pytest.mark.parametrize("num_rounds", [1, 2, 9, 30])
def test_each_environment_keeps_a_place_of_its_own_in_a_torchrl_copy(torchrl_data, num_rounds):
    replay = side_by_side(num_rounds, capacity=20)  # room for six rounds and two steps
    buffer = replay.to_torchrl()
    held = buffer.storage[:]
    assert held.batch_size == (min(num_rounds, 6), 3)
    assert (held["observation"][..., 0] // 100).eq(torch.arange(3)).all()
    newest = replay.newest(held.numel())
    assert held["observation"].flatten(0, 1).equal(newest.observation)
    assert held["next", "truncated"].flatten().equal(newest.truncated)
    assert buffer.sample().batch_size == (256,)


@pytest.mark.parametrize("num_rounds", [2, 9, 30])
def test_sequences_stay_in_their_environment_after_a_round_trip(torchrl_data, num_rounds):
    back = ReplayBuffer.from_torchrl(side_by_side(num_rounds, capacity=20).to_torchrl())
    assert back.num_envs == 3
    sequences = back.sample_sequences(300, 3)
    step = sequences.steps.observation[:, 0].unflatten(0, (3, 300))
    assert sequences.alive[1].any()
    for before, after, alive in zip(step, step[1:], sequences.alive[1:], strict=False):
        assert (after - before)[alive].eq(1).all()


def test_a_torchrl_copy_of_several_environments_goes_on_in_each(torchrl_data):
    buffer = side_by_side(2, capacity=18).to_torchrl()
    buffer.extend(side_by_side(5, capacity=9).to_torchrl()[:])  # rounds 2, 3 and 4
    back = ReplayBuffer.from_torchrl(buffer)
    assert equal(back.all(), side_by_side(5, capacity=18).all())


def batch(first, count):
    numbers = np.arange(first, first + count)
    observation = numbers[:, None] + np.array([0.0, 0.1, 0.2])
    action = numbers[:, None] + np.array([0.3, 0.4])
    ends = numbers % 3 == 0, numbers % 4 == 0
    return observation, action, numbers + 0.5, observation + 100, *ends


@pytest.mark.parametrize("counts", [(5,), (3, 3), (8,), (3, 7, 1), (5, 20), (1, 30, 2)])
def test_several_at_once_are_kept_as_if_they_came_one_by_one(counts):
    replay, first = ReplayBuffer(8, 3, 2), 0
    for count in counts:
        replay.extend(*batch(first, count))
        first += count
    assert equal(replay.all(), filled(first).all())
    assert equal(replay.sample(20), filled(first).sample(20))


@pytest.mark.parametrize("name", ["observation", "action", "reward", "next_observation"])
def test_several_with_one_that_is_not_finite_are_all_refused(name):
    replay = filled(3)
    values = dict(zip(Transition._fields, batch(3, 4), strict=True))
    values[name][2] = math.nan
    with pytest.raises(ValueError, match=rf"`{name}` must be finite, got \[nan.* in row 2"):
        replay.extend(**values)
    assert equal(replay.all(), filled(3).all())


def test_several_of_unequal_number_are_refused():
    values = batch(0, 4)
    with pytest.raises(ValueError, match=r"`reward` must have shape \(4,\), got \(3,\)"):
        ReplayBuffer(8, 3, 2).extend(*values[:2], values[2][:3], *values[3:])


def test_what_is_evenly_spaced_over_replay_is_the_same_at_every_call():
    replay = filled(6)
    generator = replay.state_dict()["generator"]
    assert numbers(replay.evenly_spaced(3)) == [0, 2, 4]
    assert numbers(replay.evenly_spaced(12)) == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    assert replay.state_dict()["generator"].equal(generator)
    with pytest.raises(ValueError, match="`num_rows` must be at least 1, got 0"):
        replay.evenly_spaced(0)
    with pytest.raises(ValueError, match="must hold a transition before it is sampled"):
        filled(0).evenly_spaced(1)


@pytest.mark.parametrize("count", [6, 21])
def test_the_weight_of_a_step_halves_with_every_half_life(count):
    sampled = filled(count).sample_fading(60_000, half_life=2).observation[:, 0]
    held = min(count, 8)
    age = torch.bincount((count - 1 - sampled).long(), minlength=held) / 60_000
    expected = 0.5 ** (torch.arange(held) / 2)
    torch.testing.assert_close(age, expected / expected.sum(), atol=0.01, rtol=0)


def test_a_half_life_beyond_all_steps_draws_them_alike():
    sampled = filled(4).sample_fading(40_000, half_life=10_000_000).observation[:, 0]
    assert (torch.bincount(sampled.long()) / 40_000 - 0.25).abs().max() < 0.01


def test_a_half_life_below_one_and_an_empty_replay_are_rejected():
    with pytest.raises(ValueError, match="`half_life` must be at least 1, got 0"):
        filled(3).sample_fading(2, half_life=0)
    with pytest.raises(ValueError, match="must hold a transition before it is sampled"):
        filled(0).sample_fading(2, half_life=5)


def test_sequences_hold_what_followed_until_the_episode_ends():
    replay = ReplayBuffer(8, 3, 2)
    for number in range(20):  # of which the last eight are held
        add(replay, number, terminated=number == 14, truncated=number == 17)
    sequences = replay.sample_sequences(200, 3)
    first = torch.tensor(numbers(sequences.first)).long()
    assert set(first.tolist()) == set(range(12, 20))
    number = sequences.steps.observation[:, 0].unflatten(0, (3, 200)).long()
    for row in range(200):
        until = next(end for end in (14, 17, 19) if end >= first[row])
        lives = [int(first[row]) + step <= until for step in range(3)]
        assert sequences.alive[:, row].tolist() == lives
        expected = [int(first[row]) + step for step in range(3) if lives[step]]
        assert number[:, row][lives].tolist() == expected
        assert sequences.last(3).observation[row, 0] == expected[-1]
        assert sequences.last(2).observation[row, 0] == expected[:2][-1]


def test_sequences_stay_in_their_environment_where_several_are_stored_side_by_side():
    replay = ReplayBuffer(90, 3, 2, num_envs=3)
    for number in range(90):
        add(replay, number)
    sequences = replay.sample_sequences(300, 2)
    one, next_one = sequences.steps.observation[:, 0].unflatten(0, (2, 300))
    alive = sequences.alive[1]
    assert (next_one - one)[alive].eq(3).all()
    assert alive.tolist() == (one < 87).tolist()


def test_sequences_of_one_step_are_what_is_sampled():
    one, other = filled(8, seed=1), filled(8, seed=1)
    assert equal(one.sample(16), other.sample_sequences(16, 1).first)
    with pytest.raises(ValueError, match="`num_steps` must be at least 1, got 0"):
        one.sample_sequences(4, 0)


def test_the_bonus_of_a_slot_is_unknown_until_it_is_kept_and_again_once_overwritten():
    replay = ReplayBuffer(4, 1, 1)
    for number in range(4):
        replay.add([float(number)], [0.0], 0.0, [float(number)], False, False)
    assert replay.bonus.isnan().all()
    replay.bonus[:] = torch.arange(4.0)
    copy = ReplayBuffer(4, 1, 1)
    copy.load_state_dict(replay.state_dict())
    assert copy.bonus.tolist() == [0, 1, 2, 3]
    replay.add([4.0], [0.0], 0.0, [4.0], False, False)
    assert replay.bonus.isnan().tolist() == [True, False, False, False]
    rows = np.zeros((2, 1))
    flags = np.zeros(2, dtype=bool)
    replay.extend(rows, rows, np.zeros(2), rows, flags, flags)
    assert replay.bonus.isnan().tolist() == [True, True, True, False]


def test_slots_say_where_each_step_of_a_sequence_lies():
    replay = ReplayBuffer(8, 1, 1)
    for number in range(11):
        replay.add([float(number)], [0.0], 0.0, [float(number)], False, number % 4 == 3)
    for num_steps in (1, 3):
        rows, alive, slot = replay.sample_rows(50, num_steps)
        assert slot.shape == (50 * num_steps,)
        observation = replay.sequences(rows, alive).steps.observation[:, 0]
        assert (observation[alive.flatten()].long() % 8).equal(slot[alive.flatten()])


def unended(first, count):
    return *batch(first, count)[:4], np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)


def test_a_step_that_was_none_repeats_the_one_before_it_as_an_end():
    replay = ReplayBuffer(20, 3, 2)
    sound = np.array([True, True, False, True])
    replay.extend(*unended(0, 4), sound)
    assert numbers(replay.all()) == [0, 1, 1, 3]
    assert replay.all().truncated.tolist() == [False, True, True, False]
    replay.extend(*unended(4, 1), np.array([False]))
    assert numbers(replay.all()) == [0, 1, 1, 3, 3]
    assert replay.all().truncated.tolist() == [False, True, True, True, True]


def test_a_step_that_was_none_keeps_the_places_of_several_environments():
    replay = ReplayBuffer(6, 3, 2, num_envs=2)
    replay.extend(*unended(0, 2), np.array([False, True]))  # nothing came before: left out
    assert len(replay) == 0
    for first in (2, 4, 6, 8):
        replay.extend(*unended(first, 2), np.array([True, first != 6]))
    assert numbers(replay.all()) == [4, 5, 6, 5, 8, 9]
    assert replay.all().truncated.tolist() == [False, True, False, True, False, False]
    rows, alive, _ = replay.sample_rows(200, 3)
    followed = {
        tuple(row[lives, 0].tolist())
        for row, lives in zip(rows.unflatten(0, (3, 200)).unbind(1), alive.unbind(1), strict=True)
    }
    assert followed == {(4, 6, 8), (6, 8), (8,), (5,), (9,)}


def test_a_first_step_that_was_none_leaves_out_the_steps_beside_it():
    replay = ReplayBuffer(6, 3, 2, num_envs=2)
    replay.extend(*unended(0, 4), np.array([False, True, True, True]))
    assert numbers(replay.all()) == [2, 3]


def broken_episodes(num_episodes, capacity=1_000):
    """Episodes of five steps, the last of which the environment ends with what is no step."""
    replay = ReplayBuffer(capacity, 3, 2)
    for episode in range(num_episodes):
        for number in range(6):
            replay.extend(*unended(10 * episode + number, 1), np.array([number < 5]))
    return replay


def test_an_episode_that_ends_in_steps_that_were_none_is_counted_once():
    assert broken_episodes(20).mean_episode_length() == 6
    assert broken_episodes(0).mean_episode_length() == 0
    replay = broken_episodes(1)
    replay.extend(*unended(0, 3), np.array([False, False, True]))
    assert replay.mean_episode_length() == 9
    add(replay, 1, terminated=True)
    replay.extend(*unended(0, 2), np.array([False, False]))
    assert replay.mean_episode_length() == 6


def test_episodes_of_one_step_that_are_alike_are_counted_one_by_one():
    replay = ReplayBuffer(8, 3, 2)
    for _ in range(6):
        replay.add(**GOOD | {"terminated": True})
    assert replay.mean_episode_length() == 1
    replay.add(**GOOD | {"terminated": True, "truncated": True})
    assert replay.mean_episode_length() == 1


@RESTORES
def test_steps_that_were_none_are_told_from_ends_once_they_are_restored(restore):
    replay = ReplayBuffer(1_000, 3, 2)
    getattr(replay, restore)(broken_episodes(20).state_dict())
    assert replay.mean_episode_length() == 6
    assert replay.all().truncated.sum() == 40


def test_a_step_after_the_end_of_a_task_repeats_that_end():
    replay = ReplayBuffer(20, 3, 2)
    values = dict(zip(Transition._fields, unended(0, 1), strict=True))
    replay.extend(**values | {"terminated": np.array([True])})
    replay.extend(*unended(1, 1), np.array([False]))
    assert replay.all().terminated.tolist() == [True, True]
    assert replay.all().truncated.tolist() == [False, False]


def ends_of(replay):
    """Number of the row that ends the episode of each row that is held, oldest first."""
    held, last = replay.all(), {}
    ended = (held.terminated | held.truncated).tolist()
    size, apart = len(ended), replay.num_envs
    for row in reversed(range(size)):
        goes_on = not ended[row] and row + apart < size
        last[row] = last[row + apart] if goes_on else row
    return last


def check_later(replay):
    """Later steps of every row are those up to the end of its episode, and all of them."""
    oldest, numbered = replay._num_added - len(replay), numbers(replay.all())
    for row, last in ends_of(replay).items():
        slot = torch.full((600,), (oldest + row) % replay.capacity)
        expected = numbered[row : last + 1 : replay.num_envs]
        assert sorted(set(numbers(replay.sample_later(slot)))) == expected


@pytest.mark.parametrize("num_envs", [1, 3])
@pytest.mark.parametrize("capacity", [8, 21, 100])
def test_later_steps_are_of_the_same_episode_to_its_end(capacity, num_envs):
    replay, generator = ReplayBuffer(capacity, 3, 2, num_envs=num_envs), np.random.default_rng(1)
    for step in range(13):
        ends = generator.uniform(size=(2, num_envs)) < 0.15
        replay.extend(*batch(step * num_envs, num_envs)[:4], *ends)
        if step % 3 == 0 or step > 10:
            check_later(replay)
    restored = ReplayBuffer(capacity, 3, 2, num_envs=num_envs)
    restored.extend(*batch(0, num_envs))
    restored.sample_later(torch.tensor([0]))
    restored.load_state_dict(replay.state_dict())
    check_later(restored)
    warm = ReplayBuffer(capacity, 3, 2, num_envs=num_envs)
    warm.take_over(replay.state_dict())
    check_later(warm)


def test_many_rounds_before_the_first_sound_one_are_left_out():
    replay = ReplayBuffer(9, 1, 1)
    number = np.arange(5_000.0)
    sound = number == 4_999
    ends = np.zeros(5_000, dtype=bool)
    replay.extend(number[:, None], 0 * number[:, None], number, number[:, None], ends, ends, sound)
    assert replay.all().reward.tolist() == [4_999.0]


def test_later_steps_end_where_there_was_no_sound_step():
    replay = ReplayBuffer(20, 3, 2)
    for number in range(3):
        add(replay, number + 1)
    check_later(replay)
    replay.extend(*batch(50, 1), sound=np.array([False]))
    check_later(replay)
    assert numbers(replay.sample_later(torch.full((50,), 2))) == [3] * 50


def test_later_steps_are_equally_likely():
    replay = ReplayBuffer(20, 3, 2)
    for number in range(1, 6):
        add(replay, number, truncated=number == 4)
    sampled = replay.sample_later(torch.zeros(40_000, dtype=torch.long)).observation[:, 0]
    share = torch.bincount(sampled.long(), minlength=6) / 40_000
    torch.testing.assert_close(
        share, torch.tensor([0, 0.25, 0.25, 0.25, 0.25, 0]), rtol=0, atol=0.01
    )


def test_to_look_for_ends_samples_nothing():
    one, other = filled(8), filled(8)
    one._last_numbers()
    assert equal(one.sample(20), other.sample(20))


BAD_VALUES = [
    ("reward", math.nan, ValueError, r"`reward` must be finite, got \[nan\]"),
    ("terminated", -1, ValueError, "`terminated` must be False or True, got -1"),
    ("truncated", 0.5, ValueError, "`truncated` must be False or True, got 0.5"),
    ("reward", 1 + 2j, TypeError, r"`reward` must be of real numbers, got \(1\+2j\)"),
    ("reward", "a", TypeError, "`reward` must be of real numbers, got 'a'"),
    ("reward", "1", TypeError, "`reward` must be of real numbers, got '1'"),
    ("action", [0.0, [1.0]], ValueError, "`action` must be an array of real numbers, got"),
    (
        "action",
        torch.zeros(2, requires_grad=True),
        TypeError,
        r"`action` must be detached and on the CPU, got .*requires_grad=True",
    ),
]


@pytest.mark.parametrize(("name", "value", "error", "message"), BAD_VALUES)
def test_what_is_no_number_or_no_flag_is_rejected_and_not_stored(name, value, error, message):
    replay = filled(2)
    with pytest.raises(error, match=message):
        replay.add(**GOOD | {name: value})
    assert numbers(replay.all()) == [0, 1]


@pytest.mark.parametrize("name", Transition._fields)
def test_numbers_hidden_by_a_mask_are_rejected_and_those_that_are_shown_are_taken(name):
    replay = filled(2)
    with pytest.raises(TypeError, match=f"`{name}` must be of real numbers, got .*masked"):
        replay.add(**GOOD | {name: np.ma.masked_array(GOOD[name], mask=True)})
    assert numbers(replay.all()) == [0, 1]
    replay.add(**GOOD | {name: np.ma.masked_array(GOOD[name], mask=False)})
    assert numbers(replay.all()) == [0, 1, 0]


@pytest.mark.parametrize("name", Transition._fields)
def test_several_of_which_one_is_hidden_by_a_mask_are_all_refused(name):
    replay = filled(2)
    values = dict(zip(Transition._fields, unended(2, 3), strict=True))
    masked = np.ma.masked_array(values[name])
    replay.extend(**values | {name: masked})
    masked[1] = np.ma.masked
    with pytest.raises(TypeError, match=f"(?s)`{name}` must be of real numbers, got .*masked"):
        replay.extend(**values | {name: masked})
    assert numbers(replay.all()) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("one", [True, 1, 1.0, np.bool_(True), np.array([True]), [1]])
def test_flags_may_be_written_as_numbers(one):
    replay = ReplayBuffer(2, 3, 2)
    replay.add(**GOOD | {"terminated": one})
    assert replay.all().terminated.tolist() == [True]
    assert replay.all().truncated.tolist() == [False]


@pytest.mark.parametrize(
    ("name", "value", "error", "message"),
    [
        ("terminated", np.array([0, -1, 0]), ValueError, "`terminated` .* got -1 in row 1"),
        ("reward", np.array([0, 1j, 0]), TypeError, "`reward` must be of real numbers, got"),
        ("reward", np.array(["0", "1", "a"]), TypeError, "`reward` must be of real numbers, got"),
        (
            "observation",
            np.zeros((0, 3)),
            ValueError,
            r"`observation` .* at least 1 row, got \(0,",
        ),
        (
            "observation",
            [[0.0] * 3, [0.0], [0.0] * 3],
            ValueError,
            r"`observation` must be an array of real numbers, got \[\[0.0",
        ),
        (
            "next_observation",
            [[0.0] * 3, [0.0], [0.0] * 3],
            ValueError,
            "`next_observation` must be an array of real numbers, got",
        ),
        (
            "observation",
            torch.zeros(3, 3, requires_grad=True),
            TypeError,
            "`observation` must be detached and on the CPU, got",
        ),
        ("sound", [[True], [True, False]], ValueError, "`sound` must be an array of bool, got"),
        ("observation", 1.0, ValueError, r"`observation` must have shape .* got \(\)"),
        ("sound", np.array([True]), ValueError, r"`sound` must have shape \(3,\), got \(1,\)"),
        ("sound", np.ones(3), TypeError, "`sound` must be an array of bool, got float64"),
    ],
)
def test_several_of_which_one_is_no_number_are_all_refused(name, value, error, message):
    replay = filled(2)
    values = dict(zip(Transition._fields, unended(2, 3), strict=True))
    with pytest.raises(error, match=message):
        replay.extend(**values | {name: value})
    assert numbers(replay.all()) == [0, 1]


def test_several_flags_may_be_written_as_numbers():
    replay = ReplayBuffer(8, 3, 2)
    values = dict(zip(Transition._fields, unended(0, 3), strict=True))
    replay.extend(**values | {"terminated": np.array([0.0, 1.0, 0.0])})
    assert replay.all().terminated.tolist() == [False, True, False]


def test_no_bonus_is_known_of_what_is_taken_over():
    replay = filled(8)
    replay.bonus[:] = torch.arange(8.0)
    replay.take_over(filled(5).state_dict())
    assert replay.bonus.isnan().all()


def test_later_steps_are_found_among_fewer_rows_than_were_searched_before():
    for restore in ("take_over", "load_state_dict"):
        replay = filled(8)
        check_later(replay)
        getattr(replay, restore)(filled(3).state_dict())
        check_later(replay)


@pytest.mark.parametrize(
    ("seed", "error", "message"),
    [
        (2**64, ValueError, r"`seed` must lie in \[-2\*\*63, 2\*\*64\), got 18446744073709551616"),
        (1.5, TypeError, "`seed` must be a whole number, got 1.5"),
        ("1", TypeError, "`seed` must be a whole number, got '1'"),
        (True, TypeError, "`seed` must be a whole number, got True"),
    ],
)
def test_a_seed_must_be_one_that_torch_takes(seed, error, message):
    with pytest.raises(error, match=message):
        ReplayBuffer(4, 3, 2, seed=seed)


@pytest.mark.parametrize("seed", [2**64 - 1, -1, np.int64(3)])
def test_a_seed_may_be_any_that_torch_takes(seed):
    assert len(ReplayBuffer(4, 3, 2, seed=seed)) == 0


def test_rows_are_of_single_precision_whatever_the_default():
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        replay = filled(3)
    finally:
        torch.set_default_dtype(before)
    assert replay.bonus.dtype == torch.float32
    assert equal(replay.all(), filled(3).all())
    assert replay.sample(2).observation.dtype == torch.float32


@pytest.mark.parametrize("num_envs", [1, 2])
def test_behind_the_newest_step_is_what_it_led_to(num_envs):
    replay = ReplayBuffer(100, 1, 1, num_envs=num_envs)
    for step in range(5):
        observation = 100.0 * np.arange(num_envs)[:, None] + step
        ended = np.full(num_envs, step == 4)
        zeros = np.zeros(num_envs)
        replay.extend(observation, zeros[:, None], zeros, observation + 1, ended, ended & False)
    rows, alive, _ = replay.sample_rows(256, 4)
    sequences = replay.sequences(rows, alive)
    begun = sequences.steps.observation[:256, 0]
    for num_steps in (1, 3):
        reached = sequences.continuation(num_steps)[:, 0]
        expected = begun // 100 * 100 + torch.clamp(begun % 100 + num_steps, max=5)
        assert reached.equal(expected)
