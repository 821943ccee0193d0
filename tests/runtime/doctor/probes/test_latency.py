"""How late cycles begin, in a time that is made up; and the busy process ends with the look."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.model import Site
from cutgate.runtime.audit.directory import lock
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import Unknown
from cutgate.runtime.doctor.probes import latency
from cutgate.runtime.doctor.probes.latency import CYCLE_S, CYCLES, UNTIL_S, lateness, loop_delays


class Time:
    """A clock that only waiting moves, each wait by so much too long."""

    def __init__(self, late_s):
        self.now_s = 5.0
        self._late_s = iter(late_s)

    def __call__(self):
        return self.now_s

    def wait(self, seconds):
        assert seconds >= 0
        self.now_s += seconds + next(self._late_s, 0.0)


def test_a_loop_that_wakes_in_time_is_not_late():
    time = Time([])
    facts = lateness(time, time.wait)
    assert facts.count == CYCLES
    assert facts.worst_ms == pytest.approx(0.0, abs=1e-6)
    assert time.now_s == pytest.approx(5.0 + CYCLES * CYCLE_S)


def test_a_short_delay_is_not_carried_on():
    time = Time([0.0, 0.005, 0.0])
    facts = lateness(time, time.wait)
    assert facts.worst_ms == pytest.approx(5.0)
    assert facts.median_ms == pytest.approx(0.0, abs=1e-6)
    assert time.now_s == pytest.approx(5.0 + CYCLES * CYCLE_S)


def test_a_stall_is_late_once():
    time = Time([0.0, 0.0, 0.5])
    facts = lateness(time, time.wait)
    assert facts.worst_ms == pytest.approx(500.0)
    assert facts.median_ms == pytest.approx(0.0, abs=1e-6)


def test_a_machine_that_stands_still_is_not_waited_for():
    time = Time([2.0] * CYCLES)
    facts = lateness(time, time.wait)
    assert facts.count == 2
    assert time.now_s < 5.0 + UNTIL_S + 2.1


@given(st.lists(st.floats(0.0, 0.2), max_size=CYCLES))
def test_the_worst_is_what_was_worst(late_s):
    time = Time(late_s)
    facts = lateness(time, time.wait)
    shown = late_s[: facts.count]
    assert facts.worst_ms >= 1000 * max(shown, default=0.0) - 1e-6
    assert facts.worst_ms <= 1000 * (max(shown, default=0.0) + CYCLE_S) + 1e-6


def test_a_session_that_runs_is_left_its_processor(tmp_path):
    if not Path("/proc/locks").exists():
        pytest.skip("this kernel lists no locks")
    held = lock(tmp_path)
    try:
        assert isinstance(loop_delays(Examined(Site(), None, log_directory=tmp_path)), Unknown)
    finally:
        os.close(held)


@pytest.mark.processes
def test_beside_a_busy_process_that_ends_with_the_look(monkeypatch, tmp_path):
    started = []
    popen = latency.subprocess.Popen
    monkeypatch.setattr(
        latency.subprocess, "Popen", lambda *a, **k: started.append(popen(*a, **k)) or started[-1]
    )
    monkeypatch.setattr(latency, "CYCLES", 3)
    facts = loop_delays(Examined(Site(), None, log_directory=tmp_path))
    assert 0 <= facts.median_ms <= facts.worst_ms
    assert [process.returncode is not None for process in started] == [True]
