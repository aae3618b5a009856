"""In whatever torchrl buffer, a bonus learns raw single steps, or says what is wrong."""

from collections.abc import Callable
from functools import partial

import pytest
import torch
from tensordict import TensorDict, lazy_stack
from torchrl.data import (
    LazyStackStorage,
    LazyTensorStorage,
    ListStorage,
    TensorDictReplayBuffer,
)
from torchrl.data.replay_buffers.samplers import SliceSampler
from torchrl.envs import ParallelEnv, SerialEnv, Transform, TransformedEnv
from torchrl.envs.transforms import (
    CatFrames,
    CatTensors,
    Compose,
    DoubleToFloat,
    DTypeCastTransform,
    MultiStepTransform,
    ObservationNorm,
    RewardClipping,
    RewardScaling,
)

import deep_curiosity_envs  # noqa: F401  # registers the tasks
from deep_curiosity.bonuses import BonusLearner
from deep_curiosity.integrations.torchrl import BonusLoss, CuriosityTransform
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.transitions import Transition
from tests.integrations.test_torchrl import LevelBonus, StepBonus, make_env

NUM_ENVS, NUM_STEPS = 3, 7


def steps(*shape: int, start: float = 0.0) -> TensorDict:
    """Environments that count their steps in tens, each beginning at its own number."""
    *envs, num_steps = shape
    first = torch.arange(torch.Size(envs).numel()).reshape(*envs, 1, 1).float()
    number = first + 10 * (start + torch.arange(num_steps).reshape(-1, 1).float())
    flags = torch.zeros(*shape, 1, dtype=torch.bool)
    outcome = {
        "observation": number + 10,
        "reward": number / 2,
        "done": flags,
        "terminated": flags,
        "truncated": flags,
    }
    action = torch.zeros_like(number)
    return TensorDict({"observation": number, "action": action, "next": outcome}, shape)


def shown(buffer: TensorDictReplayBuffer, *before: Transform) -> Transition:
    """What a bonus is shown of one batch."""
    bonus = LevelBonus()
    for transform in before:
        buffer.append_transform(transform)
    buffer.append_transform(CuriosityTransform(BonusLearner(bonus)))
    if not len(buffer):
        buffer.extend(steps(NUM_ENVS, NUM_STEPS))
    buffer.sample()
    (batch,) = bonus.observed
    return batch


def make_buffer(**options: object) -> TensorDictReplayBuffer:
    options = {"storage": LazyTensorStorage(100, ndim=2), "batch_size": 12} | options
    return TensorDictReplayBuffer(**options)


def filled(capacity: int, *, rounds: int = 1) -> TensorDictReplayBuffer:
    buffer = make_buffer(storage=LazyTensorStorage(capacity, ndim=2))
    for number in range(rounds):
        buffer.extend(steps(NUM_ENVS, NUM_STEPS, start=number * NUM_STEPS))
    return buffer


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"sampler": SliceSampler(num_slices=3, end_key=("next", "done"), strict_length=False)},
        {"storage": ListStorage(100)},
    ],
    ids=["two dimensions", "slices", "list"],
)
def test_what_is_learned_is_the_raw_successor_of_one_step(options: dict) -> None:
    buffer = make_buffer(**options)
    two_dimensional = getattr(buffer.storage, "ndim", 1) == 2
    data = steps(NUM_ENVS, NUM_STEPS)
    buffer.extend(data if two_dimensional else data.reshape(-1))
    batch = shown(buffer)
    assert torch.equal(batch.next_observation, batch.observation + 10)
    assert torch.equal(batch.reward, batch.observation[:, 0] / 2)
    assert not batch.terminated.any()


def lazily_stored(kind: type) -> TensorDictReplayBuffer:
    """A buffer whose samples are its own rows, side by side, as where they differ in length."""
    buffer = TensorDictReplayBuffer(storage=kind(100), batch_size=8)
    rows = list(steps(20).unbind(0))
    for number, row in enumerate(rows):
        row["ragged"] = torch.zeros(1 + number % 3)
    buffer.extend(lazy_stack(rows))
    return buffer


def rows_of(buffer: TensorDictReplayBuffer) -> list[TensorDict]:
    """What is stored, but for what torchrl writes there itself."""
    return [buffer.storage.get(row).exclude("index") for row in range(len(buffer))]


@pytest.mark.parametrize("kind", [LazyStackStorage, ListStorage])
@pytest.mark.parametrize("add_to_reward", [True, False])
def test_storages_that_hand_out_what_they_hold_stay_as_they_were(
    kind: type, add_to_reward: bool
) -> None:
    buffer = lazily_stored(kind)
    before = [held.clone() for held in rows_of(buffer)]
    transform = CuriosityTransform(LevelBonus(0.5), add_to_reward=add_to_reward)
    buffer.append_transform(transform)
    assert (buffer[3]["next", "curiosity"] == 0.5).all()
    for _ in range(50):
        sample = buffer.sample()
        bonus = sample["next", "reward"] - sample["observation"] / 2
        torch.testing.assert_close(bonus, torch.full((8, 1), 0.5 * add_to_reward))
    for now, held in zip(rows_of(buffer), before, strict=True):
        assert (now == held).all() and set(now["next"].keys()) == set(held["next"].keys())


@pytest.mark.parametrize("make", [SerialEnv, pytest.param(ParallelEnv, marks=pytest.mark.slow)])
def test_the_rollout_of_several_environments_is_learned_step_by_step(make: type) -> None:
    env = make(2, make_env)
    rollout = env.rollout(5)
    env.close()
    buffer = make_buffer()
    buffer.extend(rollout)
    batch = shown(buffer)
    held = {tuple(row) for row in rollout["next", "observation"].reshape(-1, 3).tolist()}
    assert {tuple(row) for row in batch.next_observation.tolist()} <= held
    assert len(batch.reward) == 12


@pytest.mark.parametrize(
    ("transform", "name"),
    [
        (ObservationNorm(0.0, 2.0, ["observation"]), "ObservationNorm"),
        (ObservationNorm(0.0, 2.0, [("next", "observation")]), "ObservationNorm"),
        (RewardScaling(0.0, 2.0, [("next", "reward")]), "RewardScaling"),
        (RewardClipping(-1.0, 1.0, [("next", "reward")]), "RewardClipping"),
    ],
)
def test_what_changes_the_numbers_must_come_after_the_bonus(
    transform: Transform, name: str
) -> None:
    with pytest.raises(
        ValueError, match=f"`transform` must come before .* got {name} of .*append the Curiosity"
    ):
        shown(make_buffer(), transform)


def test_what_changes_the_numbers_is_found_within_others() -> None:
    outer = Compose(Compose(ObservationNorm(0.0, 2.0, ["observation"])), Compose(own := curious()))
    message = "`transform` must come before .* got ObservationNorm of .*observation"
    with pytest.raises(ValueError, match=message):
        outer(steps(5))
    Compose(Compose(own.clone()), RewardScaling(0.0, 2.0, [("next", "reward")]))(steps(5))


def curious() -> CuriosityTransform:
    return CuriosityTransform(LevelBonus())


KEY = ["observation"]
NORM = partial(ObservationNorm, 0.0, 2.0, KEY)


@pytest.mark.parametrize(
    "arrange",
    [
        lambda: Compose(curious(), NORM()),
        lambda: Compose(Compose(curious()), Compose(NORM())),
        lambda: Compose(curious(), CatFrames(2, -1, ["observation"])),
    ],
)
def test_in_an_environment_nothing_may_rewrite_observations_after_the_bonus(
    arrange: Callable[[], Compose],
) -> None:
    env = TransformedEnv(make_env(), arrange())
    with pytest.raises(ValueError, match=r"must come after all .* of 'observation' behind it"):
        env.rollout(2)


def test_in_an_environment_a_wrapper_around_it_is_looked_at_too() -> None:
    env = TransformedEnv(TransformedEnv(make_env(), curious()), NORM(), auto_unwrap=True)
    with pytest.raises(ValueError, match="got ObservationNorm of 'observation' behind it"):
        env.rollout(2)


@pytest.mark.parametrize(
    "arrange",
    [
        lambda own: Compose(NORM(), own),
        lambda own: Compose(own, RewardScaling(0.0, 2.0)),
        lambda own: Compose(own, DTypeCastTransform(torch.float32, torch.float64, KEY)),
    ],
)
def test_in_an_environment_the_bonus_is_given_both_observations_in_one_unit(
    arrange: Callable[[CuriosityTransform], Compose],
) -> None:
    bonus = StepBonus()
    rollout = TransformedEnv(make_env(), arrange(CuriosityTransform(bonus))).rollout(5)
    moved = (rollout["next", "observation"] - rollout["observation"]).sum(-1, keepdim=True)
    torch.testing.assert_close(rollout["next", "curiosity"], moved, check_dtype=False)


def test_what_changes_the_numbers_may_come_after_the_bonus() -> None:
    buffer, bonus = make_buffer(), LevelBonus()
    buffer.append_transform(CuriosityTransform(BonusLearner(bonus)))
    key = [("next", "reward")]
    buffer.append_transform(RewardScaling(0.0, 100.0, key, key))
    buffer.extend(steps(NUM_ENVS, NUM_STEPS))
    scaled = buffer.sample()["next", "reward"]
    torch.testing.assert_close(scaled.flatten(), 100 * bonus.observed[0].reward)


def test_what_keeps_the_numbers_may_come_before_the_bonus() -> None:
    joined = CatTensors(["observation"], "joined", del_keys=False)
    batch = shown(make_buffer(), DoubleToFloat(["observation"]), joined)
    assert torch.equal(batch.next_observation, batch.observation + 10)


def test_outcomes_of_several_steps_are_refused() -> None:
    message = "`next_observation` must be that of one step later, got one of 3 steps"
    with pytest.raises(ValueError, match=message):
        shown(make_buffer(), MultiStepTransform(n_steps=3, gamma=0.9))
    buffer = make_buffer()
    buffer.append_transform(MultiStepTransform(n_steps=3, gamma=0.9))
    buffer.extend(steps(NUM_ENVS, NUM_STEPS))
    for learn in (BonusLoss(LevelBonus()), CuriosityTransform(LevelBonus())):
        with pytest.raises(ValueError, match=message):
            learn(buffer.storage[:])
    with pytest.raises(ValueError, match=message):
        ReplayBuffer.from_torchrl(buffer)


def test_a_window_of_one_step_is_taken() -> None:
    batch = shown(make_buffer(), MultiStepTransform(n_steps=1, gamma=0.9))
    assert torch.equal(batch.next_observation, batch.observation + 10)


@pytest.mark.parametrize(("capacity", "rounds"), [(100, 1), (100, 3), (30, 3)])
def test_storages_of_two_dimensions_are_copied_in_the_order_of_time(
    capacity: int, rounds: int
) -> None:
    copy = ReplayBuffer.from_torchrl(filled(capacity, rounds=rounds))
    num_steps = min(rounds * NUM_STEPS, capacity // NUM_ENVS)
    last = rounds * NUM_STEPS
    number = 10.0 * torch.arange(last - num_steps, last).unsqueeze(-1) + torch.arange(NUM_ENVS)
    held = copy.all()
    assert torch.equal(held.observation[:, 0], number.flatten())
    assert torch.equal(held.next_observation, held.observation + 10)
    assert torch.equal(held.reward, held.observation[:, 0] / 2)


def test_sequences_of_such_a_copy_stay_in_their_environment() -> None:
    copy = ReplayBuffer.from_torchrl(filled(100))
    sequences = copy.sample_sequences(20, 3)
    first, second, _ = sequences.steps.observation.unflatten(0, (3, 20))
    goes_on = sequences.alive[1]
    assert goes_on.any()
    assert torch.equal(second[goes_on], first[goes_on] + 10)


def test_a_copy_refuses_what_is_not_finite() -> None:
    buffer = filled(100)
    buffer.storage[:]["observation"][1, 1] = torch.nan
    with pytest.raises(ValueError, match="`observation` must be finite, got"):
        ReplayBuffer.from_torchrl(buffer)
