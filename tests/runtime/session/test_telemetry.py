"""What the log holds by the second: true by another kinematics, bounded in number, and without a say in anything."""

import json
import math
from collections import Counter
from dataclasses import replace
from io import BytesIO
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.faults import FaultName
from cutgate.firmware_sim.kinematics import as_joints, calibrated_arm, forward
from cutgate.protocol import records
from cutgate.protocol.records import joints_to_memory
from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan
from cutgate.runtime.audit.inspect import Status, verify_log
from cutgate.runtime.interlock.phases import MOVING
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.interlock.tracking import ReferenceTrajectory, TrackingMonitor
from cutgate.runtime.review.last_seen import LastSeen
from cutgate.runtime.session.telemetry import (
    PER_SECOND_MAX,
    MeasuredTip,
    RateLimit,
    Telemetry,
    tracking_sample,
)
from tests.runtime.audit.cuts import recovered
from tests.runtime.session.pair import STANDS, job_of

CUT_MM = 0.02
"""How far the reported joints of a sound plant and what frames round bring the tip off the straight path."""
Q = ("q0_deviation_deg", "q1_deviation_deg", "q2_deviation_mm", "q3_deviation_deg", "q4_deviation_deg")


@pytest.fixture(scope="module")
def pair_job(tmp_path_factory):
    return job_of(tmp_path_factory)[1]


def closed(pair):
    """The session's log, read."""
    pair.close()
    return pair.read()


def samples(read, tag):
    """Each record of tracking with the joints that the controller had sent whole before it, by the frames of the log."""
    seen = LastSeen()
    for topic, data in read.each("/can/frame", "/tracking"):
        record = json.loads(data)
        if topic == "/tracking":
            yield record, joints_to_memory(seen.joints_u(tag))
        elif record["direction"] == "received":
            seen.frame(record["id"], bytes.fromhex(record["data"]))


def whole_session(pair, time_scale=1.0):
    pair.power_up(time_scale=time_scale)
    assert pair.begin().end(limit_s=60.0) is Phase.DONE
    return closed(pair)


# ---------------------------------------------------------------- how many


@given(st.lists(st.integers(0, 64), max_size=200), st.integers(1, 5))
def test_no_second_has_more_than_so_many_and_nothing_is_refused_that_might_come(steps, most):
    """Times in exact parts of a second."""
    limit, came_s, now_s = RateLimit(most), [], 0.0
    for step in steps:
        now_s += step / 64
        lately = [at_s for at_s in came_s if now_s - at_s < 1.0]
        assert limit.allows(now_s) is (len(lately) < most)
        came_s += [now_s] if len(lately) < most else []


@pytest.mark.parametrize("heartbeat_ms", [5, 20, 100])
def test_neither_topic_has_more_than_fifty_a_second_at_any_heartbeat(pair, heartbeat_ms):
    timing = replace(pair.job.timing, heartbeat_ms=heartbeat_ms, timeout_ms=max(100, 4 * heartbeat_ms))
    pair.cycle_s = heartbeat_ms / 1000 / 4
    pair.power_up(time_scale=0.01)
    pair.begin(replace(pair.job, timing=timing)).to(Phase.CUTTING)
    pair.run(3.0)
    pair.session.interrupt()
    pair.end()
    read = closed(pair)
    for topic in ("/tracking", "/timing"):
        times_s = [message.log_time / 1e9 for message in walk(read.file, Scan()) if message.topic == topic]
        most = max(sum(at <= other < at + 1.0 - 1e-6 for other in times_s) for at in times_s)
        due = min(PER_SECOND_MAX, 1000 / heartbeat_ms)
        assert due - 2 <= most <= PER_SECOND_MAX


def test_every_sample_that_is_judged_is_there_once(pair, monkeypatch):
    """At 40 a second none is left out; the last one, behind which nothing is held any more, is there too."""
    pair.job = replace(pair.job, timing=replace(pair.job.timing, heartbeat_ms=25))
    judged = []
    step = Telemetry.tracking

    def counted(self, before, after, now_s):
        if after.nearest is not before.nearest:
            judged.append(after.nearest)
        return step(self, before, after, now_s)

    monkeypatch.setattr(Telemetry, "tracking", counted)
    read = whole_session(pair, time_scale=2.0)
    recorded = read.of("/tracking")
    assert len(recorded) == len(judged) > 60
    assert [record["reference_s"] for record in recorded] == [
        pytest.approx(one.time_s, abs=1e-4) for one in judged
    ]
    assert Counter(record["leg"] for record in recorded).keys() == {
        "approach", "entry", "cut", "exit", "retract",
    }  # fmt: skip


def test_before_the_arm_may_move_and_after_it_nothing_is_tracked(pair):
    read = whole_session(pair, time_scale=4.0)
    phase = "waiting"
    for topic, data in read.each("/audit/decision", "/tracking"):
        if topic == "/audit/decision":
            phase = json.loads(data)["to_state"]
        else:
            assert phase in {*MOVING, Phase.DONE}
    assert not [record for record in read.of("/timing") if record["timeout_ms"] != 100.0]


# ---------------------------------------------------------------- what is said


def test_a_sound_session_by_the_controllers_own_kinematics(pair):
    """Tip, distance from the straight path, segment and fraction, found without the reference trajectory."""
    read = whole_session(pair)
    path = records.Path.parse(pair.job.path)
    arm = calibrated_arm(
        records.Calibration.parse(pair.job.calibration), tool_mm=path.tool_length_mm, elbow=path.elbow
    )
    count = 0
    for record, joints in samples(read, pair.state.session.tag):
        tip = np.array(forward(arm, as_joints(joints)).tip)
        assert record["wrist_deviation_mm"] <= record["wrist_tolerance_mm"]
        assert all(abs(record[name]) <= record["joint_tolerance_deg"] for name in Q if name.endswith("deg"))
        assert 0.0 <= record["age_ms"] <= 200.0
        if record["leg"] != "cut":
            assert not {"segment", "fraction"} & record.keys()
            continue
        count += 1
        begin, end = path.tips_mm[record["segment"] : record["segment"] + 2]
        place = begin + record["fraction"] * (end - begin)
        off = _off(tip, path.tips_mm)
        assert record["tip_distance_mm"] == pytest.approx(off, abs=CUT_MM)
        assert np.linalg.norm(tip - place) <= off + 4 * CUT_MM
    assert count > 20
    for before, after in pairwise(read.of("/tracking")):
        assert after["reference_s"] >= before["reference_s"] - 0.05


def _off(point, line):
    """Distance of a point from a polyline by sampling it densely."""
    parts = np.linspace(0.0, 1.0, 2001)[:, None]
    places = np.concatenate([a + parts * (b - a) for a, b in pairwise(line)])
    return float(np.linalg.norm(places - point, axis=1).min())


STILL = np.array([0.4, 1.2, 250.0, -0.7, 0.6])


@given(st.lists(st.floats(-1.0, 1.0), min_size=5, max_size=5), st.sampled_from([0.5, 2.5, 3.5, 7.0]))
def test_deviations_are_those_of_the_joints_from_the_reference(pair_job, off, at_s):
    """Beside a reference that stands still: of each joint, in its unit, with its sign."""
    slip = np.array(off) * [0.004, 0.004, 0.5, 0.004, 0.004]
    still = ReferenceTrajectory(
        np.arange(9.0), np.tile(STILL, (9, 1)), np.array([2.0, 3.0, 5.0]), (450.0, 400.0)
    )
    monitor = TrackingMonitor.begin(still, pair_job.timing, pair_job.tracking, 1.0, 0.0)
    after, deviation = monitor.sample(STILL + slip, at_s, at_s)
    found = (deviation or after).nearest
    record = tracking_sample(still, found, MeasuredTip(pair_job), math.inf)
    degrees = [*np.degrees(slip[:2]), slip[2], *np.degrees(slip[3:])]
    assert [getattr(record, name) for name in Q] == pytest.approx(degrees, abs=1e-4)
    arm = calibrated_arm(records.Calibration.parse(pair_job.calibration), tool_mm=160.0, elbow="right")
    tips = [np.array(forward(arm, as_joints(joints)).tip) for joints in (STILL, STILL + slip)]
    assert record.tip_distance_mm == pytest.approx(float(np.linalg.norm(tips[1] - tips[0])), abs=1e-4)
    assert record.age_ms is None, "nothing proves how old it is"
    rotary = max(abs(getattr(record, name)) for name in Q if name.endswith("deg"))
    within = record.wrist_deviation_mm <= record.wrist_tolerance_mm and rotary <= record.joint_tolerance_deg
    assert within is (deviation is None) or abs(found.off - 1.0) < 1e-3


@pytest.mark.parametrize("heartbeat_ms", [5, 20])
def test_the_sample_that_stops_is_the_last_one_and_breaks_what_the_decision_says(pair, heartbeat_ms):
    """However many came before it in this second."""
    pair.cycle_s = heartbeat_ms / 1000 / 4
    pair.power_up(time_scale=1.0)
    pair.begin(replace(pair.job, timing=replace(pair.job.timing, heartbeat_ms=heartbeat_ms)))
    pair.to(Phase.CUTTING).until(lambda: pair.process.arm.state.fraction > 0.3)
    pair.process._happen(FaultName.DRIFT)
    assert pair.end() is Phase.STOPPED
    read = closed(pair)
    last = read.of("/tracking")[-1]
    (stop,) = [one for one in read.of("/audit/decision") if one.get("first_out") and one["permissives"]][:1]
    wrist, joints = stop["permissives"]
    assert last["wrist_deviation_mm"] == pytest.approx(wrist["value"], abs=1e-4)
    rotary = max(abs(last[name]) for name in Q if name.endswith("deg"))
    assert rotary == pytest.approx(joints["value"], abs=1e-3)
    assert wrist["value"] > last["wrist_tolerance_mm"] or joints["value"] > last["joint_tolerance_deg"]
    assert last["tip_distance_mm"] > 0.0


def test_timing_says_what_the_clocks_say(pair):
    """A disk that needs time, a loop that stands still, a controller that answers a cycle later."""
    pair.power_up(time_scale=0.01)
    pair.to(Phase.CUTTING).run(1.5)
    pair.disk.delay_s = 0.25
    pair.run(3.0)
    pair.runtime_runs = False
    pair.run(0.06)
    pair.runtime_runs = True
    pair.run(0.5)
    pair.session.interrupt()
    pair.end()
    found = closed(pair).of("/timing")
    assert {record["timeout_ms"] for record in found} == {pair.job.timing.timeout_ms}
    assert all(0.0 <= record["heartbeat_age_ms"] <= record["timeout_ms"] for record in found)
    assert 250.0 <= max(record.get("commit_ms", 0.0) for record in found) <= 250.0 + 3 * 1000 * pair.cycle_s
    waiting = [record for record in found if record["waiting_bytes"]]
    assert max(record["waiting_ms"] for record in waiting) == pytest.approx(250.0, abs=25.0)
    assert all(record["waiting_ms"] == 0.0 for record in found if not record["waiting_bytes"])
    gaps = sorted(record["longest_gap_ms"] for record in found)
    assert gaps[-1] == pytest.approx(65.0, abs=1.0)
    assert gaps[-2] <= 2 * 1000 * pair.cycle_s, "it is told once"
    assert 40.0 <= max(record["heartbeat_late_ms"] for record in found) <= 65.0
    assert "round_trip_ms" not in found[0]
    usual = Counter(record.get("round_trip_ms") for record in found).most_common(1)[0][0]
    assert usual == pytest.approx(1000 * (pair.job.timing.heartbeat_s - pair.cycle_s), abs=0.1)


# ---------------------------------------------------------------- kept, and covered


def test_of_a_log_that_is_cut_what_was_whole_comes_back(pair):
    """The recovered copy has the records of both topics up to the cut, as they were."""
    whole_session(pair)
    data = pair.paths.log.read_bytes()
    whole = list(walk(BytesIO(data), Scan()))
    copy, *_ = recovered(data[: len(data) * 3 // 4])
    kept = list(walk(BytesIO(copy), Scan()))
    assert [(one.topic, one.data) for one in kept] == [(one.topic, one.data) for one in whole[: len(kept)]]
    assert {"/tracking", "/timing"} <= {one.topic for one in kept}


@pytest.mark.parametrize("topic", ["/tracking", "/timing"])
def test_a_record_that_is_altered_breaks_the_chain(pair, topic):
    whole_session(pair, time_scale=4.0)
    data = pair.paths.log.read_bytes()
    one = [message for message in walk(BytesIO(data), Scan()) if message.topic == topic][3]
    at = one.offset + one.data.index(b"_ms" if topic == "/timing" else b"_mm") + 6
    digit = data[at : at + 1]
    changed = data[:at] + (b"8" if digit != b"8" else b"9") + data[at + 1 :]
    report = verify_log(changed)
    assert report.status is Status.TAMPERED
    assert verify_log(data).status is Status.INCOMPLETE, "its raw frames and signature are not given"


# ---------------------------------------------------------------- it decides nothing


@pytest.mark.parametrize("fault", [None, FaultName.DRIFT])
def test_without_it_the_same_is_decided(pair, monkeypatch, fault):
    def session():
        pair.power_up(time_scale=2.0, joints=as_joints(joints_to_memory(STANDS)))
        pair.begin().to(Phase.CUTTING).run(0.1)
        if fault:
            pair.process._happen(fault)
        pair.end()
        pair.close()
        skipped = {"prev", "utc", "monotonic", "session", "token", "reason", "permissives"}
        return [
            {key: value for key, value in one.items() if key not in skipped}
            for one in pair.read().of("/audit/decision")
            if one["to_state"] in MOVING or one["from_state"] in MOVING
        ]

    with_it = session()
    monkeypatch.setattr(Telemetry, "tracking", lambda *_: None)
    monkeypatch.setattr(Telemetry, "timing", lambda *_: None)
    pair.memory_file.unlink()
    decided = session()
    assert not pair.read().of("/tracking")
    for one in (*with_it, *decided):
        one.pop("sequence")
    assert decided == with_it
