import json
import shutil

import pytest
import torch

from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.training import continue_run, train
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.learner import Learner
from deep_curiosity.training.run import open_run
from deep_curiosity.training.warm_start import LEARNED


@pytest.fixture(scope="module")
def begun(tiny_config, tmp_path_factory):
    """A run to begin from."""
    folder = tmp_path_factory.mktemp("warm") / "first"
    train(tiny_config.override(out=folder), show_progress=False)
    return folder


def same(one, other):
    torch.testing.assert_close(one, other, rtol=0, atol=0, equal_nan=True)


def test_a_run_begins_with_what_another_has_learned(tiny, begun):
    saved = load_checkpoint(begun)["learner"]
    with open_run(tiny.override(seed=5, temperature=0.5, init_from=begun)) as run:
        learner = run.learner
        agent = learner.agent.state_dict()
        learned = [name for name in agent if name.startswith(LEARNED)]
        assert {name.split(".")[0] for name in learned} == {
            "policy", "critics", "target_critics", "prior", "value_stds", "curiosity_mean",
            "observation_scaling",
        }  # fmt: skip
        for name in learned:
            same(agent[name], saved["agent"][name])
        for name, value in learner.bonus.state_dict().items():
            same(value, saved["bonus"][name])
        assert learner.agent.temperature == pytest.approx(0.5)
        assert all(optimizer.count == 0 for optimizer in learner.agent.optimizers.values())
        assert len(learner.replay) == 0
        assert run.run_log.step == 0


def test_what_observations_were_normalised_by_is_begun_with(tiny, tmp_path):
    folder = tmp_path / "before"
    train(tiny.override(out=folder), show_progress=False)
    with open_run(tiny.override(seed=5, init_from=folder)) as run:
        scaling = run.learner.agent.observation_scaling
        saved = load_checkpoint(folder)["learner"]["agent"]
        same(scaling.square, saved["observation_scaling.square"])
        assert scaling.square.max() > 0
    with (
        pytest.raises(ValueError, match="normalize_observations"),
        open_run(
            tiny.override(out=tmp_path / "other", init_from=folder, normalize_observations=False)
        ),
    ):
        pass


@pytest.mark.parametrize(
    ("settings", "name", "learned", "expected"),
    [
        ({"bonus": "constant"}, "value", 0.1, 2.0),
        ({"tune_bonus_weight": "past"}, "tuned_weight.log_factor", 1.5, 0.0),
        ({"bonus": "information-gain"}, "tuned_weight.log_factor", 1.5, 0.0),
    ],
)
def test_the_weight_of_the_bonus_is_as_it_is_set(
    tiny, tmp_path, settings, name, learned, expected
):
    before = tiny.override(out=tmp_path / "before", **settings)
    with open_run(before) as run:
        run.learner.bonus.get_buffer(name).fill_(learned)
        run.save()
    own = tiny.override(init_from=before.run.out, bonus_weight=2.0, **settings)
    with open_run(own) as run:
        assert run.learner.bonus.get_buffer(name).item() == expected


def test_without_it_a_run_begins_anew(tiny, begun):
    saved = load_checkpoint(begun)["learner"]["agent"]
    with open_run(tiny) as run:
        name = "policy.network.layers.0.weight"
        assert not torch.equal(run.learner.agent.state_dict()[name], saved[name])


def test_its_own_policy_acts_from_the_first_step(tiny, begun, monkeypatch):
    act, uniform = Learner.act, []

    def observed(self, observation, *, explore_uniformly=False):
        uniform.append(explore_uniformly)
        return act(self, observation, explore_uniformly=explore_uniformly)

    monkeypatch.setattr(Learner, "act", observed)
    train(tiny.override(init_from=begun), show_progress=False)
    assert uniform == [False] * 60


def test_replay_is_taken_where_it_is_asked_for(tiny, begun):
    saved = load_checkpoint(begun)["learner"]["replay"]["rows"]
    with open_run(tiny.override(init_from=begun, init_replay=True)) as run:
        replay = run.learner.replay
        rows = replay.state_dict()["rows"]
        same(rows[:, :-1], saved[:, :-1])
        assert len(rows) == 60
        assert replay.all().truncated.nonzero().flatten().tolist() == [59]


@pytest.mark.parametrize(("added", "kept"), [(5, 5), (13, 8)])
def test_the_newest_of_a_buffer_are_taken_over_in_their_order(added, kept):
    other, own = ReplayBuffer(8, 1, 1, num_envs=2), ReplayBuffer(20, 1, 1, num_envs=2)
    for number in range(added):
        other.add(float(number), 0.0, 0.0, number + 1.0, False, False)
    own.take_over(other.state_dict())
    held = own.all()
    assert held.observation.flatten().tolist() == list(range(added - kept, added))
    assert held.truncated.tolist() == [False] * (kept - 2) + [True] * 2
    assert not other.all().truncated.any()
    own.add(9.0, 0.0, 0.0, 9.0, False, False)
    assert own.all().observation[-1] == 9 and len(own) == kept + 1


def test_a_smaller_buffer_takes_the_newest():
    other, own = ReplayBuffer(8, 1, 1), ReplayBuffer(3, 1, 1)
    for number in range(13):
        other.add(float(number), 0.0, 0.0, number + 1.0, False, False)
    own.take_over(other.state_dict())
    assert own.all().observation.flatten().tolist() == [10, 11, 12]
    with pytest.raises(ValueError, match="`rows` must have 7 entries, got 6"):
        ReplayBuffer(3, 1, 2).take_over(other.state_dict())


def test_a_run_goes_on_without_the_one_it_began_with(tiny, begun, tmp_path):
    first = shutil.copytree(begun, tmp_path / "first")
    train(tiny.override(init_from=first, init_replay=True), show_progress=False)
    shutil.rmtree(first)
    continue_run(tiny.run.out, total_steps=80, show_progress=False)
    assert len(load_checkpoint(tiny.run.out)["learner"]["replay"]["rows"]) == 60 + 80


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"hidden_dim": 8}, r"got .*, where critics\..* Settings that differ: hidden_dim \(16 th"),
        ({"bonus": "rnd"}, "`bonus` must be 'curiosity', that of the run in .* got 'rnd'"),
        ({"prior": "uniform"}, r"where prior\.\w+ has shape .* here None.*prior \(None there"),
        (
            {"env_id": "CartpoleSwingup"},
            r"where critics\.network\.layers\.0\.weight has shape \(3, 4, 16\), here \(3, 6, 16\)",
        ),
        ({"num_envs": 2, "init_replay": True}, "`num_envs` must be 1, that of the run in .* 2"),
        ({"whitening": "moments"}, "`whitening` must be 'saturating', that of .* got 'moments'"),
        ({"features": (0, 1, 2)}, r"`features` must be \[\], that of .* got \[0, 1, 2\]"),
        ({"bonus_parts": {"cross_entropy": 1.0}}, r"`bonus_parts` must be \{\}, .*got \{'cross_"),
        ({"num_members": 3}, r"Settings that differ: num_members \(2 there, 3 here\)"),
    ],
)
def test_a_run_that_does_not_fit_is_refused_before_anything_is_written(
    tiny, begun, settings, message
):
    with (
        pytest.raises(ValueError, match=message),
        open_run(tiny.override(init_from=begun, **settings)),
    ):
        pass
    assert not tiny.run.out.exists()


def test_features_are_of_the_same_observation(tiny, begun, tmp_path):
    first = shutil.copytree(begun, tmp_path / "first")
    values = json.loads((first / "config.json").read_text())
    (first / "config.json").write_text(json.dumps(values | {"features_of": "window"}))
    with (
        pytest.raises(ValueError, match=r"`features_of` must be .window., that of .* got .newest"),
        open_run(tiny.override(init_from=first)),
    ):
        pass


def test_a_run_must_be_there(tiny, tmp_path):
    with (
        pytest.raises(FileNotFoundError, match=r"`init_from` must be the folder .*nowhere"),
        open_run(tiny.override(init_from=tmp_path / "nowhere")),
    ):
        pass


def test_replay_without_a_run_is_refused(tiny):
    with pytest.raises(ValueError, match="`init_replay` must be left out without `init_from`"):
        tiny.override(init_replay=True)
