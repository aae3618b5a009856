import os
import signal
import threading

import pytest

from deep_curiosity.training.interruption import catch_interruption


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


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
