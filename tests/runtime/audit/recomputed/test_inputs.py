"""What a session decided on, read from its log: all of it, of a bounded size, and each from the other."""

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest

from cutgate.config.load import DEFAULT_LIMIT, REMOVED
from cutgate.config.model import Site
from cutgate.protocol.records import Path as WirePath
from cutgate.runtime.audit import names, records
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.audit.recomputed import inputs as module
from cutgate.runtime.audit.recomputed.inputs import (
    ReplayError,
    approved,
    attachment,
    derivation,
    inputs_of,
    model_of,
    typed,
)
from cutgate.runtime.kinematics.landmarks import NONE_ASKED
from cutgate.runtime.plan.prepare import IDENTITY_REGISTRATION
from cutgate.runtime.plan.toolpath.model import PLAIN, Reading
from tests.runtime.audit.build import forge, inputs, session_log

OTHER = inputs(850.0)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("admitted")).log.read_bytes()


def changed(data, **attachments):
    """The log with other attachments, by their names without ending; None leaves one out."""
    return read_log(
        forge(
            data,
            attachments=lambda name, content: attachments.get(Path(name).stem, content),
        )
    )


def opened(log):
    return typed(log, records.AuditOpen)[0]


def test_the_inputs_are_the_bytes_that_are_attached(data):
    found, made = inputs_of(read_log(data)), inputs()
    assert (found.path, found.limits, found.calibration, found.tool) == (
        made.path,
        made.limits,
        made.calibration,
        made.tool,
    )
    assert found.robot == made.robot.value
    assert found.site == Site()
    assert found.registration_digest == made.placed.digest
    assert found.placed.residual_mm == 0.2
    assert found.placed.residual_max_mm is None
    assert found.placed.matrix[0, 3] == 500.0
    assert found.placed.check_points == NONE_ASKED
    assert len(found.problem.tips_mm) == 6


def test_without_a_registration_it_is_the_identity_and_nothing_is_placed(data):
    found = inputs_of(changed(data, registration=None))
    assert found.placed is None
    assert found.registration_digest == sha256(IDENTITY_REGISTRATION).digest()


@pytest.mark.parametrize("name", ["robot", "path", "limits", "calibration", "tool"])
def test_each_of_them_is_needed(data, name):
    with pytest.raises(ReplayError, match=f"attachment {name}.* is missing: the verdict cannot be computed"):
        inputs_of(changed(data, **{name: None}))


@pytest.mark.parametrize("name", ["robot", "registration"])
def test_a_file_that_cannot_be_read_is_named(data, name):
    with pytest.raises(ReplayError, match=f"attachment {name}"):
        inputs_of(changed(data, **{name: b"{"}))


def test_records_that_pose_no_problem_say_so(data):
    for name in ("path", "limits", "calibration", "tool"):
        found = inputs_of(changed(data, **{name: b"damaged"}))
        with pytest.raises(ReplayError, match="pose no problem that can be verified: "):
            _ = found.problem


def test_a_site_is_read_as_the_version_that_wrote_it_did(tmp_path):
    """Settings that are no more stand in logs of earlier versions."""
    key, name = min(REMOVED).split(".")
    site = f'schema = "cutgate.site/1"\n[{key}]\n{name} = 1\n'.encode()
    log = read_log(session_log(tmp_path, site=site).log.read_bytes())
    assert inputs_of(log).site == Site()


# ---------------------------------------------------------------- sizes


def test_an_attachment_is_read_up_to_what_the_site_allows(data, monkeypatch, tmp_path):
    log = read_log(data)
    monkeypatch.setattr(module, "DEFAULT_LIMIT", 10)
    with pytest.raises(
        ReplayError, match=r"attachment robot.toml has \d+ bytes, the site reads files of at most 10"
    ):
        inputs_of(log)
    monkeypatch.undo()
    size = log.scan.attachment(names.PATH).size
    assert attachment(log, names.PATH, size) == inputs().path
    with pytest.raises(ReplayError, match=f"attachment path.bin has {size} bytes, .* at most {size - 1}"):
        attachment(log, names.PATH, size - 1)
    assert attachment(log, "nothing", 0) is None
    assert inputs_of(log).size_max == DEFAULT_LIMIT
    most = 2 * DEFAULT_LIMIT // 1_000_000
    text = f'schema = "cutgate.site/1"\nregistration_max_residual_mm = 1.5\n[files]\nfile_size_limit_mb = {most}\n'
    site = text.encode()
    larger = read_log(session_log(tmp_path, site=site).log.read_bytes())
    assert inputs_of(larger).placed.residual_max_mm == 1.5
    assert inputs_of(larger).size_max == most * module.BYTES_PER_MB > DEFAULT_LIMIT


def test_the_robot_and_the_site_themselves_are_read_within_the_usual_bound(data, monkeypatch):
    monkeypatch.setattr(module, "DEFAULT_LIMIT", len(inputs().robot.data) - 1)
    with pytest.raises(ReplayError, match=r"attachment robot.toml has"):
        inputs_of(read_log(data))


# ---------------------------------------------------------------- what follows from what


def test_the_path_is_the_one_that_plan_registration_and_robot_give(data):
    log = read_log(data)
    assert list(derivation(log, inputs_of(log), opened(log))) == []
    told = ["the uploaded path is not the one that plan, registration and robot give"]
    for other in (
        changed(data, path=OTHER.path),
        changed(data, registration=OTHER.registration),
        changed(data, registration=None),
    ):
        assert list(derivation(other, inputs_of(other), opened(other))) == told


def test_the_feed_is_the_plans_or_where_that_has_none_the_uploaded_one(data):
    faster = WirePath.parse(inputs().path)
    log = changed(data, path=replace(faster, feed_u=2 * faster.feed_u).body())
    assert list(derivation(log, inputs_of(log), opened(log))) == []


def test_a_plan_that_is_none_gives_no_path(data):
    log = changed(data, plan=b"x,y\n")
    (line,) = derivation(log, inputs_of(log), opened(log))
    assert line.startswith("plan, registration and robot give no path: ")
    log = changed(data, path=b"damaged")
    (line,) = derivation(log, inputs_of(log), opened(log))
    assert line.startswith("plan, registration and robot give no path: ")


def test_without_a_plan_nothing_is_made_again(data):
    log = changed(data, plan=None)
    with pytest.raises(ReplayError, match="attachment plan is missing: the path cannot be made again"):
        list(derivation(log, inputs_of(log), opened(log)))


@pytest.mark.parametrize("sec", [10**18, -(10**18), 10**400])
def test_a_record_0_without_a_date_is_no_session(data, sec):
    log = read_log(data)
    record = opened(log).model_copy(update={"utc": records.Time(sec=sec, nsec=0)})
    with pytest.raises(ReplayError, match=f"record 0 was written at {sec} s since 1970, which is no date"):
        list(derivation(log, inputs_of(log), record))


def test_the_path_is_made_at_the_second_after_record_0(data):
    """A registration that is younger than the session by more than clock_skew_s gives no path."""
    log = read_log(data)
    record = opened(log)
    made = json.loads(inputs().registration)
    for later_s, alike in ((0, True), (61, True), (62, False)):
        made["created_utc"] = (
            f"{module.datetime.fromtimestamp(record.utc.sec + later_s, module.UTC):%Y-%m-%dT%H:%M:%SZ}"
        )
        other = changed(data, registration=json.dumps(made).encode())
        found = list(derivation(other, inputs_of(other), record))
        assert (found == []) is alike, found


def test_what_the_controller_reported_is_what_the_robot_approves(data):
    log = read_log(data)
    assert list(approved(log, inputs_of(log))) == []
    for name in ("limits", "calibration", "tool"):
        other = changed(data, **{name: b"other"})
        assert list(approved(other, inputs_of(other))) == [
            f"attachment {name}.bin is not what robot.toml approves"
        ]


def test_a_record_that_cannot_be_read_is_named_with_its_place():
    with pytest.raises(
        ReplayError, match="a record of /audit/operator cannot be read: accepted: Field required"
    ):
        model_of(records.AuditOperator, b'{"word": "stop"}')
    assert model_of(records.AuditOperator, b'{"word": "stop", "accepted": true}').word == "stop"


def test_records_of_one_kind_come_in_file_order(data):
    assert [one.stage for one in typed(read_log(data), records.AuditPermit)] == 2 * [
        "authorised",
        "sent",
        "acknowledged",
    ]


# ---------------------------------------------------------------- how a tool path was read

ARC = b"""UNITS/MM
LOADTL/1
FEDRAT/600.,MMPM
GOTO/0.,0.,0.,0.5,0.,0.8660254
CUTCOM/LEFT
CIRCLE/5.,0.,0.,0.,0.,1.
GOTO/10.,0.,0.,0.5,0.,0.8660254
FINI
"""
CENTRE = Reading(cutcom_is_tool_centre=True)


def told(data, words):
    """The log whose record 0 says so of the reading of its tool path."""

    def edit(record):
        if not isinstance(record, records.AuditOpen):
            return record
        option = records.Option(name=names.READING, value=words)
        return record.model_copy(update={"simulation": (*record.simulation, option)})

    return read_log(forge(data, edit))


def test_a_tool_path_is_read_as_record_0_says(data):
    log = told(data, "cutcom_is_tool_centre=true arc_tolerance_mm=0.5")
    assert module._reading(log) == Reading(cutcom_is_tool_centre=True, arc_tolerance_mm=0.5)
    assert module._reading(read_log(data)) == PLAIN
    assert inputs_of(log).widened == inputs().robot.value  # of CSV nothing is declared


@pytest.mark.parametrize("words", ["rotary", "arc_tolerance_mm=9.5", "rotary=" + "[" * 100_000])
def test_a_reading_that_no_session_wrote_is_no_reading(data, words):
    with pytest.raises(ReplayError, match="record 0: "):
        inputs_of(told(data, words))


def test_what_chords_leave_out_of_an_arc_is_in_the_path_tolerance(data):
    robot = inputs().robot.value
    for tolerance_mm in (0.01, 0.2):
        reading = replace(CENTRE, arc_tolerance_mm=tolerance_mm)
        wider = module._widened(robot, Path("plan.apt"), ARC, reading).deadband
        assert wider.path_tolerance_mm - robot.deadband.path_tolerance_mm == pytest.approx(tolerance_mm)
    assert module._widened(robot, Path("plan.apt"), ARC.replace(b"CIRCLE", b"$$ "), CENTRE) == robot
    assert module._widened(robot, Path("plan.csv"), b"", PLAIN) == robot
    assert module._widened(robot, Path("plan.json"), b"", PLAIN) == robot


@pytest.mark.parametrize(
    ("content", "reading"), [(ARC, PLAIN), (b"", CENTRE), (ARC, Reading(rotary="xyzac"))]
)
def test_a_tool_path_that_cannot_be_read_again_gives_no_inputs(content, reading):
    with pytest.raises(ReplayError, match=r"attachment plan.apt: "):
        module._widened(inputs().robot.value, Path("plan.apt"), content, reading)
