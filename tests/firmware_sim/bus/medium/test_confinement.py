"""Error counters, as ISO 11898-1 counts them."""

from dataclasses import FrozenInstanceError

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.bus.medium.confinement import STEPS, Counted, Counters, NodeState

S = NodeState


def counted(counters, kind, times):
    for _ in range(times):
        counters = counters.after(kind)
    return counters


@pytest.mark.parametrize(
    ("transmit", "receive", "state"),
    [
        (0, 0, S.ERROR_ACTIVE),
        (95, 95, S.ERROR_ACTIVE),
        (96, 0, S.ERROR_WARNING),
        (0, 96, S.ERROR_WARNING),
        (127, 127, S.ERROR_WARNING),
        (128, 0, S.ERROR_PASSIVE),
        (0, 128, S.ERROR_PASSIVE),
        (255, 0, S.ERROR_PASSIVE),
        (256, 0, S.BUS_OFF),
    ],
)
def test_the_state_follows_from_the_counters(transmit, receive, state):
    assert Counters(transmit, receive).state is state


def test_who_sends_wrong_is_off_after_32_and_who_receives_wrong_never():
    assert counted(Counters(), Counted.SENT_WRONG, 31).state is S.ERROR_PASSIVE
    assert counted(Counters(), Counted.SENT_WRONG, 32).state is S.BUS_OFF
    assert counted(Counters(), Counted.RECEIVED_WRONG, 1000) == Counters(0, 128)


def test_alone_on_the_bus_a_node_never_goes_off():
    assert counted(Counters(), Counted.NOT_ACKNOWLEDGED, 1000) == Counters(128, 0)


def test_counters_count_down_to_nothing_and_no_further():
    assert counted(Counters(3, 3), Counted.SENT, 9) == Counters(0, 3)
    assert counted(Counters(3, 3), Counted.RECEIVED, 9) == Counters(3, 0)


def test_a_receiver_that_was_passive_is_active_after_one_frame():
    after = Counters(0, 128).after(Counted.RECEIVED)
    assert (after.receive, after.state) == (127, S.ERROR_WARNING)


@pytest.mark.parametrize(
    ("counted", "transmit", "receive"),
    [
        (Counted.SENT, 49, 50),
        (Counted.RECEIVED, 50, 49),
        (Counted.SENT_WRONG, 58, 50),
        (Counted.NOT_ACKNOWLEDGED, 58, 50),
        (Counted.RECEIVED_WRONG, 50, 51),
        (Counted.FOUND_WRONG, 50, 59),
    ],
)
def test_the_steps_of_the_standard(counted, transmit, receive):
    assert Counters(50, 50).after(counted) == Counters(transmit, receive)


def test_everything_that_is_counted_has_a_row_above():
    (marked,) = (mark for mark in test_the_steps_of_the_standard.pytestmark if mark.name == "parametrize")
    assert [row[0] for row in marked.args[1]] == [*Counted]
    assert set(STEPS) == set(Counted)


@given(st.integers(0, 255), st.integers(0, 128), st.sampled_from(Counted))
def test_whatever_is_counted_only_that_counter_moves_and_stays_within_its_bounds(transmit, receive, counted):
    after = Counters(transmit, receive).after(counted)
    assert after.receive in range(129)
    assert after.transmit in range(256 + 8)
    if counted in {Counted.SENT, Counted.SENT_WRONG, Counted.NOT_ACKNOWLEDGED}:
        assert after.receive == receive
    else:
        assert after.transmit == transmit


def test_the_states_are_numbered_as_linux_numbers_them():
    """``enum can_state`` of linux/can/netlink.h."""
    assert [int(state) for state in S] == [0, 1, 2, 3]


def test_counters_are_values():
    with pytest.raises(FrozenInstanceError):
        Counters().transmit = 1
