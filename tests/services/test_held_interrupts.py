"""What must not be cut in two is not: a signal waits until it is let go."""

import os
import signal
import threading

import pytest

from deltaq_services.process import HeldInterrupts


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_until_it_is_let_go(number):
    before = signal.getsignal(number)
    with HeldInterrupts() as held:
        held.let_go()
        os.kill(os.getpid(), number)
        all_of_it = True
        with pytest.raises(KeyboardInterrupt):
            held.let_go()
    assert all_of_it
    assert signal.getsignal(number) is before


def test_in_another_thread_nothing_is_held_and_nothing_fails():
    before, ended = signal.getsignal(signal.SIGINT), []

    def hold():
        with HeldInterrupts() as held:
            held.let_go()
        ended.append(True)

    thread = threading.Thread(target=hold)
    thread.start()
    thread.join(timeout=300)
    assert ended == [True]
    assert signal.getsignal(signal.SIGINT) is before
