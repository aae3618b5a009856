"""In whatever torchrl buffer, a bonus learns raw single steps, or says what is wrong."""

import warnings
from collections.abc import Callable
from functools import partial

import pytest
import torch
from tensordict import TensorDict, lazy_stack
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.data import (
    LazyStackStorage,
    LazyTensorStorage,
    ListStorage,
    TensorDictReplayBuffer,
)
from torchrl.data import ReplayBuffer as TorchRLReplayBuffer
from torchrl.data.replay_buffers.samplers import SliceSampler
from torchrl.envs import ParallelEnv, SerialEnv, Transform, TransformedEnv
from torchrl.envs.transforms import (
    CatFrames,
    CatTensors,
    Compose,
    DeviceCastTransform,
    DoubleToFloat,
    DTypeCastTransform,
    MultiStepTransform,
    ObservationNorm,
    RewardClipping,
    RewardScaling,
)
from torchrl.modules import ValueOperator
from torchrl.objectives import SoftUpdate

import deep_curiosity_envs  # noqa: F401  # registers the tasks
from deep_curiosity.bonuses import BonusLearner
from deep_curiosity.integrations.torchrl import (
    BonusLoss,
    CuriosityTransform,
    CuriousActorCriticLoss,
)
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.transitions import Transition
from tests.integrations.test_torchrl import (
    LevelBonus,
    PairValue,
    StepBonus,
    make_actor,
    make_batch,
    make_env,
    make_loss,
)

with warnings.catch_warnings():  # at import they warn of classes of their own
    warnings.simplefilter("ignore", DeprecationWarning)
    from torchrl.collectors.utils import split_trajectories

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


TWICE = "`reward` must be that of the environment, got one to which a CuriosityTransform has added"


@pytest.mark.parametrize("then", [True, False])
def test_a_bonus_is_added_after_all_others_have_been_computed(then: bool) -> None:
    def transform(add: bool) -> CuriosityTransform:
        return CuriosityTransform(LevelBonus(), add_to_reward=add)

    with pytest.raises(ValueError, match=TWICE):
        Compose(transform(True), Compose(transform(then)))(steps(5))
    batch = Compose(transform(False), transform(True))(steps(5))
    torch.testing.assert_close(batch["next", "reward"], steps(5)["next", "reward"] + 0.5)


def test_a_batch_to_which_a_bonus_was_added_is_not_taken_for_a_raw_one() -> None:
    buffer = make_buffer(storage=LazyTensorStorage(100))
    buffer.append_transform(CuriosityTransform(LevelBonus(), add_to_reward=True))
    buffer.extend(steps(20))
    other = make_buffer(storage=LazyTensorStorage(100))
    other.append_transform(CuriosityTransform(LevelBonus(), add_to_reward=True))
    other.extend(buffer.sample())
    with pytest.raises(ValueError, match=TWICE):
        other.sample()
    with pytest.raises(ValueError, match=TWICE):
        ReplayBuffer.from_torchrl(other)


def test_each_of_several_rewards_may_have_a_bonus_of_its_own() -> None:
    data = steps(5)
    data["next", "other"] = {"reward": torch.zeros(5, 1)}
    one = CuriosityTransform(LevelBonus(1.0), add_to_reward=True)
    options = {"reward_key": ("other", "reward"), "out_key": ("other", "curiosity")}
    two = CuriosityTransform(LevelBonus(2.0), add_to_reward=True, **options)
    batch = Compose(one, two)(data)
    assert torch.equal(batch["next", "reward"], data["next", "reward"] + 1)
    assert torch.equal(batch["next", "other", "reward"], torch.full((5, 1), 2.0))


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


class AskedBonus(LevelBonus):
    """Remembers at which transitions it was computed."""

    def __init__(self) -> None:
        super().__init__(slope=1.0)
        self.asked: list[tuple[Tensor, Tensor | None]] = []

    def forward(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None = None
    ) -> Tensor:
        outcome = None if next_observation is None else next_observation.clone()
        self.asked.append((observation.clone(), outcome))
        return super().forward(observation, action)


BOTH = ["observation", ("next", "observation")]


def shifted(batch: TensorDict) -> TensorDict:
    """What says nothing of the entries that it rewrites, in their own memory."""
    for part in (batch, batch["next"]):
        part["observation"].sub_(10).div_(3)
    return batch


REWRITERS = [
    lambda: ObservationNorm(10.0, 3.0, BOTH, standard_normal=True),
    lambda: ObservationNorm(10.0, 3.0, ["observation"]),
    lambda: ObservationNorm(10.0, 3.0, [("next", "observation")]),
    lambda: Compose(Compose(ObservationNorm(10.0, 3.0, BOTH))),
    lambda: shifted,
]
IDS = ["both", "now", "next", "within others", "a function"]


@pytest.mark.parametrize("make", REWRITERS, ids=IDS)
@pytest.mark.parametrize("curiosity_discount", [0.0, 0.97])
@pytest.mark.parametrize("shape", [(20,), (20, 5)])
def test_the_actor_critic_computes_the_bonus_where_it_was_learned(
    make: Callable[[], Transform], curiosity_discount: float, shape: tuple[int, ...]
) -> None:
    bonus, buffer = AskedBonus(), make_buffer(storage=LazyTensorStorage(100))
    buffer.append_transform(CuriosityTransform(BonusLearner(bonus)))
    buffer.append_transform(make())
    buffer.extend(make_batch(*shape))
    batch = buffer.sample()
    make_loss(CuriousActorCriticLoss, bonus, curiosity_discount=curiosity_discount)(batch)
    learned, again = bonus.asked
    assert torch.equal(again[0], learned[0])
    if curiosity_discount == 0:
        assert again[1] is None  # of an action that was not taken
    else:
        assert torch.equal(again[1], learned[1])


def test_the_bonus_loss_is_shown_what_was_there_before_it_was_rewritten() -> None:
    data, real = padded("mask")
    bonus = LevelBonus()
    batch = Compose(curious(), ObservationNorm(10.0, 3.0, BOTH))(data.clone())
    BonusLoss(bonus)(batch)
    (seen,) = bonus.observed
    assert torch.equal(seen.observation, data["observation"][real])
    assert torch.equal(seen.next_observation, seen.observation + 10)


def test_nested_observations_are_set_aside_in_their_place() -> None:
    data = steps(5)
    for part in (data, data["next"]):
        part["robot", "state"] = part.pop("observation")
    key = ("robot", "state")
    transform = CuriosityTransform(StepBonus(), observation_key=key)
    batch = Compose(transform, ObservationNorm(0.0, 2.0, [key, ("next", *key)]))(data.clone())
    for part, before in ((batch, data), (batch["next"], data["next"])):
        assert torch.equal(part["robot", "state_for_bonus"], before[key])
        assert torch.equal(part[key], 2 * before[key])


@pytest.mark.parametrize(
    "transform",
    [
        RewardScaling(0.0, 2.0, [("next", "reward")], [("next", "reward")]),
        DTypeCastTransform(torch.float32, torch.float64, BOTH),
        DoubleToFloat(),
        DeviceCastTransform("cpu"),
        ObservationNorm(0.0, 2.0, ["observation"], ["normed"]),
        CuriosityTransform(LevelBonus()),
    ],
    ids=lambda transform: type(transform).__name__,
)
def test_nothing_is_set_aside_where_observations_stay_as_they_are(transform: Transform) -> None:
    batch = Compose(curious(), transform)(steps(5))
    assert not [key for key in batch.keys(True, True) if "for_bonus" in str(key)]


@pytest.mark.parametrize("kind", [LazyStackStorage, ListStorage])
def test_nothing_is_set_aside_in_storages_that_hand_out_what_they_hold(kind: type) -> None:
    buffer = lazily_stored(kind)
    before = [held.clone() for held in rows_of(buffer)]
    buffer.append_transform(curious())
    buffer.append_transform(ObservationNorm(10.0, 3.0, BOTH))
    sample = buffer.sample()
    assert torch.equal(sample["observation"], 3 * sample["observation_for_bonus"] + 10)
    for now, held in zip(rows_of(buffer), before, strict=True):
        assert set(now.keys(True)) == set(held.keys(True)) and (now == held).all()


def actor_of(key: str) -> TensorDictModule:
    return TensorDictModule(torch.tanh, in_keys=[key], out_keys=["action"])


def asked_before(transform: Transform, policy: TensorDictModule) -> list[Tensor]:
    """Fresh actions that a bonus is given before the batch passes another transform."""
    bonus = LevelBonus()
    Compose(CuriosityTransform(BonusLearner(bonus), policy=policy), transform)(steps(5))
    return bonus.fresh


@pytest.mark.parametrize(
    ("transform", "read", "written"),
    [
        (NORM(), "observation", "observation"),
        (ObservationNorm(0.0, 2.0, KEY, ["normed"]), "normed", "normed"),
        (ObservationNorm(0.0, 2.0, ["action"]), "observation", "action"),
    ],
    ids=["in place", "elsewhere", "action"],
)
def test_what_a_policy_reads_or_writes_may_not_be_rewritten_behind(
    transform: Transform, read: str, written: str
) -> None:
    message = rf"`policy` must read .* got ObservationNorm of \['{written}'\] behind the Curiosity"
    with pytest.raises(ValueError, match=message):
        asked_before(Compose(transform), actor_of(read))


@pytest.mark.parametrize(
    "transform",
    [
        RewardScaling(0.0, 2.0, [("next", "reward")]),
        ObservationNorm(0.0, 2.0, [("next", "observation")]),
        DoubleToFloat(KEY),
    ],
    ids=lambda transform: type(transform).__name__,
)
def test_what_a_policy_does_not_read_may_be_rewritten_behind(transform: Transform) -> None:
    (fresh,) = asked_before(transform, actor_of("observation"))
    assert torch.equal(fresh, steps(5)["observation"].tanh())


def test_a_policy_that_nobody_asks_is_left_alone() -> None:
    Compose(CuriosityTransform(LevelBonus(), policy=actor_of("observation")), NORM())(steps(5))


def test_an_agent_may_read_an_entry_that_is_written_before_the_bonus() -> None:
    actor, critic = make_actor(read="normed"), ValueOperator(PairValue(), ["normed", "action"])
    bonus, seen = AskedBonus(), []
    actor.register_forward_pre_hook(lambda _, given: seen.append(given[0]["normed"]))
    buffer = make_buffer(storage=LazyTensorStorage(100))
    own = ["normed", ("next", "normed")]
    buffer.append_transform(ObservationNorm(10.0, 3.0, BOTH, own, standard_normal=True))
    buffer.append_transform(CuriosityTransform(BonusLearner(bonus), policy=actor))
    buffer.extend(make_batch(20))
    batch = buffer.sample()
    assert torch.equal(seen[0], batch["normed"])
    loss = CuriousActorCriticLoss(actor, critic, bonus)
    SoftUpdate(loss, tau=0.1)
    loss(batch)
    for observation, next_observation in bonus.asked:
        assert torch.equal(observation, batch["observation"])
        assert torch.equal(next_observation, batch["next", "observation"])


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


def test_a_copy_leaves_padding_out_or_refuses_it() -> None:
    data, real = padded("mask")
    buffer = make_buffer(storage=LazyTensorStorage(100))
    buffer.extend(data.reshape(-1))
    copy = ReplayBuffer.from_torchrl(buffer)
    assert torch.equal(copy.all().observation, data["observation"][real])
    buffer = make_buffer()
    buffer.extend(data)
    with pytest.raises(ValueError, match=r"`buffer` must hold no padding .* got 8 padding steps"):
        ReplayBuffer.from_torchrl(buffer)


def listed(*rows: object, capacity: int = 10) -> TorchRLReplayBuffer:
    buffer = TorchRLReplayBuffer(storage=ListStorage(capacity), batch_size=4)
    for row in rows:
        buffer.extend([row])
    return buffer


@pytest.mark.parametrize("count", [7, 10, 13])
def test_a_list_of_rows_is_copied_oldest_first(count: int) -> None:
    rows = steps(count).unbind(0)
    for number, row in enumerate(rows):
        row["ragged"] = torch.zeros(1 + number % 3)
    copy = ReplayBuffer.from_torchrl(listed(*rows))
    assert torch.equal(copy.all().observation, steps(count)["observation"][-10:])


@pytest.mark.parametrize(
    ("rows", "kind", "message"),
    [
        ((), ValueError, "`buffer` must hold a transition, got an empty one"),
        ((1, 2), TypeError, "`buffer` must hold tensordicts, got int"),
        ((steps(3), steps(3)), ValueError, r"`buffer` must hold single .* shape \(3,\)"),
    ],
)
def test_a_list_of_what_are_no_transitions_is_refused(
    rows: tuple, kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        ReplayBuffer.from_torchrl(listed(*rows))


def test_a_copy_refuses_what_is_not_finite() -> None:
    buffer = filled(100)
    buffer.storage[:]["observation"][1, 1] = torch.nan
    with pytest.raises(ValueError, match="`observation` must be finite, got"):
        ReplayBuffer.from_torchrl(buffer)


MASKS = ["mask", ("collector", "mask")]


def padded(key: str | tuple[str, ...]) -> tuple[TensorDict, Tensor]:
    """Trajectories of 5, 2 and no steps, brought to one length, and which steps are real."""
    data = steps(NUM_ENVS, 5)
    real = torch.arange(5) < torch.tensor([5, 2, 0]).unsqueeze(1)
    data[key] = real
    for name in ("observation", "action"):
        data[name][~real] = 0.0
        data["next", "observation"][~real] = 0.0
    return data, real


@pytest.mark.parametrize("key", MASKS)
@pytest.mark.parametrize("add_to_reward", [True, False])
def test_padding_is_not_learned_and_has_no_bonus(key: str, add_to_reward: bool) -> None:
    data, real = padded(key)
    bonus = LevelBonus()
    transform = CuriosityTransform(BonusLearner(bonus), add_to_reward=add_to_reward)
    batch = transform(data)
    (seen,) = bonus.observed
    assert torch.equal(seen.observation, data["observation"][real])
    assert torch.equal(seen.next_observation, seen.observation + 10)
    paid = batch["next", "curiosity"].squeeze(-1)
    assert paid.shape == real.shape and (paid[~real] == 0).all() and (paid[real] != 0).all()
    added = batch["next", "reward"] - data["next", "reward"]
    torch.testing.assert_close(added, batch["next", "curiosity"] * add_to_reward)


@pytest.mark.parametrize("key", MASKS)
def test_each_step_beside_padding_has_the_bonus_of_its_own(key: str) -> None:
    data, real = padded(key)
    data["action"] = torch.rand_like(data["action"])
    paid = CuriosityTransform(LevelBonus(0.5, slope=1.0))(data)["next", "curiosity"]
    torch.testing.assert_close(paid, torch.where(real.unsqueeze(-1), 0.5 + data["action"], 0.0))


def test_the_policy_is_asked_at_the_steps_beside_padding() -> None:
    data, real = padded("mask")
    data["goal"] = torch.rand_like(data["action"])
    policy = TensorDictModule(lambda goal: goal, in_keys=["goal"], out_keys=["action"])
    bonus = LevelBonus()
    CuriosityTransform(BonusLearner(bonus), policy=policy)(data)
    torch.testing.assert_close(bonus.fresh[0], data["goal"][real])


def test_padding_alone_teaches_nothing() -> None:
    data = padded("mask")[0][2:]
    bonus = LevelBonus()
    batch = CuriosityTransform(BonusLearner(bonus))(data)
    assert not bonus.observed and (batch["next", "curiosity"] == 0).all()
    with pytest.raises(ValueError, match="`mask` must leave a step to learn from, got padding"):
        BonusLoss(bonus)(data)


@pytest.mark.parametrize("key", MASKS)
def test_the_bonus_loss_leaves_padding_out(key: str) -> None:
    data, real = padded(key)
    bonus = LevelBonus()
    BonusLoss(bonus)(data)
    (seen,) = bonus.observed
    assert torch.equal(seen.observation, data["observation"][real])


def test_what_torchrl_splits_is_learned_as_it_was() -> None:
    rollout = steps(7)
    rollout["next", "done"] = (torch.arange(7) == 4).unsqueeze(-1)
    bonus = LevelBonus()
    CuriosityTransform(BonusLearner(bonus))(split_trajectories(rollout))
    assert torch.equal(bonus.observed[0].observation, rollout["observation"])


def test_a_mask_of_something_else_is_left_aside() -> None:
    data = steps(4)
    data["mask"] = torch.zeros(4, 9, dtype=torch.bool)
    bonus = LevelBonus()
    CuriosityTransform(BonusLearner(bonus))(data)
    assert len(bonus.observed[0].reward) == 4
