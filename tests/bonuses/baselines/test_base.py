import pytest
import torch

from deep_curiosity.bonuses import make_bonus
from deep_curiosity.bonuses.baselines.base import BaselineBonus
from deep_curiosity.transitions import Transition


class FirstEntryBonus(BaselineBonus):
    """The first entry of the observation; it keeps the batches that it is given."""

    def __init__(self, **options):
        raw = {"weight": 1.0, "center": False, "scale": False, "refresh_interval": 1}
        super().__init__(2, 1, **raw | options)
        self.batches = []

    def score(self, observation, action, next_observation):
        return observation[:, 0]

    def update_statistics(self, transition, fresh_action):
        self.batches.append((transition, fresh_action))


def transition(batch=8):
    flag = torch.zeros(batch, dtype=torch.bool)
    observation = torch.randn(batch, 2) * 3 + 1
    return Transition(observation, torch.rand(batch, 1), flag.float(), observation, flag, flag)


def compute(bonus, batch):
    return bonus(batch.observation, batch.action)


def test_the_bonus_is_the_standardised_score():
    bonus, batch = FirstEntryBonus(weight=0.5, center=True, scale=True), transition()
    bonus.observe(batch)
    score = batch.observation[:, 0]
    expected = 0.5 * (score - score.mean()) / score.std(correction=0)
    torch.testing.assert_close(compute(bonus, batch), expected)
    raw = FirstEntryBonus()
    raw.observe(batch)
    torch.testing.assert_close(compute(raw, batch), score)


def test_metrics_are_moments_of_the_score_in_its_own_unit():
    bonus, batch = FirstEntryBonus(weight=0.5, center=True, scale=True), transition()
    bonus.observe(batch)
    metrics = bonus.metrics()
    score = batch.observation[:, 0]
    torch.testing.assert_close(metrics["score"], score.mean())
    torch.testing.assert_close(metrics["score_std"], score.std(correction=0))
    before = {name: value.clone() for name, value in metrics.items()}
    bonus.observe(transition())
    assert all(metrics[name].equal(value) for name, value in before.items())


def test_batches_between_two_refreshes_are_only_counted():
    bonus, given = FirstEntryBonus(refresh_interval=3), [transition() for _ in range(7)]
    for batch in given:
        bonus.observe(batch)
    shown = [batch for batch, _ in bonus.batches]
    assert len(shown) == 3
    assert all(one is other for one, other in zip(shown, given[::3], strict=True))
    assert bonus.observation_moments.count == 24


class CuriousAboutThePolicy(FirstEntryBonus):
    asks_policy = True


def centre(observation):
    return torch.zeros(len(observation), 1)


def test_statistics_are_given_fresh_actions_where_they_ask_for_them():
    bonus, batch = CuriousAboutThePolicy(), transition()
    bonus.observe(batch, centre), bonus.observe(batch)
    assert bonus.batches[0][1].equal(torch.zeros(8, 1)) and bonus.batches[1][1] is None
    indifferent = FirstEntryBonus()
    indifferent.observe(batch, lambda observation: pytest.fail("asked"))
    assert indifferent.batches[0][1] is None


class FollowsVisits(FirstEntryBonus):
    follows_visits = True


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_visited_states_that_are_refused_change_nothing(bad):
    bonus, late = FollowsVisits(), transition()
    bonus.observe(transition())
    before = {name: value.clone() for name, value in bonus.state_dict().items()}
    late.observation[3, 1] = bad
    with pytest.raises(ValueError, match=r"`visited.observation` must be finite.* in row 3"):
        bonus.observe(transition(), visited=late)
    assert all(value.equal(before[name]) for name, value in bonus.state_dict().items())
    assert len(bonus.batches) == 1


def test_pairs_are_whitened_observations_and_actions_as_they_are():
    bonus, batch = FirstEntryBonus(), transition()
    bonus.observe(batch)
    features = bonus.pair_features(batch.observation, batch.action)
    assert features[:, 2:].equal(batch.action)
    torch.testing.assert_close(features[:, :2].mean(0), torch.zeros(2), atol=1e-5, rtol=0)


def test_without_networks_the_loss_is_zero_and_the_batch_is_checked():
    bonus = FirstEntryBonus()
    loss = bonus.loss(transition())
    loss.backward()
    assert loss == 0 and loss.shape == ()
    with pytest.raises(ValueError, match="one batch size"):
        bonus.loss(transition()._replace(action=torch.zeros(3, 1)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weight": -1.0}, "`weight` must be finite and not negative, got -1"),
        ({"refresh_interval": 0}, "`refresh_interval` must be at least 1, got 0"),
    ],
)
def test_what_is_out_of_range_is_rejected_by_name_and_value(options, message):
    with pytest.raises(ValueError, match=message):
        FirstEntryBonus(**options)


@pytest.mark.parametrize("kind", ["hash-count", "nearest-neighbours"])
@pytest.mark.parametrize("states", ["one-hot", "flags", "tiny"])
def test_states_of_entries_that_are_seldom_set_are_paid_a_centred_bonus(kind, states):
    torch.manual_seed(1)
    num_rows = 4_001
    chances = torch.tensor([0.75 / 50] * 50 + [0.25 / 100] * 100)
    observation = {
        "one-hot": torch.eye(150)[torch.multinomial(chances, num_rows, replacement=True)],
        "flags": torch.cat(
            [torch.randn(num_rows, 2), (torch.rand(num_rows, 20) < 0.005).float()], 1
        ),
        "tiny": 1e-6 * torch.randn(num_rows, 4),
    }[states]
    flag = torch.zeros(num_rows - 1, dtype=torch.bool)
    action = torch.rand(num_rows - 1, 1) * 2 - 1
    data = Transition(observation[:-1], action, flag.float(), observation[1:], flag, flag)
    bonus = make_bonus(kind, observation.shape[1], 1, bonus_weight=1.0)
    for _ in range(1_200):
        row = torch.randint(num_rows - 1, (256,))
        bonus.observe(Transition(*(field[row] for field in data)))
    value = bonus(data.observation, data.action, data.next_observation)
    assert abs(value.mean()) < 0.15
    assert 0.8 < value.std() < 1.25
