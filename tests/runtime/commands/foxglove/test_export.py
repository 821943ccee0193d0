"""The second file: what is in it is what the log holds, by another kinematics, and every message as it is published."""

import json
import math
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from cutgate.firmware_sim.kinematics import as_joints, calibrated_arm, forward
from cutgate.protocol import records as wire
from cutgate.runtime.audit import records
from cutgate.runtime.commands.foxglove.arm import FRAMES
from cutgate.runtime.commands.foxglove.decided import UNDEFINED, VIOLATED
from cutgate.runtime.commands.foxglove.lichtblick import LAYOUT, layout_bytes
from cutgate.runtime.commands.foxglove.schemas import VIEWED
from cutgate.runtime.commands.foxglove.streams import HANDLERS
from cutgate.runtime.commands.reach_page import CIVIDIS
from cutgate.runtime.interlock.state import Phase
from tests.logs import judged
from tests.runtime.audit.build import MODELS, forge, session_log, small_log
from tests.runtime.commands.foxglove.published_schema import problems, published
from tests.runtime.commands.foxglove.sessions import (
    by_topic,
    export,
    exported,
    finished_session,
    matrix,
    quaternion_matrix,
    read_indexed,
    read_linearly,
    stored,
)
from tests.runtime.session.pair import ADMISSIBLE_MM, INADMISSIBLE_MM, job_of, pair_of
from tests.runtime.session.test_telemetry import samples

MICROMETRE_M = 1e-6
EARLIER = Path(__file__).parents[3] / "compat/0.1.0/sessions"
Q = ("q0_{}_deg", "q1_{}_deg", "q2_{}_mm", "q3_{}_deg", "q4_{}_deg")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Of two sessions, by where the bone stands: log, job and tag, and the file that was made of it."""
    found = {}
    for given in (ADMISSIBLE_MM, INADMISSIBLE_MM):
        folder = tmp_path_factory.mktemp("session")
        with pair_of(folder, *job_of(tmp_path_factory, given)) as pair:
            log = finished_session(pair)
            found[given] = log, pair.job, pair.state.session.tag, exported(log, folder)
    return found


@pytest.fixture(params=[ADMISSIBLE_MM, INADMISSIBLE_MM], ids=["cut", "refused"])
def session(request, made):
    return made[request.param]


@pytest.fixture
def cut(made):
    return made[ADMISSIBLE_MM]


# ---------------------------------------------------------------- form


def test_every_message_is_as_it_is_published_and_nothing_more(session):
    seen = set()
    for name, messages in by_topic(session[3]).items():
        for message in messages:
            if message.schema.startswith("foxglove."):
                schema = published(message.schema.removeprefix("foxglove."))
                assert problems(schema, message.data) == []
                seen.add(message.schema)
            else:
                assert VIEWED[name].model_validate_json(json.dumps(message.data))
    assert len(seen) == 4


def test_linearly_and_by_index_it_is_the_same(session):
    linearly, by_index = (
        sorted((message.sequence, channel.topic, schema.name, message.log_time, message.data) for schema, channel, message in found)
        for found in (read_linearly(session[3]), read_indexed(session[3]))
    )  # fmt: skip
    assert linearly == by_index
    assert [one[0] for one in linearly] == list(range(len(linearly)))


def test_every_channel_has_the_schema_of_its_topic_as_json_schema(session):
    for schema, channel, _ in read_indexed(session[3]):
        assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
        assert json.loads(schema.data)["type"] == "object"


def test_times_are_those_of_the_logs_records(session):
    times = {message.log_time for message in stored(session[0])}
    for messages in by_topic(session[3]).values():
        for message in messages:
            assert message.time_ns in times
            for at in _timestamps(message.data):
                assert at["sec"] * 10**9 + at["nsec"] == message.time_ns


def _timestamps(value):
    if isinstance(value, dict):
        for key, inner in value.items():
            if key == "timestamp":
                yield inner
            else:
                yield from _timestamps(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _timestamps(inner)


def test_it_has_metadata_and_the_layout_beside_its_messages(session):
    reader = make_reader(BytesIO(session[3]))
    (told,) = reader.iter_metadata()
    report = judged(session[0]).report
    assert (told.name, told.metadata["log"], told.metadata["log_id"]) == (
        "cutgate.export",
        session[0].name,
        report.log_id,
    )
    assert (told.metadata["judgement"], told.metadata["root"]) == (report.headline, report.root)
    assert [(one.name, one.data) for one in reader.iter_attachments()] == [(LAYOUT, layout_bytes())]


# ---------------------------------------------------------------- the arm


def arm_of(job):
    path = wire.Path.parse(job.path)
    found = wire.Calibration.parse(job.calibration)
    return calibrated_arm(found, tool_mm=path.tool_length_mm, elbow=path.elbow)


def in_memory(joints, kind):
    values = np.array([joints[name.format(kind)] for name in Q])
    return np.where(np.arange(5) == 2, values, np.radians(values))


def test_the_tools_frame_is_where_the_controllers_kinematics_has_the_tip(session):
    _, job, _, data = session
    found, arm = by_topic(data), arm_of(job)
    assert [one.time_ns for one in found["/transforms"]] == [one.time_ns for one in found["/joints"]]
    for joints, transforms in zip(found["/joints"], found["/transforms"], strict=True):
        chain, frame = np.eye(4), FRAMES[0]
        for one in transforms.data["transforms"]:
            assert one["parent_frame_id"] == frame, "each in the one before"
            chain, frame = chain @ matrix(one), one["child_frame_id"]
        pose = forward(arm, as_joints(in_memory(joints.data, "measured")))
        assert frame == "tool"
        assert chain[:3, 3] * 1000 == pytest.approx(np.array(pose.tip), abs=0.01)
        assert chain[:3, 2] == pytest.approx(np.array(pose.axis), abs=1e-5)


def test_what_is_drawn_of_the_arm_stands_in_its_frames_and_joins_them(session):
    (arm,) = by_topic(session[3])["/arm"]
    found = wire.Calibration.parse(session[1].calibration)
    links = {
        "arm/upper": found.upper_mm + found.upper_link_error_mm,
        "arm/forearm": found.forearm_mm + found.forearm_link_error_mm,
    }
    for entity in arm.data["entities"]:
        assert entity["frame_id"] in FRAMES
        for cylinder in entity["cylinders"]:
            half = quaternion_matrix(cylinder["pose"]["orientation"])[:, 2] * cylinder["size"]["z"] / 2
            middle = np.array([cylinder["pose"]["position"][name] for name in "xyz"])
            if entity["id"] in links:
                assert middle - half == pytest.approx(np.zeros(3), abs=2 * MICROMETRE_M)
                assert (middle + half) * 1000 == pytest.approx([links[entity["id"]], 0.0, 0.0], abs=0.002)


# ---------------------------------------------------------------- joints, tracking, timing


def test_joints_are_those_of_the_frames_and_of_the_reference(cut):
    """Each record of tracking has joints of its time: those that the controller sent, and less the deviation the reference."""
    log, _, tag, data = cut
    at = {one.time_ns: one.data for one in by_topic(data)["/joints"]}
    tracked = [message for message in stored(log) if message.topic == "/tracking"]
    whole = list(samples(judged(log), tag))
    assert len(tracked) == len(whole) > 50
    for message, (record, sent) in zip(tracked, whole, strict=True):
        joints = at.get(message.log_time)
        if joints is None:  # one too many in this second
            continue
        assert in_memory(joints, "measured") == pytest.approx(sent, abs=2e-3)
        for name in Q:
            off = joints[name.format("measured")] - joints[name.format("reference")]
            assert off == pytest.approx(record[name.format("deviation")], abs=2e-4)
    assert sum("q0_reference_deg" in joints for joints in at.values()) > 0.9 * len(tracked)


@pytest.mark.parametrize("topic", ["/tracking", "/timing"])
def test_tracking_and_timing_are_as_in_the_log(session, topic):
    own = [json.loads(message.data) for message in stored(session[0]) if message.topic == topic]
    assert [one.data for one in by_topic(session[3]).get(topic, [])] == own


def test_before_the_arm_may_move_joints_are_those_of_the_frames_alone(session):
    found = by_topic(session[3])["/joints"]
    assert found
    assert "q0_reference_deg" not in found[0].data


# ---------------------------------------------------------------- what was decided


def lines_of(data, name):
    (scene,) = by_topic(data)["/scene"]
    (entity,) = [one for one in scene.data["entities"] if one["id"] == name]
    return entity


def xyz(points):
    return np.array([[point[name] for name in "xyz"] for point in points]).reshape(-1, 3)


def code(colour):
    return "#" + "".join(f"{round(colour[name] * 255):02x}" for name in "rgb")


def pieces(entity):
    """Begin and end of each piece in the order of the path, and its colour."""
    for line in entity["lines"]:
        assert line["type"] == 2
        ends = xyz(line["points"])[np.array(line["indices"]).reshape(-1, 2)]
        for begin, end in ends:
            yield begin, end, code(line["color"])


def off_line(point, line):
    chord, rest = line[1:] - line[:-1], point - line[:-1]
    along = np.clip(
        np.einsum("ij,ij->i", rest, chord) / np.maximum(np.einsum("ij,ij->i", chord, chord), 1e-12), 0, 1
    )
    return float(np.linalg.norm(rest - along[:, None] * chord, axis=1).min())


def test_the_tips_path_is_the_uploaded_one_from_end_to_end_each_piece_once(session):
    path = wire.Path.parse(session[1].path)
    found = list(pieces(lines_of(session[3], "path/tip")))
    for begin, end, _ in found:
        assert max(off_line(begin * 1000, path.tips_mm), off_line(end * 1000, path.tips_mm)) < 0.002
    length = sum(np.linalg.norm(end - begin) for begin, end, _ in found) * 1000
    whole = sum(np.linalg.norm(b - a) for a, b in pairwise(path.tips_mm))
    assert length == pytest.approx(whole, abs=0.01)


def test_the_wrists_path_is_the_tips_a_tools_length_along_the_axis(session):
    path = wire.Path.parse(session[1].path)
    wrist = path.tips_mm + path.tool_length_mm * path.axes
    places = (
        np.array(
            [point for begin, end, _ in pieces(lines_of(session[3], "path/wrist")) for point in (begin, end)]
        )
        * 1000
    )
    for pose in wrist:
        assert np.linalg.norm(places - pose, axis=1).min() < 0.01


def test_colours_are_those_of_the_page_and_what_violates_is_marked(session):
    document = json.loads(judged(session[0]).of("/audit/verdict")[-1]["document"])
    for name in ("path/tip", "path/wrist"):
        colours = {colour for _, _, colour in pieces(lines_of(session[3], name))}
        assert colours <= {*CIVIDIS, VIOLATED, UNDEFINED}
        assert (VIOLATED in colours) is (document["verdict"] == "inadmissible")


def test_worst_places_are_labelled_with_what_the_verdict_says(session):
    document = json.loads(judged(session[0]).of("/audit/verdict")[-1]["document"])
    (scene,) = by_topic(session[3])["/scene"]
    path = wire.Path.parse(session[1].path)
    shown = {
        one["id"].removeprefix("worst/"): one
        for one in scene.data["entities"]
        if one["id"].startswith("worst/")
    }
    placed = {name: one for name, one in document["boundaries"].items() if one["segment"] is not None}
    assert shown.keys() == placed.keys()
    for name, entity in shown.items():
        told = {one["key"]: one["value"] for one in entity["metadata"]}
        (text,) = entity["texts"]
        entry = placed[name]
        assert ("violated" if entry["violated"] else "kept") == told[""]
        assert (code(text["color"]) == VIOLATED) is entry["violated"]
        if entry["certified"] is not None:
            value = float(told["clearance, proved"].split()[0])
            assert entry["certified"] - 0.011 <= value <= entry["certified"] + 1e-9, (
                "never more than is proved"
            )
        segment, part = entry["segment"], entry["fraction"]
        tip = path.tips_mm[segment] + part * (path.tips_mm[segment + 1] - path.tips_mm[segment])
        place = np.array([text["pose"]["position"][axis] for axis in "xyz"]) * 1000
        assert np.linalg.norm(place - tip) == pytest.approx(path.tool_length_mm, abs=0.01)


def test_the_workspace_is_bounded_at_both_ends_of_the_slide(session):
    limits = wire.Limits.parse(session[1].limits)
    heights = {
        round(float(height) * 1000, 3)
        for line in lines_of(session[3], "workspace")["lines"]
        for height in xyz(line["points"])[:, 2]
    }
    assert {float(limits.q_min[2]), float(limits.q_max[2])} <= heights


def test_the_bone_and_its_path_lie_where_they_were_registered(session):
    data = session[3]
    (bone,) = by_topic(data)["/transforms/bone"]
    (place,) = bone.data["transforms"]
    own = lines_of(data, "bone/path")
    assert own["frame_id"] == place["child_frame_id"] == "bone"
    points = xyz(own["lines"][0]["points"])
    moved = points @ matrix(place)[:3, :3].T + matrix(place)[:3, 3]
    path = wire.Path.parse(session[1].path)
    assert max(off_line(point * 1000, path.tips_mm) for point in moved) < 0.01


def test_the_plan_is_the_uploaded_poses(session):
    path = wire.Path.parse(session[1].path)
    (plan,) = by_topic(session[3])["/plan"]
    assert plan.data["frame_id"] == "robot"
    for pose, tip, axis in zip(plan.data["poses"], path.tips_mm, path.axes, strict=True):
        assert [pose["position"][name] * 1000 for name in "xyz"] == pytest.approx(tip, abs=0.001)
        assert quaternion_matrix(pose["orientation"])[:, 2] == pytest.approx(axis, abs=1e-6)


def test_clearances_are_nowhere_less_than_the_verdict_and_reach_it(cut):
    document = json.loads(judged(cut[0]).of("/audit/verdict")[-1]["document"])
    found = by_topic(cut[3])["/clearance"]
    places = [(one.data["segment"], one.data["fraction"]) for one in found]
    assert places == sorted(set(places)), "where the arm stands nothing is repeated"
    assert len(places) > 20
    for name, entry in document["boundaries"].items():
        unit = entry["unit"]
        values = [one.data.get(f"{name}_{unit}", math.inf) for one in found]
        deadbands = {one.data.get(f"{name}_deadband_{unit}") for one in found}
        if deadbands == {None}:  # the picture leaves it out
            continue
        assert deadbands == {
            entry["deadband"]
            if "deadband" in entry
            else document["deadband"]["arm_mm" if unit == "mm" else "wrist_deg"]
        }
        assert min(values) >= entry["clearance"] - 0.02
        assert min(values) <= entry["clearance"] + 1.0, (
            "the worst place was passed, and hardly between two records"
        )
    for one in found:
        ratios = [
            one.data[key] / one.data[key.replace("_mm", "_deadband_mm").replace("_deg", "_deadband_deg")]
            for key in one.data
            if key.endswith(("_mm", "_deg")) and "deadband" not in key
        ]
        assert one.data["least_in_deadbands"] == pytest.approx(min(ratios), abs=1e-3)


# ---------------------------------------------------------------- words


def test_decisions_faults_and_commands_are_lines_with_levels(session):
    log, *_, data = session
    lines = by_topic(data)["/log"]
    worded = {"decision", "controller", "fault", "operator", "permit", "verdict", "close"}
    own = [one for one in stored(log) if one.topic.removeprefix("/audit/") in worded]
    assert [(one.data["line"], one.data["name"]) for one in lines] == [
        (one.sequence, one.topic) for one in own
    ]
    assert {one.data["file"] for one in lines} == {log.name}
    levels = {one.data["name"]: one.data["level"] for one in lines if one.data["name"] != "/audit/decision"}
    assert levels["/audit/close"] == 2
    verdict = judged(log).of("/audit/verdict")[-1]["verdict"]
    assert levels["/audit/verdict"] == (2 if verdict == "admissible" else 3)


def test_the_state_is_that_of_the_last_decision_and_of_the_controller(session):
    log, *_, data = session
    for state, before in zip(by_topic(data)["/state"][1:], by_topic(data)["/state"], strict=False):
        assert state.data != before.data
    last = by_topic(data)["/state"][-1].data
    assert last["phase"] == judged(log).of("/audit/decision")[-1]["to_state"]


def test_a_session_that_is_stopped_goes_on_with_the_joints_of_its_frames(tmp_path, tmp_path_factory):
    """The stop is an error in the log; behind it nothing is held against the path, and joints have no reference."""
    with pair_of(tmp_path, *job_of(tmp_path_factory)) as pair:
        pair.power_up(time_scale=0.5)
        pair.begin().to(Phase.CUTTING).run(1.0)
        pair.disk.delay_s = 0.2
        pair.say("stop")
        pair.end()
        log = pair.close().log
        found = by_topic(exported(log, tmp_path))
    stops = [one for one in found["/log"] if one.data["name"] == "/audit/decision" and one.data["level"] == 4]
    assert len(stops) == 1
    assert "-> stopping" in stops[0].data["message"]
    assert "OPERATOR_STOP" in stops[0].data["message"]
    last = max(one.time_ns for one in found["/tracking"])
    joints = sorted(found["/joints"], key=lambda one: one.time_ns)
    assert "q0_reference_deg" in next(one for one in reversed(joints) if one.time_ns <= last).data
    behind = [one for one in joints if one.time_ns > last]
    assert behind
    assert all("q0_reference_deg" not in one.data for one in behind)


BAD = "\x1b[31mred\x1b[0m <b>\u202e\n"


@pytest.fixture
def strange(tmp_path):
    """A log whose texts are hostile, and with records that are none of their topics."""
    replaced = iter([
        records.AuditFault(source="controller", code="STOP", cause="BONE_MOVED", detail=BAD),
        records.AuditOperator(word=BAD, accepted=False, reason="x" * 5000),
        records.AuditController(state=BAD, cause=BAD, epoch=1, device_pressed=True, emergency_stop_clear=True, cutting_mode=False, fresh=True),
        records.AuditDecision(sequence=9, event=BAD, from_state="cutting", to_state="stopping", disposition="decided", session="zz"),
        records.CanFrame(stamp=records.ZERO, direction="received", id=0x300, dlc=8, data="zz"),
        records.AuditDecision(sequence=9, event="x", from_state="cutting", to_state="stopping", disposition="decided", first_out=BAD),
    ])  # fmt: skip

    def swap(record):
        return next(replaced, record) if isinstance(record, records.AuditOperator) else record

    log = tmp_path / "strange.mcap"
    log.write_bytes(forge(small_log(tmp_path / "small", decisions=8).log.read_bytes(), swap))
    return log


def test_no_text_of_a_log_is_more_than_text(strange, tmp_path):
    found = by_topic(exported(strange, tmp_path))
    texts = [one.data["message"] for one in found["/log"]] + [
        one.data["controller"] for one in found["/state"]
    ]
    assert all(text.isprintable() for text in texts)
    assert max(map(len, texts)) < 2100
    assert any("red" in text for text in texts)
    assert {one.data["level"] for one in found["/log"]} == {2, 3, 4}


def test_what_is_no_record_is_left_out_and_counted(strange, tmp_path):
    _, said = export(strange, tmp_path / "x.mcap")
    assert "2 records that are none left out" in said
    assert "neither path nor arm is drawn: the session ended before a verdict" not in said
    assert "the session ended before a verdict: neither path nor arm is drawn" in said


# ---------------------------------------------------------------- what cannot be drawn


@pytest.mark.parametrize("log", sorted(EARLIER.glob("*.mcap")), ids=lambda log: log.stem)
def test_a_log_of_an_earlier_version_is_drawn_without_what_it_does_not_hold(log, tmp_path):
    found = by_topic(exported(log, tmp_path))
    read = judged(log)
    assert {"/log", "/state", "/joints"} <= found.keys()
    assert not {"/tracking", "/timing"} & found.keys()
    assert ("/scene" in found) is bool(read.of("/audit/verdict"))
    assert ("/clearance" in found) is any(one["to_state"] == "cutting" for one in read.of("/audit/decision"))
    for name, messages in found.items():
        for message in messages:
            if message.schema.startswith("foxglove."):
                assert problems(published(message.schema.removeprefix("foxglove.")), message.data) == [], name


def flipped(record):
    if isinstance(record, records.AuditVerdict):
        return record.model_copy(update={"verdict": "inadmissible"})
    return record


def endless(record):
    if isinstance(record, records.AuditApproach):
        return record.model_copy(update={"entry_um": 10**15})
    return record


@pytest.mark.parametrize(
    ("edit", "missing", "told"),
    [
        (flipped, {"/scene", "/plan", "/transforms/bone"}, "the path is not drawn: the log's verdict is inadmissible, deciding again comes to admissible"),
        (endless, set(), "the reference of the joints is not written: its record of approach and retract is none"),
    ],
)  # fmt: skip
def test_what_deciding_again_does_not_come_to_is_not_drawn(tmp_path, edit, missing, told):
    log = tmp_path / "edited.mcap"
    log.write_bytes(forge(session_log(tmp_path / "logs").log.read_bytes(), edit))
    code, said = export(log, tmp_path / "x.mcap")
    assert code == 0
    assert told in said
    found = by_topic((tmp_path / "x.mcap").read_bytes())
    assert not missing & found.keys()
    assert {"/arm", "/log"} <= found.keys()
    assert ({"/scene", "/plan"} <= found.keys()) is not bool(missing)


def test_an_attachment_that_is_missing_is_named(tmp_path):
    log = tmp_path / "without.mcap"
    data = session_log(tmp_path / "logs").log.read_bytes()
    log.write_bytes(forge(data, attachments=lambda name, one: None if name == "limits.bin" else one))
    _, said = export(log, tmp_path / "x.mcap")
    assert "neither path nor arm is drawn: attachment limits.bin is missing" in said
    assert "/log" in by_topic((tmp_path / "x.mcap").read_bytes())


def test_every_topic_of_a_log_is_known_or_left_out_on_purpose():
    left_out = {
        "/audit/open", "/audit/checkpoint", "/audit/collected", "/audit/boundary", "/audit/approach", "/audit/guidance",
        "/audit/witness", "/audit/process", "/audit/attachment", "/can/transfer",
    }  # fmt: skip
    assert HANDLERS.keys() | left_out == MODELS.keys()
    assert not HANDLERS.keys() & left_out
