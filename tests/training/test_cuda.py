import pytest
import torch

from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.training import continue_run, train
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.learner import Learner

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")


@pytest.fixture
def on_gpu(tiny):
    return tiny.override(device="cuda", prior="learned")


@pytest.mark.parametrize("num_envs", [1, 3])
def test_a_resumed_run_equals_an_uninterrupted_one(on_gpu, tmp_path, num_envs):
    whole = on_gpu.override(num_envs=num_envs, total_steps=90, out=tmp_path / "whole")
    halves = whole.override(total_steps=45, out=tmp_path / "halves")
    train(whole, show_progress=False)
    train(halves, show_progress=False)
    continue_run(halves.run.out, total_steps=90, show_progress=False)
    one, other = (load_checkpoint(run.run.out)["learner"] for run in (whole, halves))
    assert torch.equal(one["replay"]["rows"], other["replay"]["rows"])
    for part in ("agent", "bonus"):
        for name, value in one[part].items():
            torch.testing.assert_close(value, other[part][name], equal_nan=True)


def test_everything_that_learns_lives_on_the_gpu(on_gpu):
    learner = Learner(on_gpu, 3, 1)
    state = {**learner.agent.state_dict(), **learner.bonus.state_dict()}
    assert {value.device.type for value in state.values()} == {"cuda"}
    learner.replay.add(*a_step())
    assert {field.device.type for field in learner.replay.sample(4)} == {"cuda"}


def a_step(number=0.0):
    return [number] * 3, [0.0], 0.0, [number + 1] * 3, False, False


@pytest.mark.filterwarnings("ignore:Synchronization debug mode")
def test_storing_and_sampling_wait_for_nothing():
    replay = ReplayBuffer(8, 3, 1, device="cuda")
    torch.cuda.set_sync_debug_mode("error")
    try:
        for number in range(12):
            replay.add(*a_step(float(number)))
        batches = [
            replay.sample(64),
            replay.sample_fading(64, half_life=3),
            replay.sample_sequences(64, 2).first,
        ]
    finally:
        torch.cuda.set_sync_debug_mode("default")
    for batch in batches:
        assert set(batch.observation[:, 0].tolist()) <= set(range(4, 12))
        torch.testing.assert_close(batch.next_observation, batch.observation + 1)
