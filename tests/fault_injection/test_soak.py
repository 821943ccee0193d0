"""The soak: under disturbances that the protocol tolerates no session stops; ``make test-long`` cuts for an hour."""

import os

import pytest

from tests.fault_injection.soak import soak, with_timing
from tests.runtime.session.pair import job_of

pytestmark = pytest.mark.no_cover
SEED = int(os.environ.get("CUTGATE_SEED", "1"))
MINUTE_S, HOUR_S = 60.0, 3600.0
QUICK = (20, 100)
"""Heartbeat and time-out of a session that says nothing else, ms."""
LEISURELY = (50, 250)
"""Two fifths of the frames, ms: so an hour passes in some minutes."""
KINDS = 9


def nothing_stopped(tally, seconds):
    """And something has happened."""
    print(tally)  # noqa: T201 - a soak says what it did
    assert not tally.false_stops
    assert not tally.logs
    assert tally.virtual_s >= seconds
    assert tally.cuts == tally.sessions >= seconds / 30
    assert len(tally.disturbances) == KINDS
    assert tally.disturbances.total() >= seconds / 2


def test_a_minute_of_what_is_tolerated_stops_nothing(tmp_path, tmp_path_factory):
    files, job = job_of(tmp_path_factory)
    assert (job.timing.heartbeat_ms, job.timing.timeout_ms) == QUICK
    nothing_stopped(soak(tmp_path, files, job, MINUTE_S, SEED), MINUTE_S)


@pytest.mark.long
def test_an_hour_of_what_is_tolerated_stops_nothing(tmp_path, tmp_path_factory):
    files, job = job_of(tmp_path_factory)
    nothing_stopped(soak(tmp_path, files, with_timing(job, *LEISURELY), HOUR_S, SEED), HOUR_S)


def test_pauses_longer_than_the_time_out_are_told_as_false_stops(tmp_path, tmp_path_factory, monkeypatch):
    """What is not benign does stop, and the soak says so."""
    monkeypatch.setattr("tests.fault_injection.soak.PAUSE_TIMEOUTS", 10.0)
    monkeypatch.setattr("tests.fault_injection.soak.Disturbed.FRAME", {})
    tally = soak(tmp_path, *job_of(tmp_path_factory), 1.0, SEED)
    assert tally.false_stops
    assert "false stops: 0" not in str(tally)
