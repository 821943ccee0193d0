"""What of a session's log counts when it is held against another one's, and what does not."""

import json
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import pytest

from cutgate.runtime.audit import names, records
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.interlock.permissives import AT_START, FOR_PERMIT, FOR_START, evaluate
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.review.comparable import MOMENTARY, RUNNING, comparable, timing, words_of
from cutgate.runtime.review.difference import difference
from cutgate.runtime.review.story import story
from tests.runtime.audit.build import forge, inputs, session_log, small_log
from tests.runtime.audit.test_replay import changed, in_document
from tests.runtime.interlock.builders import NOW, in_phase

OLD = Path(__file__).parents[2] / "compat" / "0.1.0" / "sessions"
SITE = b'schema = "cutgate.site/1"\n[timing]\nheartbeat_ms = 20\n'


@pytest.fixture(scope="module")
def admitted(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("admitted"), site=SITE).log.read_bytes()


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("refused"), 850.0).log.read_bytes()


def of(data):
    log = read_log(BytesIO(data), b"")
    told = story(log, "x.mcap", None)
    return comparable(log, told), timing(told)


def differing(one, other):
    """Section, name and both values of what differs."""
    return {
        (section["section"], entry["what"]): (entry.get("a"), entry.get("b"))
        for section in difference(of(one)[0], of(other)[0])
        for entry in section["differences"]
    }


def attached(name, edit):
    return lambda of, data: edit(data) if of == name else data


def test_a_session_on_the_same_inputs_is_equal(admitted, tmp_path):
    again = session_log(tmp_path, site=SITE).log.read_bytes()
    assert differing(admitted, again) == {}
    assert sum(map(len, of(admitted)[0].values())) > 200


@pytest.mark.parametrize(
    "edit",
    [
        changed(
            records.AuditOpen, log_id="f" * 32, previous_log="x.mcap", previous_head="aa", previous_note="n"
        ),
        changed(records.AuditPermit, nonce="00" * 16, code="11" * 16, log_root="22" * 32, token=9),
        changed(records.AuditDecision, sequence=99, session="33" * 32, token=7),
        changed(records.AuditVerdict, elapsed_ms=99.0),
        changed(records.AuditClose, candump_sha256="44" * 32, candump_bytes=17),
        changed(records.AuditController, epoch=17),
        changed(records.AuditProcess, pid=1),
    ],
    ids=["open", "permit", "decision", "verdict", "close", "controller", "process"],
)
def test_what_differs_between_any_two_sessions_does_not_count(admitted, edit):
    assert differing(admitted, forge(admitted, edit, trees_again=False)).keys() <= {("log", "status")}


@pytest.mark.parametrize(
    ("edit", "where", "values"),
    [
        (changed(records.AuditOpen, numpy="1.0"), ("record 0", "numpy"), None),
        (changed(records.AuditOpen, operator="B"), ("record 0", "operator"), (None, "B")),
        (changed(records.AuditOpen, host="there"), ("record 0", "host"), (None, "there")),
        (
            changed(records.AuditOpen, simulation=(records.Option(name="time scale", value="7"),)),
            ("record 0", "option time scale"),
            ("20", "7"),
        ),
        (changed(records.AuditVerdict, verdict="inadmissible"), ("verdict", "verdict"), ("admissible", "inadmissible")),
        (changed(records.AuditVerdict, q0_turns=1), ("verdict", "q0 turns"), (0, 1)),
        (changed(records.AuditBoundary, lambda one: one.name == "top", certified=7.25), ("verdict", "top certified, mm"), None),
        (changed(records.AuditBoundary, lambda one: one.name == "top", clearance=None), ("verdict", "top clearance, mm"), None),
        (changed(records.AuditBoundary, lambda one: one.name == "top", deadband=6.0), ("verdict", "top deadband, mm"), (5.0, 6.0)),
        (changed(records.AuditBoundary, lambda one: one.name == "top", violated=True), ("verdict", "top violated"), (False, True)),
        (changed(records.AuditApproach, verdict="inadmissible"), ("approach", "verdict"), ("admissible", "inadmissible")),
        (changed(records.AuditApproach, entry_um=11_000), ("approach", "entry_um"), None),
        (changed(records.AuditApproach, start_joints_u=(1, 2, 3, 4, 5)), ("approach", "start_joints, 1e-6 deg or mm"), None),
        (changed(records.AuditClose, final_state="stopped"), ("outcome", "final state"), ("done", "stopped")),
        (changed(records.AuditClose, outcome="the operator left"), ("outcome", "outcome"), (None, "the operator left")),
        (changed(records.AuditClose, clean=False), ("outcome", "clean"), (True, False)),
    ],
    ids=lambda value: str(value) if isinstance(value, tuple) else "",
)  # fmt: skip
def test_what_counts_is_found_with_both_values_and_alone(admitted, edit, where, values):
    found = differing(admitted, forge(admitted, edit))
    assert found.keys() == {where}
    assert values is None or found[where] == values
    assert found[where][0] != found[where][1]


@pytest.mark.parametrize(
    ("name", "edit", "where", "values"),
    [
        (names.ROBOT, lambda data: data.replace(b"= 450.0", b"= 450.5", 1), ("robot", "arm.upper_link_mm"), (450.0, 450.5)),
        (names.SITE, lambda data: data.replace(b"= 20", b"= 25"), ("site", "timing.heartbeat_ms"), (20, 25)),
        ("registration.json", lambda data: data.replace(b'"test"', b'"other"'), ("registration", "id"), ("test", "other")),
        ("registration.json", lambda data: data.replace(b"500.0", b"501.0"), ("registration", "R_T_CT[0]"), ([1, 0, 0, 500.0], [1, 0, 0, 501.0])),
        ("plan.csv", lambda data: data + b"\n", ("plan", "SHA-256"), None),
        (names.TOOL, lambda data: (161_000_000).to_bytes(8, "little"), ("collected", "tool.length, mm"), (160.0, 161.0)),
        (names.LIMITS, lambda data: (-81_000_000).to_bytes(8, "little", signed=True) + data[8:], ("collected", "limits.q_min.q0, deg"), (-80.0, -81.0)),
    ],
    ids=lambda value: str(value) if isinstance(value, str | tuple) else "",
)  # fmt: skip
def test_inputs_are_compared_value_by_value(admitted, name, edit, where, values):
    found = differing(admitted, forge(admitted, attachments=attached(name, edit)))
    assert where in found
    assert values is None or found[where] == values
    assert {section for section, _ in found} == {where[0]}


def test_how_a_file_is_written_is_no_difference(admitted):
    def indented(data):
        return json.dumps(json.loads(data), indent=3, sort_keys=True).encode()

    assert differing(admitted, forge(admitted, attachments=attached("registration.json", indented))) == {}


def test_a_plan_of_ours_is_compared_by_key_and_its_poses_by_count_and_digest():
    (log,) = OLD.glob("*-eea20e88.mcap")
    data = log.read_bytes()

    def with_plan(**changes):
        return forge(
            data,
            attachments=attached("plan.json", lambda plan: json.dumps(json.loads(plan) | changes).encode()),
        )

    plan = json.loads(read_log(BytesIO(data)).scan.attachment("plan.json").data)
    assert differing(data, with_plan()) == {}
    assert differing(data, with_plan(id="two")) == {("plan", "id"): (plan["id"], "two")}
    moved = [*plan["poses"][:-1], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]
    assert differing(data, with_plan(poses=moved)).keys() == {("plan", "poses.SHA-256")}
    fewer = differing(data, with_plan(poses=plan["poses"][:-1]))
    assert fewer["plan", "poses.count"] == (len(plan["poses"]), len(plan["poses"]) - 1)


def test_a_path_is_compared_by_its_poses_extent_and_digest(admitted, refused):
    found = differing(admitted, refused)
    assert found["path", "extent x, mm"][1][0] - found["path", "extent x, mm"][0][0] == pytest.approx(350.0)
    assert ("path", "poses") not in found
    assert ("path", "SHA-256") in found


def test_a_file_that_cannot_be_read_by_keys_is_compared_by_its_digest(admitted):
    broken = forge(admitted, attachments=attached(names.ROBOT, lambda _data: b"[[["))
    found = differing(admitted, broken)
    assert found["robot", "SHA-256"][0] is None
    assert found["robot", "size, bytes"] == (None, 3)
    other = forge(admitted, attachments=attached(names.ROBOT, lambda _data: b"[[]"))
    assert differing(broken, other).keys() == {("robot", "SHA-256")}


def test_a_session_that_has_an_input_less_lacks_its_values(admitted):
    found = differing(
        admitted, forge(admitted, attachments=lambda name, data: None if name == names.SITE else data)
    )
    assert found["site", "timing.heartbeat_ms"] == (20, None)


def permissive(**changes):
    values = {"name": "bus", "holds": True, "text": "up", "bound": "up", "remedy": "cable"}
    return records.PermissiveValue(**(values | changes))


def left_on(admitted, *permissives):
    """The log whose permit left on these."""

    def edit(record):
        if isinstance(record, records.AuditDecision) and record.disposition == "sent":
            return record.model_copy(update={"permissives": permissives, "effects": ("send Permit",)})
        return record

    return forge(admitted, edit)


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"holds": False}, {"bus: holds"}),
        ({"text": "down"}, {"bus: found"}),
        ({"bound": "well up"}, {"bus: required"}),
        ({"remedy": "another"}, set()),
        (
            {"name": "gate"},
            {f"{name}: {what}" for name in ("bus", "gate") for what in ("holds", "required", "found")},
        ),
    ],
)
def test_permissives_are_compared_by_what_held_was_found_and_required(admitted, changes, found):
    one, other = left_on(admitted, permissive()), left_on(admitted, permissive(**changes))
    assert {what for _, what in differing(one, other)} == found


@pytest.mark.parametrize("name", sorted(MOMENTARY | RUNNING))
def test_of_what_is_measured_at_the_moment_only_counts_whether_it_held(admitted, name):
    def one(value, **changes):
        return left_on(admitted, permissive(name=name, text=None, value=value, **changes))

    assert differing(one(0.1), one(0.2)) == {}
    assert {what for _, what in differing(one(0.1), one(0.1, holds=False))} == {f"{name}: holds"}
    bound = {what for _, what in differing(one(0.1), one(0.1, bound="other"))}
    assert bound == (set() if name in RUNNING else {f"{name}: required"})


def test_the_names_of_what_is_of_the_moment_are_names_of_permissives():
    asked = evaluate((*FOR_PERMIT, *FOR_START, *AT_START), in_phase(Phase.PERMITTED), NOW)
    assert {one.name for one in asked} >= MOMENTARY | RUNNING


def test_a_document_that_was_changed_is_found_in_speeds_lengths_and_warnings(admitted):
    def change(document):
        document["speed"][1]["peak"] *= 1.5
        document["path"]["tip_length_mm"] += 1.0
        document["warnings"] = [{"code": "FAR", "text": "", "value": 3.0, "bound": 1.0, "confirm": False}]

    found = differing(admitted, forge(admitted, in_document(change)))
    assert {what for section, what in found if section == "verdict"} == {
        "q1 peak speed, of its limit", "path.tip_length_mm", "warning FAR",
    }  # fmt: skip


def test_times_and_counts_of_the_link_are_told_apart(admitted):
    counts = records.BusCounts(
        accepted=7, losses=1, repetitions=0, crc_failures=0, outside_session=0, stale_heartbeats=0
    )
    data = forge(left_on(admitted, permissive()), changed(records.AuditClose, bus=counts))
    found = of(data)[1]
    assert 0.0 < found["opening to permit, s"] < found["opening to end, s"]
    assert found["controller's frames: losses"] == 1
    assert "opening to start, s" not in found


def test_a_strange_log_is_compared_without_an_error(tmp_path):
    data = small_log(tmp_path).log.read_bytes()
    for old, new in [
        (b'"utc":', b'"utC":'),
        (b'"simulation"', b'"simulatioN"'),
        (b'"final_state":"done"', b'"final_state":1e9999'),
    ]:
        values, _ = of(data.replace(old, new))
        json.dumps(values, allow_nan=False)


def test_words_are_what_is_left_without_numbers():
    assert words_of("short by 12.5 mm at 3") == words_of("short by 1 mm at 44")
    assert words_of("a") != words_of("b")


def test_the_inputs_of_the_builder_are_what_is_compared(admitted):
    values, _ = of(admitted)
    assert values["path"]["poses"] == 6
    assert values["collected"]["tool.length, mm"] == inputs().robot.value.tool.length_mm


def test_first_out_and_its_phase_are_compared():
    (done,), (stopped,) = OLD.glob("*-eea20e88.mcap"), OLD.glob("*-0cac3de8.mcap")
    found = differing(done.read_bytes(), stopped.read_bytes())
    assert found["outcome", "first-out"] == (None, "OPERATOR_STOP")
    assert found["outcome", "stopped while"] == (None, "cutting")
    assert found["outcome", "final state"] == ("done", "stopped")


def test_the_file_of_another_program_is_told_beside_what_was_made_of_it(admitted):
    found = of(admitted)[0]["registration"]
    assert "made of" not in found
    source = next(
        entry for entry in read_log(BytesIO(admitted)).scan.attachments if entry.name == "registration.json"
    )
    log = read_log(BytesIO(admitted))
    log.scan.attachments.append(replace(source, name="registration-source.tfm"))
    values = comparable(log, story(log, "x.mcap", None))
    assert values["registration"]["made of"] == f"registration-source.tfm, SHA-256 {source.sha256}"


def test_what_nests_without_end_equals_nothing(admitted):
    deep = json.loads("[" * 900 + "]" * 900)

    def at(one):
        return changed(records.AuditVerdict, document=json.dumps({"path": {"x": deep, "y": one}}))

    found = differing(forge(admitted, at(1)), forge(admitted, at(2)))
    assert {section for section, _ in found} == {"verdict"}
