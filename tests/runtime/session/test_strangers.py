"""Frames that are neither side's: counted within bounds, and named where hardly any others are heard."""

import math
from collections import Counter
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.frames import IDS, ControllerHeartbeat, RuntimeHeartbeat
from cutgate.runtime.interlock.state import Crowd
from cutgate.runtime.session.strangers import FRAMES_PER_S, IDENTIFIERS_MAX, Strangers

STEP_S = 0.125
"""A window, and a number that binary fractions hold."""
TIMING = SimpleNamespace(timeout_s=2 * STEP_S)
OURS = (IDS[ControllerHeartbeat], IDS[RuntimeHeartbeat], 0x600, 0x641)
ENOUGH = math.ceil(FRAMES_PER_S * 2 * STEP_S)


def heard(frames, after_s=STEP_S):
    """What is said of these, all of them in one window."""
    strangers = Strangers(TIMING)
    strangers.cycle(1.0)
    strangers.cycle(1.0 + STEP_S)
    for can_id, is_extended in frames:
        strangers.frame(can_id, is_extended=is_extended)
    return strangers.crowd(1.0 + STEP_S + after_s)


def test_who_says_nearly_everything_is_named():
    assert heard([(0, False)] * 730) == Crowd(0, False, round(730 / (2 * STEP_S)), 100)
    assert str(heard([(0x7F, False)] * 730)).startswith(
        "100 % of the frames on the bus had identifier 0x07F, which is"
    )
    assert (
        "0x00000080" in str(heard([(IDS[ControllerHeartbeat], True)] * 730))
        or IDS[ControllerHeartbeat] != 0x80
    )


@pytest.mark.parametrize("one", OURS)
def test_what_the_two_sides_say_is_no_crowd(one):
    assert heard([(one, False)] * 5000) is None
    assert heard([(one, True)] * 5000) is not None


@pytest.mark.parametrize(("ours", "named"), [(630, True), (631, False)])
def test_where_more_than_half_is_ours_we_get_through(ours, named):
    frames = [(1, False)] * 630 + [(OURS[0], False)] * ours
    assert (heard(frames) is not None) is named


@pytest.mark.parametrize(("number", "named"), [(ENOUGH, True), (ENOUGH - 1, False)])
def test_a_node_that_does_its_work_is_not_named(number, named):
    assert (heard([(1, False)] * number) is not None) is named


def test_a_bus_on_which_nothing_is_heard_is_not_crowded():
    assert heard([]) is None
    assert Strangers(TIMING).crowd(1.0) is None


def test_what_is_older_than_the_time_out_says_nothing():
    strangers = Strangers(TIMING)
    for at_s, number, named in ((0.0, 5000, False), (1.1, 0, True), (2.2, 0, False)):
        strangers.cycle(1.0 + at_s * STEP_S)
        for _ in range(number):
            strangers.frame(0, is_extended=False)
        assert (strangers.crowd(1.0 + (at_s + 0.05) * STEP_S) is not None) is named


@given(
    st.lists(st.tuples(st.integers(0, 0x7FF), st.booleans()), min_size=1, max_size=40).map(
        lambda keys: keys * 40
    )
)
def test_the_identifier_of_most_is_the_one_that_counting_finds(frames):
    strange = Counter(key for key in frames if key[0] not in OURS or key[1])
    found = heard(frames)
    if found is not None:
        key = (found.can_id, found.is_extended)
        assert strange[key] == max(strange.values())
        assert found.percent == round(100 * strange[key] / len(frames))


def test_of_more_identifiers_than_are_counted_the_first_are():
    strangers = Strangers(TIMING)
    strangers.cycle(1.0)
    for can_id in range(IDENTIFIERS_MAX + 1):
        for _ in range(10):
            strangers.frame(can_id, is_extended=True)
    assert len(strangers._now.by_identifier) == IDENTIFIERS_MAX
    strangers.cycle(1.0 + STEP_S)
    assert strangers.crowd(1.0 + 2 * STEP_S).can_id == IDENTIFIERS_MAX - 1


def test_a_window_has_its_length_however_many_cycles_are_in_it():
    strangers = Strangers(TIMING)
    strangers.cycle(1.0)
    for _ in range(ENOUGH):
        strangers.frame(0, is_extended=False)
    for part in range(1, 8):
        strangers.cycle(1.0 + part * STEP_S / 8)
    strangers.cycle(1.0 + STEP_S)
    assert strangers.crowd(1.0 + 2 * STEP_S) == Crowd(0, False, FRAMES_PER_S, 100)


@pytest.mark.parametrize("order", [(1, 2), (2, 1)])
def test_of_two_that_say_as_much_always_the_same_is_named(order):
    assert heard([(can_id, False) for can_id in order] * 500).can_id == 2


def test_the_bounds():
    assert (FRAMES_PER_S, IDENTIFIERS_MAX) == (500, 64)
