import os
import signal
import threading

import pytest

from deep_curiosity.training.interruption import (
    Interrupted,
    catch_interruption,
    cut_off_at_once,
    is_interrupted,
    terminated_like_interrupted,
)


def interrupt(number=signal.SIGINT):
    os.kill(os.getpid(), number)


def test_sigterm_is_noted_as_often_as_it_comes():
    before = signal.getsignal(signal.SIGTERM)
    with catch_interruption() as interruption:
        assert not is_interrupted()
        for _ in range(3):
            interrupt(signal.SIGTERM)
        assert interruption.requested and is_interrupted()
    assert signal.getsignal(signal.SIGTERM) is before
    assert not is_interrupted()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_takes_long_is_cut_off_at_once(number):
    with catch_interruption() as interruption:
        with pytest.raises(Interrupted), cut_off_at_once():
            interrupt(number)
            pytest.fail("it should have been cut off")
        assert interruption.requested
        interrupt(signal.SIGTERM)  # what follows, such as a checkpoint, is not cut off
        with pytest.raises(Interrupted), cut_off_at_once():
            pytest.fail("it should not have been begun")


@pytest.mark.usefixtures("hears_interruptions")
def test_outside_a_block_nothing_is_changed():
    with cut_off_at_once(), pytest.raises(KeyboardInterrupt) as raised:
        interrupt()
    assert raised.type is KeyboardInterrupt


def test_sigterm_can_be_had_like_ctrl_c():
    before = signal.getsignal(signal.SIGTERM)
    with terminated_like_interrupted(), pytest.raises(KeyboardInterrupt):
        interrupt(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is before


def test_the_first_ctrl_c_is_noted_and_the_second_stops_at_once():
    with pytest.raises(KeyboardInterrupt), catch_interruption() as interruption:
        assert not interruption.requested
        interrupt()
        assert interruption.requested
        interrupt()
        pytest.fail("the second one should have raised")


@pytest.fixture
def hears_interruptions():
    """Python's own handler, also where a shell has started the tests in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("hears_interruptions")
@pytest.mark.parametrize("error", [None, ValueError])
def test_the_handler_from_before_is_restored_however_the_block_ends(error):
    before = signal.getsignal(signal.SIGINT)
    try:
        with catch_interruption():
            assert signal.getsignal(signal.SIGINT) is not before
            if error is not None:
                raise error
    except ValueError:
        pass
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(KeyboardInterrupt):
        interrupt()


def test_another_thread_changes_no_handler():
    before, found = signal.getsignal(signal.SIGINT), []

    def work():
        with catch_interruption() as interruption:
            found.append((signal.getsignal(signal.SIGINT), interruption.requested))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [(before, False)]
