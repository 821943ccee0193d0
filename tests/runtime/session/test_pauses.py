"""Which side was late: what the loop remembers of its own pauses."""

import math

from cutgate.runtime.session.pauses import PAUSES_KEPT, Pauses
from tests.runtime.interlock.builders import TIMING

LONG_S = 2 * TIMING.heartbeat_s
LATELY_S = 2 * TIMING.timeout_s


def told(*cycles, now_s=10.0):
    """The longest pause of late, ms, after cycles that began at so many seconds, so long after the one before."""
    pauses = Pauses(TIMING)
    for at_s, gap_s in cycles:
        pauses.cycle(gap_s, at_s)
    return pauses.longest_ms(now_s)


def test_a_loop_that_keeps_its_time_has_not_paused():
    assert told() == 0
    assert told((9.9, TIMING.heartbeat_s), (10.0, LONG_S)) == 0


def test_a_pause_is_told_for_as_long_as_it_may_be_the_cause():
    assert told((10.0, math.nextafter(LONG_S, 1.0))) == 40
    assert told((9.9, 0.14)) == 140
    assert told((9.9, 2.0)) == 2000
    for now_s, ms in ((LATELY_S, 500), (math.nextafter(LATELY_S, 1.0), 0)):
        assert told((0.0, 0.5), now_s=now_s) == ms


def test_the_longest_is_told_and_not_the_latest():
    assert told((9.85, 0.3), (9.9, 0.12), (9.95, 0.06)) == 300


def test_a_gap_that_is_no_number_is_a_pause():
    pauses = Pauses(TIMING)
    pauses.cycle(math.inf, 10.0)
    pauses.cycle(math.nan, 10.0)
    assert len(pauses._pauses) == 2


def test_what_is_remembered_is_bounded():
    pauses = Pauses(TIMING)
    for _ in range(10 * PAUSES_KEPT):
        pauses.cycle(1.0, 10.0)
    assert len(pauses._pauses) == PAUSES_KEPT == 64
