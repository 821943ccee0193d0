"""Error counters, as ISO 11898-1 counts them."""

import pytest

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


def test_everything_that_is_counted_has_a_row():
    assert set(STEPS) == set(Counted)
