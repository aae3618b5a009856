import numpy as np
import pytest
import torch

import deep_curiosity as dc
from deep_curiosity.training.checkpoint import load_checkpoint
from tests.trained.conftest import HIGH, LOW

RNG = np.random.default_rng(0)
OBSERVATIONS = RNG.normal(size=(4, 3)).astype(np.float32)
ACTIONS = RNG.uniform(LOW, HIGH, size=(4, 2))
SETTINGS = [{}, {"whitening": "moments"}, {"model_mixture_components": 2}, {"features": (0, 1)}]


@pytest.mark.parametrize("settings", SETTINGS)
def test_predictions_are_of_the_next_observation_in_its_own_units(run_of, settings):
    model = dc.load_model(run_of(**settings))
    prediction = model.predict(OBSERVATIONS, ACTIONS, num_samples=20_000)
    scaled = 2 * (ACTIONS - np.array(LOW)) / (np.array(HIGH) - np.array(LOW)) - 1
    mean, var = model.dynamics.change(
        torch.from_numpy(OBSERVATIONS), torch.from_numpy(scaled.astype(np.float32))
    )
    expected = OBSERVATIONS + mean.mean(0).numpy()
    np.testing.assert_allclose(prediction.mean, expected, rtol=0, atol=1e-6)
    epistemic = mean.numpy().std(0)  # float32 resolves no finer
    np.testing.assert_allclose(prediction.epistemic, epistemic, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(prediction.aleatoric, var.mean(0).sqrt().numpy(), rtol=1e-4)
    samples = prediction.samples
    assert samples.shape == (20_000, 4, 3)
    deviation = np.abs(samples.mean(0) - prediction.mean) / prediction.std
    assert (deviation < 5 / np.sqrt(20_000)).all()
    np.testing.assert_allclose(samples.std(0), prediction.std, rtol=0.15)  # tails are heavy


def test_the_two_kinds_of_doubt_add_up(run_of):
    prediction = dc.load_model(run_of()).predict(OBSERVATIONS, ACTIONS)
    parts = prediction.epistemic**2 + prediction.aleatoric**2
    np.testing.assert_allclose(prediction.std**2, parts, rtol=1e-6)
    assert (prediction.epistemic > 0).all() and (prediction.aleatoric > 0).all()


def test_one_pair_is_a_batch_of_one_and_samples_follow_the_seed(run_of):
    model = dc.load_model(run_of())
    one = model.predict(OBSERVATIONS[1], ACTIONS[1], num_samples=3)
    assert [value.shape for value in one] == [(3,)] * 4 + [(3, 3)]
    batch = model.predict(OBSERVATIONS, ACTIONS, num_samples=3)
    np.testing.assert_allclose(one.mean, batch.mean[1], rtol=0, atol=1e-6)
    again, other = (model.predict(OBSERVATIONS, ACTIONS, seed=seed) for seed in (0, 1))
    np.testing.assert_array_equal(
        again.samples, model.predict(OBSERVATIONS, ACTIONS, seed=0).samples
    )
    assert not np.allclose(again.samples, other.samples)


@pytest.mark.parametrize(
    ("argument", "error", "message"),
    [
        ({"num_samples": 0}, ValueError, "`num_samples` must be at least 1, got 0"),
        ({"num_samples": -1}, ValueError, "`num_samples` must be at least 1, got -1"),
        ({"num_samples": 2.5}, TypeError, r"`num_samples` must be a whole number, got 2\.5"),
        ({"seed": "a"}, TypeError, "`seed` must be a whole number, got 'a'"),
        ({"seed": 1.0}, TypeError, r"`seed` must be a whole number, got 1\.0"),
        ({"seed": 2**64}, ValueError, r"`seed` must lie in .* got 18446744073709551616"),
    ],
    ids=str,
)
def test_samples_that_cannot_be_drawn_are_refused_by_name(run_of, argument, error, message):
    model = dc.load_model(run_of())
    with pytest.raises(error, match=message):
        model.predict(OBSERVATIONS, ACTIONS, **argument)
    model.predict(OBSERVATIONS, ACTIONS, num_samples=np.int64(2), seed=np.int64(-1))


def test_actions_are_as_fine_as_their_space(far_run):
    model = dc.load_model(far_run)
    first, second = (model.predict(OBSERVATIONS[0], [0.2, 1e6 + part]) for part in (0.30, 0.33))
    assert not np.array_equal(first.mean, second.mean)


def test_actions_beyond_the_bounds_are_cut(run_of):
    model = dc.load_model(run_of())
    at, beyond = (model.predict(OBSERVATIONS[0], action) for action in (HIGH, (9.0, 9.0)))
    np.testing.assert_array_equal(at.mean, beyond.mean)


@pytest.mark.parametrize(
    ("observation", "action", "message"),
    [
        (OBSERVATIONS, ACTIONS[:2], "`action` must be one for each observation, 4, got 2"),
        (OBSERVATIONS, ACTIONS[:, :1], r"`action` must have shape \(2,\) or \(batch, 2\)"),
        (OBSERVATIONS[:, :2], ACTIONS, r"`observation` must have shape \(3,\) or \(batch, 3\)"),
        (OBSERVATIONS, np.full((4, 2), np.nan), "`action` must be finite"),
    ],
)
def test_what_does_not_fit_is_refused(run_of, observation, action, message):
    with pytest.raises(ValueError, match=message):
        dc.load_model(run_of()).predict(observation, action)


def test_windows_are_predicted_where_frames_were_stacked(run_of):
    model = dc.load_model(run_of(frame_stack=3))
    assert model.predict(np.zeros(13), ACTIONS[0]).mean.shape == (13,)
    with pytest.raises(ValueError, match="`observation` must be a window of 3 observations with"):
        model.predict(OBSERVATIONS[0], ACTIONS[0])


def test_a_bonus_without_such_a_model_is_named(run_of):
    with pytest.raises(ValueError, match=r"`folder` must be of a run whose bonus .*'rnd'"):
        dc.load_model(run_of(bonus="rnd"))
    with pytest.raises(ValueError, match="`folder` must be of a run with a bonus, got bonus 'non"):
        dc.load_bonus(run_of(bonus="none"))


@pytest.mark.parametrize(
    ("kind", "settings"), [("curiosity", {"components": 16, "num_members": 2}), ("rnd", {})]
)
def test_the_bonus_is_the_runs_own(run_of, kind, settings):
    folder = run_of(bonus=kind)
    learner = load_checkpoint(folder)["learner"]
    rows = learner["replay"]["rows"]
    steps = rows[:, :3], rows[:, 3:5], rows[:, 6:9]
    bonus = dc.load_bonus(folder)
    value = bonus(*steps)
    assert bonus.scores_outcomes == (kind == "rnd")
    expected = dc.make_bonus(kind, 3, 2, hidden_dims=(16, 16), **settings)
    expected.load_state_dict(learner["bonus"])
    torch.testing.assert_close(value, expected(*steps))
    assert value.std() > 0
