"""One cycle of a loop: what came too late is found, nothing of it counts, and heartbeats keep their pace."""

import math
from dataclasses import dataclass, field

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.cycle import Cycle
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.frames import (
    ControllerHeartbeat,
    RuntimeHeartbeat,
)
from cutgate.protocol.link import Accepted, Violation
from cutgate.protocol.port import RETRY_S, Port
from cutgate.protocol.states import ControllerState, RuntimeCode, StopCause
from cutgate.protocol.wire import Side
from tests.protocol.sessions import DIGEST, KEY, tagged

TIMEOUT_S, HEARTBEAT_S, TRANSFER_S = 0.125, 0.03125, 2.0  # exact, so that bounds are met exactly
START_S = 50.0
BEAT = RuntimeHeartbeat(RuntimeCode.CUT, 3)
ANSWER = ControllerHeartbeat(ControllerState.CUTTING, 3, StopCause.NONE, True, True, True, echo=0)


@dataclass
class Bus:
    """What waits on it, whether it has room, and how long each look at it takes."""

    clock: "Clock"
    waiting: list[can.Message] = field(default_factory=list)
    room: bool = True
    takes_s: float = 0.0
    broken: bool = False

    def recv(self, timeout):
        assert timeout == 0
        if self.broken:
            raise can.CanOperationError("gone")
        self.clock.now_s += self.takes_s
        self.takes_s = 0.0
        return self.waiting.pop(0) if self.waiting else None

    def send(self, message, timeout):
        assert timeout == 0
        if not self.room:
            raise can.CanTimeoutError("full")


@dataclass
class Clock:
    now_s: float = START_S

    def __call__(self):
        return self.now_s


class Loop:
    """A cycle of the runtime's side, and what it is joined to."""

    def __init__(self, *, opened=True):
        self.clock = Clock()
        self.bus = Bus(self.clock)
        self.endpoint = Endpoint(
            Side.RUNTIME, KEY, heartbeat_s=HEARTBEAT_S, timeout_s=TIMEOUT_S, transfer_timeout_s=TRANSFER_S
        )
        if opened:
            self.endpoint.use_session(DIGEST)
            self.endpoint.open_link(START_S)
        self.port = Port(self.bus, self.endpoint)
        self.cycle = Cycle(self.port, self.clock)

    def arrives(self, counter=0):
        can_id, data = tagged(ANSWER, counter, ANSWER.echo)
        self.bus.waiting.append(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def begin(self, after_s):
        self.clock.now_s += after_s
        self.cycle.begin()


@pytest.fixture
def loop():
    return Loop()


# ---------------------------------------------------------------- too late


@pytest.mark.parametrize(
    ("gap_s", "stalled"), [(TIMEOUT_S, False), (TIMEOUT_S + 1e-6, True), (math.nan, True)]
)
def test_a_loop_that_stood_still_throws_away_what_queued_meanwhile(loop, gap_s, stalled):
    for counter in range(3):
        loop.arrives(counter)
    loop.begin(gap_s)
    found = next(loop.cycle.late(), None)
    if stalled:
        assert found is not None
        assert found.cause is StopCause.LOOP_STALLED
        assert found.detail.endswith("ms; 3 frames discarded")
        assert not loop.bus.waiting
    else:
        assert found is None
        assert len(loop.bus.waiting) == 3


def test_a_stall_says_how_long_it_was(loop):
    loop.begin(0.6123)
    assert next(loop.cycle.late()).detail == "this computer stood still for 612 ms; 0 frames discarded"


def test_outside_a_session_nothing_is_too_late():
    loop = Loop(opened=False)
    loop.arrives()
    loop.begin(3600.0)
    assert not list(loop.cycle.late())
    loop.bus.takes_s = 3600.0
    loop.cycle.read()
    assert not loop.bus.waiting, "it was read, whatever came of it"


def test_a_lost_peer_is_found_after_a_stall_and_on_its_own(loop):
    loop.begin(2 * TIMEOUT_S)
    assert [one.cause for one in loop.cycle.late()] == [StopCause.LOOP_STALLED, StopCause.HEARTBEAT_LOST]
    again = Loop()
    for _ in range(3):
        again.begin(0.4 * TIMEOUT_S)
        causes = [one.cause for one in again.cycle.late()]
    assert causes == [StopCause.HEARTBEAT_LOST]


def test_what_is_done_about_the_first_that_is_late_comes_before_the_next_is_looked_for(loop):
    """Whoever stops for a stall voids its transfers: none of them did not end in time as well."""
    loop.begin(2 * TIMEOUT_S)
    found = loop.cycle.late()
    assert next(found).cause is StopCause.LOOP_STALLED
    loop.endpoint.end_session()
    assert not list(found)


def test_a_bus_that_fails_while_it_is_emptied_is_the_callers(loop):
    loop.bus.broken = True
    loop.begin(2 * TIMEOUT_S)
    with pytest.raises(can.CanError):
        next(loop.cycle.late())


# ---------------------------------------------------------------- what arrives


@pytest.mark.parametrize("takes_s", [TIMEOUT_S, TIMEOUT_S + 1e-6])
def test_what_was_read_after_a_stall_at_the_bus_does_not_count(loop, takes_s):
    loop.endpoint.send_frame(BEAT, START_S)
    loop.arrives()
    loop.begin(0.0)
    loop.bus.takes_s = takes_s
    (item,) = loop.cycle.read()
    if takes_s <= TIMEOUT_S:
        assert isinstance(item, Accepted)
        assert item.fresh
    else:
        assert item == Violation(
            StopCause.LOOP_STALLED, "this computer stood still for 125 ms; 1 items discarded at the bus"
        )


# ---------------------------------------------------------------- what is due


def test_the_first_heartbeat_is_due_at_once_and_the_next_a_period_later(loop):
    due = []
    for _ in range(9):
        loop.begin(0.3 * HEARTBEAT_S)
        due.append(loop.cycle.heartbeat_due())
    assert due == [True, False, False] * 3


@given(st.lists(st.floats(0.0, 0.2), min_size=1, max_size=40))
def test_heartbeats_keep_their_pace_and_none_is_made_up_for(gaps_s):
    """One a cycle at most; after a pause the next one is due no sooner than a late one was made."""
    loop, made_s = Loop(), []
    for gap_s in gaps_s:
        loop.begin(gap_s)
        before_s = loop.cycle.next_heartbeat_s
        if loop.cycle.heartbeat_due():
            made_s.append(loop.cycle.now_s)
            assert loop.cycle.now_s >= before_s
            assert loop.cycle.next_heartbeat_s >= loop.cycle.now_s
        else:
            assert loop.cycle.now_s < before_s <= made_s[-1] + HEARTBEAT_S
    assert len(made_s) <= 1 + (loop.cycle.now_s - START_S) / HEARTBEAT_S + 1


def test_how_late_a_heartbeat_was_made_is_known_until_the_next(loop):
    late = []
    for after in (0.0, 0.5, 1.0, 0.25, 0.75):  # of a period
        loop.begin(after * HEARTBEAT_S)
        loop.cycle.heartbeat_due()
        late.append(loop.cycle.late_s / HEARTBEAT_S)
    assert late == [0.0, 0.0, 0.5, 0.5, 0.5]


def test_one_that_has_not_left_is_made_anew_each_cycle(loop):
    loop.bus.room = False
    loop.begin(0.0)
    assert loop.cycle.heartbeat_due()
    loop.endpoint.send_frame(BEAT, loop.cycle.now_s)
    loop.port.flush()
    loop.begin(HEARTBEAT_S / 4)
    assert loop.cycle.heartbeat_due()
    loop.bus.room = True
    loop.port.flush()
    loop.begin(HEARTBEAT_S / 4)
    assert not loop.cycle.heartbeat_due()


# ---------------------------------------------------------------- waiting


def test_nothing_is_waited_for_beyond_what_is_due_next(loop):
    loop.cycle.next_heartbeat_s = START_S + 0.015
    assert loop.cycle.wait_s() == pytest.approx(0.015)
    loop.cycle.next_heartbeat_s = START_S + 9.0
    assert loop.cycle.wait_s() == pytest.approx(TIMEOUT_S), "the peer's time-out comes first"
    assert loop.cycle.wait_s(START_S + 0.03) == pytest.approx(0.03)
    loop.clock.now_s += 10.0
    assert loop.cycle.wait_s() == 0.0


def test_without_a_session_something_else_is_due():
    loop = Loop(opened=False)
    assert loop.cycle.wait_s(START_S + 5.0) == pytest.approx(5.0)


def test_while_the_bus_takes_no_more_it_is_asked_again_soon(loop):
    loop.cycle.next_heartbeat_s = START_S + HEARTBEAT_S
    loop.port.waits = True
    assert loop.cycle.wait_s() == RETRY_S
    loop.cycle.next_heartbeat_s = START_S + RETRY_S / 2
    assert loop.cycle.wait_s() == pytest.approx(RETRY_S / 2)


def test_the_clock_says_when_each_cycle_began_and_how_long_after_the_one_before(loop):
    assert (loop.cycle.now_s, loop.cycle.gap_s) == (START_S, 0.0)
    loop.begin(0.25)
    loop.begin(0.5)
    assert (loop.cycle.now_s, loop.cycle.gap_s) == (START_S + 0.75, 0.5)
