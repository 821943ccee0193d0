"""The suite against the simulated controller: whole, it passes; with one guard taken out, exactly its cases fail."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cutgate.firmware_sim import loop, rules, table
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.state import Controller, FaultArisen, PathChecked, StopReceived
from cutgate.protocol import link, records
from cutgate.protocol import path as path_module
from cutgate.protocol.e2e import protect
from cutgate.protocol.frames import DATA_IDS, Frame, Joint4, Joints01, Joints23
from cutgate.protocol.link import Link, Violation
from cutgate.protocol.path import HEADER_BYTES, POSE_BYTES
from cutgate.protocol.records import Limits
from cutgate.protocol.states import WITHDRAWING, ControllerState, Refusal, StopCause
from cutgate.runtime.conform import sample
from cutgate.runtime.conform.suite import CaseVerdict
from cutgate.runtime.conform.table import cases
from tests.protocol.plain_coding import Bits, component
from tests.runtime.conform.rig import Rig, by_name, failing

SLOW = (
    "permit: after the nonce's lifetime",
    "permit: expires",
    "start: after the nonce's lifetime",
    "cyclic frames",
)
"""Cases that wait for long; guards that have nothing to do with them are judged without."""


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    made = Rig(tmp_path)
    yield made
    made.close()


ON_THE_LINK = ("opens", "heartbeats", "stop", "record", "second", "latched")
"""What the cases about single frames begin with."""


def test_the_simulated_controller_passes_every_case_and_is_left_inhibited(rig: Rig) -> None:
    outcome = rig.run()
    assert failing(outcome) == {}
    assert outcome.passed
    assert outcome.state is ControllerState.INHIBITED
    assert not outcome.needs_reset
    assert len(outcome.results) == len(cases())


# ---------------------------------------------------------------- guards taken out of the controller


def without(*refusals: Refusal) -> Callable[[Any], tuple[Any, ...]]:
    return lambda table_of_rules: tuple(rule for rule in table_of_rules if rule[0] not in refusals)


def test_every_rule_on_permits_that_a_test_takes_out_is_there() -> None:
    assert {refusal for refusal, _ in PERMIT_GUARDS} <= {refusal for refusal, _ in rules.PERMIT_RULES}
    assert {refusal for refusal, _ in START_GUARDS} <= {refusal for refusal, _ in rules.START_RULES}


PERMIT_GUARDS = (
    (Refusal.MAC_INVALID, {"permit: wrong code"}),
    (Refusal.WRONG_SESSION, {"permit: wrong session digest"}),
    (Refusal.WRONG_SERIAL, {"permit: wrong serial number"}),
    (Refusal.ANNOUNCE_NONCE, {"permit: wrong announce nonce"}),
    (Refusal.PROTOCOL_VERSION, {"permit: other protocol version"}),
    (Refusal.EPOCH, {"permit: wrong epoch"}),
    (Refusal.NONCE_MISMATCH, {"permit: old nonce"}),
    (Refusal.LIMITS_DIGEST, {"permit: wrong limits digest"}),
    (Refusal.CALIBRATION_DIGEST, {"permit: wrong calibration digest"}),
    (Refusal.TOOL_DIGEST, {"permit: wrong tool digest"}),
    (Refusal.PATH_DIGEST, {"permit: wrong path digest"}),
    (Refusal.REGISTRATION_DIGEST, {"permit: wrong registration digest"}),
    (Refusal.CONFIGURATION_DIGEST, {"permit: wrong configuration digest"}),
    (Refusal.VERIFIER, {"permit: other verifier"}),
    (Refusal.TIMING_OUT_OF_BOUNDS, {"permit: other lifetime"}),
    (Refusal.BRANCH, {"permit: other branch"}),
    (Refusal.APPROACH, {"permit: other entry", "permit: other exit", "permit: other entry joints"}),
    (Refusal.APPROACH_SPEED, {"permit: other approach speed"}),
    (Refusal.START_JOINTS, {"permit: start joints elsewhere"}),
    (Refusal.REGISTRATION_WITHDRAWN, {"withdraw: place"}),
    (Refusal.REGISTRATION_TOO_EARLY, {"withdraw: barrier"}),
    (Refusal.WITHDRAWAL_DUE, {"withdraw: cause in the heartbeat"}),
)
START_GUARDS = (
    (Refusal.LOG_NOT_CONTINUED, {"start: other log", "start: log not gone on"}),
    (Refusal.MAC_INVALID, {"start: wrong code"}),
    (Refusal.WRONG_SESSION, {"start: wrong session"}),
    (Refusal.EPOCH, {"start: wrong epoch"}),
    (Refusal.NONCE_MISMATCH, {"start: wrong nonce"}),
    (Refusal.PERMIT_MISMATCH, {"start: other permit"}),
    (Refusal.START_JOINTS, {"start: start joints elsewhere"}),
)


def judged(rig: Rig, begin: str, *more: str) -> set[str]:
    """Names of the cases about one kind of request that fail."""
    names = [c.name for c in rig.cases() if c.name not in SLOW and c.name.startswith((begin, *more))]
    return set(failing(rig.run(*names)))


@pytest.mark.parametrize(("guard", "fails"), PERMIT_GUARDS, ids=lambda value: getattr(value, "name", ""))
def test_a_controller_without_one_rule_on_permits_fails_exactly_its_cases(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, guard: Refusal, fails: set[str]
) -> None:
    monkeypatch.setattr(table, "PERMIT_RULES", without(guard)(rules.PERMIT_RULES))
    assert judged(rig, "permit", "withdraw: ") == fails


def test_a_controller_whose_joints_count_for_themselves_fails_the_cyclic_frames(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The age of a sample is told by the heartbeat of its counter."""
    honest = Link.encode

    def ahead(of: Link, frame: Frame, now_s: float) -> tuple[int, bytes]:
        can_id, data = honest(of, frame, now_s)
        if isinstance(frame, Joints01 | Joints23 | Joint4):
            return can_id, protect(data[3:], (data[2] + 7) % 256, DATA_IDS[can_id], of.tag)
        return can_id, data

    monkeypatch.setattr(Link, "encode", ahead)
    assert "no fresh heartbeat and joints" in failing(rig.run("cyclic frames"))["cyclic frames"]


@pytest.mark.parametrize(("guard", "fails"), START_GUARDS, ids=lambda value: getattr(value, "name", ""))
def test_a_controller_without_one_rule_on_starts_fails_exactly_its_cases(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, guard: Refusal, fails: set[str]
) -> None:
    monkeypatch.setattr(table, "START_RULES", without(guard)(rules.START_RULES))
    assert judged(rig, "start") == fails


@pytest.mark.parametrize("guard", [Refusal.UNACKNOWLEDGED_STOP, Refusal.WRONG_CAUSE], ids=lambda r: r.name)
def test_a_controller_without_one_rule_on_resets_fails_the_case_of_the_latch(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, guard: Refusal
) -> None:
    monkeypatch.setattr(table, "RESET_RULES", without(guard)(rules.RESET_RULES))
    assert judged(rig, "latched") == {"latched fault: acknowledge, then reset"}


@pytest.mark.parametrize(
    ("guard", "fails"),
    [
        (Refusal.MAC_INVALID, "open: wrong code"),
        (Refusal.IDENTITY_DIGEST, "open: other controller"),
        (Refusal.SESSION_IN_USE, "open: during a session"),
        (Refusal.TIMING_OUT_OF_BOUNDS, "open: timing out of bounds"),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_controller_without_one_rule_on_open_fails_exactly_that_case(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, guard: Refusal, fails: str
) -> None:
    monkeypatch.setattr(table, "OPEN_RULES", without(guard)(rules.OPEN_RULES))
    assert judged(rig, "open:") == {fails}


@pytest.mark.parametrize(
    ("guard", "fails"),
    [
        (Refusal.POSE_OUTSIDE_LIMITS, "path: pose outside the limits"),
        (Refusal.WRONG_ELBOW, "path: wrong elbow"),
        (Refusal.TOOL_LENGTH, "path: other tool"),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_controller_without_one_check_of_paths_fails_exactly_that_case(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, guard: Refusal, fails: str
) -> None:
    step = loop.step

    def lax(state: Any, event: Any, now_s: float) -> Any:
        if isinstance(event, PathChecked) and event.refusal is guard:
            event = replace(event, refusal=Refusal.ACCEPTED)
        return step(state, event, now_s)

    monkeypatch.setattr(loop, "step", lax)
    assert judged(rig, "path", "permit: right") == {fails}


def lax_decoder(data: bytes, count: int, *, looks_behind: bool) -> np.ndarray:
    """Takes any order and parameter that gives the poses."""
    bits = Bits(data)
    try:
        poses = np.array([component(bits, count) for _ in range(5)], dtype=np.int32).T
    except EOFError:
        raise records.RecordError("too short") from None
    if looks_behind and len(data) > -(-bits.at // 8):
        raise records.RecordError("too long")
    return poses


@pytest.mark.parametrize(
    ("looks_behind", "fails"),
    [
        (True, {"path: more bits than needed", "path: higher order than needed"}),
        (
            False,
            {
                "path: more bits than needed",
                "path: higher order than needed",
                "path: a byte behind the coding",
            },
        ),
    ],
)
def test_a_controller_that_takes_poses_in_other_forms_fails_exactly_those_cases(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, looks_behind: bool, fails: set[str]
) -> None:
    monkeypatch.setattr(path_module, "decode", partial(lax_decoder, looks_behind=looks_behind))
    assert judged(rig, "path") == fails


def test_a_controller_that_does_not_look_at_the_crc_of_its_poses_fails_that_case(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lax(block: records.PathBlock) -> bytes:
        poses = path_module.decode(block.data[HEADER_BYTES:], (block.total - HEADER_BYTES) // POSE_BYTES)
        return block.data[:HEADER_BYTES] + poses.tobytes()

    monkeypatch.setattr(records.PathBlock, "decoded", lax)
    assert judged(rig, "path: corrupted") == {"path: corrupted block"}


@pytest.mark.parametrize(
    ("ignored", "fails"),
    [
        (StopCause.CORRUPTION, {"heartbeats: three corrupted", "heartbeats: other session tag"}),
        (StopCause.SEQUENCE_ERROR, {"heartbeats: three lost", "heartbeats: counter used twice"}),
        (StopCause.SECOND_NODE, {"second node", "latched fault: acknowledge, then reset"}),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_controller_that_ignores_what_its_link_finds_fails_exactly_its_cases(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, ignored: StopCause, fails: set[str]
) -> None:
    judge = rig.process._item

    def lax(item: object) -> None:
        if not (isinstance(item, Violation) and item.cause is ignored):
            judge(item)

    monkeypatch.setattr(rig.process, "_item", lax)
    assert judged(rig, *ON_THE_LINK) == fails


def test_a_controller_that_takes_stale_heartbeats_for_fresh_fails_exactly_the_cases_about_age(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge = Link._refresh

    def lax(of: Link, echo: int, now_s: float) -> bool:
        if of is not rig.process.port.endpoint.link:
            return judge(of, echo, now_s)
        of._heard, of._refreshed_s = True, now_s
        of._sent_s.setdefault(echo, now_s)
        return True

    monkeypatch.setattr(Link, "_refresh", lax)
    assert judged(rig, *ON_THE_LINK) == {"heartbeats: a stale burst", "heartbeats: one held back"}


def test_a_controller_whose_permit_never_expires_fails_exactly_that_case(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table, "permit_ages", lambda state, _event, _now_s: (state, ()))
    for key, handler in list(table.TABLE.items()):
        if handler.__name__ == "permit_ages":
            monkeypatch.setitem(table.TABLE, key, lambda state, _event, _now_s: (state, ()))
    assert set(failing(rig.run(*SLOW))) == {"permit: expires"}


@pytest.mark.parametrize(
    ("guarded", "fails"),
    [
        ("PERMIT_RULES", "permit: after the nonce's lifetime"),
        ("START_RULES", "start: after the nonce's lifetime"),
    ],
)
def test_a_controller_whose_nonces_live_for_ever_fails_exactly_that_case(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, guarded: str, fails: str
) -> None:
    monkeypatch.setattr(table, guarded, without(Refusal.NONCE_EXPIRED)(getattr(rules, guarded)))
    assert set(failing(rig.run(*SLOW))) == {fails}


def test_a_controller_that_waits_twice_the_time_out_fails_exactly_the_cases_that_measure_it(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint = rig.process.port.endpoint
    agree = endpoint.use_timing

    def lax(*, heartbeat_s: float, timeout_s: float) -> None:
        agree(heartbeat_s=heartbeat_s, timeout_s=2 * timeout_s)

    monkeypatch.setattr(endpoint, "use_timing", lax)
    assert judged(rig, *ON_THE_LINK) == {
        "heartbeats: silence in OPEN",
        "heartbeats: silence in PERMITTED",
        "heartbeats: a stale burst",
        "heartbeats: one held back",
        "heartbeats: no session tag",
    }


def test_a_controller_whose_epoch_stands_still_fails_exactly_the_cases_that_look_at_it(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    void = table._void
    monkeypatch.setattr(table, "_void", lambda state: replace(void(state), epoch=state.epoch))
    assert judged(rig, *ON_THE_LINK) == {
        "heartbeats: silence in OPEN",
        "heartbeats: silence in PERMITTED",
        "heartbeats: a stale burst",
        "stop frame",
    }


def test_cutting_mode_outside_permitted_fails_the_case_that_watches_the_whole_suite(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    on = (ControllerState.OPEN, ControllerState.PERMITTED)
    monkeypatch.setattr(Controller, "cutting_mode", property(lambda c: c.state in on))
    assert failing(rig.run("opens", "permit: right", "nothing moved")).keys() == {"nothing moved"}


# ---------------------------------------------------------------- when the suite must not go on


def test_an_arm_that_moves_is_stopped_at_once_and_the_suite_says_no_more(rig: Rig) -> None:
    assert rig.run("opens").passed
    q0, *rest = rig.process.arm.state.joints
    rig.process.arm.state = replace(rig.process.arm.state, joints=(q0 + 0.002, *rest))
    found = by_name(rig.run("opens", "permit: right", "nothing moved"))
    assert found["opens"].verdict is CaseVerdict.FAIL
    assert "moved" in found["opens"].came
    assert found["permit: right"].verdict is CaseVerdict.NOT_RUN
    assert found["nothing moved"].verdict is CaseVerdict.FAIL
    assert rig.process.controller.state is ControllerState.INHIBITED


def test_motion_without_the_enabling_device_is_stopped_at_once_and_the_suite_says_no_more(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    lax = without(Refusal.DEVICE_NOT_RELEASED_AND_PRESSED)(rules.START_RULES)
    monkeypatch.setattr(table, "START_RULES", lax)
    found = by_name(rig.run("start: enabling device released", "start: wrong nonce", "nothing moved"))
    assert found["start: enabling device released"].verdict is CaseVerdict.FAIL
    assert found["start: wrong nonce"].verdict is CaseVerdict.NOT_RUN
    assert found["nothing moved"].verdict is CaseVerdict.FAIL
    assert rig.process.controller.state is ControllerState.INHIBITED


def test_a_pressed_enabling_device_halts_the_suite_without_blaming_the_controller(rig: Rig) -> None:
    rig.process.act(ConsoleCommand.HOLD)
    outcome = rig.run("opens", "permit: right", "nothing moved")
    found = by_name(outcome)
    assert found["opens"].verdict is CaseVerdict.NOT_RUN
    assert "pressed" in found["opens"].came
    assert found["permit: right"].verdict is CaseVerdict.NOT_RUN
    assert not outcome.passed


def test_a_controller_with_another_key_opens_nothing_and_is_left_as_it_was(tmp_path: Path) -> None:
    rig = Rig(tmp_path, key=bytes(32))
    try:
        outcome = rig.run("permit: right", "nothing moved")
    finally:
        rig.close()
    assert failing(outcome)["permit: right"] == "a right OPEN was answered with Reply MAC_INVALID"
    assert outcome.state is ControllerState.INHIBITED
    assert not outcome.needs_reset


def test_a_controller_that_opens_for_a_used_announce_nonce_fails_exactly_the_cases_that_name_one(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table, "OPEN_RULES", without(Refusal.ANNOUNCE_NONCE)(rules.OPEN_RULES))
    assert judged(rig, "open:") == {"open: other announce nonce", "open: said again"}


def test_a_controller_that_believes_any_tag_fails_exactly_the_cases_about_tags(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "_fits", lambda _made, _sent: True)
    assert judged(rig, "heartbeats: ") == {
        "heartbeats: CUT without the key",
        "heartbeats: guessed tag",
        "heartbeats: a round before",
    }


def test_a_controller_whose_stop_frames_withdraw_fails_exactly_that_case(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped = table.EVERYWHERE[StopReceived]

    def withdraws(state: Any, event: Any, now_s: float) -> Any:
        after, effects = stopped(state, event, now_s)
        if event.cause in WITHDRAWING and state.session is not None:
            places = after.memory.withdrawn | {state.session.place}
            after = replace(after, memory=replace(after.memory, withdrawn=places))
        return after, effects

    monkeypatch.setitem(table.EVERYWHERE, StopReceived, withdraws)
    assert judged(rig, "withdraw: ") == {"withdraw: claimed by a stop"}


def test_a_controller_that_falls_silent_is_not_waited_for_without_end(rig: Rig) -> None:
    rig.controller_runs = False
    outcome = rig.run()
    assert not outcome.passed
    assert outcome.needs_reset
    assert all(r.verdict is not CaseVerdict.PASS for r in outcome.results)


def test_a_latched_fault_found_at_the_beginning_is_reset(rig: Rig) -> None:
    rig.process._feed(FaultArisen(StopCause.SECOND_NODE))
    found = by_name(rig.run("announces", "opens"))
    assert found["announces"].verdict is CaseVerdict.FAIL
    assert found["opens"].verdict is CaseVerdict.PASS


def test_every_case_has_a_name_of_its_own_and_a_requirement() -> None:
    all_cases = cases()
    assert len({case.name for case in all_cases}) == len(all_cases)
    assert all(case.requirement and case.sent and case.expected for case in all_cases)
    latching = [case.latches for case in all_cases[:-1]]
    assert latching == sorted(latching), "what latches comes last"


def test_the_sample_path_of_joints_without_limits_lies_where_they_may_go() -> None:
    limits = Limits.quantised(
        q_min_deg=(-39, 0, 0, -36_000, 0),
        q_max_deg=(36_000, 180, 1, -139, 180),
        speed_deg_s=(57, 57, 200, 114, 114),
    )
    middle = sample._middle(limits)
    assert np.degrees(middle[[0, 3]]) == pytest.approx([1111, -1200])
    assert middle[2] == 0.5
