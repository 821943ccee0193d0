"""The cases in a table: what is said to the controller, what must come, and where docs/protocol.md says so.

Those that latch a fault come last; the suite acknowledges and resets after each of them.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from cutgate.protocol import records
from cutgate.protocol.records import Permit, Start
from cutgate.protocol.states import EPOCHS, Refusal
from cutgate.runtime.conform import cases as c
from cutgate.runtime.conform import codings
from cutgate.runtime.conform.bench import PERMIT_RECORDS, Bench
from cutgate.runtime.conform.cases import Case
from cutgate.runtime.conform.sample import LONG, other_elbow, other_tool, outside_limits

NOTHING_MOVED: Final = Case(
    "nothing moved",
    "Promised, and not",
    "the whole suite, the enabling device released",
    "joints stay within 0.05 deg or mm; no CUTTING, no Progress; cutting mode off except in PERMITTED",
    c.nothing_moved,
)
"""Judged after all others."""

ALWAYS_WRONG: Final = bytes(32)


def _turned(digest: str) -> Callable[[Bench, Permit], Permit]:
    """One digest of the permit with a bit turned."""

    def change(_bench: Bench, permit: Permit) -> Permit:
        value = getattr(permit, digest)
        return replace(permit, **{digest: bytes([value[0] ^ 1]) + value[1:]})

    return change


def _approach(**changes: int) -> Callable[[Bench, Permit], Permit]:
    """The permit with its approach changed by so much."""

    def change(_bench: Bench, permit: Permit) -> Permit:
        bound = permit.approach
        moved = {name: getattr(bound, name) + by for name, by in changes.items()}
        return replace(permit, approach=replace(bound, **moved))

    return change


def _other_speed(_bench: Bench, permit: Permit) -> Permit:
    bound = permit.approach
    return replace(permit, approach=replace(bound, speed_percent=bound.speed_percent % 100 + 1))


def _other_entry_joints(_bench: Bench, permit: Permit) -> Permit:
    q0, *rest = permit.approach.entry_joints_u
    moved = (q0 + records.UNIT, *rest)
    return replace(permit, approach=replace(permit.approach, entry_joints_u=moved))


def _other_branch(_bench: Bench, permit: Permit) -> Permit:
    return replace(permit, branch=replace(permit.branch, q0_turns=permit.branch.q0_turns + 1))


def _opening() -> tuple[Case, ...]:
    page = "Conversation 1, 2"
    return (
        Case("announces", page, "nothing", f"Announce with version {records.PROTOCOL_VERSION}, serial, one announce nonce, INHIBITED, repeated", c.announces),
        Case("opens", page, "a right OPEN", "Opened with a right code, in OPEN; fresh heartbeats and joints; then another announce nonce", c.opens),
        Case("open: other protocol version", page, "OPEN with the next version", "Reply PROTOCOL_VERSION", c.open_refused(Refusal.PROTOCOL_VERSION, protocol_version=records.PROTOCOL_VERSION + 1)),
        Case("open: other announce nonce", page, "OPEN with an announce nonce of zeros", "Reply ANNOUNCE_NONCE", c.open_refused(Refusal.ANNOUNCE_NONCE, announce_nonce=bytes(16))),
        Case("open: said again", page, "the bytes that opened the session before", "Reply ANNOUNCE_NONCE", c.open_again),
        Case("open: wrong code", "Authentication", "one bit of the code turned, then a right OPEN", "Reply MAC_INVALID, nothing changed; then Opened", c.open_with_a_wrong_code),
        Case("open: other controller", page, "OPEN that names another identity digest", "Reply IDENTITY_DIGEST", c.open_refused(Refusal.IDENTITY_DIGEST, identity_digest=ALWAYS_WRONG)),
        Case("open: during a session", page, "a right OPEN in an open session", "Reply SESSION_IN_USE; the session goes on", c.open_during_session),
        Case("open: timing out of bounds", "Records, timing; constants.md", "OPEN once for each bound, just beyond it", "Reply TIMING_OUT_OF_BOUNDS", c.timing_out_of_bounds),
    )  # fmt: skip


def _frames() -> tuple[Case, ...]:
    page = "Single frames"
    return (
        Case("cyclic frames", page, "heartbeats, for 50 periods", "heartbeat and joints each period within 20 %, counters up by one, one counter a cycle", c.cyclic),
        Case("heartbeats: silence in OPEN", f"{page}, Age", "nothing", "HEARTBEAT_LOST within time-out and 2 periods; new epoch", c.silence(permitted=False)),
        Case("heartbeats: silence in PERMITTED", f"{page}, Age", "a right permit, then nothing", "HEARTBEAT_LOST within time-out and 2 periods; new epoch", c.silence(permitted=True)),
        Case("heartbeats: a stale burst", f"{page}, Age", f"{c.STALE_BURST} at once and more after, counters right, echo older than the time-out", "HEARTBEAT_LOST as if nothing had come", c.stale_heartbeats),
        Case("heartbeats: one held back", f"{page}, Age", "one, 0.7 of the time-out after it was made, then nothing", "HEARTBEAT_LOST as if it had come at once", c.held_back),
        Case("heartbeats: two corrupted", f"{page}, Corruption", "2 with a bit turned", "discarded, the session goes on", c.two_corrupted),
        Case("heartbeats: three corrupted", f"{page}, Corruption", "3 with a bit turned within a second", "CORRUPTION", c.three_corrupted),
        Case("heartbeats: other session tag", f"{page}, Corruption", "3 under another tag", "CORRUPTION", c.other_session_heartbeats),
        Case("heartbeats: no session tag", f"{page}, Corruption", "one each period under tag 0, none of the session's", "discarded: HEARTBEAT_LOST", c.outside_session_heartbeats),
        Case("heartbeats: repeated", f"{page}, Counter", "the same one three times", "discarded, the session goes on", c.repeated),
        Case("heartbeats: two lost", f"{page}, Counter", "counter up by 3", "accepted, the session goes on", c.two_lost),
        Case("heartbeats: three lost", f"{page}, Counter", "counter up by 4", "SEQUENCE_ERROR", c.three_lost),
        Case("heartbeats: counter used twice", f"{page}, Counter", "the last counter with other content", "SEQUENCE_ERROR", c.counter_reused),
        Case("stop frame", f"{page}, Stop", "a right permit, then STOP", "stop within 2 periods, cutting mode off, epoch up by one", c.stop_frame),
        Case("stop frame: malformed", f"{page}, Stop", "eight zero bytes on 0x011 in PERMITTED", "CORRUPTION within 2 periods", c.malformed_stop),
        Case("stop cause in the heartbeat", "Conversation", "a heartbeat with OPERATOR_STOP in PERMITTED, no stop frame", "OPERATOR_STOP within 2 periods", c.cause_in_heartbeat),
        Case("record of another session", "Transfers", "NonceRequest under another tag", "no nonce; the session goes on", c.other_session_record),
    )  # fmt: skip


def _paths(approved: tuple[bytes, bytes, bytes] | None) -> tuple[Case, ...]:
    page, blocks = "Records; Counts", "Transfers; The path"
    return (
        Case("reports itself", page, "Collect", "Limits, Calibration, Tool in canonical form, physically possible", c.reports),
        Case("reports the same twice", page, "Collect, twice", "equal digests", c.reports_the_same),
        Case("reports what is approved", page, "Collect", "the digests of robot.toml", c.reports_what_is_approved(approved), approved=True),
        Case("path: stored", "Conversation 4, 5", f"{LONG} poses in two blocks, inside the limits", "PathStored with the digest of what was sent; LOADED", c.stores),
        Case("path: pose outside the limits", "Promised, and not", "last pose 20 mm above the slide's limit", "PathStored POSE_OUTSIDE_LIMITS, pose 2", c.path_refused(Refusal.POSE_OUTSIDE_LIMITS, lambda b: (outside_limits(b.sample(), b.arm), 2))),
        Case("path: wrong elbow", "Promised, and not", "the same poses for the other elbow", "PathStored WRONG_ELBOW", c.path_refused(Refusal.WRONG_ELBOW, lambda b: (other_elbow(b.sample()), 0))),
        Case("path: other tool", "The path", "made for a tool 1 mm longer", "PathStored TOOL_LENGTH", c.path_refused(Refusal.TOOL_LENGTH, lambda b: (other_tool(b.sample()), 0))),
        Case("path: corrupted record", blocks, "a block with a bit turned", "never stored", c.corrupted_record),
        Case("path: corrupted block", blocks, "a sound record whose poses are not those of the block's CRC-32", "never stored", c.block_not_stored(codings.corrupted)),
        *(
            Case(f"path: {name}", "Coded poses", sent, "never stored", c.coded(coder))
            for name, sent, coder in (
                ("coding cut short", "the coded poses without their last byte", codings.cut_short),
                ("a byte behind the coding", "the coded poses and a byte of zeros", codings.a_byte_behind),
                ("a pose too many", "coded poses, one more than the block's place has", codings.a_pose_more),
                ("a pose too few", "coded poses, one less than the block's place has", codings.a_pose_less),
                ("more bits than needed", "every difference in 32 bits", codings.in_32_bits),
                ("higher order than needed", "what does not change as differences of order 2", codings.of_a_higher_order),
                ("prefix without an end", "zeros where a prefix must end", codings.endless_prefix),
            )
        ),
        Case("path: second block first", blocks, "block 1 without block 0", "never stored", c.second_block_first),
    )  # fmt: skip


def _permits() -> tuple[Case, ...]:
    page = "Conversation 6, 7; Authentication"

    def changed(
        name: str, sent: str, refusal: Refusal, change: Callable[[Bench, Permit], Permit], on: str = page
    ) -> Case:
        return Case(f"permit: {name}", on, sent, f"Reply {refusal.name}", c.permit_refused(refusal, change))

    digests = tuple(
        changed(f"wrong {name} digest", "one bit of it turned", refusal, _turned(f"{name}_digest"))
        for name, refusal in (
            ("session", Refusal.WRONG_SESSION),
            ("limits", Refusal.LIMITS_DIGEST),
            ("calibration", Refusal.CALIBRATION_DIGEST),
            ("tool", Refusal.TOOL_DIGEST),
            ("path", Refusal.PATH_DIGEST),
            ("registration", Refusal.REGISTRATION_DIGEST),
            ("configuration", Refusal.CONFIGURATION_DIGEST),
        )
    )
    ends = "Approach and retract"
    return (
        Case("permit: right", page, "a right permit", "Reply ACCEPTED, PERMITTED; nothing moves", c.permit_accepted),
        Case("permit: without a nonce", page, "a permit before any NonceRequest", "Reply NO_NONCE", c.without_nonce),
        Case("permit: old nonce", page, "the nonce before the last", "Reply NONCE_MISMATCH", c.old_nonce),
        Case("permit: nonce of a start", page, "a nonce asked for START", "Reply NO_NONCE", c.nonce_of_another_purpose),
        Case("permit: nonce used twice", page, "the accepted permit again", "Reply NOT_IN_STATE or NO_NONCE", c.nonce_consumed),
        *digests,
        changed("wrong serial number", "another serial number", Refusal.WRONG_SERIAL, c.with_fields(serial="NOT-THIS-ONE")),
        changed("other verifier", "another verifier than OPEN's", Refusal.VERIFIER, c.with_fields(verifier_version="another")),
        changed("wrong announce nonce", "an announce nonce of zeros", Refusal.ANNOUNCE_NONCE, c.with_fields(announce_nonce=bytes(16))),
        changed("other protocol version", "the next version", Refusal.PROTOCOL_VERSION, c.with_fields(protocol_version=records.PROTOCOL_VERSION + 1)),
        changed("wrong epoch", "the next epoch", Refusal.EPOCH, lambda b, p: replace(p, epoch=(b.epoch + 1) % EPOCHS)),
        changed("other lifetime", "a lifetime 1 s longer than OPEN's", Refusal.TIMING_OUT_OF_BOUNDS, lambda _b, p: replace(p, lifetime_s=p.lifetime_s + 1)),
        changed("other branch", "one turn more of q0", Refusal.BRANCH, _other_branch, ends),
        changed("other entry", "entry 10 um further", Refusal.APPROACH, _approach(entry_um=10), ends),
        changed("other exit", "exit 10 um further", Refusal.APPROACH, _approach(exit_um=10), ends),
        changed("other entry joints", "q0 at entry 1 deg off", Refusal.APPROACH, _other_entry_joints, ends),
        changed("other approach speed", "another percentage than OPEN's", Refusal.APPROACH_SPEED, _other_speed, ends),
        changed("start joints elsewhere", "q3 5 deg off", Refusal.START_JOINTS, c.elsewhere, ends),
        Case("permit: overtaken by a stop", "Conversation", "STOP and the permit in one cycle", "stopped; the permit is dead on arrival", c.overtaken_by_stop),
        Case("permit: after a stop", "Conversation", "STOP, then a permit made before it", "Reply VOIDED_BY_STOP, UNACKNOWLEDGED_STOP, NOT_IN_STATE, NO_NONCE or EPOCH", c.after_a_stop),
        Case("permit: after the nonce's lifetime", page, "a right permit after permit_lifetime_s", "Reply NONCE_EXPIRED", c.after_the_lifetime),
        Case("permit: expires", page, "a right permit, then no start for permit_lifetime_s", "PERMIT_EXPIRED, cutting mode off", c.permit_expires),
    )  # fmt: skip


def _starts() -> tuple[Case, ...]:
    page = "Conversation 8, 9"

    def changed(name: str, sent: str, refusal: Refusal, change: Callable[[Bench, Start], Start]) -> Case:
        return Case(f"start: {name}", page, sent, f"Reply {refusal.name}", c.start_refused(refusal, change))

    return (
        Case("start: without a permit", page, "START in LOADED", "Reply NO_PERMIT or NOT_IN_STATE", c.start_without_permit),
        changed("enabling device released", "a right START", Refusal.DEVICE_NOT_RELEASED_AND_PRESSED, c.with_fields()),
        changed("wrong nonce", "a nonce of zeros", Refusal.NONCE_MISMATCH, c.with_fields(nonce=bytes(16))),
        changed("wrong epoch", "the next epoch", Refusal.EPOCH, lambda b, s: replace(s, epoch=(b.epoch + 1) % EPOCHS)),
        changed("wrong session", "a session digest of zeros", Refusal.WRONG_SESSION, c.with_fields(session_digest=ALWAYS_WRONG)),
        changed("other permit", "a permit digest of zeros", Refusal.PERMIT_MISMATCH, c.with_fields(permit_digest=ALWAYS_WRONG)),
        changed("start joints elsewhere", "q3 5 deg off", Refusal.START_JOINTS, c.elsewhere),
        changed("other log", "the id of another log than the permit's", Refusal.LOG_NOT_CONTINUED, c.log_not_continued(log_id=bytes(16))),
        changed("log not gone on", "no more records than the permit's", Refusal.LOG_NOT_CONTINUED, c.log_not_continued(size=PERMIT_RECORDS)),
        Case("start: after the nonce's lifetime", page, "a right START after start_lifetime_ms", "Reply NONCE_EXPIRED", c.start_nonce_expired),
        Case("start: CUT without START", page, "heartbeats that say CUT in PERMITTED", "PERMITTED; nothing moves", c.cut_without_start),
    )  # fmt: skip


def _last() -> tuple[Case, ...]:
    page = "Authentication"
    return (
        Case("withdraw: claimed by a stop", "Withdrawal", "STOP with REGISTRATION_WITHDRAWN; in the next session a right permit", "PROTOCOL_VIOLATION; Reply ACCEPTED", c.claimed_withdrawal),
        Case("withdraw: place", "Withdrawal", "Withdraw with the session's place; a right permit then, and in the next session under another digest", "Reply REGISTRATION_WITHDRAWN to both", c.withdrawn),
        Case("withdraw: barrier", "Withdrawal", "Withdraw with the registration's time as barrier; a right permit; in the next session one for a later registration", "Reply REGISTRATION_TOO_EARLY, then ACCEPTED", c.too_early),
        Case("withdraw: cause in the heartbeat", "Withdrawal", "a heartbeat with BONE_MOVED; in the next session a right permit, then Withdraw", "Opened says that a withdrawal is due; Reply WITHDRAWAL_DUE, then ACCEPTED", c.withdrawn_by_heartbeat),
        Case("acknowledge: other epoch", "Conversation", "Acknowledge of the next epoch", "Reply EPOCH", c.acknowledge_of_another_epoch),
        Case("heartbeats: CUT without the key", page, "CUT for READY in a heartbeat in PERMITTED, its CRC made anew", "latched AUTHENTICATION_FAILED", c.unkeyed_heartbeat(c.saying_cut), latches=True),
        Case("heartbeats: guessed tag", page, "one bit of a heartbeat's tag turned, its CRC made anew", "latched AUTHENTICATION_FAILED", c.unkeyed_heartbeat(c.guessed), latches=True),
        Case("heartbeats: a round before", page, "a heartbeat again, 256 heartbeats later", "latched AUTHENTICATION_FAILED", c.heartbeat_of_a_round_before, latches=True),
        Case("acknowledge: wrong code", page, "one bit of the MAC turned", "Reply MAC_INVALID, latched AUTHENTICATION_FAILED", c.wrong_mac(c.right_acknowledge), latches=True),
        Case("withdraw: wrong code", page, "one bit of the MAC turned", "Reply MAC_INVALID, latched AUTHENTICATION_FAILED", c.wrong_mac(c.right_withdraw), latches=True),
        Case("permit: wrong code", page, "one bit of the MAC turned", "Reply MAC_INVALID, latched AUTHENTICATION_FAILED", c.wrong_mac(c.right_permit), latches=True),
        Case("start: wrong code", page, "one bit of the MAC turned", "Reply MAC_INVALID, latched AUTHENTICATION_FAILED", c.wrong_mac(c.right_start), latches=True),
        Case("second node", "Single frames, One of each", "a frame on the controller's own 0x081", "latched SECOND_NODE", c.second_node, latches=True),
        Case("latched fault: acknowledge, then reset", "Conversation", "a second node; Reset, Acknowledge, Reset for another cause, Reset", "UNACKNOWLEDGED_STOP, WRONG_CAUSE, then OPEN", c.held_in_fault, latches=True),
    )  # fmt: skip


def cases(approved: tuple[bytes, bytes, bytes] | None = None) -> tuple[Case, ...]:
    """All cases, in the order in which they are run.

    Args:
        approved: canonical limits, calibration and tool of the site's robot.toml, where it is given.
    """
    return (*_opening(), *_paths(approved), *_permits(), *_starts(), *_frames(), *_last(), NOTHING_MOVED)
