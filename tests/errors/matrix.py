"""The error matrix as data: one row per injection, with what must come of it. The tests and the page follow it.

Where a message has no row for an error within or beyond tolerance, ``NO_ROW`` says why.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

from cutgate.protocol import records as r
from cutgate.protocol.frames import (
    ControllerFault,
    ControllerHeartbeat,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
)
from cutgate.protocol.states import FaultCode, Purpose, StopCause, StopCode
from cutgate.runtime.interlock.state import Phase
from tests.errors import injections as do
from tests.errors.scene import SHORT, UNLISTED_ID, Message, Observed, Scene
from tests.runtime.session.pair import CYCLE_S, Pair


class Error(StrEnum):
    """The communication errors of IEC 61784-3."""

    CORRUPTION = "corruption"
    REPETITION = "unintended repetition"
    SEQUENCE = "incorrect sequence"
    LOSS = "loss"
    DELAY = "unacceptable delay"
    INSERTION = "insertion"
    MASQUERADE = "masquerade"
    ADDRESS = "wrong address"


HEARTBEAT_S, TIMEOUT_S, REPLY_S = 0.020, 0.100, 2.0
LATE_S = REPLY_S + 0.2
"""The defaults both loops run with."""
BOTH_WAYS_S = 2 * CYCLE_S
"""A frame to its receiver, and the receiver's stop back."""


@dataclass(frozen=True)
class Bound:
    """How soon after the injection neither side may enable anything."""

    why: str
    seconds: float


AT_ONCE = Bound("one cycle each way", BOTH_WAYS_S)
BY_LEVEL = Bound("the next heartbeat", HEARTBEAT_S + BOTH_WAYS_S)
BY_GAP = Bound("four heartbeats", 4 * HEARTBEAT_S + BOTH_WAYS_S)
BY_SILENCE = Bound("time-out and a heartbeat", TIMEOUT_S + HEARTBEAT_S + BOTH_WAYS_S)
BY_AGE = Bound("two time-outs and a heartbeat", 2 * TIMEOUT_S + HEARTBEAT_S + BOTH_WAYS_S)
BY_CARRIER = Bound("a transfer's frames", 6 * CYCLE_S + BOTH_WAYS_S)
BY_REPLY = Bound("reply time-out", REPLY_S + BOTH_WAYS_S)
BY_NEXT_REPLY = Bound("reply time-out, from the next request on", REPLY_S + 20 * CYCLE_S + BOTH_WAYS_S)
BY_UPLOAD = Bound(
    "upload time-out, from the upload on", SHORT["transfer_timeout_s"] + 10 * CYCLE_S + BOTH_WAYS_S
)
BY_ANNOUNCE = Bound("waiting time for a controller", SHORT["announce_wait_s"] + BOTH_WAYS_S)
BY_OPERATOR = Bound(
    "reply time-out, then the operator's waiting time", REPLY_S + SHORT["operator_wait_s"] + BOTH_WAYS_S
)

NONE = StopCause.NONE


@dataclass(frozen=True)
class End:
    """How a scene ends: "goes on", or phase and controller state, and the first-out cause of each side."""

    phase: str = "goes on"
    state: str = ""
    runtime: StopCause = NONE
    controller: StopCause = NONE

    def __str__(self) -> str:
        if self == GOES_ON:
            return "cutting goes on"
        causes = f"{self.runtime.name} on both sides"
        if self.runtime is not self.controller:
            causes = f"{self.runtime.name} (runtime), {self.controller.name} (controller)"
        return f"{self.phase}, {self.state}: {causes}"


GOES_ON = End()


def stops(cause: StopCause, controller: StopCause | None = None) -> End:
    return End("stopped", "INHIBITED", cause, cause if controller is None else controller)


def latches(cause: StopCause) -> End:
    return End("stopped", "FAULT", cause, cause)


def refused(controller: StopCause = NONE, state: str = "INHIBITED") -> End:
    return End("refused", state, StopCause.NOT_ADMITTED, controller)


FOUND: dict[str, str] = {
    "CRC-16": r"0x\w{3} corrupted",
    "CRC-16 of the stop": r"CORRUPTION",
    "CRC-32": r"record CRC-32 does not match",
    "counter": r"repeated|counter \d+ after a gap",
    "counter, counted": r"[12] lost",
    "record number": r"record \d+ (after \d+|repeated)",
    "transfer": r"channel: |TRANSFER_FAILED",
    "time-out": r"no fresh (controller )?heartbeat within|HEARTBEAT_LOST",
    "echo": r"stale",
    "deadline": r"within [\d.]+ s|did not arrive|no measured joints",
    "session tag": r"outside the session|record of session|corrupted",
    "own identifier": r"received on our own identifier",
    "tag": r"its tag is none",
    "authentication code": r"reply MAC_INVALID|AUTHENTICATION_FAILED",
    "nonce": r"reply N\w+",
    "state": r"reply \w+|dropped|LIMITS_CHANGED|not asked for|announced itself anew",
    "data ID": r"corrupted",
    "record's channel": r"does not belong on",
    "level in the heartbeat": r"",
    "nobody": r"",
    "tracking monitor": r"no measured joints|no progress|progress",
}
"""What detects an error, and what either side must have said for it."""


@dataclass(frozen=True)
class Row:
    """One injection and what must come of it."""

    message: Message
    error: Error
    tolerated: bool
    injected: str
    inject: Callable[[Scene], None]
    found_by: str
    end: End = GOES_ON
    bound: Bound | None = None
    stage: Callable[[Scene], object] = lambda scene: scene

    @property
    def name(self) -> str:
        return f"{self.error}-{self.message.name}-{'within' if self.tolerated else 'beyond'}-{self.injected}"


def observe(row: Row, pair: Pair) -> Observed:
    """Play the row."""
    scene = Scene(pair, row.message)
    row.stage(scene)
    row.inject(scene)
    return scene.observe()


# ---------------------------------------------------------------- messages

HEARTBEATS = tuple(Message(kind.__name__, kind) for kind in (RuntimeHeartbeat, ControllerHeartbeat))
JOINTS = tuple(Message(kind.__name__, kind) for kind in (Joints01, Joints23, Joint4))
PROGRESS = Message("Progress", Progress)
STATUS = (*JOINTS, PROGRESS)
CYCLIC = (*HEARTBEATS, *STATUS)
STOP, FAULT = Message("RuntimeStop", RuntimeStop), Message("ControllerFault", ControllerFault)

ANNOUNCE, OPEN, OPENED = (Message(k.__name__, k) for k in (r.Announce, r.Open, r.Opened))
COLLECT, LIMITS, CALIBRATION, TOOL = (
    Message(k.__name__, k) for k in (r.Collect, r.Limits, r.Calibration, r.Tool)
)
BLOCK, BLOCK_STORED, PATH_STORED = (
    Message(k.__name__, k) for k in (r.PathBlock, r.BlockStored, r.PathStored)
)
ASK_PERMIT, ASK_START = (
    Message(f"NonceRequest {p.name}", r.NonceRequest, lambda x, p=p: x.purpose is p)
    for p in (Purpose.PERMIT, Purpose.START)
)
NONCE_PERMIT, NONCE_START = (
    Message(f"Nonce {p.name}", r.Nonce, lambda x, p=p: x.purpose is p)
    for p in (Purpose.PERMIT, Purpose.START)
)
PERMIT, START, RESET = (Message(k.__name__, k) for k in (r.Permit, r.Start, r.Reset))
REPLY_PERMIT, REPLY_START = (
    Message(f"Reply to {k.__name__}", r.Reply, lambda x, k=k: x.request_type == k.TYPE)
    for k in (r.Permit, r.Start)
)
ACKNOWLEDGE, WITHDRAW = (Message(k.__name__, k) for k in (r.Acknowledge, r.Withdraw))

IN_SESSION = (
    OPENED, COLLECT, LIMITS, CALIBRATION, TOOL, BLOCK, BLOCK_STORED, PATH_STORED, ASK_PERMIT, NONCE_PERMIT, PERMIT,
    REPLY_PERMIT, ASK_START, NONCE_START, START, REPLY_START, ACKNOWLEDGE, RESET, WITHDRAW,
)  # fmt: skip
RECORDS = (ANNOUNCE, OPEN, *IN_SESSION)
MESSAGES = (*CYCLIC, STOP, FAULT, *RECORDS)


# ---------------------------------------------------------------- rows


def _cyclic() -> Iterator[Row]:
    """Frames that come with every heartbeat, while the arm cuts."""
    for message in CYCLIC:
        # a sound Progress that nobody sent is off reference trajectory before its successor's counter is wrong
        unlike = UNLIKE[message.kind]
        for row in (
            Row(message, Error.CORRUPTION, True, "one bit of two frames", do.corrupt_frames(2), "CRC-16"),
            Row(message, Error.CORRUPTION, False, "one bit of three frames within a second", do.corrupt_frames(3),
                "CRC-16", stops(StopCause.CORRUPTION), AT_ONCE),
            Row(message, Error.REPETITION, True, "a frame twice", do.repeat_frame, "counter"),
            Row(message, Error.SEQUENCE, False, "two frames change places", do.swap_frames, "counter",
                stops(StopCause.SEQUENCE_ERROR), AT_ONCE),
            Row(message, Error.LOSS, True, "two frames", do.lose_frames(2), "counter, counted"),
            Row(message, Error.LOSS, False, "three frames", do.lose_frames(3), "counter",
                stops(StopCause.SEQUENCE_ERROR), BY_GAP),
            Row(message, Error.DELAY, True, "every frame by half a heartbeat", do.delay_frames(HEARTBEAT_S / 2), "nobody"),
            Row(message, Error.INSERTION, True, "a frame from outside the session", do.insert_from_outside, "session tag"),
            Row(message, Error.INSERTION, False, "a sound frame under the next counter", do.insert_sound, *unlike),
            Row(message, Error.MASQUERADE, True, "two frames of another session", do.masquerade_frames(2), "session tag"),
            Row(message, Error.MASQUERADE, False, "three frames of another session", do.masquerade_frames(3),
                "session tag", stops(StopCause.CORRUPTION), AT_ONCE),
            Row(message, Error.MASQUERADE, False, "a sound frame of a second node", do.second_node_frame,
                "own identifier", SECOND_BEAT.get(message.kind, latches(StopCause.SECOND_NODE)), AT_ONCE),
        ):  # fmt: skip
            yield replace(row, stage=Scene.cutting)


UNTAGGED = ("tag", latches(StopCause.AUTHENTICATION_FAILED), BY_LEVEL)
UNLIKE = {
    RuntimeHeartbeat: UNTAGGED,
    ControllerHeartbeat: UNTAGGED,
    **dict.fromkeys((Joints01, Joints23), ("counter", latches(StopCause.SEQUENCE_ERROR), BY_LEVEL)),
    Joint4: UNTAGGED,
    Progress: ("tracking monitor", stops(StopCause.TRACKING_DEVIATION), AT_ONCE),
}
"""What finds a frame with a sound CRC that nobody sent; of joints its successor's counter, then the sample's tag latches."""
SECOND_BEAT = {
    RuntimeHeartbeat: End("stopped", "FAULT", StopCause.SECOND_NODE, StopCause.AUTHENTICATION_FAILED),
    ControllerHeartbeat: End("stopped", "FAULT", StopCause.AUTHENTICATION_FAILED, StopCause.SECOND_NODE),
}
"""Whose identifier it is finds a second node, the other side a wrong tag."""


def _heartbeats() -> Iterator[Row]:
    """What only heartbeats can show: silence and age."""
    for message in HEARTBEATS:
        for row in (
            Row(message, Error.REPETITION, False, "one frame again and again instead of the new ones", do.stick,
                "time-out", stops(StopCause.HEARTBEAT_LOST), BY_SILENCE),
            Row(message, Error.LOSS, False, "every frame", do.lose_frames(10_000), "time-out",
                stops(StopCause.HEARTBEAT_LOST), BY_SILENCE),
            Row(message, Error.DELAY, False, "each frame by a heartbeat more than the one before",
                do.delay_frames(0.0, growing_s=HEARTBEAT_S), "echo", stops(StopCause.HEARTBEAT_LOST), BY_AGE),
        ):  # fmt: skip
            yield replace(row, stage=Scene.cutting)


def _watched() -> Iterator[Row]:
    """While the arm cuts the runtime holds joints and progress against the reference trajectory, and misses them."""
    lost = stops(StopCause.TRACKING_DEVIATION)
    for message in STATUS:
        yield Row(message, Error.LOSS, False, "every frame while the arm cuts", do.lose_frames(10_000),
                  "tracking monitor", lost, BY_AGE, stage=Scene.cutting)  # fmt: skip


def _joints() -> Iterator[Row]:
    """Joints matter before the permit: without young, whole samples nothing is verified."""
    lost = stops(StopCause.TRANSFER_FAILED)
    for message in JOINTS:
        for row in (
            Row(message, Error.LOSS, False, "every frame since the opening", do.lose_frames(10_000), "deadline",
                lost, BY_UPLOAD),
            Row(message, Error.DELAY, False, "every frame since the opening by ten heartbeats",
                do.delay_frames(10 * HEARTBEAT_S), "deadline", lost, BY_UPLOAD),
        ):  # fmt: skip
            yield replace(row, stage=lambda scene: scene.to(Phase.OPENING))


def _misaddressed() -> Iterator[Row]:
    for message in CYCLIC:
        runtime = message.kind is RuntimeHeartbeat
        unlisted = do.misaddress_frames(2, UNLISTED_ID)
        within = Row(message, Error.ADDRESS, True, "two copies on the identifier of the frame beside it",
                     do.misaddress_frames(2), "data ID", stage=Scene.cutting)  # fmt: skip
        if runtime:
            within = replace(
                within,
                injected="two copies on an identifier that is not listed",
                inject=unlisted,
                found_by="nobody",
            )
        yield within
        yield Row(message, Error.ADDRESS, False,
                  "a copy on the stop's identifier" if runtime else "three copies on the identifier of the frame beside it",
                  do.misaddress_frames(1 if runtime else 3), "CRC-16 of the stop" if runtime else "data ID",
                  stops(StopCause.CORRUPTION), AT_ONCE, Scene.cutting)  # fmt: skip


def _stop() -> Iterator[Row]:
    """The stop frame only makes faster what the heartbeats say: nothing that happens to it prevents the stop."""
    level, found = stops(StopCause.OPERATOR_STOP), "level in the heartbeat"
    corrupted = stops(StopCause.OPERATOR_STOP, StopCause.CORRUPTION)
    quit_it = RuntimeStop(StopCode.STOP, StopCause.OPERATOR_QUIT)
    for row in (
        Row(STOP, Error.CORRUPTION, True, "one bit", do.once(do.corrupt_frames(1)), "CRC-16 of the stop", corrupted, AT_ONCE),
        Row(STOP, Error.REPETITION, True, "the frame twice", do.once(do.repeat_frame), found, level, AT_ONCE),
        Row(STOP, Error.SEQUENCE, True, "the next heartbeat overtakes it", do.once(do.delay_frames(1.5 * HEARTBEAT_S)), found, level, BY_LEVEL),
        Row(STOP, Error.LOSS, True, "the frame", do.once(do.lose_frames(1)), found, level, BY_LEVEL),
        Row(STOP, Error.LOSS, False, "the frame and every heartbeat behind it",
            do.once(do.lose_frames(1), do.silence_behind(RuntimeHeartbeat)), "time-out",
            stops(StopCause.OPERATOR_STOP, StopCause.HEARTBEAT_LOST), BY_SILENCE),
        Row(STOP, Error.DELAY, True, "by a time-out", do.once(do.delay_frames(TIMEOUT_S)), found, level, BY_LEVEL),
        Row(STOP, Error.INSERTION, False, "a sound frame that nobody sent", do.insert_frame(quit_it), found,
            stops(StopCause.OPERATOR_QUIT), AT_ONCE),
        Row(STOP, Error.MASQUERADE, False, "a frame of zeros, at the controller alone", do.put_zeros(everybody=False),
            "CRC-16 of the stop", stops(StopCause.CORRUPTION), AT_ONCE),
        Row(STOP, Error.MASQUERADE, False, "a frame of zeros of a second node", do.put_zeros(everybody=True),
            "own identifier", End("stopped", "FAULT", StopCause.SECOND_NODE, StopCause.CORRUPTION), AT_ONCE),
        Row(STOP, Error.ADDRESS, True, "on the heartbeat's identifier instead", do.once(do.divert_frame), "data ID", level, BY_LEVEL),
    ):  # fmt: skip
        yield replace(row, stage=Scene.cutting)


def _fault() -> Iterator[Row]:
    """The arm stands before the fault frame leaves; the frame only tells the runtime sooner."""
    level, found = stops(StopCause.EMERGENCY_STOP), "level in the heartbeat"
    moved = ControllerFault(FaultCode.STOPPED, StopCause.TRACKING_DEVIATION)
    for row in (
        Row(FAULT, Error.CORRUPTION, True, "one bit", do.once(do.corrupt_frames(1)), "CRC-16", level, BY_LEVEL),
        Row(FAULT, Error.REPETITION, True, "the frame twice", do.once(do.repeat_frame), "counter", level, AT_ONCE),
        Row(FAULT, Error.SEQUENCE, True, "the next heartbeat overtakes it", do.once(do.delay_frames(1.5 * HEARTBEAT_S)), found, level, BY_LEVEL),
        Row(FAULT, Error.LOSS, True, "the frame", do.once(do.lose_frames(1)), found, level, BY_LEVEL),
        Row(FAULT, Error.LOSS, False, "the frame and every heartbeat behind it",
            do.once(do.lose_frames(1), do.silence_behind(ControllerHeartbeat)), "time-out",
            stops(StopCause.HEARTBEAT_LOST, StopCause.EMERGENCY_STOP), BY_SILENCE),
        Row(FAULT, Error.DELAY, True, "by a time-out", do.once(do.delay_frames(TIMEOUT_S)), found, level, BY_LEVEL),
        Row(FAULT, Error.INSERTION, False, "a sound frame that nobody sent", do.insert_frame(moved), found,
            stops(StopCause.TRACKING_DEVIATION), AT_ONCE),
        Row(FAULT, Error.MASQUERADE, True, "two frames of another session", do.strange_frames(moved, 2), "session tag"),
        Row(FAULT, Error.MASQUERADE, False, "three frames of another session", do.strange_frames(moved, 3), "session tag",
            stops(StopCause.CORRUPTION), AT_ONCE),
        Row(FAULT, Error.MASQUERADE, False, "a frame of zeros of a second node", do.put_zeros(everybody=True),
            "own identifier", latches(StopCause.SECOND_NODE), AT_ONCE),
        Row(FAULT, Error.ADDRESS, True, "on the joints' identifier instead", do.once(do.divert_frame), "data ID", level, BY_LEVEL),
    ):  # fmt: skip
        yield replace(row, stage=Scene.cutting)


def _records() -> Iterator[Row]:
    """Every record of a session at its step of the conversation."""
    failed, violated = stops(StopCause.TRANSFER_FAILED), stops(StopCause.PROTOCOL_VIOLATION)
    for message in IN_SESSION:
        for row in (
            Row(message, Error.CORRUPTION, False, "one bit of a carrying frame", do.corrupt_record, "CRC-32", violated, BY_CARRIER),
            Row(message, Error.REPETITION, True, "the record twice", do.repeat_record, "record number"),
            Row(message, Error.SEQUENCE, True, "a record with an older number behind it", do.old_record, "record number"),
            Row(message, Error.SEQUENCE, False, "two carrying frames change places", do.swap_carriers, "transfer", failed, BY_CARRIER),
            Row(message, Error.LOSS, False, "one carrying frame", do.lose_carrier, "transfer", failed, BY_CARRIER),
            Row(message, Error.LOSS, False, "the whole record", do.lose_record, "deadline", failed, BY_REPLY),
            Row(message, Error.DELAY, True, "by a heartbeat", do.delay_record(HEARTBEAT_S), "nobody"),
            Row(message, Error.DELAY, False, "by more than the reply time-out", do.delay_record(LATE_S), "deadline", failed, BY_REPLY),
            Row(message, Error.INSERTION, True, "a copy of another session before it", do.record_of_another_session, "session tag"),
            Row(message, Error.INSERTION, True, "a sound copy, never sent, while the arm cuts", do.insert_while_cutting, "state"),
            Row(message, Error.MASQUERADE, False, "a second node sends it", do.second_node_record, "own identifier",
                latches(StopCause.SECOND_NODE), AT_ONCE),
            Row(message, Error.ADDRESS, True, "once more on an identifier that is not listed", do.misaddress_record, "nobody"),
            Row(message, Error.ADDRESS, False, "on the other channel", do.wrong_channel, "record's channel", violated, BY_CARRIER),
        ):  # fmt: skip
            yield _own_end(row)
    for message in (PERMIT, START, RESET, WITHDRAW):
        yield _own_end(Row(message, Error.MASQUERADE, False, "a code made without the key", do.unsigned,
                           "authentication code", latches(StopCause.AUTHENTICATION_FAILED), BY_CARRIER))  # fmt: skip
    again, masqueraded = (
        "the record again under a number of its own",
        latches(StopCause.AUTHENTICATION_FAILED),
    )
    for row in (
        Row(COLLECT, Error.REPETITION, False, again, do.say_twice, "state", stops(StopCause.LIMITS_CHANGED), BY_CARRIER),
        Row(TOOL, Error.REPETITION, False, again, do.say_twice, "state", stops(StopCause.CALIBRATION_CHANGED), BY_CARRIER),
        Row(ASK_PERMIT, Error.REPETITION, False, again, do.say_twice, "nonce", refused(), BY_CARRIER),
        Row(PERMIT, Error.REPETITION, False, again, do.say_twice, "authentication code", masqueraded, BY_CARRIER),
        Row(START, Error.REPETITION, False, again, do.say_twice, "authentication code", masqueraded, BY_CARRIER),
    ):  # fmt: skip
        yield row


def _own_end(row: Row) -> Row:
    """A record of a session, as its step demands: whoever is held stays latched and keeps its first cause."""
    row = replace(row, **EXCEPTIONS.get((row.message.name, row.injected), {}))  # type: ignore[arg-type]
    if row.message is WITHDRAW:
        return replace(row, stage=Scene.moved)
    if row.message not in (ACKNOWLEDGE, RESET):
        return row
    held = replace(row, stage=Scene.held)
    if row.end == GOES_ON or row.injected == COPY:
        return held
    return replace(held, end=replace(row.end, state="FAULT", controller=StopCause.SECOND_NODE))


_REOPENED = {"end": refused(StopCause.HEARTBEAT_LOST), "found_by": "deadline", "bound": BY_OPERATOR}
_INTERRUPTED = {"end": End("stopped", "FAULT", StopCause.TRANSFER_FAILED, StopCause.SECOND_NODE)}
_STUCK = {"found_by": "transfer"}
COPY, SECOND, LATE, WHOLE, ONE = (
    "a sound copy, never sent, while the arm cuts", "a second node sends it", "by more than the reply time-out",
    "the whole record", "one carrying frame",
)  # fmt: skip
EXCEPTIONS: dict[tuple[str, str], dict[str, object]] = {
    # the controller's session dies of silence, the next Opened names its cause, nobody acknowledges it
    ("Opened", "two carrying frames change places"): _REOPENED,
    ("Opened", ONE): _REOPENED,
    ("Opened", WHOLE): _REOPENED,
    ("Opened", LATE): _REOPENED | {"bound": BY_REPLY},
    ("Opened", SECOND): {"end": refused(StopCause.SECOND_NODE, "FAULT"), "bound": BY_OPERATOR},
    # what the controller sends unasked means that something has changed
    ("Limits", COPY): {"tolerated": False, "end": stops(StopCause.LIMITS_CHANGED), "bound": BY_CARRIER},
    **{
        (name, COPY): {"tolerated": False, "end": stops(StopCause.CALIBRATION_CHANGED), "bound": BY_CARRIER}
        for name in ("Calibration", "Tool")
    },
    # the strange first frame breaks off the record that is coming in: each side keeps what it found first
    **{
        (name, SECOND): _INTERRUPTED
        for name in ("Limits", "Calibration", "Tool", "BlockStored", "PathStored")
    },
    # its code is that of its own number
    **{
        (name, COPY): {
            "tolerated": False,
            "found_by": "authentication code",
            "end": latches(StopCause.AUTHENTICATION_FAILED),
            "bound": BY_CARRIER,
        }
        for name in ("Permit", "Start", "Acknowledge", "Reset", "Withdraw")
    },
    # that it was accepted is believed by the heartbeat alone
    **{
        (f"Reply to {name}", what): {"tolerated": True, "end": GOES_ON, "bound": None, "found_by": "nobody"}
        for name, what in (("Permit", WHOLE), ("Start", WHOLE), ("Start", LATE))
    },
    ("Reply to Permit", LATE): {"bound": BY_NEXT_REPLY, "found_by": "transfer"},
    ("PathBlock", WHOLE): {"bound": BY_UPLOAD},
    ("PathStored", WHOLE): {"bound": BY_UPLOAD},
    # nobody waits for the last block's receipt: PathStored follows it
    ("BlockStored", WHOLE): {"tolerated": True, "end": GOES_ON, "bound": None, "found_by": "nobody"},
    **{(name, LATE): _STUCK for name in ("PathBlock", "BlockStored", "PathStored", "Acknowledge")},
    # nobody waits for it; without it a permit is refused
    ("Withdraw", WHOLE): {"end": refused(), "found_by": "state", "bound": BY_REPLY},
    ("Withdraw", SECOND): {"end": End("stopped", "FAULT", StopCause.SECOND_NODE, StopCause.TRANSFER_FAILED)},
    # the operator says nothing again, and is waited for
    ("Acknowledge", WHOLE): {"end": refused(), "bound": BY_OPERATOR},
}
"""By message and injection: what is different from other records, and only that."""


def _openings() -> Iterator[Row]:
    """Announce and Open belong to no session: a lost one is followed by another."""
    unopened = {ANNOUNCE: BY_ANNOUNCE, OPEN: BY_REPLY}
    for message, bound in unopened.items():
        yield from (
            Row(message, Error.CORRUPTION, True, "one bit of a carrying frame", do.corrupt_record, "CRC-32"),
            Row(message, Error.CORRUPTION, False, "one bit in every one", do.corrupt_every_record, "CRC-32", refused(), bound),
            Row(message, Error.SEQUENCE, True, "two carrying frames change places", do.swap_carriers, "nobody"),
            Row(message, Error.LOSS, True, ONE, do.lose_carrier, "nobody"),
            Row(message, Error.LOSS, True, WHOLE, do.lose_record, "nobody"),
            Row(message, Error.LOSS, False, "every one", do.lose_every_record, "deadline", refused(), bound),
            Row(message, Error.DELAY, True, "by a heartbeat", do.delay_record(HEARTBEAT_S), "nobody"),
            Row(message, Error.ADDRESS, True, "once more on an identifier that is not listed", do.misaddress_record, "nobody"),
            Row(message, Error.ADDRESS, True, "on the other channel", do.wrong_channel, "record's channel"),
        )  # fmt: skip
    yield from (
        Row(ANNOUNCE, Error.REPETITION, True, "the record twice", do.repeat_record, "nobody"),
        Row(OPEN, Error.REPETITION, True, "the record twice", do.repeat_record, "record number"),
        Row(OPEN, Error.REPETITION, True, "the record again under a number of its own", do.say_twice, "state"),
        Row(ANNOUNCE, Error.DELAY, False, LATE, do.delay_record(LATE_S), "deadline", refused(), BY_ANNOUNCE),
        Row(OPEN, Error.DELAY, False, LATE, do.delay_record(LATE_S), "deadline", refused(), BY_REPLY),
        Row(ANNOUNCE, Error.INSERTION, False, COPY, do.insert_while_cutting, "state", stops(StopCause.PEER_REBOOTED), BY_CARRIER),
        Row(OPEN, Error.INSERTION, True, COPY, do.insert_while_cutting, "state"),
        Row(ANNOUNCE, Error.MASQUERADE, False, SECOND, do.second_node_record, "own identifier", refused(StopCause.SECOND_NODE, "FAULT"), BY_OPERATOR),
        Row(OPEN, Error.MASQUERADE, False, SECOND, do.second_node_record, "own identifier", stops(StopCause.SECOND_NODE, NONE), AT_ONCE),
    )  # fmt: skip


def rows() -> tuple[Row, ...]:
    return (
        *_cyclic(),
        *_heartbeats(),
        *_joints(),
        *_watched(),
        *_misaddressed(),
        *_stop(),
        *_fault(),
        *_openings(),
        *_records(),
    )


ROWS = rows()


# ---------------------------------------------------------------- where there is no row

ONCE = (STOP, FAULT)
NO_ROW: tuple[tuple[tuple[Message, ...], Error, bool, str], ...] = (
    (STATUS, Error.REPETITION, False, "any number of repetitions is discarded; a sample that never changes any more is an old one, as after its loss"),
    (CYCLIC, Error.SEQUENCE, True, "an older counter is never tolerated: nobody could tell it from one that is 255 ahead"),
    ((PROGRESS,), Error.DELAY, False, "it is shown and decides nothing"),
    (ONCE, Error.CORRUPTION, False, "the cause stands in every heartbeat until it is acknowledged: no number of damaged frames hides it"),
    (ONCE, Error.REPETITION, False, "a stop that is repeated is a stop"),
    (ONCE, Error.SEQUENCE, False, "there is no order in which a stop is less than a stop"),
    (ONCE, Error.DELAY, False, "the next heartbeat is there first, however late the frame is"),
    ((STOP,), Error.INSERTION, True, "whatever arrives on this identifier stops"),
    ((STOP,), Error.MASQUERADE, True, "whatever arrives on this identifier stops"),
    ((FAULT,), Error.INSERTION, True, "a fault frame from outside the session is discarded like one of another session: see masquerade"),
    (ONCE, Error.ADDRESS, False, "it is sent once: there is no third one to go astray"),
    (IN_SESSION, Error.CORRUPTION, True, "a record is used once and whole: one that is not ends the session"),
    (tuple(m for m in IN_SESSION if m not in (COLLECT, TOOL, ASK_PERMIT, PERMIT, START)), Error.REPETITION, False, "any number of repetitions is discarded by its number"),
    (tuple(m for m in IN_SESSION if m not in (BLOCK_STORED, REPLY_PERMIT, REPLY_START)), Error.LOSS, True, "a record is sent once: without it the conversation does not go on, and its deadline ends it"),
    (tuple(m for m in IN_SESSION if m not in (LIMITS, CALIBRATION, TOOL, PERMIT, START, ACKNOWLEDGE, RESET, WITHDRAW)), Error.INSERTION, False, "out of its step a record is refused or dropped and changes nothing"),
    (RECORDS, Error.MASQUERADE, True, "a second node is never tolerated, nor is a code without the key"),
    ((ANNOUNCE,), Error.REPETITION, False, "outside a session it says nothing new; inside one it is an insertion"),
    ((OPEN,), Error.REPETITION, False, "any number of repetitions is discarded, or refused while the session lives"),
    ((REPLY_START,), Error.DELAY, False, "the heartbeat says first that it was accepted, and nobody waits for more"),
    ((ANNOUNCE, OPEN), Error.SEQUENCE, False, "a broken transfer is followed by another, as after a loss"),
    ((ANNOUNCE,), Error.INSERTION, True, "it belongs to no session that it could come from; outside a session it is one of many"),
    ((OPEN,), Error.INSERTION, False, "a session in use is not opened a second time"),
    ((ANNOUNCE, OPEN), Error.ADDRESS, False, "on the other channel it is not believed, as if it were lost"),
)  # fmt: skip
"""Messages, error, within tolerance or beyond, and the reason."""
