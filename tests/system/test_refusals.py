"""A start that must not be: refused by the runtime, and by the controller where the runtime is blind to it."""

from dataclasses import replace

import numpy as np
import pytest

from cutgate.config.load import load_robot
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.protocol import records
from cutgate.protocol.frames import CONTROL_IDS, ControllerHeartbeat
from cutgate.protocol.states import ControllerState
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.recorded import problem_from_records
from tests.system.children import Script
from tests.system.harness import ROBOT, state_of

pytestmark = pytest.mark.processes


def ended(rig, sim, run):
    """Quit, and see that the arm never moved."""
    run.say("quit")
    assert run.exit() == 3
    assert rig.at_rest(sim) == "INHIBITED"
    assert "state CUTTING" not in sim.told


def test_a_device_held_since_before_the_permit_counts_only_after_it_was_released(rig):
    sim = rig.sim()
    sim.say("hold")
    run = rig.run()
    run.line("not ready to start: enabling device")
    run.say("start")
    run.line("start refused: enabling device")
    sim.say("release")
    mark = len(rig.bus.frames)
    rig.bus.single(ControllerHeartbeat, lambda beat: not beat.device_pressed, after=mark)
    sim.say("hold")
    run.line("enabling device is held: say start")
    ended(rig, sim, run)


def test_a_device_held_since_before_the_permit_is_refused_by_the_controller_too(rig):
    sim = rig.sim()
    sim.say("hold")
    run = rig.run(script=Script(blind=("device_cycled",)))
    run.line("permitted:")
    until_refused(run, "DEVICE_NOT_RELEASED_AND_PRESSED")
    assert "refused: DEVICE_NOT_RELEASED_AND_PRESSED" in sim.line("refused")
    ended(rig, sim, run)


def until_refused(run, reason):
    """Say start again as long as the runtime itself does not yet see the controller permitted."""
    while True:
        run.say("start")
        if reason in run.line("start refused"):
            return


def test_an_arm_off_the_start_pose_is_seen_by_the_runtime(rig):
    sim, run = rig.permitted("off-start@permitted")
    sim.say("hold")
    run.line("not ready to start: measured wrist centre to the verified start")
    run.say("start")
    run.line("start refused: measured wrist centre to the verified start")
    ended(rig, sim, run)


def test_an_arm_off_the_start_pose_is_refused_by_the_controller_too(rig):
    """Of a runtime that neither asks nor watches: its tracking monitor would stop it before START is complete, or after."""
    blind = Script(blind=("start_distance", "start_angle"), unwatched=True)
    sim, run = rig.permitted("off-start@permitted", script=blind)
    sim.say("hold")
    run.line("not ready to start: measured wrist centre")  # the view is not blind
    until_refused(run, "NOT_AT_START")
    assert "refused: NOT_AT_START" in sim.line("refused")
    ended(rig, sim, run)


@pytest.mark.parametrize(
    ("fault", "refusal"), [("flip-path-bit", "PATH_DIGEST"), ("change-limit", "LIMITS_DIGEST")]
)
def test_what_changed_in_the_controller_without_a_word_is_found_at_the_start(rig, fault, refusal):
    sim, run = rig.permitted(f"{fault}@permitted")
    sim.say("hold")
    run.line("say start$")
    run.say("start")
    run.line(f"the controller refused the start: {refusal}")
    ended(rig, sim, run)


def test_a_bit_flipped_while_cutting_stops_the_cut(rig):
    sim, run = rig.permitted("flip-path-bit@cutting", scale=100)
    sim.say("hold")
    run.line("say start$")
    run.say("start")
    assert run.exit() == 3
    assert "PATH_CHANGED" in run.told
    assert state_of(sim) == "INHIBITED (PATH_CHANGED)"


def test_a_controller_that_rebooted_is_no_longer_permitted(rig):
    run, sim = rig.run(), rig.sim("reboot@permitted")
    assert run.exit() == 3
    assert "the controller announced itself anew" in run.told
    rig.at_rest(sim)
    announced = [e.record for e in rig.bus.records(CONTROL_IDS[1]) if isinstance(e.record, records.Announce)]
    assert announced[-1].announce_nonce != announced[0].announce_nonce
    assert announced[-1].state is ControllerState.INHIBITED


def test_a_path_that_only_its_quantised_form_brings_over_the_deadband_is_refused():
    """0.3 um inside the slide's upper deadband; on the wire the tip is rounded up by 0.4 um."""
    robot = load_robot(ROBOT).value
    height, reserve = 317.0006, 0.0003
    cosine = (robot.limits.q2_mm[1] - robot.deadband.arm_mm - reserve - height) / robot.tool.length_mm
    axes = np.tile([np.sqrt(1.0 - cosine**2), 0.0, cosine], (3, 1))
    tips = np.array([[x, 0.0, height] for x in (600.0, 605.0, 610.0)])
    path = records.Path.quantised(
        tips, axes, feed_mm_s=5.0, tool_length_mm=robot.tool.length_mm, elbow=robot.elbow
    )
    on_the_wire = problem_from_records(
        path.body(),
        limits_record(robot).body(),
        calibration_record(robot).body(),
        tool_record(robot).body(),
        robot,
    )
    as_planned = replace(on_the_wire, tips_mm=tips, axes=axes)
    assert certified.verify(as_planned).admissible
    refused = certified.verify(on_the_wire)
    assert not refused.admissible
    assert [name for name, boundary in refused.boundaries.items() if boundary.violated] == ["top"]
