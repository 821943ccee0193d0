"""Signals that end a program by default, and an end in order instead."""

import os
import signal
import subprocess
from pathlib import Path
from threading import Thread

import pytest

from cutgate.config import signals
from cutgate.config.signals import ENDING, SUSPENDING, handled, name_of, none_here, wake

WAIT_S = 20.0
FAULTS = {"SIGILL", "SIGBUS", "SIGFPE", "SIGSEGV"}
"""Of the program itself: what they interrupt cannot go on."""
NOT_ENDING = {"SIGCHLD", "SIGCONT", "SIGURG", "SIGWINCH"}
SUSPEND = {"SIGSTOP", "SIGTSTP", "SIGTTIN", "SIGTTOU"}
PYTHON_IGNORES = {"SIGPIPE", "SIGXFSZ"}


def test_every_signal_is_accounted_for():
    """The table of signal(7), typed here a second time."""
    rest = {name_of(number) for number in signal.valid_signals() - ENDING}
    assert rest == FAULTS | NOT_ENDING | SUSPEND | PYTHON_IGNORES | {"SIGKILL"}
    assert {name_of(number) for number in SUSPENDING} == SUSPEND - {"SIGSTOP"}


@pytest.mark.processes
def test_every_signal_that_is_handled_would_end_a_program():
    for number in ENDING:
        with subprocess.Popen(["sleep", "60"]) as sleeping:
            sleeping.send_signal(number)
            assert sleeping.wait(WAIT_S) == -number


@pytest.fixture(autouse=True)
def hang_up():
    """How a hang-up is handled is put back, whatever a test has made of it."""
    before = signal.getsignal(signal.SIGHUP)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", sorted(ENDING | SUSPENDING), ids=name_of)
def test_a_handled_signal_does_what_it_is_told_and_is_given_back(number):
    before, arrived = signal.getsignal(number), []
    with handled(ENDING | SUSPENDING, arrived.append):
        signal.raise_signal(number)
        signal.raise_signal(number)
    assert arrived == [number, number]
    assert signal.getsignal(number) == (signal.SIG_IGN if number == signal.SIGHUP else before)


def test_a_hang_up_that_is_ignored_stays_ignored():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    arrived = []
    with handled(ENDING, arrived.append):
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGTERM)
    assert arrived == [signal.SIGTERM]
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


def test_the_second_hang_up_comes_too_late_to_do_harm():
    with handled(frozenset({signal.SIGHUP}), lambda _number: None):
        signal.raise_signal(signal.SIGHUP)
    signal.raise_signal(signal.SIGHUP)
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


def test_without_a_hang_up_its_handling_is_given_back():
    before = signal.getsignal(signal.SIGHUP)
    with handled(ENDING, lambda _number: None):
        pass
    assert signal.getsignal(signal.SIGHUP) == before


def test_a_handler_that_was_not_pythons_becomes_the_default(monkeypatch):
    monkeypatch.setattr(signals.signal, "signal", lambda number, handler: set_.append((number, handler)))
    set_ = []
    with handled(frozenset({signal.SIGUSR1}), lambda _number: None):
        pass
    assert set_[-1] == (signal.SIGUSR1, signal.SIG_DFL)


def test_a_full_pipe_is_awake_already():
    reading, writing = os.pipe2(os.O_NONBLOCK)
    for _ in range(100_000):
        wake(writing)
    assert os.read(reading, 10) == bytes(10)
    os.close(reading)
    os.close(writing)


def test_a_thread_without_signals_has_all_of_them_blocked():
    blocked = []

    def look():
        none_here()
        status = Path("/proc/thread-self/status").read_text(encoding="ascii")
        blocked.append(int(status.partition("SigBlk:")[2].split()[0], 16))

    thread = Thread(target=look)
    thread.start()
    thread.join(WAIT_S)
    (mask,) = blocked
    names = {number for number in range(1, 65) if mask >> (number - 1) & 1}
    assert names == signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, ())  # of this thread, none


def test_a_real_time_signal_has_a_number_for_a_name():
    assert name_of(signal.SIGHUP) == "SIGHUP"
    assert name_of(40) == "signal 40"


def test_a_signal_wakes_who_waits_without_a_bound_and_before_it_is_acted_on():
    """In the very moment: what comes between the last step of the program and the waiting is not told otherwise."""
    reading, writing = os.pipe2(os.O_NONBLOCK)
    outer, inner = os.pipe2(os.O_NONBLOCK)
    before = signal.set_wakeup_fd(inner)
    acted = []

    def act(number):
        acted.append((number, os.read(reading, 10)))

    with handled(ENDING, act, writing):
        signal.raise_signal(signal.SIGTERM)
    assert acted == [(signal.SIGTERM, bytes([signal.SIGTERM]))]
    assert signal.set_wakeup_fd(before) == inner, "given back"
    for descriptor in (reading, writing, outer, inner):
        os.close(descriptor)


def test_without_a_pipe_the_wake_up_is_left_as_it_was():
    with handled(ENDING, lambda _number: None):
        assert signal.set_wakeup_fd(-1) == -1
