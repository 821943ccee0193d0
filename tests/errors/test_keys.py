"""Keys and permits that are not right: the controller refuses each, the log names it, the operator reads it.

Both loops are real; only what leaves the runtime is changed, before it is signed (somebody who holds the key permits
something else) or after (somebody who does not).
"""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any
from unittest import mock

import pytest

from cutgate.firmware_sim import command as sim
from cutgate.firmware_sim.faults import FaultName
from cutgate.protocol import records
from cutgate.protocol.codes import PresharedKey
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.states import ControllerState, Purpose, Refusal, StopCause
from cutgate.runtime.audit.inspect import Log, Status
from cutgate.runtime.commands.app import execute
from cutgate.runtime.interlock.refusals import told
from cutgate.runtime.interlock.state import Phase, Refused
from tests.runtime.session.pair import KEY, Pair, Stranger
from tests.runtime.session.test_session import first_frames

OTHER_KEY = bytes(range(1, 33))
OTHER = b"\x5a" * 32
SIGN = Endpoint._signed


def altered(record: Any, name: str) -> Any:
    """The record with one field changed to another value that it can hold; ``a.b`` reaches into a block."""
    outer, _, inner = name.partition(".")
    if inner:
        return replace(record, **{outer: altered(getattr(record, outer), inner)})
    value = getattr(record, outer)
    match value:
        case bytes():
            other: Any = bytes([value[0] ^ 1]) + value[1:]
        case tuple():
            other = (value[0] + 1_000_000, *value[1:])
        case int():
            other = value + 1
        case str():
            other = {"right": "left", "left": "right"}.get(value, f"{value[:-1]}x")
    return replace(record, **{outer: other})


def changing(
    kind: type[records.Record], change: Callable[[Any], Any], *, key: bytes = KEY, signed: bool
) -> Any:
    """The runtime signs another record of this kind than it decided on, or changes the signed one."""

    def sign(endpoint: Endpoint, record: Any, sequence: int) -> Any:
        if not isinstance(record, kind):
            return SIGN(endpoint, record, sequence)
        codes = PresharedKey(key).session(endpoint._codes.digest)
        if signed:
            return codes.sign(change(record), sequence)
        return change(codes.sign(record, sequence))

    return mock.patch.object(Endpoint, "_signed", sign)


def judged(pair: Pair, status: Status = Status.OK) -> Log:
    """The closed log; it is whole, and the arm has never moved. TAMPERED where a record that left names another tree."""
    assert pair.process.arm.state.joints == pair.options.joints
    assert not any("state CUTTING" in line for line in pair.said)
    assert pair.close().closed
    log = pair.read()
    assert log.report.status is status
    return log


def refused_in(log: Log, kind: str) -> list[str]:
    """The controller's refusals of this kind of record, as the log has them."""
    return [r["reply"] for r in log.of("/audit/permit") if (r["kind"], r["stage"]) == (kind, "refused")]


def words_refused(pair: Pair) -> list[str]:
    return [effect.reason for effect in pair.notes.effects if isinstance(effect, Refused)]


# ---------------------------------------------------------------- each field of the permit

SAME_AS_HELD = {
    "nonce": Refusal.NONCE_MISMATCH,
    "announce_nonce": Refusal.ANNOUNCE_NONCE,
    "session_digest": Refusal.WRONG_SESSION,
    "serial": Refusal.WRONG_SERIAL,
    "protocol_version": Refusal.PROTOCOL_VERSION,
    "epoch": Refusal.EPOCH,
    "limits_digest": Refusal.LIMITS_DIGEST,
    "calibration_digest": Refusal.CALIBRATION_DIGEST,
    "tool_digest": Refusal.TOOL_DIGEST,
    "path_digest": Refusal.PATH_DIGEST,
    "registration_digest": Refusal.REGISTRATION_DIGEST,
    "configuration_digest": Refusal.CONFIGURATION_DIGEST,
    "verifier_version": Refusal.VERIFIER,
    "start_joints_u": Refusal.START_JOINTS,
    "branch.elbow": Refusal.BRANCH,
    "branch.q0_turns": Refusal.BRANCH,
    "branch.roll_turns": Refusal.BRANCH,
    "approach.entry_joints_u": Refusal.APPROACH,
    "approach.exit_joints_u": Refusal.APPROACH,
    "approach.speed_percent": Refusal.APPROACH_SPEED,
    "lifetime_s": Refusal.TIMING_OUT_OF_BOUNDS,
}
"""What the controller compares with what it holds itself or was opened for, whoever has signed it."""

WITHIN_ROUNDING = ("approach.entry_um", "approach.exit_um")
"""One um is the rounding of either side; 1000 um are another entry."""

OF_THE_LOG = dict.fromkeys(("log.log_id", "log.size", "log.root"), Status.TAMPERED)
"""What a permit says of the log is held against the start under it, and the log against what it says."""

EVERY_FIELD = (*SAME_AS_HELD, *WITHIN_ROUNDING, *OF_THE_LOG)


def test_every_field_of_the_permit_is_altered():
    blocks = {"branch": records.Branch, "approach": records.Approach, "log": records.TreeHead}
    names = [
        f"{field.name}.{part.name}" if field.name in blocks else field.name
        for field in fields(records.Permit)
        for part in (fields(blocks[field.name]) if field.name in blocks else (field,))
    ]
    assert sorted(names) == sorted((*EVERY_FIELD, "mac"))


@pytest.mark.parametrize(("name", "refusal"), SAME_AS_HELD.items())
def test_a_signed_permit_for_something_else_is_refused_with_its_reason(pair, name, refusal):
    with changing(records.Permit, lambda permit: altered(permit, name), signed=True):
        assert pair.begin().end() is Phase.REFUSED
    assert pair.state.reason == f"the controller refused the permit: {told(refusal)}"
    assert Phase.PERMITTED not in pair.notes.phases
    assert refused_in(judged(pair), "permit") == [refusal.name]


@pytest.mark.parametrize("name", WITHIN_ROUNDING)
def test_a_signed_permit_for_another_entry_or_exit_is_refused(pair, name):
    part = name.partition(".")[2]

    def further(permit: Any) -> Any:
        bound = permit.approach
        return replace(permit, approach=replace(bound, **{part: getattr(bound, part) + 1000}))

    with changing(records.Permit, further, signed=True):
        assert pair.begin().end() is Phase.REFUSED
    assert refused_in(judged(pair), "permit") == [Refusal.APPROACH.name]


@pytest.mark.parametrize("name", [*WITHIN_ROUNDING, *OF_THE_LOG])
def test_a_start_under_another_permit_than_the_decided_one_is_refused(pair, name):
    with changing(records.Permit, lambda permit: altered(permit, name), signed=True):
        pair.to(Phase.PERMITTED)
    pair.until(lambda: bool(words_refused(pair)), act=pair._lead)
    assert words_refused(pair)[0] == f"the controller refused the start: {told(Refusal.PERMIT_MISMATCH)}"
    pair.say("quit").end()
    log = judged(pair, OF_THE_LOG.get(name, Status.OK))
    assert refused_in(log, "start") == [Refusal.PERMIT_MISMATCH.name]


@pytest.mark.parametrize("name", EVERY_FIELD)
def test_a_permit_altered_without_the_key_latches_whatever_was_altered(pair, name):
    with changing(records.Permit, lambda permit: altered(permit, name), signed=False):
        masqueraded(pair, "permit", OF_THE_LOG.get(name, Status.OK))


def masqueraded(pair: Pair, kind: str, status: Status = Status.OK) -> None:
    """The session ends with a latched fault of both sides, in the log and on the screen."""
    pair.begin() if pair.session is None else None
    pair.until(lambda: pair.phase is Phase.STOPPED, act=pair._lead)
    pair.run(0.1)
    assert (pair.state.cause, pair.controller.cause) == (StopCause.AUTHENTICATION_FAILED,) * 2
    assert pair.controller.state is ControllerState.FAULT
    assert not pair.controller.cutting_mode
    assert pair.state.reason.startswith(
        f"the controller reports AUTHENTICATION_FAILED: it refused with {told(Refusal.MAC_INVALID)}"
    )
    assert any(
        line.startswith("refused: MAC_INVALID: the runtime has another key file") for line in pair.said
    )
    log = judged(pair, status)
    assert {record.get("first_out") for record in log.of("/audit/decision")} - {None} == {
        "AUTHENTICATION_FAILED"
    }
    faults = {record["cause"] for record in log.of("/audit/fault") if record["source"] == "controller"}
    assert faults == {"AUTHENTICATION_FAILED"}
    stages = [record["stage"] for record in log.of("/audit/permit") if record["kind"] == kind]
    assert stages == ["authorised", "sent", "refused"], (
        "the stop leaves first, then the reply with its reason"
    )
    assert refused_in(log, kind) == ["MAC_INVALID"]


# ---------------------------------------------------------------- keys


@pytest.mark.parametrize("kind", [records.Permit, records.Start], ids=["permit", "start"])
def test_a_wrong_key_latches(pair, kind):
    with changing(kind, lambda record: record, key=OTHER_KEY, signed=True):
        masqueraded(pair, kind.__name__.lower())


def test_a_reset_with_a_wrong_key_leaves_the_fault_latched(pair):
    pair.latch(StopCause.SECOND_NODE)
    pair.to(Phase.HELD).run(0.05).say("acknowledge").run(0.1)
    with changing(records.Reset, lambda record: record, key=OTHER_KEY, signed=True):
        pair.say("reset").run(0.3)
    assert (pair.controller.state, pair.controller.cause) == (ControllerState.FAULT, StopCause.SECOND_NODE)
    assert pair.state.cause is StopCause.AUTHENTICATION_FAILED
    log = judged(pair)
    stages = [record["stage"] for record in log.of("/audit/permit") if record["kind"] == "reset"]
    assert stages == ["authorised", "sent", "refused"]
    assert refused_in(log, "reset") == ["MAC_INVALID"]


def test_a_code_is_good_for_one_kind_of_record_only(pair):
    """The permit's code under a start."""
    codes: list[bytes] = []

    def swap(endpoint: Endpoint, record: Any, sequence: int) -> Any:
        signed = SIGN(endpoint, record, sequence)
        if not isinstance(record, records.Permit | records.Start):
            return signed
        codes.append(signed.mac)
        return signed.with_mac(codes[0])

    with mock.patch.object(Endpoint, "_signed", swap):
        masqueraded(pair, "start")


@pytest.fixture
def command(pair, tmp_path):
    """``cutgate run`` and ``cutgate sim`` with these options for the key."""
    directory = pair.files.prepared.plan.path.parent
    robot = ("--robot", str(directory / "robot.toml"))
    registration = ("--registration", str(directory / "registration.json"))
    run = ("run", str(directory / "plan.csv"), *robot, *registration, "--log-dir", str(tmp_path / "logs"))

    def call(name: str, *key: str) -> int:
        if name == "sim":
            return sim.main([*robot, *key])
        with mock.patch(
            "cutgate.runtime.commands.run._bus", side_effect=AssertionError("the bus was opened")
        ):
            return execute([*run, *key])

    return call


@pytest.mark.parametrize("name", ["run", "sim"])
def test_without_a_key_nothing_begins(command, name, capfd, tmp_path):
    assert command(name) == 2
    assert "no key file is given" in capfd.readouterr().err
    assert command(name, "--key", str(tmp_path / "absent")) == 2
    assert "cutgate key new" in capfd.readouterr().err


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660])
@pytest.mark.parametrize("name", ["run", "sim"])
def test_a_key_that_others_can_read_is_refused(command, name, mode, capfd, tmp_path):
    file = tmp_path / "key"
    file.write_text(KEY.hex())
    file.chmod(mode)
    assert command(name, "--key", str(file)) == 2
    said = capfd.readouterr().err
    assert str(file.name) in said.replace("\n", "")
    assert "600" in said


# ---------------------------------------------------------------- old permits


def kept(into: list[Any]) -> Any:
    """Keep the signed permit that leaves."""

    def keep(record: Any) -> Any:
        into.append(record)
        return record

    return changing(records.Permit, keep, signed=False)


def test_a_permit_replayed_under_a_new_number_latches(pair):
    signed: list[Any] = []
    with kept(signed):
        pair.to(Phase.PERMITTED)
    stranger = Stranger(pair, pair.state.session.digest)
    said(stranger, signed[0])
    pair.run(0.1)
    assert [reply.refusal for reply in stranger.replies] == [Refusal.MAC_INVALID]
    assert (pair.controller.state, pair.controller.cause) == (
        ControllerState.FAULT,
        StopCause.AUTHENTICATION_FAILED,
    ), "its code is that of another number"
    assert not pair.controller.cutting_mode
    judged(pair)


def test_a_permit_signed_anew_is_refused_before_and_after_the_stop(pair):
    """By a second holder of the key."""
    signed: list[Any] = []
    with kept(signed):
        pair.to(Phase.PERMITTED)
    stranger = Stranger(pair, pair.state.session.digest)
    stranger.say(signed[0])
    pair.run(0.1)
    pair.say("stop")
    stranger.say(signed[0])
    pair.run(0.06)
    assert [reply.refusal for reply in stranger.replies] == [Refusal.NOT_IN_STATE, Refusal.VOIDED_BY_STOP]
    assert not pair.controller.cutting_mode
    judged(pair)


def said(stranger: Stranger, record: Any) -> None:
    """Without signing it anew: the code is the one that it carries."""
    with mock.patch.object(Endpoint, "_signed", lambda _endpoint, given, _sequence: given):
        stranger.say(record)


def test_a_permit_of_another_session_and_of_another_boot_is_refused(pair):
    """Carried over by a runtime that signs what it kept."""
    signed: list[Any] = []
    with kept(signed):
        pair.to(Phase.PERMITTED)
    pair.say("quit").end()
    pair.close()
    for prepare in (pair.run, lambda _s: pair.power_up()):
        prepare(0.3)
        pair.begin()
        with changing(records.Permit, lambda permit: replace(signed[0], log=permit.log), signed=True):
            assert pair.end() is Phase.REFUSED
        assert pair.state.reason == f"the controller refused the permit: {told(Refusal.WRONG_SESSION)}"
        assert refused_in(judged(pair), "permit") == [Refusal.WRONG_SESSION.name]


def test_the_code_of_a_permit_of_another_session_latches(pair):
    signed: list[Any] = []
    with kept(signed):
        pair.to(Phase.PERMITTED)
    pair.say("quit").end()
    pair.close()
    pair.run(0.3)
    pair.begin()
    with changing(records.Permit, lambda _permit: signed[0], signed=False):
        masqueraded(pair, "permit", Status.TAMPERED)


def test_a_permit_on_its_way_when_the_controller_reboots_is_ignored(pair):
    signed: list[Any] = []
    with kept(signed):
        pair.to(Phase.PERMITTING)
    session = pair.state.session.digest
    pair.process._happen(FaultName.REBOOT)
    stranger = Stranger(pair, session)
    said(stranger, signed[0])
    pair.run(0.1)
    assert stranger.replies == []
    assert (pair.controller.state, pair.controller.permit) == (ControllerState.INHIBITED, None)
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause in (StopCause.PEER_REBOOTED, StopCause.HEARTBEAT_LOST), "what comes first"
    judged(pair)


# ---------------------------------------------------------------- lifetimes, on the controller's clock


def timed(pair: Pair, **timing: Any) -> Pair:
    return pair.begin(replace(pair.job, timing=replace(pair.job.timing, **timing)))


def test_a_permit_whose_nonce_has_outlived_its_lifetime_is_refused(pair):
    """The disk takes its time; the runtime would wait for it."""
    pair.job = replace(pair.job, deadlines=replace(pair.job.deadlines, commit_deadline_s=30.0))
    timed(pair, permit_lifetime_s=10)
    pair.to(Phase.COLLECTING).disk.answers = False
    pair.to(Phase.AUTHORISING_PERMIT)
    pair.session._checkpoint_deadline_s = 30.0
    pair.run(10.1).disk.answers = True
    assert pair.end() is Phase.REFUSED
    assert pair.state.reason == f"the controller refused the permit: {told(Refusal.NONCE_EXPIRED)}"
    assert refused_in(judged(pair), "permit") == ["NONCE_EXPIRED"]


def test_a_start_whose_nonce_has_outlived_its_lifetime_is_refused(pair):
    timed(pair, start_lifetime_ms=500)
    pair.to(Phase.PERMITTED).disk.delay_s = 0.6
    pair.until(lambda: bool(words_refused(pair)), act=pair._lead)
    assert words_refused(pair) == [f"the controller refused the start: {told(Refusal.NONCE_EXPIRED)}"]
    pair.disk.delay_s = 0.0
    pair.say("quit").end()
    pair.run(0.7)
    assert refused_in(judged(pair), "start") == ["NONCE_EXPIRED"]


def test_a_permit_that_nobody_starts_expires_on_both_sides_and_ends_the_cutting_mode(pair):
    timed(pair, permit_lifetime_s=10)
    pair.to(Phase.PERMITTED)
    began_s = pair.state.nonce_at_s
    pair.until(lambda: not pair.controller.cutting_mode, limit_s=11.0, act=lambda: None)
    assert pair.clock() - began_s <= 10.0 + 3 * pair.cycle_s
    pair.run(0.1)
    assert pair.phase is Phase.STOPPED
    assert (pair.state.cause, pair.controller.cause) == (StopCause.PERMIT_EXPIRED,) * 2
    assert not first_frames(pair, records.Start)
    judged(pair)


def test_a_permit_expires_on_the_controllers_own_clock_before_a_start_can_use_it(pair):
    """The runtime believes that it is early; a start that is signed and on its way finds nothing."""
    timed(pair, permit_lifetime_s=10)
    pair.to(Phase.PERMITTED)
    late = replace(pair.controller, permit_issued_at_s=pair.clock() - 10.1)
    stranger = Stranger(pair, pair.state.session.digest)
    stranger.say(start_of(pair, late))
    pair.process.controller = late
    pair.run(0.05)
    assert pair.controller.cause is StopCause.PERMIT_EXPIRED
    assert ControllerState.CUTTING.name not in "".join(pair.said)
    assert Refusal.ACCEPTED not in [reply.refusal for reply in stranger.replies]
    pair.end()
    judged(pair)


def start_of(pair: Pair, controller: Any) -> records.Start:
    return records.Start(
        nonce=bytes(16),
        epoch=controller.epoch,
        session_digest=pair.state.session.digest,
        permit_digest=controller.permit.digest,
        start_joints_u=controller.permit.start_joints_u,
        log=replace(controller.permit.log, size=controller.permit.log.size + 1),
    )


# ---------------------------------------------------------------- each field of start and reset


@pytest.mark.parametrize(
    ("name", "refusal"),
    [
        ("nonce", Refusal.NONCE_MISMATCH),
        ("epoch", Refusal.EPOCH),
        ("session_digest", Refusal.WRONG_SESSION),
        ("permit_digest", Refusal.PERMIT_MISMATCH),
        ("start_joints_u", Refusal.START_JOINTS),
        ("log.log_id", Refusal.LOG_NOT_CONTINUED),
    ],
)
def test_a_signed_start_of_something_else_is_refused_with_its_reason(pair, name, refusal):
    with changing(records.Start, lambda start: altered(start, name), signed=True):
        pair.begin().until(lambda: bool(words_refused(pair)), act=pair._lead)
    assert words_refused(pair)[0] == f"the controller refused the start: {told(refusal)}"
    pair.say("quit").end()
    assert refused_in(judged(pair, OF_THE_LOG.get(name, Status.OK)), "start") == [refusal.name]


@pytest.mark.parametrize("purpose", [Purpose.PERMIT, Purpose.START])
def test_a_nonce_asked_for_another_purpose_serves_nothing(pair, purpose):
    """The record that leaves asks for a nonce of the other purpose; the runtime takes no such answer."""
    pair.begin()
    ask, other = pair.session._send, Purpose.START if purpose is Purpose.PERMIT else Purpose.PERMIT

    def send(record: records.Record) -> Any:
        if isinstance(record, records.NonceRequest) and record.purpose is purpose:
            record = replace(record, purpose=other)
        return ask(record)

    with mock.patch.object(pair.session, "_send", send):
        pair.until(lambda: pair.phase is Phase.STOPPED, act=pair._lead)
    assert pair.state.cause is StopCause.TRANSFER_FAILED
    assert not first_frames(pair, {Purpose.PERMIT: records.Permit, Purpose.START: records.Start}[purpose])
    pair.run(0.1)
    judged(pair)
