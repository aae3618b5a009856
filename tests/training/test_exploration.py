import pytest
import torch

from deep_curiosity.training import continue_run, train
from deep_curiosity.training.exploration import NOISES, RESAMPLED_STEPS, StateDependentNoise


def series(noise, steps, width=4):
    """Noise along a walk through hidden activations, `(steps, num_envs, action_dim)`."""
    hidden = torch.randn(noise.shape[0], width)
    samples = []
    for _ in range(steps):
        hidden = hidden + 0.05 * torch.randn_like(hidden)
        samples.append(noise.sample(hidden).clone())
    return torch.stack(samples)


def correlation(samples):
    return (samples[1:] * samples[:-1]).mean().item() / samples.square().mean().item()


@pytest.fixture(params=NOISES)
def kind(request):
    return NOISES[request.param]


def test_noise_has_unit_variance_at_every_step(kind):
    samples = series(kind(200, 3), 20)
    assert samples.shape == (20, 200, 3) and samples.dtype == torch.float32
    assert samples.std().item() == pytest.approx(1, abs=0.1)
    assert samples.mean().item() == pytest.approx(0, abs=0.1)


def test_noise_hangs_together_in_time(kind):
    assert correlation(series(kind(50, 2), 200)) > 0.5


def test_the_state_and_the_generator_are_all_that_the_noise_depends_on(kind):
    noise = kind(3, 2)
    series(noise, 10)
    state, random_state = noise.state_dict(), torch.get_rng_state()
    expected = series(noise, 10)
    copy = kind(3, 2)
    copy.load_state_dict(state)
    torch.set_rng_state(random_state)
    assert series(copy, 10).equal(expected)


def test_an_episode_begins_with_noise_of_its_own(kind):
    noise = kind(2, 1)
    series(noise, 5)
    hidden = torch.ones(2, 4)
    before = noise.sample(hidden).clone()
    noise.begin(1)
    after = noise.sample(hidden)
    assert (after[1] - before[1]).abs() > 1e-3
    if kind is StateDependentNoise:
        assert after[0].equal(before[0])


def test_state_dependent_noise_is_a_function_of_the_state_until_it_is_resampled():
    noise = StateDependentNoise(1, 2)
    hidden = torch.randn(1, 4)
    samples = [noise.sample(hidden).clone() for _ in range(RESAMPLED_STEPS + 1)]
    assert all(value.equal(samples[0]) for value in samples[:-1])
    assert not samples[-1].equal(samples[0])


@pytest.mark.parametrize(
    ("exploration", "num_envs"),
    [
        ("gsde", 2),
        pytest.param("pink", 3, marks=pytest.mark.slow),
        pytest.param("ou", 1, marks=pytest.mark.slow),
    ],
)
def test_a_run_explores_so_and_resumes_as_if_it_had_not_stopped(tiny, exploration, num_envs):
    tiny = tiny.override(exploration=exploration, num_envs=num_envs, checkpoint_interval=1_000)
    whole = tiny.override(out=tiny.run.out / "whole", total_steps=90)
    halves = tiny.override(out=tiny.run.out / "halves")
    train(whole, show_progress=False)
    train(halves, show_progress=False)
    continue_run(halves.run.out, total_steps=90, show_progress=False)
    first, second = (
        torch.load(run.run.out / "checkpoint.pt")["learner"]["replay"]["rows"]
        for run in (whole, halves)
    )
    assert first.equal(second)
    train(whole.override(out=tiny.run.out / "white", exploration="policy"), show_progress=False)
    white = torch.load(tiny.run.out / "white" / "checkpoint.pt")["learner"]["replay"]["rows"]
    assert not white.equal(first)


def test_several_mixture_components_have_noise_of_their_own(tiny):
    with pytest.raises(ValueError, match="`exploration` must be 'policy' for a policy of 2 mix"):
        tiny.override(exploration="pink", policy_mixture_components=2)


def test_a_bonus_of_outcomes_cannot_be_maximised_directly(tiny):
    with pytest.raises(ValueError, match="`curiosity_discount` must be above 0 for the bonus rnd"):
        tiny.override(bonus="rnd", curiosity_discount=0.0)
