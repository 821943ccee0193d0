"""Other nodes on the bus: stale heartbeats, a stop that overtakes a permit, a second runtime, a second controller."""

import signal
from dataclasses import replace

import can
import pytest

from cutgate.protocol import records
from cutgate.protocol.frames import (
    IDS,
    ControllerFault,
    ControllerHeartbeat,
    RuntimeHeartbeat,
    RuntimeStop,
    encode_frame,
)
from cutgate.protocol.states import RuntimeCode, StopCause
from cutgate.runtime.interlock.state import Phase
from tests.protocol.sessions import tagged
from tests.system.children import Script
from tests.system.harness import (
    FAST,
    IN_TIME,
    POSES,
    begins,
    decoded,
    is_kind,
    session_codes,
    state_of,
)

pytestmark = pytest.mark.processes

STALE = 60


def inject(rig, can_id: int, data: bytes) -> None:
    rig.bus.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


def heartbeats(rig) -> list[can.Message]:
    """The runtime's heartbeats that said CUT, oldest first."""
    beats = [m for m in list(rig.bus.frames) if is_kind(m, RuntimeHeartbeat)]
    return [m for m in beats if decoded(m).code is RuntimeCode.CUT]


def test_queued_heartbeats_do_not_keep_the_gate_open(rig):
    """What a queue in between would deliver: 60 heartbeats, intact and in sequence, that echo nothing new."""
    sim, run = rig.cutting()
    run.signal(signal.SIGSTOP)
    rig.bus.single(ControllerHeartbeat, after=len(rig.bus.frames))  # the runtime's last one has been seen
    last = heartbeats(rig)[-1]
    beat, codes, given = decoded(last), session_codes(rig), 0
    for number in range(1, STALE + 1):
        mark = len(rig.bus.frames)
        inject(rig, *tagged(beat, last.data[2] + number, beat.echo, codes))
        given = number
        seen = rig.bus.frame(  # the next one follows a controller heartbeat later: 50 ms
            lambda m: is_kind(m, ControllerHeartbeat) or begins(m, records.Announce), after=mark
        )
        if begins(seen, records.Announce):
            break
    stopped = rig.bus.single(ControllerFault)
    assert decoded(stopped).cause is StopCause.HEARTBEAT_LOST
    heard = next(number for number, m in enumerate(rig.bus.frames) if m is last)
    assert rig.bus.beats(ControllerHeartbeat, after=heard, before=stopped) <= IN_TIME
    assert 1 < given < STALE  # they were taken for heartbeats, and not one of them counted
    assert "SEQUENCE_ERROR" not in sim.told
    assert rig.at_rest(sim) == "INHIBITED (HEARTBEAT_LOST)"


def test_heartbeats_that_nobody_with_the_key_has_made_stop_the_cut_at_once(rig):
    """Sound in everything but the tag, as a node that reads the bus can make them while the runtime hangs."""
    sim, run = rig.cutting()
    run.signal(signal.SIGSTOP)
    seen = rig.bus.single(ControllerHeartbeat, after=len(rig.bus.frames))
    last, tag = heartbeats(rig)[-1], session_codes(rig).tag
    forged = replace(decoded(last), echo=seen.data[2])
    inject(rig, *encode_frame(forged, (last.data[2] + 1) % 256, tag))
    stopped = rig.bus.single(ControllerFault)
    assert decoded(stopped).cause is StopCause.AUTHENTICATION_FAILED
    assert rig.at_rest(sim) == "FAULT (AUTHENTICATION_FAILED)"


def test_heartbeats_of_the_past_stop_the_cut_by_their_counters(rig):
    sim, run = rig.cutting()
    run.signal(signal.SIGSTOP)
    old = [m for m in list(rig.bus.frames) if is_kind(m, RuntimeHeartbeat)][-STALE:-4]
    for message in old:
        inject(rig, message.arbitration_id, bytes(message.data))
    sim.line(r"state INHIBITED \(SEQUENCE_ERROR\)")


def test_a_permit_overtaken_by_a_stop_enables_nothing(rig):
    """The runtime sleeps with its PERMIT begun; anything on the stop identifier comes in between."""
    run, sim = rig.run(script=Script(at=Phase.PERMITTING, sent=True, number=signal.SIGSTOP)), rig.sim()
    rig.bus.frame(lambda m: begins(m, records.Permit))
    rig.until(lambda: run.stopped)
    inject(rig, IDS[RuntimeStop], bytes(8))
    sim.line("state INHIBITED")
    run.signal(signal.SIGCONT)
    assert run.exit() == 3
    assert "state PERMITTED" not in sim.told
    assert not any(beat.cutting_mode for _, beat in rig.bus.all(ControllerHeartbeat))


def test_a_second_runtime_notices_the_first_and_leaves_it_alone(rig):
    sim, run = rig.cutting(scale=12)
    second = rig.run(logs="other-logs")
    assert second.exit() == 3
    assert "own identifier" in second.told
    assert run.exit() == 0
    assert f"{POSES - 1} segments executed" in sim.line("state DONE")


@pytest.mark.parametrize("identifier", [IDS[RuntimeHeartbeat], IDS[ControllerHeartbeat]])
def test_a_node_that_speaks_for_one_side_latches_the_controller(rig, identifier):
    sim, run = rig.cutting()
    inject(rig, identifier, bytes(8))
    assert run.exit() == 3
    assert rig.at_rest(sim) == "FAULT (SECOND_NODE)"


def test_a_second_controller_refuses_the_bus(rig):
    rig.sim()
    second = rig.sim(ready=False, fresh=True)
    assert second.exit() == 2
    assert "the bus already carries cutgate frames" in second.told


def test_a_log_directory_serves_one_session_at_a_time(rig):
    first = rig.run(script=Script(at=Phase.WAITING, number=signal.SIGSTOP))
    rig.until(rig.logs)
    second = rig.run()
    assert second.exit() == 2
    assert "in use" in second.told
    first.signal(signal.SIGKILL)
    assert first.exit() == -signal.SIGKILL
    third = rig.run()  # the lock dies with its holder; the crash is on record
    sim = rig.sim(scale=FAST)
    third.line("permitted:")
    third.say("quit")
    assert third.exit() == 3
    assert state_of(sim) == "INHIBITED"
    opened = rig.log().of("/audit/open")[0]
    assert opened["previous_crashed"] is True
