"""What 0.1.0 wrote is read: logs, log folder, proofs, key, controller's memory and input files."""

import json
import shutil
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from io import BytesIO
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

from cutgate.config.key import load_key
from cutgate.config.load import InputError, Loaded, load_robot, load_site, site_from_bytes
from cutgate.config.model import Site
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.state import Memory
from cutgate.protocol.states import StopCause
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.audit.log import AuditLog, OpenInfo
from cutgate.runtime.audit.recomputed.authenticated import check_codes
from cutgate.runtime.commands.app import execute
from cutgate.runtime.interlock.permissives import registration_stands
from cutgate.runtime.interlock.state import Interlock
from cutgate.runtime.plan.load import load_plan, load_registration
from cutgate.runtime.session import withdrawn
from cutgate.runtime.session.job import make_job, read_files
from cutgate.runtime.session.withdrawal import listed_before

STORED = Path(__file__).parent / "0.1.0"
INPUTS, PROOFS, SESSIONS, CONTROLLER = (
    STORED / name for name in ("inputs", "proofs", "sessions", "controller")
)
SUMS = STORED / "SHA256SUMS"
PRIVATE = 0o600
"""git keeps no such mode, and what decides is believed only with it."""


@dataclass(frozen=True)
class Session:
    """One stored session, and what 0.1.0 itself says of its log."""

    name: str
    stem: str
    ended: str
    verdict: str = "admissible"

    def __str__(self) -> str:
        return self.name

    @property
    def log(self) -> Path:
        return SESSIONS / f"{self.stem}.mcap"


FINISHED = Session("finished", "20261127T072416Z-eea20e88", "done, done, after 5.750 s")
REFUSED = Session(
    "refused",
    "20261127T072422Z-aafdf719",
    "refused, controller's own check of the path: POSE_OUTSIDE_LIMITS at pose 0",
    verdict="inadmissible",
)
STOPPED = Session("stopped", "20261127T072424Z-0cac3de8", "stopped, the operator said stop, after 2.780 s")
CRASHED = Session("crashed", "20261127T072427Z-0fbca8e4", "no close record")
WITHDRAWN = Session(
    "withdrawn", "20261127T072431Z-c0838631", "stopped, the registration was withdrawn, after 2.964 s"
)
LATCHED = Session(
    "latched", "20261127T072437Z-31522be0", "stopped, the controller reports AUTHENTICATION_FAILED"
)
RESET = Session("reset", "20261127T072440Z-b7809ef8", "done, done, after 4.628 s")
IN_ORDER = (FINISHED, REFUSED, STOPPED, CRASHED, WITHDRAWN, LATCHED, RESET)

every_session = pytest.mark.parametrize("session", IN_ORDER, ids=str)


@pytest.fixture
def cutgate(capsys):
    """Runs a command; its exit code and its output with every run of blanks as one."""

    def call(*arguments):
        code = execute([*map(str, arguments)])
        return code, " ".join(capsys.readouterr().out.split())

    return call


def private_copy(source, target):
    """A copy as its owner keeps it."""
    shutil.copyfile(source, target)
    target.chmod(PRIVATE)
    return target


def digest(name):
    return sha256((INPUTS / name).read_bytes()).digest()


# ---------------------------------------------------------------- the folder


def test_every_stored_file_is_byte_by_byte_what_0_1_0_wrote_and_none_is_missing_or_new():
    found = {
        str(file.relative_to(STORED)): sha256(file.read_bytes()).hexdigest()
        for file in STORED.rglob("*")
        if file.is_file() and file != SUMS
    }
    lines = SUMS.read_text(encoding="ascii").splitlines()
    assert found == {name: sum_ for sum_, name in (line.split("  ") for line in lines)}


# ---------------------------------------------------------------- logs


def test_every_stored_log_has_its_session_here():
    assert sorted(SESSIONS.glob("*.mcap")) == [session.log for session in IN_ORDER]


@every_session
def test_audit_verify_finds_no_log_ok_that_nobody_signed(cutgate, session):
    """Who takes the signatures away must not get more than that."""
    code, out = cutgate("audit", "verify", session.log)
    assert (code, out.partition(":")[0]) == (1, "INCOMPLETE (unsigned, old form)")
    assert "tampered" not in out.casefold()


@every_session
def test_audit_replay_decides_the_same_again(cutgate, session):
    code, out = cutgate("audit", "replay", session.log)
    assert (code, out.partition(":")[0]) == (0, "IDENTICAL")
    assert out.endswith(f"recomputed verdict: {session.verdict}")


@every_session
def test_audit_show_says_how_a_session_ended(cutgate, session):
    code, out = cutgate("audit", "show", session.log)
    assert code == 0
    assert f" ended {session.ended}" in out
    assert f"Verdict: {session.verdict.upper()}" in out


@every_session
def test_the_codes_of_0_1_0_cannot_be_checked_and_that_is_said(session):
    key = bytes.fromhex((CONTROLLER / "permit-key.txt").read_text(encoding="ascii"))
    frames = session.log.with_suffix(".candump.log").read_bytes()
    log = read_log(session.log.read_bytes(), frames)
    found = check_codes(log, BytesIO(frames), key)
    assert (found.answer, found.wrong, found.wrong_count) == ("not checked", (), 0)
    assert "they cannot be checked, for it holds no OPEN and OPENED" in found.line


def test_each_session_names_the_one_before_it_and_its_head():
    logs = [read_log(session.log.read_bytes()) for session in IN_ORDER]
    (opened, *later) = [log.of("/audit/open")[0] for log in logs]
    assert "previous_log" not in opened
    assert [
        (entry["previous_log"], entry["previous_head"], entry["previous_crashed"]) for entry in later
    ] == [
        (session.log.name, log.report.head, session is CRASHED)
        for session, log in zip(IN_ORDER[:-1], logs[:-1], strict=True)
    ]


# ---------------------------------------------------------------- the log folder


@pytest.mark.parametrize(
    ("head", "last"),
    [(SESSIONS / "HEAD", RESET), (STORED / "HEAD-after-crash", CRASHED)],
    ids=["closed", "open"],
)
def test_the_next_session_follows_on_what_0_1_0_left(tmp_path, head, last):
    private_copy(head, tmp_path / "HEAD")
    private_copy(SESSIONS / "WITHDRAWN", tmp_path / "WITHDRAWN")
    private_copy(last.log, tmp_path / last.log.name)
    log = AuditLog.create(tmp_path, log_id="ab" * 16, opened=OpenInfo("next", "next"))
    paths = log.close(final_state="done", clean=True)
    assert paths.closed
    (opened,) = read_log(paths.log.read_bytes()).of("/audit/open")
    assert (opened["previous_log"], opened["previous_crashed"]) == (last.log.name, last is CRASHED)
    assert opened["previous_head"] == read_log(last.log.read_bytes()).report.head
    assert "previous_note" not in opened


@pytest.mark.parametrize(
    ("registration", "said"),
    [
        ("registration.json", f"this registration was withdrawn in {WITHDRAWN.log.name}"),
        ("registration-shifted.json", "is not surely later than the withdrawal"),
        ("registration-second.json", "is not surely later than the withdrawal"),
    ],
)
@pytest.mark.parametrize("there", [True, False], ids=["with its log", "without"])
def test_what_was_withdrawn_under_0_1_0_is_refused_and_whatever_was_taken_before(
    tmp_path, registration, said, there
):
    """Nobody wrote down when it was: the list is completed, and what is taken from then on counts."""
    private_copy(SESSIONS / "WITHDRAWN", tmp_path / "WITHDRAWN")
    if there:
        private_copy(WITHDRAWN.log, tmp_path / WITHDRAWN.log.name)
        private_copy(SESSIONS / "HEAD", tmp_path / "HEAD")
    files = read_files(
        INPUTS / "plan.json", INPUTS / "robot.toml", INPUTS / registration, INPUTS / "site.toml", None
    )
    job = make_job(files, now=datetime.now(UTC))
    log = AuditLog.create(tmp_path, log_id=bytes(16).hex(), opened=OpenInfo("cutgate", "cutgate"))
    listed = listed_before(log)
    found = withdrawn.refusal(listed, files.prepared.digests, files.registration, 60.0)
    assert said in found
    again = files.registration.model_copy(update={"id": "under another name"})
    same = withdrawn.refusal(listed, {bytes(32)}, again, 60.0)
    known = registration == "registration.json" and there
    assert ("the same place was withdrawn" if known else "is not surely later than the withdrawal") in same
    later = datetime.now(UTC) + timedelta(seconds=61)
    moved = again.model_copy(
        update={"R_T_CT": np.eye(4).tolist(), "created_utc": f"{later:%Y-%m-%dT%H:%M:%S.%fZ}"}
    )
    assert withdrawn.refusal(listed, {bytes(32)}, moved, 60.0) == ""
    assert log.close(final_state="refused", clean=True).closed
    permissive = registration_stands(Interlock(replace(job, withdrawal=found)), 0.0)
    assert (permissive.holds, permissive.text) == (False, found)


# ---------------------------------------------------------------- proofs


@pytest.mark.parametrize(
    ("proof", "plan", "registration", "code", "word"),
    [
        ("plan.proof", "plan.json", "registration.json", 0, "PROVEN"),
        ("plan.proof", "plan.csv", "registration.json", 0, "PROVEN"),
        ("plan-six.proof", "plan-six.json", "registration-second.json", 0, "PROVEN"),
        ("plan.proof", "plan.json", "registration-shifted.json", 1, "NOT PROVEN"),
        ("plan.proof", "plan-six.json", "registration-second.json", 1, "NOT PROVEN"),
    ],
)
def test_a_proof_holds_for_what_it_was_made_for_and_for_nothing_else(
    cutgate, proof, plan, registration, code, word
):
    found = cutgate(
        "recheck", PROOFS / proof, INPUTS / plan, "--robot", INPUTS / "robot.toml",
        "--registration", INPUTS / registration,
    )  # fmt: skip
    assert (found[0], found[1].partition(":")[0]) == (code, word)


# ---------------------------------------------------------------- the controller's side


def test_the_key_is_the_one_in_its_file(tmp_path):
    key = load_key(private_copy(CONTROLLER / "permit-key.txt", tmp_path / "site.key"))
    assert sha256(key).hexdigest() == "85039aaedfaf36f50c701ccd13838359ca29701d1d2f507d2e30b4ad4cfe070e"


@pytest.mark.parametrize(
    ("stored", "latched"),
    [("memory.json", StopCause.NONE), ("memory-latched.json", StopCause.AUTHENTICATION_FAILED)],
)
def test_the_controller_remembers_what_was_withdrawn_and_what_is_latched(tmp_path, stored, latched):
    file = private_copy(CONTROLLER / stored, memory.beside(tmp_path / "site.key"))
    now_us = 1_795_000_000_000_000
    assert memory.load(file, now_us) == Memory(
        earlier=frozenset({digest("registration.json"), digest("registration-shifted.json")}),
        barrier_us=now_us,
        latched=latched,
    )


# ---------------------------------------------------------------- input files

ROBOT, SITE = "robot-full.toml", "site-full.toml"


def of_a_log(path: Path) -> Loaded[Site]:
    """A site as a replay reads it."""
    data = path.read_bytes()
    return Loaded(site_from_bytes(path, data, recorded=True), data, path)


LOADED = [
    (load_robot, "robot.toml", "name", "small"),
    (load_robot, "robot.toml", "arm.upper_link_mm", 450.0),
    (load_robot, "robot.toml", "limits.q1_deg", (0.0, 145.0)),
    (load_robot, "robot.toml", "limits.acceleration", None),
    (load_robot, "robot.toml", "calibration.residual_mm", 0.0),
    (load_robot, "robot.toml", "deadband.wrist_deg", 2.0),
    (load_robot, ROBOT, "elbow", "left"),
    (load_robot, ROBOT, "arm.forearm_link_mm", 440.5),
    (load_robot, ROBOT, "tool.length_mm", 152.75),
    (load_robot, ROBOT, "limits.q0_deg", (-100.0, 95.5)),
    (load_robot, ROBOT, "limits.q2_mm", (-20.0, 430.0)),
    (load_robot, ROBOT, "limits.q3_deg", (-36000.0, 36000.0)),
    (load_robot, ROBOT, "limits.speed", (1.1, 1.2, 210.0, 2.3, 2.4)),
    (load_robot, ROBOT, "limits.acceleration", (5.0, 6.0, 1000.0, 11.0, 12.0)),
    (load_robot, ROBOT, "calibration.upper_link_error_mm", 0.125),
    (load_robot, ROBOT, "calibration.joint_offset_deg", (0.05, -0.04, 0.3, 0.02, -0.01)),
    (load_robot, ROBOT, "calibration.slide_tilt_mrad", (0.5, -0.75)),
    (load_robot, ROBOT, "calibration.residual_deg", 0.03),
    (load_robot, ROBOT, "wrist.hold_roll_when_vertical", True),
    (load_robot, ROBOT, "wrist.hold_roll_deg", 12.5),
    (load_robot, ROBOT, "deadband.path_tolerance_mm", 0.15),
    (load_robot, ROBOT, "deadband.path_tolerance_deg", 0.05),
    (load_site, "site.toml", "timing.timeout_ms", 1000),
    (load_site, "site.toml", "start.start_lifetime_ms", 5000),
    (load_site, "site.toml", "log.commit_deadline_ms", 5000),
    (load_site, "site.toml", "key_file", None),
    (of_a_log, SITE, "bus.interface", "socketcan"),
    (of_a_log, SITE, "bus.channel", "can0"),
    (of_a_log, SITE, "bus.bitrate_bit_s", 500_000),
    (of_a_log, SITE, "bus.fd", True),
    (of_a_log, SITE, "controller.serial", "CG-0001"),
    (of_a_log, SITE, "key_file", "site.key"),
    (of_a_log, SITE, "registration_max_age_s", 3600.5),
    (of_a_log, SITE, "log.directory", "room-3"),
    (load_plan, "plan.json", "id", "three poses"),
    (load_plan, "plan.json", "feed_mm_s", 20.0),
    (load_plan, "plan.json", "tool_length_mm", None),
    (load_plan, "plan-six.json", "implant", "tapered stem"),
    (load_plan, "plan-six.json", "side", "right"),
    (load_plan, "plan-six.json", "ct_id", "knee-ct"),
    (load_plan, "plan-six.json", "tool_length_mm", 160.0),
    (load_plan, "plan-six.json", "feed_mm_s", 7.5),
    (load_plan, "plan.csv", "id", "plan"),
    (load_plan, "plan.csv", "feed_mm_s", None),
    (load_registration, "registration.json", "residual_rms_mm", 0.2),
    (load_registration, "registration.json", "created", datetime(2026, 1, 15, 8, 2, 11, tzinfo=UTC)),
    (load_registration, "registration.json", "ct_id", None),
    (load_registration, "registration-shifted.json", "R_T_CT", (
        (1.0, 0.0, 0.0, 301.5), (0.0, 1.0, 0.0, -0.25), (0.0, 0.0, 1.0, 2.0), (0.0, 0.0, 0.0, 1.0),
    )),
    (load_registration, "registration-shifted.json", "created", datetime(2026, 1, 15, 9, 2, 11, tzinfo=UTC)),
    (load_registration, "registration-second.json", "ct_id", "knee-ct"),
    (load_registration, "registration-second.json", "created",
     datetime(2026, 1, 15, 10, 2, 11, 500_000, tzinfo=UTC)),
]  # fmt: skip

CONSTANTS = {
    "heartbeat_ms": 25,
    "timeout_ms": 120,
    "permit_lifetime_s": 90,
    "start_lifetime_ms": 1500,
    "start_tolerance_mm": 0.4,
    "start_tolerance_deg": 0.15,
    "approach_clearance_mm": 12.5,
    "approach_speed_percent": 30,
    "tracking_tolerance_mm": 0.75,
    "tracking_tolerance_deg": 0.3,
    "transfer_timeout_s": 30,
    "reply_timeout_ms": 2500,
    "announce_wait_s": 45,
    "verify_timeout_s": 90,
    "operator_wait_s": 600,
    "stop_confirm_ms": 1500,
    "commit_deadline_ms": 1200,
    "checkpoint_deadline_ms": 6000,
    "chunk_period_ms": 800,
    "file_size_limit_mb": 32,
    "pose_limit": 100_000,
}
"""Every constant of 0.1.0 that did anything; a later version may have more."""

POSES = [
    [501.003359, 494.226536, 127.432889, 0.0, 0.64278761, 0.766044443],
    [513.003359, 478.226536, 127.432889, 0.0, 0.64278761, 0.766044443],
    [525.003359, 462.226536, 127.432889, 0.0, 0.64278761, 0.766044443],
]
TURNED = [[0.0, -1.0, 0.0, 10.0], [1.0, 0.0, 0.0, -20.0], [0.0, 0.0, 1.0, 30.0], [0.0, 0.0, 0.0, 1.0]]


@pytest.mark.parametrize(("load", "name", "key", "value"), LOADED)
def test_an_input_file_says_what_it_said_to_0_1_0(load, name, key, value):
    assert attrgetter(key)(load(INPUTS / name).value) == value


def test_a_site_with_every_constant_has_them_all_in_a_log():
    assert of_a_log(INPUTS / SITE).value.constants().items() >= CONSTANTS.items()


def test_a_site_with_settings_that_never_did_anything_is_refused_with_the_lines_to_delete(tmp_path):
    with pytest.raises(InputError) as caught:
        load_site(INPUTS / SITE)
    told = str(caught.value).splitlines()
    assert len(told) == 4
    assert all(line.endswith("delete this line") for line in told)
    dead = {problem.key.split(".")[1] for problem in caught.value.problems}
    lines = (INPUTS / SITE).read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [line for line in lines if line.split("=")[0].strip() not in dead]
    (tmp_path / "site.toml").write_text("".join(kept), encoding="utf-8")
    assert load_site(tmp_path / "site.toml").value == of_a_log(INPUTS / SITE).value


def test_a_site_that_says_nothing_is_the_default_site():
    assert load_site(INPUTS / "site-minimal.toml").value == Site()


@pytest.mark.parametrize("name", ["plan.json", "plan.csv"])
def test_a_plan_and_a_tool_path_hold_the_poses_of_their_file(name):
    plan = load_plan(INPUTS / name).value
    assert plan.ct_T_implant.tolist() == np.eye(4).tolist()
    assert np.hstack([plan.tips_mm, plan.axes]) == pytest.approx(np.array(POSES), abs=1e-8)


def test_a_plan_in_a_turned_frame_keeps_frame_and_poses():
    plan = load_plan(INPUTS / "plan-six.json").value
    assert plan.ct_T_implant.tolist() == TURNED
    poses = json.loads((INPUTS / "plan-six.json").read_bytes())["poses"]
    assert np.hstack([plan.tips_mm, plan.axes]) == pytest.approx(np.array(poses), abs=1e-6)
