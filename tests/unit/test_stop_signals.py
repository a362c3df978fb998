"""What the learner makes of the signals that ask for an end."""

import signal

import pytest

from dppo.process import Terminated
from dppo.signals import heeded
from learner.signals import StopSignals


@pytest.fixture(autouse=True)
def handlers():
    """As they were before, afterwards."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_one_ends_the_run_at_the_next_look(number):
    signals = StopSignals()
    signals.check()
    signal.raise_signal(number)
    with pytest.raises(Terminated):
        signals.check()


def test_one_that_was_put_off_during_an_import_is_taken_over():
    signal.setitimer(signal.ITIMER_REAL, 60)
    signals = StopSignals()
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0)
    with pytest.raises(Terminated):
        signals.check()


def test_behind_nohup_ctrl_c_stays_ignored():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signals = StopSignals()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    assert heeded() == [signal.SIGTERM]
    signal.raise_signal(signal.SIGTERM)
    with pytest.raises(Terminated):
        signals.check()
