"""Key, log directory, space and delays: where each bound lies."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.model import LogSettings, Site, TimingSettings
from cutgate.config.records import timing_record
from cutgate.config.refusal import FileProblem
from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import Delays, FreeSpace, KeyFile, LogFolder
from cutgate.runtime.doctor.finding import Condition
from cutgate.runtime.doctor.judges.files import (
    HOUR_S,
    judge_disk,
    judge_key,
    judge_log_folder,
    judge_loop,
    judge_space,
    needed_bytes,
)
from cutgate.runtime.session.space import space

HERE = Examined(Site(), None)
PROBLEM = FileProblem("site.key", "mode", "0644", "without access by others (0600)", "chmod 600")
MISSING = FileProblem("site.key", "", "", "there is no such key file", "cutgate key new")
WORSE = [Condition.OK, Condition.WARNING, Condition.FAIL]


def only(found):
    (one,) = found
    assert bool(one.remedy) is (one.state is not Condition.OK)
    return one


def test_a_key_is_told_by_its_fingerprint():
    found = only(judge_key(KeyFile("site.key", "1234-5678", None), HERE))
    assert (found.state, found.found) == (Condition.OK, "site.key, fingerprint 1234-5678")


@pytest.mark.parametrize(
    ("problem", "found", "bound"),
    [
        (PROBLEM, "site.key: mode is 0644", "without access by others (0600)"),
        (MISSING, "site.key: there is no such key file", "a key that only this user may read"),
    ],
)
def test_a_refused_key_is_told_as_a_session_tells_it(problem, found, bound):
    told = only(judge_key(KeyFile("site.key", "", problem), HERE))
    assert (told.state, told.found, told.bound) == (Condition.FAIL, found, bound)
    assert told.remedy == problem.remedy


@pytest.mark.parametrize(
    ("facts", "state", "told"),
    [
        (LogFolder("logs", there=True, problem=None, session=None), Condition.OK, "logs"),
        (
            LogFolder("logs", there=False, problem=None, session=None),
            Condition.OK,
            "the first session makes it",
        ),
        (LogFolder("logs", there=True, problem=None, session=42), Condition.FAIL, "in use by process 42"),
        (LogFolder("logs", there=True, problem=PROBLEM, session=None), Condition.FAIL, "mode is 0644"),
    ],
)
def test_a_log_directory(facts, state, told):
    found = only(judge_log_folder(facts, HERE))
    assert found.state is state
    assert told in found.found


def test_an_hour_is_asked_for_and_less_than_the_wait_for_an_operator_is_a_failure():
    hour, least = needed_bytes(HERE, HOUR_S), needed_bytes(HERE, 300.0 + 120.0)
    assert 0 < least < hour
    for free, state in (
        (hour, Condition.OK),
        (hour - 1, Condition.WARNING),
        (least, Condition.WARNING),
        (least - 1, Condition.FAIL),
        (0, Condition.FAIL),
    ):
        found = only(judge_space(FreeSpace("/data", free), HERE))
        assert found.state is state
        assert "/data" in found.found


def test_what_is_asked_for_is_twice_what_a_session_takes():
    site = Site(timing=TimingSettings(heartbeat_ms=50, timeout_ms=500), log=LogSettings(chunk_period_ms=200))
    examined = Examined(site, None, "socketcan", "can0")
    taken = space(3600, timing_record(site), chunk_period_s=0.2, interface="can0")
    assert needed_bytes(examined, HOUR_S) == 2 * (taken.log + taken.frames)


def test_free_and_missing_space_are_told_in_megabytes():
    hour = needed_bytes(HERE, HOUR_S)
    found = only(judge_space(FreeSpace("/data", hour - 250_000_000), HERE))
    assert found.found == f"{(hour - 250_000_000) / 1e6:.0f} MB free on the disk of /data"
    assert found.bound.startswith(f">= {hour / 1e6:.0f} MB: ")
    assert found.remedy.startswith("free 250 MB there")


def test_half_the_heartbeat_takes_twice_the_space_of_frames():
    """Tracking and timing come no more than 50 times a second: from 20 ms on they take the same."""
    five, ten, twenty = (
        needed_bytes(Examined(Site(timing=TimingSettings(heartbeat_ms=period_ms)), None), HOUR_S)
        for period_ms in (5, 10, 20)
    )
    assert five - ten == pytest.approx(2 * (ten - twenty), rel=0.01)
    assert 1.6 < ten / twenty < 2.0


def test_a_wait_that_is_longer_than_an_hour_is_never_good_with_less():
    patient = Examined(Site(timing=TimingSettings(operator_wait_s=3600)), None)
    assert only(judge_space(FreeSpace("/", needed_bytes(patient, HOUR_S)), patient)).state is Condition.FAIL


@pytest.mark.parametrize(
    ("worst_ms", "state"),
    [
        (0.0, Condition.OK),
        (199.9, Condition.OK),
        (200.0, Condition.WARNING),
        (399.9, Condition.WARNING),
        (400.0, Condition.FAIL),
        (math.inf, Condition.FAIL),
        (math.nan, Condition.FAIL),
    ],
)
def test_a_disk_by_its_worst(worst_ms, state):
    site = Site(log=LogSettings(commit_deadline_ms=400))
    found = only(judge_disk(Delays(20, 1.0, worst_ms), Examined(site, None)))
    assert found.state is state
    assert "commit_deadline_ms = 400" in found.bound


@pytest.mark.parametrize(
    ("worst_ms", "state"),
    [
        (0.0, Condition.OK),
        (24.9, Condition.OK),
        (25.0, Condition.WARNING),
        (124.9, Condition.WARNING),
        (125.0, Condition.FAIL),
        (math.nan, Condition.FAIL),
    ],
)
def test_a_loop_by_its_worst(worst_ms, state):
    site = Site(timing=TimingSettings(heartbeat_ms=25, timeout_ms=150))
    found = only(judge_loop(Delays(50, 1.0, worst_ms), Examined(site, None)))
    assert found.state is state
    assert "docs/timing.md" in found.remedy or state is Condition.OK


@given(st.floats(0, 1e6), st.floats(0, 1e6), st.sampled_from([judge_disk, judge_loop]))
def test_what_is_later_is_never_better(one_ms, other_ms, judge):
    first, second = (
        WORSE.index(only(judge(Delays(9, 0.0, ms), HERE)).state) for ms in sorted((one_ms, other_ms))
    )
    assert first <= second
