"""Laws of the torchrl adapter, with bonuses whose values are known."""

import math
import sys
import warnings
from collections.abc import Callable
from functools import partial
from importlib import import_module, reload
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data import (
    Bounded,
    Composite,
    LazyTensorStorage,
    ListStorage,
    TensorDictReplayBuffer,
    Unbounded,
)
from torchrl.envs import EnvBase, GymEnv, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import HardUpdate, SACLoss, SoftUpdate, ValueEstimators

import deep_curiosity_envs  # noqa: F401  # registers the tasks
from deep_curiosity import requirements
from deep_curiosity.bonuses.base import Bonus, Policy
from deep_curiosity.bonuses.curiosity import CuriosityBonus
from deep_curiosity.bonuses.learner import BonusLearner
from deep_curiosity.bonuses.registry import make_bonus
from deep_curiosity.integrations.check import check_integration
from deep_curiosity.integrations.torchrl import (
    BonusLoss,
    CuriosityTransform,
    CuriousActorCriticLoss,
    TorchRLAgent,
    TorchRLIntegration,
)
from deep_curiosity.integrations.torchrl.integration import total_loss
from deep_curiosity.integrations.torchrl.transform import ONE_AT_A_TIME
from deep_curiosity.transitions import Transition

with warnings.catch_warnings():  # at import they warn of classes of their own
    warnings.simplefilter("ignore", DeprecationWarning)
    from torchrl.collectors import Collector, MultiAsyncCollector, MultiSyncCollector
    from torchrl.trainers import ReplayBufferTrainer, TargetNetUpdaterHook, Trainer

pytestmark = [
    pytest.mark.filterwarnings("ignore:The env passed to Collector is missing:FutureWarning"),
    pytest.mark.filterwarnings("ignore:The '.*' hook stage will be replaced:FutureWarning"),
    pytest.mark.filterwarnings("ignore:No target network updater has been associated"),
]
BATCH = 32


class LevelBonus(Bonus):
    """`level + slope * action`, with a level that learns to be one."""

    def __init__(self, level: float = 0.5, slope: float = 0.0) -> None:
        super().__init__()
        self.level = nn.Parameter(torch.tensor(level))
        self.slope = slope
        self.observed: list[Transition] = []
        self.fresh: list[Tensor] = []

    def forward(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None = None
    ) -> Tensor:
        return self.level.detach() + self.slope * action.sum(-1)

    def loss(self, transition: Transition) -> Tensor:
        return (self.level - 1).square()

    def observe(
        self,
        transition: Transition,
        policy: Policy | None = None,
        visited: Transition | None = None,
    ) -> None:
        self.observed.append(transition)
        if policy is not None:
            self.fresh.append(policy(transition.observation))

    def metrics(self) -> dict[str, Tensor]:
        return {}


class StepBonus(LevelBonus):
    """Sum of what changed in the observation."""

    scores_outcomes = True

    def forward(
        self, observation: Tensor, action: Tensor, next_observation: Tensor | None = None
    ) -> Tensor:
        assert next_observation is not None
        return (next_observation - observation).sum(-1)


class PairValue(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.network = nn.Sequential(nn.Linear(4, 8), nn.Tanh(), nn.Linear(8, 1))

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        return self.network(torch.cat([observation, action], -1))


def make_env() -> EnvBase:
    return GymEnv("deep_curiosity/PendulumSwingup-v0", action_cost=0.1)


def make_actor(high: float = 1.0, read: str = "observation") -> ProbabilisticActor:
    network = nn.Sequential(nn.Linear(3, 2), NormalParamExtractor())
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=[read], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=Bounded(-high, high, (1,)),
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -high, "high": high},
        return_log_prob=True,
    )


def make_networks() -> tuple[ProbabilisticActor, ValueOperator]:
    return make_actor(), ValueOperator(PairValue(), in_keys=["observation", "action"])


def make_batch(*shape: int) -> TensorDict:
    shape = shape or (BATCH,)
    flags = torch.zeros(*shape, 1, dtype=torch.bool)
    outcome = {
        "observation": torch.randn(*shape, 3),
        "reward": torch.randn(*shape, 1),
        "terminated": flags,
        "truncated": flags.clone(),
        "done": flags.clone(),
    }
    return TensorDict(
        {
            "observation": torch.randn(*shape, 3),
            "action": 2 * torch.rand(*shape, 1) - 1,
            "next": outcome,
        },
        batch_size=shape,
    )


def make_replay(transform: CuriosityTransform, batch: TensorDict) -> TensorDictReplayBuffer:
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(100), batch_size=BATCH)
    replay.append_transform(transform)
    replay.extend(batch)
    return replay


def make_loss(make: Callable = CuriousActorCriticLoss, *parts: object, **options: object):
    """A loss with the networks of seed 0, whichever its class."""
    torch.manual_seed(0)
    actor, critic = make_networks()
    loss = make(actor, critic, *parts, **options)
    SoftUpdate(loss, tau=0.1)
    return loss


def small_curiosity() -> CuriosityBonus:
    return CuriosityBonus.default(3, 1, hidden_dims=(8,), components=8, num_members=2)


def read_batch(batch: TensorDict) -> Transition:
    return CuriosityTransform(LevelBonus()).reader.read(batch)


# The transform on a replay buffer


def test_bonus_is_written_and_the_reward_left_alone():
    batch = make_batch(1)
    batch["action"][:], batch["next", "reward"][:] = 0.25, 3.0
    sampled = make_replay(CuriosityTransform(LevelBonus(0.5, slope=2.0)), batch).sample()
    assert torch.allclose(sampled["next", "curiosity"], torch.full((BATCH, 1), 1.0))
    assert torch.equal(sampled["next", "reward"], torch.full((BATCH, 1), 3.0))


def test_bonus_is_added_to_the_sampled_reward_and_never_to_the_storage():
    batch = make_batch()
    raw = batch["next", "reward"].clone()
    replay = make_replay(CuriosityTransform(LevelBonus(0.5), add_to_reward=True), batch)
    for _ in range(3):
        sampled = replay.sample()
        assert torch.equal(sampled["next", "reward"], raw[sampled["index"]] + 0.5)
    assert torch.equal(replay[:]["next", "reward"], raw + 0.5)
    assert torch.equal(replay.storage[:]["next", "reward"], raw)
    assert "curiosity" not in replay.storage[:]["next"].keys()


def test_bonus_is_fresh_after_the_model_has_moved():
    bonus = LevelBonus(0.5)
    replay = make_replay(CuriosityTransform(bonus), make_batch())
    assert replay.sample()["next", "curiosity"].unique().tolist() == [0.5]
    with torch.no_grad():
        bonus.level.fill_(0.75)
    assert replay.sample()["next", "curiosity"].unique().tolist() == [0.75]


def test_learner_learns_at_each_sample_at_its_own_pace():
    bonus = LevelBonus(0.5)
    learner = BonusLearner(bonus, learning_rate=0.125, update_interval=2)
    replay = make_replay(CuriosityTransform(learner), make_batch())
    levels = [replay.sample()["next", "curiosity"][0].item() for _ in range(4)]
    assert levels == pytest.approx([0.625, 0.625, 0.75, 0.75], abs=5e-3)  # Adam steps by its rate
    assert len(bonus.observed) == 4


def test_bonus_alone_learns_nothing():
    bonus = LevelBonus(0.5)
    make_replay(CuriosityTransform(bonus), make_batch()).sample()
    assert bonus.observed == [] and bonus.level.item() == 0.5


def test_policy_gives_the_bonus_fresh_actions_in_the_unit_box():
    bonus, actor = LevelBonus(), make_actor(high=2.0)
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.zero_()
        actor[0].module[0].bias[0] = 20.0  # at the upper edge, whatever the noise
    transform = CuriosityTransform(
        BonusLearner(bonus), policy=actor, action_spec=Bounded(-2, 2, (1,))
    )
    make_replay(transform, make_batch()).sample()
    assert torch.allclose(bonus.fresh[0], torch.ones(BATCH, 1), atol=1e-2)
    assert all(part not in name for name in transform.state_dict() for part in ("policy", "actor"))


def test_a_policy_may_read_other_entries_of_the_batch_and_is_left_as_it_is():
    bonus = LevelBonus()
    network = nn.Sequential(nn.BatchNorm1d(1), nn.Identity())
    policy = TensorDictModule(
        lambda observation, goal: network(goal),
        in_keys=["observation", "goal"],
        out_keys=["action"],
    )
    policy.network = network  # known as a part of the policy
    batch = make_batch(BATCH // 2, 2)
    goal = batch["goal"] = torch.rand(BATCH // 2, 2, 1) * 0.5
    transform = CuriosityTransform(BonusLearner(bonus), policy=policy)
    transform(batch)
    torch.testing.assert_close(bonus.fresh[0], goal.reshape(-1, 1), rtol=1e-4, atol=0)
    assert network[0].running_mean == 0 and network.training


def reading_policy(read: Callable[[Tensor], Tensor], *parts: Tensor) -> TensorDictModule:
    """A policy of the observation, with parameters of its own."""
    policy = TensorDictModule(read, in_keys=["observation"], out_keys=["action"])
    policy.parts = nn.ParameterList(parts)
    return policy


@pytest.mark.parametrize("learn", [CuriosityTransform, BonusLoss])
@pytest.mark.parametrize("shape", [(BATCH,), (BATCH // 2, 2)])
def test_a_policy_is_shown_the_batch_in_the_precision_of_the_batch(
    learn: Callable, shape: tuple[int, ...]
):
    bonus = LevelBonus()
    network = nn.Sequential(nn.Linear(3, 1), nn.Tanh()).double()
    policy = TensorDictModule(network, in_keys=["observation"], out_keys=["action"])
    batch = make_batch(*shape).double()
    batch["mask"] = torch.rand(*shape) < 0.5
    learn(BonusLearner(bonus) if learn is CuriosityTransform else bonus, policy=policy)(batch)
    with torch.no_grad():
        expected = network(batch["observation"][batch["mask"]])
    torch.testing.assert_close(bonus.fresh[0], expected.float())


@pytest.mark.parametrize(
    ("given", "shown"), [(torch.float64, torch.bfloat16), (torch.int64, torch.int64)]
)
def test_a_policy_is_shown_the_batch_where_it_computes(given: torch.dtype, shown: torch.dtype):
    seen = []

    def read(observation: Tensor) -> Tensor:
        seen.append((observation.device.type, observation.dtype))
        return observation[:, :1]

    policy = reading_policy(read, torch.empty(1, device="meta", dtype=torch.bfloat16))
    batch = make_batch()
    batch["observation"] = batch["observation"].to(given)
    with pytest.raises(NotImplementedError, match="Cannot copy out of meta tensor"):
        CuriosityTransform(BonusLearner(LevelBonus()), policy=policy)(batch)
    assert seen == [("meta", shown)]


@pytest.mark.parametrize("batch_size", [[4], [4, 5]])
def test_a_policy_is_shown_each_step_of_a_sequence(batch_size: list[int]):
    batch, bonus = make_batch(4, 5), LevelBonus()
    batch.batch_size = batch_size
    policy = reading_policy(lambda observation: observation[:, :1].clamp(-1, 1))
    CuriosityTransform(BonusLearner(bonus), policy=policy)(batch)
    expected = batch["observation"].reshape(-1, 3)[:, :1].clamp(-1, 1)
    torch.testing.assert_close(bonus.fresh[0], expected)


class LookingAheadBonus(LevelBonus):
    """Asks the policy twice, the second time where an action has led."""

    def observe(
        self,
        transition: Transition,
        policy: Policy | None = None,
        visited: Transition | None = None,
    ) -> None:
        super().observe(transition, policy)
        self.fresh.append(policy(transition.next_observation))


def test_a_bonus_may_ask_the_policy_at_other_observations():
    batch, bonus = make_batch().double(), LookingAheadBonus()
    policy = reading_policy(lambda observation: observation[:, :1].tanh(), torch.zeros(1).double())
    CuriosityTransform(BonusLearner(bonus), policy=policy)(batch)
    for part, fresh in zip((batch, batch["next"]), bonus.fresh, strict=True):
        torch.testing.assert_close(fresh, part["observation"][:, :1].tanh().float())


@pytest.mark.parametrize("name", ["curiosity", "disagreement", "rnd"])
def test_a_buffer_that_prefetches_in_threads_learns_one_batch_at_a_time(name: str):
    bonus = make_bonus(name, 3, 1, hidden_dims=(8,))
    learned = [parameter.requires_grad for parameter in bonus.parameters()]
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(100), batch_size=BATCH, prefetch=3)
    replay.append_transform(CuriosityTransform(BonusLearner(bonus), add_to_reward=True))
    replay.extend(make_batch(50))
    for _ in range(60):
        assert replay.sample()["next", "reward"].isfinite().all()
    with ONE_AT_A_TIME:  # threads still sample ahead, and hold networks fixed meanwhile
        assert [parameter.requires_grad for parameter in bonus.parameters()] == learned


def test_rewards_of_whole_numbers_leave_the_bonus_a_real_one():
    batch = make_batch()
    batch["next", "reward"] = torch.ones(BATCH, 1, dtype=torch.long)
    sample = make_replay(CuriosityTransform(StepBonus(), add_to_reward=True), batch).sample()
    bonus = sample["next", "curiosity"]
    assert bonus.is_floating_point()
    torch.testing.assert_close(sample["next", "reward"], 1 + bonus)


def test_any_batch_shape_is_flattened_and_restored():
    batch = make_batch(4, 5)
    out = CuriosityTransform(LevelBonus(0.0, slope=1.0))(batch)
    assert torch.equal(out["next", "curiosity"], batch["action"])


def test_outcomes_are_given_to_a_bonus_that_scores_them():
    batch = make_batch(4, 5)
    out = CuriosityTransform(StepBonus())(batch)
    moved = (batch["next", "observation"] - batch["observation"]).sum(-1, keepdim=True)
    assert torch.allclose(out["next", "curiosity"], moved)


def test_keys_may_be_nested():
    flat = make_batch()
    batch = TensorDict({}, batch_size=flat.batch_size)
    batch["robot", "state"], batch["robot", "torque"] = flat["observation"], flat["action"]
    batch["next", "robot", "state"] = flat["next", "observation"]
    batch["next", "robot", "pay"] = flat["next", "reward"]
    batch["next", "robot", "fell"] = flat["next", "terminated"]
    transform = CuriosityTransform(
        LevelBonus(0.0, slope=1.0),
        add_to_reward=True,
        observation_key=("robot", "state"),
        action_key=("robot", "torque"),
        reward_key=("robot", "pay"),
        terminated_key=("robot", "fell"),
        out_key=("robot", "wonder"),
    )
    sampled = make_replay(transform, batch).sample()
    assert torch.equal(sampled["next", "robot", "wonder"], sampled["robot", "torque"])
    raw = flat["next", "reward"][sampled["index"]]
    assert torch.allclose(sampled["next", "robot", "pay"], raw + sampled["robot", "torque"])


def test_actions_are_brought_to_the_unit_box():
    batch = make_batch(3)
    batch["action"] = torch.tensor([[0.0], [1.0], [4.0]])
    by_range = CuriosityTransform(LevelBonus(0.0, slope=1.0), low=0.0, high=4.0)
    by_spec = CuriosityTransform(LevelBonus(0.0, slope=1.0), action_spec=Bounded(0, 4, (1,)))
    for transform in (by_range, by_spec):
        bonus = transform(batch.clone())["next", "curiosity"]
        assert torch.allclose(bonus, torch.tensor([[-1.0], [-0.5], [1.0]]))


def test_data_in_double_are_read_in_the_precision_of_the_bonus():
    batch = make_batch().double()
    transform = CuriosityTransform(BonusLearner(small_curiosity()))
    assert transform(batch)["next", "curiosity"].dtype == torch.float64


def test_buffer_state_holds_the_learner():
    batch = make_batch()
    learners = [BonusLearner(small_curiosity()) for _ in range(2)]
    first, second = (make_replay(CuriosityTransform(learner), batch) for learner in learners)
    first.sample()
    second.load_state_dict(first.state_dict())
    assert_same_state(*(learner.state_dict() for learner in learners))
    assert learners[1].every._num_calls == 1


# The transform in an environment


def test_environment_keeps_its_specs():
    check_env_specs(TransformedEnv(make_env(), CuriosityTransform(LevelBonus())))
    nested = CuriosityTransform(LevelBonus(), out_key=("bonus", "curiosity"))
    check_env_specs(TransformedEnv(make_env(), nested))


def test_environment_writes_the_bonus_of_each_step_beside_the_raw_reward():
    env = TransformedEnv(make_env(), CuriosityTransform(LevelBonus(0.5, slope=1.0)))
    plain = make_env()
    for each in (env, plain):
        each.set_seed(0)
    torch.manual_seed(0)
    rollout = env.rollout(5)
    torch.manual_seed(0)
    assert torch.allclose(rollout["next", "curiosity"], rollout["action"] + 0.5)
    assert torch.equal(rollout["next", "reward"], plain.rollout(5)["next", "reward"])


def test_environment_learns_nothing_and_waits_for_the_first_observation():
    learner = BonusLearner(small_curiosity())
    env = TransformedEnv(make_env(), CuriosityTransform(learner))
    before = {name: value.clone() for name, value in learner.state_dict().items()}
    rollout = env.rollout(5)
    assert torch.equal(rollout["next", "curiosity"], torch.zeros(5, 1))
    assert_same_state(before, learner.state_dict())
    learner.learn(read_batch(rollout))
    assert env.rollout(5)["next", "curiosity"].abs().max() > 0


def test_several_environments_have_one_bonus_each():
    env = TransformedEnv(SerialEnv(3, make_env), CuriosityTransform(LevelBonus(0.0, slope=1.0)))
    check_env_specs(env)
    rollout = env.rollout(4)
    assert torch.allclose(rollout["next", "curiosity"], rollout["action"])
    env.close()


# The loss of the bonus


def test_bonus_loss_is_that_of_the_bonus_and_shows_it_the_batch():
    bonus = LevelBonus(0.5)
    assert BonusLoss(bonus)(make_batch())["loss_bonus"].item() == 0.25
    assert len(bonus.observed) == 1
    BonusLoss(bonus, observe=False)(make_batch())
    assert len(bonus.observed) == 1


def test_bonus_loss_trains_the_bonus_by_any_optimizer():
    bonus = LevelBonus(0.5)
    loss = BonusLoss(bonus)
    optimizer = torch.optim.SGD(loss.parameters(), lr=0.25)
    loss(make_batch())["loss_bonus"].backward()
    optimizer.step()
    assert bonus.level.item() == 0.75  # 0.5 - 0.25 * 2 * (0.5 - 1)


def test_bonus_loss_reads_the_keys_it_is_given():
    batch = make_batch()
    batch["push"] = batch.pop("action")
    bonus = LevelBonus()
    loss = BonusLoss(bonus, policy=None)
    loss.set_keys(action="push")
    loss(batch)
    assert torch.equal(bonus.observed[0].action, batch["push"])
    assert "push" in loss.in_keys


def robot_spec(**entries: Bounded) -> Composite:
    return Composite(robot=Composite(torque=Bounded(-2, 2, (1,))), **entries)


@pytest.mark.parametrize("spec", [robot_spec(), robot_spec(action=Bounded(-9, 9, (1,)))])
def test_bonus_loss_finds_the_range_of_an_action_whose_key_is_set_later(spec: Composite):
    batch = make_batch()
    batch["robot", "torque"] = 2 * batch.pop("action")
    bonus = LevelBonus()
    loss = BonusLoss(bonus, action_spec=spec)
    loss.set_keys(observation="observation")
    loss.set_keys(action=("robot", "torque"))
    loss(batch)
    assert torch.equal(bonus.observed[0].action, batch["robot", "torque"] / 2)


def test_bonus_loss_refuses_a_spec_without_the_action():
    loss = BonusLoss(LevelBonus(), action_spec=robot_spec())
    message = r"`action_spec` must have an entry .*, got entries \[\('robot', 'torque'\)\]"
    with pytest.raises(ValueError, match=message):
        loss(make_batch())
    with pytest.raises(ValueError, match=message):
        loss.set_keys(action=("robot", "force"))
    with pytest.raises(ValueError, match="`action_spec` must be bounded, got"):
        BonusLoss(LevelBonus(), action_spec=Unbounded((1,)))
    loss = BonusLoss(LevelBonus(), action_spec=Composite(push=Unbounded((1,))))
    with pytest.raises(ValueError, match="`action_spec` must be bounded, got"):
        loss.set_keys(action="push")


def test_bonus_loss_runs_in_a_trainer():
    bonus = LevelBonus(0.5)
    loss = BonusLoss(bonus)
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(100))
    run_trainer(loss, replay)
    assert bonus.level.item() > 0.5


# The loss of the actor-critic


@pytest.mark.parametrize("options", [{}, {"loss_function": "l2", "alpha_init": 0.3}])
def test_without_bonus_and_with_the_uniform_prior_it_is_sac(options: dict):
    batch = make_batch()
    batch["next", "terminated"][:5] = True
    losses = []
    for make in (SACLoss, CuriousActorCriticLoss):
        loss = make_loss(make, **options)
        torch.manual_seed(1)
        losses.append(loss(batch.clone()))
    assert set(losses[0].keys()) == set(losses[1].keys())
    for name in losses[0].keys():
        assert torch.allclose(losses[0][name], losses[1][name], atol=1e-5), name


@pytest.mark.parametrize(
    "estimator", [ValueEstimators.TD0, ValueEstimators.TD1, ValueEstimators.TDLambda]
)
def test_value_estimators_are_those_of_sac(estimator: ValueEstimators):
    losses = []
    for make in (SACLoss, CuriousActorCriticLoss):
        loss = make_loss(make)
        loss.make_value_estimator(estimator, gamma=0.9)
        torch.manual_seed(1)
        losses.append(loss(make_batch(4, 5))["loss_qvalue"])
    assert torch.allclose(*losses, atol=1e-5)


def test_curiosity_critics_learn_the_bonus_under_a_discount_of_their_own():
    loss = make_loss(CuriousActorCriticLoss, LevelBonus(0.5), loss_function="l2")
    zero_last_layers(loss.curiosity_network_params, bias=2.0)
    zero_last_layers(loss.target_curiosity_network_params, bias=3.0)
    loss.make_value_estimator(gamma=0.0)
    batch = make_batch()
    batch["next", "terminated"][: BATCH // 2] = True
    # errors 2 - 0.5 where the episode terminated, 2 - (0.5 + 0.97 * 3) elsewhere; two critics
    expected = 2 * 0.5 * (1.5**2 + 1.41**2)
    assert loss(batch)["loss_curiosity"].item() == pytest.approx(expected, rel=1e-4)


def test_curiosity_critics_learn_no_bonus_of_padding():
    loss = make_loss(CuriousActorCriticLoss, LevelBonus(0.5), loss_function="l2")
    zero_last_layers(loss.curiosity_network_params, bias=2.0)
    zero_last_layers(loss.target_curiosity_network_params, bias=3.0)
    loss.make_value_estimator(gamma=0.0)
    batch = make_batch()
    batch["mask"] = torch.arange(BATCH) % 2 == 0
    expected = (2 - (0.5 + 2.91)) ** 2 + (2 - (0.0 + 2.91)) ** 2  # one half each, of two critics
    assert loss(batch)["loss_curiosity"].item() == pytest.approx(expected, rel=1e-4)


def test_the_actor_seeks_no_bonus_in_padding():
    loss = make_loss(CuriousActorCriticLoss, LevelBonus(0.5), curiosity_discount=0.0)
    losses = []
    for real in (torch.ones(BATCH, dtype=torch.bool), torch.arange(BATCH) % 2 == 0):
        torch.manual_seed(1)
        losses.append(loss(make_batch().set("mask", real))["loss_actor"].item())
    assert losses[1] - losses[0] == pytest.approx(0.25, abs=1e-5)


def test_reward_of_the_extrinsic_critics_holds_no_bonus():
    batch = make_batch()
    values = []
    for bonus in (LevelBonus(0.5), LevelBonus(1e6)):
        loss = make_loss(CuriousActorCriticLoss, bonus)
        torch.manual_seed(1)
        values.append(loss(batch.clone())["loss_qvalue"])
    assert torch.equal(*values)


@pytest.mark.parametrize("curiosity_discount", [0.0, 0.97])
def test_a_reward_that_holds_the_bonus_already_is_refused(curiosity_discount: float):
    bonus = LevelBonus()
    batch = make_replay(CuriosityTransform(bonus, add_to_reward=True), make_batch()).sample()
    loss = make_loss(CuriousActorCriticLoss, bonus, curiosity_discount=curiosity_discount)
    with pytest.raises(ValueError, match="`reward` must be that of the environment"):
        loss(batch)
    make_loss(CuriousActorCriticLoss)(batch)  # without a bonus of its own
    batch = make_replay(CuriosityTransform(bonus), make_batch()).sample()
    loss(batch)


def test_each_loss_reaches_only_its_own_parameters():
    bonus = LevelBonus(0.5, slope=1.0)
    loss = make_loss(CuriousActorCriticLoss, bonus, prior="learned")
    owners = {
        "loss_actor": loss.actor_network_params,
        "loss_qvalue": loss.qvalue_network_params,
        "loss_curiosity": loss.curiosity_network_params,
        "loss_prior": loss.prior,
    }
    own = {name: set(owner.parameters()) for name, owner in owners.items()}
    own["loss_alpha"] = {loss.log_alpha}
    everything = [*loss.parameters(), *bonus.parameters()]
    losses = loss(make_batch())
    for name, parameters in own.items():
        gradients = torch.autograd.grad(
            losses[name], everything, retain_graph=True, allow_unused=True
        )
        reached = {
            part for part, grad in zip(everything, gradients, strict=True) if grad is not None
        }
        assert reached == parameters, name


@pytest.mark.parametrize("updater", [SoftUpdate, HardUpdate])
def test_updaters_move_both_pairs_of_targets(updater: type):
    actor, critic = make_networks()
    loss = CuriousActorCriticLoss(actor, critic, LevelBonus())
    options = {"tau": 0.25} if updater is SoftUpdate else {"value_network_update_interval": 0}
    target = updater(loss, **options)
    share = 0.25 if updater is SoftUpdate else 1.0
    for name in ("qvalue_network", "curiosity_network"):
        source = next(getattr(loss, f"{name}_params").parameters())
        moved = next(iter(getattr(loss, f"target_{name}_params").buffers()))
        before = moved.clone()
        with torch.no_grad():
            source.add_(1.0)
        target.step()
        assert torch.allclose(moved, before + share, atol=1e-5), name


def test_a_huge_bonus_moves_the_actor():
    loss = make_loss(CuriousActorCriticLoss, LevelBonus(0.0, slope=1e3))
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-2)
    batch = make_batch(256)
    policy = loss.get_stateful_net("actor_network", copy=False)
    before = policy.get_dist(batch.clone()).deterministic_sample.mean().item()
    for _ in range(40):
        optimizer.zero_grad()
        total_loss(loss(batch.clone())).backward()
        optimizer.step()
    policy = loss.get_stateful_net("actor_network", copy=False)
    assert policy.get_dist(batch.clone()).deterministic_sample.mean().item() > max(before, 0.5)


def test_without_curiosity_discount_the_actor_maximises_the_bonus_itself():
    steep = make_loss(CuriousActorCriticLoss, LevelBonus(0.0, slope=1.0), curiosity_discount=0.0)
    level = make_loss(CuriousActorCriticLoss, LevelBonus(0.5), curiosity_discount=0.0)
    plain = make_loss()
    assert "loss_curiosity" not in steep.out_keys
    losses = []
    for loss in (steep, level, plain):
        torch.manual_seed(1)
        losses.append(loss(make_batch())["loss_actor"])
    assert losses[1].item() == pytest.approx(losses[2].item() - 0.5, abs=1e-5)
    gradients = [
        torch.autograd.grad(value, list(loss.actor_network_params.parameters()))[1]
        for value, loss in zip(losses, (steep, level, plain), strict=True)
    ]
    assert torch.allclose(gradients[1], gradients[2], atol=1e-6)
    assert gradients[0][0] < gradients[2][0]  # the mean is pushed up


def test_hunger_weighs_the_extrinsic_value_and_may_be_set():
    loss = make_loss(alpha_init=1e-9)
    zero_last_layers(loss.qvalue_network_params, bias=2.0)
    assert loss(make_batch())["loss_actor"].item() == pytest.approx(-2.0, abs=1e-4)
    loss.hunger = 0.25
    assert loss(make_batch())["loss_actor"].item() == pytest.approx(-0.5, abs=1e-4)


def test_information_cost_does_not_depend_on_the_unit_of_actions():
    costs = []
    for high in (1.0, 2.0):
        torch.manual_seed(0)
        actor, critic = make_actor(high), make_networks()[1]
        torch.manual_seed(1)
        loss = CuriousActorCriticLoss(actor, critic, prior="learned")
        torch.manual_seed(2)
        costs.append(loss._sample(make_batch()).information_cost)
    assert torch.allclose(*costs, atol=1e-3)


def test_information_cost_is_zero_where_policy_and_prior_are_one():
    loss = make_loss(CuriousActorCriticLoss, prior="learned")
    with torch.no_grad():
        loss.prior.raw_loc.zero_()
        loss.prior.raw_std.fill_(50.0)
        loss.actor_network_params.zero_()
        std = torch.tensor(1 + 0.05)  # of the prior, with its floor
        loss.actor_network_params["module", "0", "module", "0", "bias"][1] = (
            std.expm1().log() - torch.tensor(1.0).expm1().log()
        )
    cost = loss._sample(make_batch(256)).information_cost
    assert cost.abs().max() < 0.25  # the prior keeps a tenth for the uniform density


def test_temperature_rises_while_the_rate_is_above_target():
    for rate, sign in ((0.0, -1), (100.0, 1)):
        for prior in ("uniform", "learned"):
            loss = make_loss(prior=prior, target_information_rate=rate)
            (gradient,) = torch.autograd.grad(loss(make_batch())["loss_alpha"], [loss.log_alpha])
            assert gradient.sign() == sign


def test_losses_read_the_keys_they_are_given():
    batch = make_batch()
    renamed = batch.clone()
    renamed["next", "pay"] = renamed["next"].pop("reward")
    renamed["next", "fell"] = renamed["next"].pop("terminated")
    losses = []
    for data, keys in ((batch, {}), (renamed, {"reward": "pay", "terminated": "fell"})):
        loss = make_loss(CuriousActorCriticLoss, LevelBonus(0.5, slope=1.0))
        loss.set_keys(**keys)
        torch.manual_seed(1)
        losses.append(loss(data))
    for name in losses[0].keys():
        assert torch.equal(losses[0][name], losses[1][name]), name


def test_critics_given_as_a_list_are_taken():
    torch.manual_seed(0)
    actor, critic = make_networks()
    loss = CuriousActorCriticLoss(actor, [critic, make_networks()[1]], LevelBonus())
    assert loss(make_batch())["loss_curiosity"].isfinite()


def test_td_error_is_written_for_prioritized_replay():
    loss = make_loss(CuriousActorCriticLoss, LevelBonus(7.0))
    zero_last_layers(loss.qvalue_network_params, bias=2.0)
    with torch.no_grad():  # which of two critics errs most depends on the row
        loss.qvalue_network_params["module", "network", "2", "bias"][1] = -1.0
    zero_last_layers(loss.target_qvalue_network_params, bias=3.0)
    loss.make_value_estimator(gamma=0.9)
    batch = make_batch()
    batch["next", "terminated"][: BATCH // 2] = True
    loss(batch)
    target = batch["next", "reward"].flatten()  # of the reward alone; there is no price here
    target[BATCH // 2 :] += 0.9 * 3.0
    expected = torch.maximum((2.0 - target).abs(), (-1.0 - target).abs())
    torch.testing.assert_close(batch["td_error"], expected)


def test_a_batch_keeps_all_else_as_it_is():
    batch = make_batch()
    before = set(batch.keys(True, True))
    make_loss(CuriousActorCriticLoss, LevelBonus())(batch)
    assert set(batch.keys(True, True)) - before == {"td_error"}


@pytest.mark.filterwarnings("ignore")
def test_an_actor_that_knows_no_range_acts_between_minus_one_and_one():
    plain, critic = make_networks()
    actor = ProbabilisticActor(
        plain[0],
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    loss = CuriousActorCriticLoss(actor, critic, LevelBonus(), action_spec=None)
    assert (loss.box.low.item(), loss.box.high.item()) == (-1.0, 1.0)


def test_curiosity_that_is_not_ready_counts_as_zero():
    for discount in (0.0, 0.97):
        loss = make_loss(CuriousActorCriticLoss, small_curiosity(), curiosity_discount=discount)
        assert total_loss(loss(make_batch())).isfinite()


def test_state_of_the_loss_goes_round():
    first, second = (
        make_loss(CuriousActorCriticLoss, LevelBonus(), prior="learned", hunger=hunger)
        for hunger in (0.5, 1.0)
    )
    optimizer = torch.optim.Adam(first.parameters(), lr=1e-2)
    total_loss(first(make_batch())).backward()
    optimizer.step()
    second.load_state_dict(first.state_dict())
    batch = make_batch()
    losses = []
    for loss in (first, second):
        torch.manual_seed(1)
        losses.append(total_loss(loss(batch.clone())).item())
    assert losses[0] == losses[1]


def test_actor_critic_runs_in_a_trainer_with_the_transform():
    learner = BonusLearner(small_curiosity())
    loss = make_loss(CuriousActorCriticLoss, learner.bonus)
    before = [part.clone() for part in loss.curiosity_network_params.parameters()]
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(100))
    replay.append_transform(CuriosityTransform(learner))
    run_trainer(loss, replay, loss.actor_network)
    after = loss.curiosity_network_params.parameters()
    assert all(not torch.equal(old, new) for old, new in zip(before, after, strict=True))
    assert learner.every._num_calls == 4


# Collectors


def test_collector_fills_a_buffer_that_samples_the_bonus():
    actor = make_actor()
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(100), batch_size=BATCH)
    replay.append_transform(CuriosityTransform(LevelBonus(0.0, slope=1.0)))
    collector = Collector(make_env(), actor, frames_per_batch=20, total_frames=40)
    for rollout in collector:
        replay.extend(rollout)
        sampled = replay.sample()
        assert torch.allclose(sampled["next", "curiosity"], sampled["action"])
    collector.shutdown()
    assert len(replay) == 40


@pytest.mark.slow
@pytest.mark.parametrize("collector_class", [MultiSyncCollector, MultiAsyncCollector])
def test_collectors_of_several_processes_carry_the_transform(collector_class: type):
    collector = collector_class(
        [make_curious_env, make_curious_env],
        make_actor(),
        frames_per_batch=20,
        total_frames=40,
    )
    try:
        for rollout in collector:
            flat = rollout.reshape(-1)
            assert torch.allclose(flat["next", "curiosity"], flat["action"] + 0.5)
    finally:
        collector.shutdown()


def make_curious_env() -> EnvBase:
    return TransformedEnv(make_env(), CuriosityTransform(LevelBonus(0.5, slope=1.0)))


# The integration


def make_agent(
    make: Callable[..., SACLoss] = SACLoss,
    capacity: int = 1_000,
    storage: type = LazyTensorStorage,
) -> TorchRLAgent:
    torch.manual_seed(0)
    learner = BonusLearner(small_curiosity())
    actor, critic = make_networks()
    curious = make is CuriousActorCriticLoss
    loss = make(actor, critic, *([learner.bonus] if curious else []))
    transform = CuriosityTransform(learner, add_to_reward=not curious)
    replay = TensorDictReplayBuffer(storage=storage(capacity), batch_size=16)
    replay.append_transform(transform)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-2)
    target = SoftUpdate(loss, tau=0.1)
    return TorchRLAgent(make_env(), actor, loss, optimizer, target, replay, transform)


def make_curious_agent() -> TorchRLAgent:
    return make_agent(CuriousActorCriticLoss)


AGENTS = [make_agent, make_curious_agent]


@pytest.mark.parametrize("make", AGENTS)
def test_integration_collects_what_it_stores_and_the_same_for_one_seed(make: Callable):
    first, second = TorchRLIntegration(make), TorchRLIntegration(make)
    given = first.collect(30, seed=3)
    for name, part in given._asdict().items():
        assert torch.equal(part, getattr(first.stored(), name)), name
        assert torch.equal(part, getattr(second.collect(30, seed=3), name)), name


@pytest.mark.parametrize("storage", [LazyTensorStorage, ListStorage])
def test_integration_stores_in_the_order_of_collecting_when_the_ring_is_full(storage: type):
    integration = TorchRLIntegration(partial(make_agent, capacity=50, storage=storage))
    parts = [integration.collect(30, seed=seed) for seed in (0, 1)]
    both = torch.cat([part.observation for part in parts])
    assert torch.equal(integration.stored().observation, both[-50:])


@pytest.mark.parametrize("make", AGENTS)
def test_integration_learns_and_comes_back_as_it_was_saved(make: Callable, tmp_path: Path):
    first = TorchRLIntegration(make)
    first.collect(30, seed=0)
    before = [part.clone() for part in (*first.actor(), *first.critic())]
    first.learn(seed=0)
    moved = zip(before, (*first.actor(), *first.critic()), strict=True)
    assert all(not torch.equal(*pair) for pair in moved)
    first.save(tmp_path / "agent")
    second = first.load(tmp_path / "agent")
    assert second.bonus is not first.bonus
    for integration in (first, second):
        integration.learn(seed=1)
    assert_same_state(first.bonus.state_dict(), second.bonus.state_dict())
    for pair in zip(
        (*first.actor(), *first.critic()), (*second.actor(), *second.critic()), strict=True
    ):
        assert torch.equal(*pair)
    assert torch.equal(first.stored().reward, second.stored().reward)


@pytest.mark.parametrize(
    "make", [pytest.param(make_agent, marks=pytest.mark.slow), make_curious_agent]
)
def test_integration_passes_the_check(make: Callable):
    report = check_integration(TorchRLIntegration(make), num_steps=220)
    assert report.passed, str(report)


# Errors


def test_unbounded_actions_are_refused():
    with pytest.raises(ValueError, match="`action_spec` must be bounded"):
        CuriosityTransform(LevelBonus(), action_spec=Unbounded((1,)))
    elsewhere = Composite(agent=Composite(move=Bounded(-2, 2, (1,))))
    with pytest.raises(ValueError, match=r"an entry 'action', .* \[\('agent', 'move'\)\]"):
        CuriosityTransform(LevelBonus(), action_spec=elsewhere)


@pytest.mark.parametrize("bonus", [LevelBonus(), "curiosity", 3, nn.Linear(1, 1)])
@pytest.mark.parametrize(
    "make", [CuriosityTransform, BonusLoss, lambda bonus: make_loss(bonus=bonus)]
)
@pytest.mark.filterwarnings("ignore")
def test_what_is_no_bonus_is_refused_at_once(make: Callable, bonus: object):
    if isinstance(bonus, Bonus):
        assert make(bonus).out_keys
        return
    with pytest.raises(TypeError, match=r"`bonus` must be a Bonus.*, got ('cur|3|Linear\()"):
        make(bonus)


@pytest.mark.parametrize("make", [CuriosityTransform, BonusLoss])
@pytest.mark.parametrize("policy", [None, nn.Linear(3, 1), torch.tanh, TensorDictModule])
def test_a_policy_that_does_not_name_what_it_reads_is_refused_at_once(
    make: Callable, policy: object
):
    if policy is None:
        assert make(LevelBonus(), policy=policy).policy is None
        return
    message = r"`policy` must be a TensorDictModule.*, got (Linear\(|<built-in|<class)"
    with pytest.raises(TypeError, match=message):
        make(LevelBonus(), policy=policy)


def test_a_policy_that_writes_no_action_is_named():
    policy = TensorDictModule(nn.Linear(3, 1), in_keys=["observation"], out_keys=["push"])
    transform = CuriosityTransform(BonusLearner(LevelBonus()), policy=policy)
    with pytest.raises(KeyError, match=r"`action` must be among .* got .*'push'"):
        transform(make_batch())


def test_an_empty_range_is_refused():
    with pytest.raises(
        ValueError, match=r"`low` must be finite and below `high`, got 1.0 and 1.0"
    ):
        BonusLoss(LevelBonus(), low=1.0, high=1.0)


WIDE = torch.tensor(-1e300, dtype=torch.float64)


@pytest.mark.parametrize(("low", "high"), [(-3e38, 3e38), (WIDE, 0.0)])
def test_a_range_wider_than_float32_holds_is_refused(low: float | Tensor, high: float):
    with pytest.raises(ValueError, match="`low` must be finite and below `high`, got"):
        CuriosityTransform(LevelBonus(), low=low, high=high)


def test_small_whole_actions_have_their_whole_range():
    spec = Bounded(-128, 127, (1,), dtype=torch.int8)
    batch = make_batch(2)
    batch["action"] = torch.tensor([[-128], [127]], dtype=torch.int8)
    transform = CuriosityTransform(LevelBonus(0.0, slope=1.0), action_spec=spec)
    bonus = transform(batch)["next", "curiosity"]
    torch.testing.assert_close(bonus, torch.tensor([[-1.0], [1.0]]))


def test_a_reward_of_another_shape_is_refused():
    batch = make_batch()
    batch["next", "reward"] = torch.zeros(BATCH, 2)
    with pytest.raises(ValueError, match="`reward` must hold one number for each of 32"):
        CuriosityTransform(LevelBonus())(batch)


def test_a_missing_entry_is_named():
    batch = make_batch()
    batch["next"].pop("terminated")
    with pytest.raises(KeyError, match=r"`terminated` must be among the entries, got .*'reward'"):
        CuriosityTransform(LevelBonus())(batch)


def test_a_missing_clock_is_taken_for_none():
    batch = make_batch()
    batch["next"].pop("truncated")
    assert not read_batch(batch).truncated.any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"curiosity_discount": 1.0}, r"`curiosity_discount` must lie in \[0, 1\), got 1.0"),
        ({"curiosity_discount": "x"}, r"`curiosity_discount` must lie in \[0, 1\), got 'x'"),
        ({"hunger": -1.0}, "`hunger` must be finite and not negative, got -1.0"),
        ({"hunger": None}, "`hunger` must be finite and not negative, got None"),
        (
            {"target_information_rate": math.nan},
            "`target_information_rate` must be a finite number or None, got nan",
        ),
        ({"target_information_rate": -1.0}, "`target_information_rate` must not be negative"),
        (
            {"bonus": StepBonus(), "curiosity_discount": 0.0},
            "`curiosity_discount` must be above 0 with a bonus that scores outcomes",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_numbers_out_of_range_are_refused(options: dict, message: str):
    with pytest.raises(ValueError, match=message):
        make_loss(CuriousActorCriticLoss, **options)


@pytest.mark.parametrize("hunger", [math.nan, math.inf, -1.0, None, "x", torch.tensor(-1.0)])
def test_a_hunger_that_is_none_is_refused_at_any_step(hunger: object):
    loss = make_loss(CuriousActorCriticLoss, LevelBonus(), hunger=0.5)
    with pytest.raises(ValueError, match="`hunger` must be finite and not negative, got"):
        loss.hunger = hunger
    assert loss.hunger.item() == 0.5
    loss.hunger = torch.tensor(0.25)
    assert loss.hunger.item() == 0.25 and "hunger" in loss.state_dict()


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda flag: CuriosityTransform(LevelBonus(), add_to_reward=flag), "add_to_reward"),
        (lambda flag: BonusLoss(LevelBonus(), observe=flag), "observe"),
        (lambda flag: make_loss(CuriousActorCriticLoss, soft_backup=flag), "soft_backup"),
    ],
)
def test_a_flag_is_true_or_false(make: Callable, name: str):
    with pytest.raises(TypeError, match=name):
        make("no")


def test_options_that_mean_nothing_here_are_refused():
    with pytest.raises(TypeError, match="`target_entropy` is no option of this loss, got -1"):
        make_loss(CuriousActorCriticLoss, target_entropy=-1.0)


def test_a_missing_library_is_reported_with_the_command(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "torchrl", None)
    package = import_module("deep_curiosity.integrations.torchrl")
    with pytest.raises(ImportError, match=r"pip install 'deep-curiosity\[torchrl\]'"):
        reload(package)


def test_an_untested_version_is_warned_of(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(requirements, "version", lambda package: "0.15.0")
    package = import_module("deep_curiosity.integrations.torchrl")
    with pytest.warns(UserWarning, match=r"torchrl 0.15.0 is untested"):
        reload(package)


def assert_same_state(first: dict[str, Tensor], second: dict[str, Tensor]) -> None:
    assert first.keys() == second.keys()
    for name, part in first.items():
        torch.testing.assert_close(part, second[name], rtol=0, atol=0, equal_nan=True)


def zero_last_layers(params: TensorDict, bias: float) -> None:
    """Make every critic return one number."""
    with torch.no_grad():
        params["module", "network", "2", "weight"].zero_()
        params["module", "network", "2", "bias"].fill_(bias)


def run_trainer(
    loss: nn.Module, replay: TensorDictReplayBuffer, policy: ProbabilisticActor | None = None
) -> None:
    collector = Collector(make_env(), policy, frames_per_batch=20, total_frames=40)
    trainer = Trainer(
        collector=collector,
        total_frames=40,
        frame_skip=1,
        optim_steps_per_batch=2,
        loss_module=loss,
        optimizer=torch.optim.Adam(loss.parameters(), lr=1e-2),
        progress_bar=False,
    )
    ReplayBufferTrainer(replay, batch_size=16, flatten_tensordicts=True).register(trainer)
    if isinstance(loss, SACLoss):
        TargetNetUpdaterHook(SoftUpdate(loss, tau=0.1)).register(trainer, "target_updater")
    trainer.train()
