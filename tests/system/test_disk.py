"""A disk that never answers again: nothing that enables leaves, what stops leaves at once."""

import pytest

from cutgate.protocol import records
from cutgate.protocol.frames import ControllerHeartbeat, RuntimeHeartbeat, RuntimeStop
from cutgate.protocol.states import RuntimeCode, StopCause
from cutgate.runtime.interlock.state import Phase
from tests.system.children import Script
from tests.system.harness import begins

pytestmark = pytest.mark.processes

AT_ONCE = 2
"""Heartbeats: one that was on its way, and one that was due with the word."""


def test_no_permit_leaves_and_the_session_fails(rig):
    run, sim = rig.run(script=Script(disk_stops_at=Phase.VERIFYING)), rig.sim()
    run.line("permit authorised, its record is being made durable")
    run.line("STOP sent: the permit's record did not reach the disk")
    sim.line(r"state FAULT \(AUDIT_FAILED\)")
    assert not any(begins(message, records.Permit) for message in rig.bus.frames)
    assert {beat.code for _, beat in rig.bus.all(RuntimeHeartbeat)} == {RuntimeCode.INHIBIT}
    assert not any(beat.cutting_mode for _, beat in rig.bus.all(ControllerHeartbeat))


@pytest.mark.parametrize("phase", [Phase.AUTHORISING_PERMIT, Phase.AUTHORISING_START, Phase.CUTTING])
def test_the_stop_leaves_within_a_heartbeat_of_the_word(rig, phase):
    stuck = Phase.PERMITTED if phase is Phase.AUTHORISING_START else phase
    script = Script(disk_stops_at=Phase.VERIFYING if phase is Phase.AUTHORISING_PERMIT else stuck)
    run, sim = rig.run(script=script), rig.sim()
    if phase is not Phase.AUTHORISING_PERMIT:
        run.line("permitted:")
        sim.say("hold")
        run.line("say start$")
        run.say("start")
    run.line(
        {Phase.AUTHORISING_PERMIT: "permit auth", Phase.AUTHORISING_START: "start auth"}.get(
            phase, "cutting$"
        )
    )
    said = len(rig.bus.frames)
    run.say("stop")
    left = rig.bus.single(RuntimeStop)
    assert rig.bus.beats(RuntimeHeartbeat, after=said, before=left) <= AT_ONCE
    sim.line(r"state INHIBITED \(OPERATOR_STOP\)")
    assert not any(begins(m, records.Start) for m in rig.bus.frames) or phase is Phase.CUTTING
    assert rig.bus.all(RuntimeStop)[0][1].cause is StopCause.OPERATOR_STOP
