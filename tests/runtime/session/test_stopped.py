"""After a stop the session, its document and its log say the same: what, where, whether confirmed, and what next."""

import math

import pytest

from cutgate.firmware_sim.kinematics import calibrated_arm, forward
from cutgate.protocol import records
from cutgate.protocol.frames import FRACTION_MAX, IDS, Joints01, Progress
from cutgate.protocol.states import StopCause
from cutgate.runtime.audit.inspect import Log, read_log
from cutgate.runtime.audit.records import AuditClose, AuditDecision, CanFrame
from cutgate.runtime.commands.session_view import run_document, stopped
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.review.story import story
from tests.runtime.audit.build import forge


def from_the_log(pair, data=None):
    log = read_log(data) if data is not None else pair.read()
    return story(log, pair.paths.log, pair.paths.candump)["stop"]


def moving(pair, time_scale=1.0):
    """The cut is half done."""
    pair.power_up(time_scale=time_scale)
    pair.to(Phase.CUTTING)
    return pair.until(lambda: (pair.session.last_seen[0] or (0, 0))[0] >= 2, 60.0)


def operator(pair):
    pair.say("stop")


def device(pair):
    pair.controller_terminal.type("release")


def emergency(pair):
    pair.controller_terminal.type("estop")


def disk(pair):
    pair.disk.answers = False


def silence(pair):
    pair.controller_runs = False


ACTS = {
    operator: StopCause.OPERATOR_STOP,
    device: StopCause.DEVICE_RELEASED,
    emergency: StopCause.EMERGENCY_STOP,
    disk: StopCause.AUDIT_FAILED,
    silence: StopCause.HEARTBEAT_LOST,
}


@pytest.mark.parametrize("act", ACTS, ids=lambda act: act.__name__)
def test_a_stopped_cut_is_told_alike_by_session_and_log(pair, act):
    moving(pair, 0.1 if act is disk else 1.0)  # for a silent disk is waited some seconds
    act(pair)
    assert pair.end(20.0) is Phase.STOPPED
    told = stopped(pair.session)
    assert (told["cause"], told["moving"]) == (ACTS[act].name, True)
    assert told["confirmed"] is (act is not silence)
    pair.disk.answers = True
    pair.close()
    assert from_the_log(pair) == told
    assert run_document(pair.state, pair.session.answer, pair.paths, told)["stop"] == told


def test_what_a_stalled_session_was_sent_meanwhile_is_told_although_it_is_not_acted_on(pair):
    """Else a person looks for the tool where it was before the stall."""
    moving(pair, 0.3)
    before, _ = pair.session.last_seen
    pair.runtime_runs = False
    pair.run(0.2)
    pair.runtime_runs = True
    assert pair.end() is Phase.STOPPED
    told = stopped(pair.session)
    assert told["cause"] == StopCause.LOOP_STALLED.name
    after, _ = pair.session.last_seen
    assert after > before
    stands = pair.process.arm.state
    assert after[0] == stands.segment
    assert 0 <= stands.fraction - after[1] / FRACTION_MAX < 0.03, "it moved on for a heartbeat at most"
    pair.close()
    assert from_the_log(pair) == told


def test_the_place_is_where_the_plant_stands(pair):
    moving(pair).say("stop").end()
    where = stopped(pair.session)["where"]
    assert 0 < where["segment"] < where["segments"]
    assert 0.0 < where["percent"] < 100.0
    tool, path = records.Tool.parse(pair.job.tool), records.Path.parse(pair.job.path)
    arm = calibrated_arm(
        records.Calibration.parse(pair.job.calibration), tool_mm=tool.length_mm, elbow=path.elbow
    )
    pose = forward(arm, pair.process.arm.state.joints)
    assert math.dist(where["tip_mm"], pose.tip) < 0.2, "a joint frame's last digit is 0.005 deg"
    assert where["segment"] == pair.process.arm.state.segment


@pytest.mark.parametrize("phase", [Phase.COLLECTING, Phase.PERMITTED])
def test_a_session_that_is_left_before_the_start_has_moved_nothing(pair, phase):
    pair.to(phase).say("quit").run(0.1)
    told = stopped(pair.session)
    assert (told["cause"], told["moving"], told["where"]) == ("OPERATOR_QUIT", False, None)
    pair.close()
    assert from_the_log(pair) == told


@pytest.mark.parametrize("name", ["pair", "outside"])
def test_a_cut_that_was_completed_or_refused_tells_of_no_stop(request, name):
    one = request.getfixturevalue(name)
    one.end()
    assert stopped(one.session) is None
    one.close()
    assert from_the_log(one) is None


def test_what_a_stranger_says_of_the_arm_is_not_believed_of_a_log(pair):
    """Frames without the session's tag tell nobody where the arm is."""
    moving(pair).say("stop").end()
    told = stopped(pair.session)
    pair.close()

    def edit(record):
        if isinstance(record, CanFrame) and record.id in (IDS[Progress], IDS[Joints01]):
            return record.model_copy(update={"data": "0000" + record.data[4:]})
        return record

    found = from_the_log(pair, forge(pair.paths.log.read_bytes(), edit))
    assert found["where"] | {"tip_mm": None, "depth_mm": None} == {
        "leg": None,
        "segment": None,
        "segments": told["where"]["segments"],
        "percent": None,
        "to_go_mm": None,
        "tip_mm": None,
        "depth_mm": None,
    }


def test_a_log_that_ends_while_the_arm_moves_says_where_and_that_nobody_confirmed_anything(pair):
    moving(pair).say("stop").end()
    told = stopped(pair.session)
    pair.close()

    def cut_off(record):
        ended = isinstance(record, AuditClose) or (
            isinstance(record, AuditDecision) and record.to_state in ("stopping", "stopped")
        )
        return None if ended else record

    found = from_the_log(pair, forge(pair.paths.log.read_bytes(), cut_off))
    assert (found["cause"], found["while"], found["confirmed"]) == ("NONE", "cutting", False)
    assert "the runtime was killed" in found["reason"]
    assert found["where"] == told["where"]
    assert found["next"][0] == "Release the enabling device."


@pytest.mark.parametrize("can_id", [[1], {}, "x", None, 2**70, True])
def test_a_frame_with_an_identifier_that_is_none_is_passed_over(pair, monkeypatch, can_id):
    moving(pair).say("stop").end()
    pair.close()
    log, before = pair.read(), Log.one_by_one
    frames = [{"direction": "received", "id": can_id, "data": "00" * 8}, {}, {"id": 1}]
    monkeypatch.setattr(
        Log,
        "one_by_one",
        lambda log, topic: iter(frames) if topic == CanFrame.TOPIC else before(log, topic),
    )
    assert story(log, pair.paths.log, None)["stop"]["where"]["segment"] is None
