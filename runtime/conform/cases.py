# ruff: noqa: D103 - each case is named and described in the table (table.py)
"""What each case says to the controller, and how it judges what comes.

A case runs in sessions of its own and returns what came, or raises ``DeviationError``.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

from cutgate.config.constants import CONSTANTS
from cutgate.protocol import records
from cutgate.protocol.e2e import protect
from cutgate.protocol.frames import (
    DATA_IDS,
    IDS,
    ControllerHeartbeat,
    Joint4,
    Joints01,
    Joints23,
    RuntimeHeartbeat,
    encode_frame,
)
from cutgate.protocol.link import Accepted
from cutgate.protocol.records import Channel, Permit, Start
from cutgate.protocol.states import EPOCHS, ControllerState, Purpose, Refusal, RuntimeCode, StopCause
from cutgate.runtime.conform import codings
from cutgate.runtime.conform.bench import REGISTERED_US, Bench
from cutgate.runtime.conform.failures import DeviationError, InconclusiveError
from cutgate.runtime.conform.heard import Stop, shown
from cutgate.runtime.conform.sample import LONG

STALE_BURST: Final = 26
"""As many heartbeats as once came out of a paused reader's queue within 5 ms."""
WATCHED_PERIODS: Final = 50
PERIOD_TOLERANCE: Final = 0.2
MIDDLE_PAUSE: Final = 0.5
HELD_BACK: Final = 0.7
"""So great a part of the time-out a heartbeat is held back."""
ROUND: Final = 256

Run = Callable[[Bench], str]


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        name: unique, in words.
        requirement: the part of docs/protocol.md it stands on.
        sent: what is said to the controller.
        expected: what must come.
        run: says it, and returns what came.
        latches: afterwards the controller is in a latched fault.
        approved: needs the site's robot.toml.
    """

    name: str
    requirement: str
    sent: str
    expected: str
    run: Run
    latches: bool = False
    approved: bool = False


# ---------------------------------------------------------------- what cases have in common


def refused(bench: Bench, request: records.Record, *refusals: Refusal) -> str:
    """The request is refused with one of these reasons, and the state stays."""
    state = bench.state.state if bench.state else ControllerState.OPEN
    answer = bench.ask(request)
    if answer is None or answer.refusal not in refusals:
        raise DeviationError(shown(answer))
    if answer.refusal is not Refusal.MAC_INVALID:
        bench.stays(state)
    return shown(answer)


def stopped(bench: Bench, since: int, begun_s: float, cause: StopCause, within_s: float) -> Stop:
    """The controller stops for this cause within this time."""
    found = bench.until(lambda: bench.stop_sign(since, begun_s), within_s + bench.timeout_s)
    if found is None:
        raise DeviationError(f"no stop, state {bench.state_name}")
    bench.latency_s = found.after_s
    if found.cause is not cause or not found.after_s <= within_s:
        raise DeviationError(f"{found}, must be {cause.name} within {within_s * 1000:.0f} ms")
    return found


def goes_on(bench: Bench, seconds: float, state: ControllerState = ControllerState.OPEN) -> str:
    """Nothing stops for so long and the session answers still."""
    since, begun_s = len(bench.heard), bench.now_s
    bench.run(seconds)
    found = bench.stop_sign(since, begun_s)
    if found is not None:
        raise DeviationError(str(found))
    bench.nonce(Purpose.PERMIT)
    bench.stays(state)
    return f"discarded; the session goes on in {state.name}"


# ---------------------------------------------------------------- announce and open


def announces(bench: Bench) -> str:
    first, second = bench.hello(), bench.hello()
    if first.protocol_version != records.PROTOCOL_VERSION:
        raise DeviationError(f"protocol version {first.protocol_version}")
    if first != second or not first.serial:
        raise DeviationError(f"{first} then {second}, must stay the same while no session is opened")
    if first.state is not ControllerState.INHIBITED:
        raise DeviationError(f"state {first.state.name}, cause {first.cause.name}")
    return f"{first.serial}, firmware {first.firmware_version}, version {first.protocol_version}, INHIBITED"


def opens(bench: Bench) -> str:
    answer = bench.open()
    used = bench.identity.announce_nonce
    if answer.state is not ControllerState.OPEN:
        raise DeviationError(f"Opened in {answer.state.name}")
    if bench.finish().announce_nonce == used:
        raise DeviationError("the announce nonce is the same after a session was opened with it")
    return f"Opened, epoch {answer.epoch}; heartbeats and joints fresh; then another announce nonce"


def open_refused(refusal: Refusal, **changes: Any) -> Run:
    """A case in which a right OPEN with these changes is refused."""

    def run(bench: Bench) -> str:
        bench.hello()
        answer = bench.ask_open(bench.open_request(**changes))
        if not isinstance(answer, records.Reply) or answer.refusal is not refusal:
            raise DeviationError(shown(answer))
        return shown(answer)

    return run


def open_again(bench: Bench) -> str:
    """What opened the session before, code and all, in another envelope: the very bytes would count as a repetition."""
    bench.open()
    opening = bench.opening
    assert opening is not None  # noqa: S101 - open() has set it
    bench.finish()
    bench.endpoint.use_session(records.session_digest(opening))
    bench.endpoint.number(Channel.CONTROL)
    answer = bench.answer_to_open(len(bench.heard), bench.say(opening, session=0))
    bench.endpoint.use_session(None)
    if not isinstance(answer, records.Reply) or answer.refusal is not Refusal.ANNOUNCE_NONCE:
        raise DeviationError(shown(answer))
    return shown(answer)


def open_with_a_wrong_code(bench: Bench) -> str:
    """It names nothing and changes nothing: what follows is as if it had never been."""
    before = bench.hello()
    sound = bench.endpoint.signed_next(bench.open_request())
    answer = bench.ask_open(sound.with_mac(bytes([sound.code[0] ^ 1]) + sound.code[1:]))
    if not isinstance(answer, records.Reply) or answer.refusal is not Refusal.MAC_INVALID:
        raise DeviationError(shown(answer))
    after = bench.hello()
    if after != before:
        raise DeviationError(f"{before} became {after}")
    return f"{shown(answer)}; {opens(bench)}"


def open_during_session(bench: Bench) -> str:
    bench.open()
    since = len(bench.heard)
    sequence = bench.say(bench.open_request(), session=0)
    answer = bench.until(lambda: bench.reply(records.Open, sequence, since), bench.reply_s)
    if answer is None or answer.refusal is not Refusal.SESSION_IN_USE:
        raise DeviationError(shown(answer))
    return f"{shown(answer)}; {goes_on(bench, bench.timeout_s)}"


def out_of_bounds(timing: records.Timing) -> Iterator[tuple[str, records.Timing]]:
    """The timing with one value just outside its bounds, for each bound that a record can carry."""
    for name, scale in (
        ("heartbeat_ms", 1),
        ("timeout_ms", 1),
        ("permit_lifetime_s", 1),
        ("start_lifetime_ms", 1),
        ("start_tolerance_um", 1000),
        ("start_tolerance_mdeg", 1000),
        ("approach_clearance_um", 1000),
        ("approach_speed_percent", 1),
    ):
        constant = CONSTANTS[name.replace("_um", "_mm").replace("_mdeg", "_deg")]
        for value in (round(constant.low * scale) - 1, round(constant.high * scale) + 1):
            if 0 <= value < 1 << 16 or (name == "approach_clearance_um" and value > 0):
                yield f"{name} {value}", replace(timing, **{name: value})
    yield "timeout_ms of two heartbeats", replace(timing, timeout_ms=2 * timing.heartbeat_ms)


def timing_out_of_bounds(bench: Bench) -> str:
    count = 0
    for name, timing in out_of_bounds(bench.timing):
        bench.hello()  # just after an announcement, so that the next one does not cross the reply
        answer = bench.ask_open(bench.open_request(timing=timing))
        if not isinstance(answer, records.Reply) or answer.refusal is not Refusal.TIMING_OUT_OF_BOUNDS:
            raise DeviationError(f"{name}: {shown(answer)}")
        count += 1
    return f"Reply TIMING_OUT_OF_BOUNDS to each of {count}"


# ---------------------------------------------------------------- cyclic frames


def cyclic(bench: Bench) -> str:
    """Periods by the tester's clock; counters and echoes by the frames themselves."""
    bench.open()
    begun = len(bench.heard)
    bench.run(WATCHED_PERIODS * bench.heartbeat_s)
    kinds = (ControllerHeartbeat, Joints01, Joints23, Joint4)
    counters: dict[type, list[int]] = {kind: [] for kind in kinds}
    times: dict[type, list[float]] = {kind: [] for kind in kinds}
    for heard in bench.heard[begun:]:
        if isinstance(heard.item, Accepted) and type(heard.item.frame) in counters:
            counters[type(heard.item.frame)].append(heard.item.counter)
            times[type(heard.item.frame)].append(heard.at_s)
    for kind in kinds:
        _regular(bench, kind.__name__, times[kind], counters[kind])
    least = min(len(counters[kind]) for kind in kinds[1:])
    if any(counters[kind][:least] != counters[Joints01][:least] for kind in kinds[2:]):
        raise DeviationError("the three joint frames of a sample do not share their counter")
    samples = [
        heard.item
        for heard in bench.heard[begun:]
        if isinstance(heard.item, Accepted) and isinstance(heard.item.frame, ControllerHeartbeat | Joints01)
    ]
    for before, after in pairwise(samples):
        if isinstance(after.frame, Joints01) and after.counter != before.counter:
            raise DeviationError(
                f"joints with the counter {after.counter} follow the heartbeat {before.counter}: a sample carries the "
                "counter of its cycle's heartbeat, by which its age is told"
            )
    return f"{len(times[ControllerHeartbeat])} heartbeats in {WATCHED_PERIODS} periods, no counter missing"


def _regular(bench: Bench, name: str, times: list[float], counters: list[int]) -> None:
    """Raises DeviationError unless these frames came with the period of OPEN, one counter after the other."""
    wanted = WATCHED_PERIODS * PERIOD_TOLERANCE
    if not abs(len(times) - WATCHED_PERIODS) <= wanted:
        raise DeviationError(f"{name}: {len(times)} frames in {WATCHED_PERIODS} periods")
    gap_s = max((b - a for a, b in pairwise(times)), default=0.0)
    if not gap_s <= bench.timeout_s:
        raise DeviationError(f"{name}: a gap of {gap_s * 1000:.0f} ms")
    if any((b - a) % 256 != 1 for a, b in pairwise(counters)):
        raise DeviationError(f"{name}: counters do not go up by one")


# ---------------------------------------------------------------- what it reports


def reports(bench: Bench) -> str:
    bench.open()
    found = bench.collect()
    problems = [text for record in found for text in record.problems()]
    if problems:
        raise DeviationError("; ".join(problems))
    names = ("limits", "calibration", "tool")
    digests = (f"{n} {records.digest(r.body()).hex()[:8]}" for n, r in zip(names, found, strict=True))
    return ", ".join(digests)


def reports_the_same(bench: Bench) -> str:
    bench.open()
    first, second = bench.collect(), bench.collect()
    for one, other in zip(first, second, strict=True):
        if one.body() != other.body():
            raise DeviationError(f"{type(one).__name__} differs between two answers")
    return "equal digests"


def reports_what_is_approved(approved: tuple[bytes, bytes, bytes] | None) -> Run:
    """The reported records equal those of the site's robot.toml."""

    def run(bench: Bench) -> str:
        if approved is None:
            raise InconclusiveError("no --robot given")
        bench.open()
        for record, wanted in zip(bench.collect(), approved, strict=True):
            if record.body() != wanted:
                raise DeviationError(f"{type(record).__name__} differs from robot.toml")
        return "equal digests"

    return run


# ---------------------------------------------------------------- the path


def stores(bench: Bench) -> str:
    bench.open()
    path = bench.sample(LONG).path
    blocks = records.split(path.body())
    answer = bench.upload(blocks)
    if answer is None or answer.refusal is not Refusal.ACCEPTED or answer.digest != path.digest:
        raise DeviationError(f"{shown(answer)}, or another digest than that of the bytes sent")
    if not bench.reaches(ControllerState.LOADED):
        raise DeviationError(f"state {bench.state_name}")
    return f"PathStored with the digest of {len(blocks)} blocks, LOADED"


def path_refused(refusal: Refusal, change: Callable[[Bench], tuple[records.Path, int]]) -> Run:
    """A case in which a path is refused with this reason at this pose."""

    def run(bench: Bench) -> str:
        bench.open()
        path, pose = change(bench)
        answer = bench.upload(records.split(path.body()))
        if answer is None or (answer.refusal, answer.pose) != (refusal, pose):
            raise DeviationError(shown(answer))
        bench.stays(ControllerState.OPEN)
        return shown(answer)

    return run


def _not_stored(bench: Bench, since: int) -> str:
    """Nothing is stored: no block, no path, never LOADED."""
    begun_s = bench.now_s

    def answered() -> bool | None:
        block, path = bench.first(records.BlockStored, since), bench.first(records.PathStored, since)
        return any((block, path, bench.stop_sign(since, begun_s))) or None

    bench.until(answered, bench.reply_s)
    bench.run(3 * bench.heartbeat_s)
    stored, stop = bench.first(records.PathStored, since), bench.stop_sign(since, begun_s)
    if bench.first(records.BlockStored, since) or (stored and stored.refusal is Refusal.ACCEPTED):
        raise DeviationError(f"the block was stored; {shown(stored)}")
    if bench.state is not None and bench.state.state is ControllerState.LOADED:
        raise DeviationError("LOADED")
    return f"not stored; {shown(stored)}" if stop is None else f"not stored; stop {stop.cause.name}"


def corrupted_record(bench: Bench) -> str:
    """A bit of the block's data is turned; the CRC-32 of the record is the old one."""
    bench.open()
    block = records.split(bench.sample().path.body())[0]
    payload = bytearray(records.pack(block, bench.endpoint.session, bench.endpoint.number(Channel.BULK)))
    payload[-10] ^= 1
    since = len(bench.heard)
    bench.say_bytes(Channel.BULK, bytes(payload))
    return _not_stored(bench, since)


def block_not_stored(make: Callable[[records.Path], records.PathBlock]) -> Run:
    """A case in which a sound record brings a block that must not be taken."""

    def run(bench: Bench) -> str:
        bench.open()
        block = make(bench.sample().path)
        since = len(bench.heard)
        bench.say(block)
        return _not_stored(bench, since)

    return run


def coded(coder: codings.Coder) -> Run:
    """A case in which the only block of a path is coded so."""
    return block_not_stored(lambda path: codings.block(path, coder))


def second_block_first(bench: Bench) -> str:
    bench.open()
    since = len(bench.heard)
    bench.say(records.split(bench.sample(LONG).path.body())[1])
    return _not_stored(bench, since)


# ---------------------------------------------------------------- permits


def permit_accepted(bench: Bench) -> str:
    bench.permitted()
    if bench.state is None or not bench.state.cutting_mode:
        raise DeviationError("PERMITTED without the cutting mode bit")
    bench.stays(ControllerState.PERMITTED)
    return "Reply ACCEPTED, PERMITTED; nothing moves"


def permit_refused(refusal: Refusal, change: Callable[[Bench, Permit], Permit]) -> Run:
    """A case in which a permit that is right but for one change, and signed, is refused for it."""

    def run(bench: Bench) -> str:
        bench.loaded()
        return refused(bench, change(bench, bench.permit()), refusal)

    return run


def with_fields(**changes: Any) -> Callable[[Bench, Any], Any]:
    """The record with these fields."""
    return lambda _bench, record: replace(record, **changes)


def without_nonce(bench: Bench) -> str:
    bench.loaded()
    permit = bench.permit(nonce=bytes(range(16)))
    return refused(bench, permit, Refusal.NO_NONCE)


def old_nonce(bench: Bench) -> str:
    bench.loaded()
    old = bench.nonce(Purpose.PERMIT)
    bench.nonce(Purpose.PERMIT)
    return refused(bench, bench.permit(old), Refusal.NONCE_MISMATCH)


def nonce_of_another_purpose(bench: Bench) -> str:
    bench.loaded()
    permit = bench.permit(bench.nonce(Purpose.START))
    return refused(bench, permit, Refusal.NO_NONCE, Refusal.NONCE_MISMATCH)


def nonce_consumed(bench: Bench) -> str:
    """The nonce of an accepted permit serves no second time."""
    permit = bench.permitted()
    return refused(bench, permit, Refusal.NOT_IN_STATE, Refusal.NO_NONCE)


def after_the_lifetime(bench: Bench) -> str:
    bench.loaded()
    permit = bench.permit()
    bench.run(bench.timing.permit_lifetime_s + bench.heartbeat_s)
    return refused(bench, permit, Refusal.NONCE_EXPIRED)


def permit_expires(bench: Bench) -> str:
    bench.permitted()
    since, begun_s = len(bench.heard), bench.now_s
    found = stopped(
        bench,
        since,
        begun_s,
        StopCause.PERMIT_EXPIRED,
        bench.timing.permit_lifetime_s + bench.allowance_s,
    )
    return str(found)


def overtaken_by_stop(bench: Bench) -> str:
    """The STOP and the permit's first frame leave in one cycle, the STOP first."""
    bench.loaded()
    permit = bench.permit()
    since, begun_s = len(bench.heard), bench.now_s
    sequence = bench.say(permit)
    bench.stop(StopCause.OPERATOR_STOP)
    stopped(bench, since, begun_s, StopCause.OPERATOR_STOP, bench.allowance_s)
    latency_s = bench.latency_s
    answer = bench.until(lambda: bench.reply(Permit, sequence, since), 5 * bench.timeout_s)
    bench.latency_s = latency_s
    if answer is not None and answer.refusal is Refusal.ACCEPTED:
        raise DeviationError("Reply ACCEPTED")
    bench.stays(ControllerState.INHIBITED)
    return f"stop OPERATOR_STOP; then {shown(answer)}"


def after_a_stop(bench: Bench) -> str:
    """The session's link is still open, its permits are void."""
    bench.loaded()
    permit = bench.permit()
    since, begun_s = len(bench.heard), bench.now_s
    bench.stop(StopCause.OPERATOR_STOP)
    stopped(bench, since, begun_s, StopCause.OPERATOR_STOP, bench.allowance_s)
    bench.reaches(ControllerState.INHIBITED)
    return refused(
        bench,
        permit,
        Refusal.VOIDED_BY_STOP,
        Refusal.UNACKNOWLEDGED_STOP,
        Refusal.NOT_IN_STATE,
        Refusal.NO_NONCE,
        Refusal.EPOCH,
    )


# ---------------------------------------------------------------- start


def start_without_permit(bench: Bench) -> str:
    bench.loaded()
    start = bench.start(bench.permit())
    return refused(bench, start, Refusal.NO_PERMIT, Refusal.NOT_IN_STATE)


def start_refused(refusal: Refusal, change: Callable[[Bench, Start], Start]) -> Run:
    """A case in which a start that is right but for one change, and signed, is refused for it."""

    def run(bench: Bench) -> str:
        permit = bench.permitted()
        return refused(bench, change(bench, bench.start(permit)), refusal)

    return run


def log_not_continued(**changes: Any) -> Callable[[Bench, Start], Start]:
    """The start with another log than the permit's."""
    return lambda _bench, start: replace(start, log=replace(start.log, **changes))


def elsewhere(_bench: Bench, record: Any) -> Any:
    """The record with start joints 5 deg off in q3."""
    joints = list(record.start_joints_u)
    joints[3] += 5 * records.UNIT
    return replace(record, start_joints_u=tuple(joints))


def start_nonce_expired(bench: Bench) -> str:
    permit = bench.permitted()
    start = bench.start(permit)
    bench.run(bench.timing.start_lifetime_ms / 1000 + bench.heartbeat_s)
    return refused(bench, start, Refusal.NONCE_EXPIRED)


def cut_without_start(bench: Bench) -> str:
    bench.permitted()
    bench.code = RuntimeCode.CUT
    bench.run(bench.timeout_s)
    bench.stays(ControllerState.PERMITTED)
    return "PERMITTED; nothing moves"


# ---------------------------------------------------------------- heartbeats, stops, corruption


def silence(permitted: bool) -> Run:
    """The runtime falls silent in a session."""

    def run(bench: Bench) -> str:
        if permitted:
            bench.permitted()
        else:
            bench.open()
        epoch, bench.beating = bench.epoch, False
        since, begun_s = len(bench.heard), bench.now_s
        found = stopped(bench, since, begun_s, StopCause.HEARTBEAT_LOST, bench.timeout_s + bench.allowance_s)
        return f"{found}; {_new_epoch(bench, epoch)}"

    return run


def _new_epoch(bench: Bench, old: int) -> str:
    """After a stop the next session has another epoch and the cause must be acknowledged."""
    latency_s = bench.latency_s
    bench.finish()
    answer = bench.open()
    bench.latency_s = latency_s
    if answer.epoch == old:
        raise DeviationError(f"the epoch is {old} as before the stop")
    return f"epoch {old} became {answer.epoch}"


def stale_heartbeats(bench: Bench) -> str:
    """A burst of heartbeats, and one each period, that echo what was heard before the time-out."""
    bench.open()
    bench.run(2 * bench.timeout_s)
    old = [
        h.item.counter
        for h in bench.heard
        if isinstance(h.item, Accepted)
        and isinstance(h.item.frame, ControllerHeartbeat)
        and bench.now_s - h.at_s > bench.timeout_s
    ]
    if not old:
        raise InconclusiveError("no controller heartbeat older than the time-out")
    epoch, bench.beating = bench.epoch, False
    since, begun_s = len(bench.heard), bench.now_s
    bench.run(MIDDLE_PAUSE * bench.timeout_s)
    for _ in range(STALE_BURST):
        _stale(bench, old[-1])

    def stop() -> Stop | None:
        _stale(bench, old[-1])
        return bench.stop_sign(since, begun_s)

    within_s = bench.timeout_s + bench.allowance_s
    found = bench.until(stop, within_s)
    if found is None or found.cause is not StopCause.HEARTBEAT_LOST or not found.after_s <= within_s:
        raise DeviationError(str(found) if found else f"no stop within {within_s * 1000:.0f} ms")
    bench.latency_s = found.after_s
    return f"{found}; {_new_epoch(bench, epoch)}"


def _stale(bench: Bench, echo: int) -> None:
    beat = RuntimeHeartbeat(bench.code, bench.epoch)
    bench.inject(*bench.endpoint.tagged(beat, bench.now_s, echo))


def held_back(bench: Bench) -> str:
    """A heartbeat reaches the controller late, and gains it nothing: the time-out runs from what it echoes."""
    bench.open()
    bench.run(2 * bench.heartbeat_s)
    bench.beating = False
    since, begun_s = len(bench.heard), bench.now_s
    held = bench.encoded(RuntimeHeartbeat(bench.code, bench.epoch))
    bench.run(HELD_BACK * bench.timeout_s)
    bench.inject(*held)
    return str(stopped(bench, since, begun_s, StopCause.HEARTBEAT_LOST, bench.timeout_s + bench.allowance_s))


def unkeyed_heartbeat(change: Callable[[Bench, bytes], bytes]) -> Run:
    """A heartbeat with a sound CRC and the next counter, changed as a node without the key could."""

    def run(bench: Bench) -> str:
        bench.permitted()
        since, begun_s = len(bench.heard), bench.now_s
        can_id, data = bench.encoded(RuntimeHeartbeat(RuntimeCode.READY, bench.epoch))
        payload = change(bench, data[3:])
        bench.inject(can_id, protect(payload, data[2], DATA_IDS[can_id], bench.endpoint.link.tag))
        return latched(bench, since, begun_s, StopCause.AUTHENTICATION_FAILED)

    return run


def saying_cut(_bench: Bench, payload: bytes) -> bytes:
    """CUT in place of READY, tag and echo as they were."""
    return payload[:3] + bytes([payload[3] ^ RuntimeCode.READY ^ RuntimeCode.CUT]) + payload[4:]


def guessed(_bench: Bench, payload: bytes) -> bytes:
    """A tag with one bit turned."""
    return bytes([payload[0] ^ 1]) + payload[1:]


def heartbeat_of_a_round_before(bench: Bench) -> str:
    """The same eight bits of counter, 256 heartbeats later: what was said once is never said again."""
    bench.open()
    kept = bench.encoded(RuntimeHeartbeat(bench.code, bench.epoch))
    bench.inject(*kept)

    def a_round_later() -> bool | None:
        """A cycle sends one heartbeat at most, so that none is passed over."""
        return kept[1][2] == (bench.endpoint.link.counter + 1) % ROUND or None

    bench.until(a_round_later, 2 * ROUND * bench.heartbeat_s)
    since, begun_s = len(bench.heard), bench.now_s
    bench.inject(*kept)
    return latched(bench, since, begun_s, StopCause.AUTHENTICATION_FAILED)


def stop_frame(bench: Bench) -> str:
    """A stop while permitted: cutting mode ends, the epoch goes up within the session."""
    bench.permitted()
    epoch = bench.epoch
    since, begun_s = len(bench.heard), bench.now_s
    bench.stop(StopCause.OPERATOR_STOP)
    found = stopped(bench, since, begun_s, StopCause.OPERATOR_STOP, bench.allowance_s)
    bench.stays(ControllerState.INHIBITED)
    if bench.state is None or bench.state.epoch != (epoch + 1) % EPOCHS:
        raise DeviationError(f"the epoch is {bench.state.epoch if bench.state else None}, was {epoch}")
    return f"{found}; epoch {epoch} became {bench.state.epoch}"


def malformed_stop(bench: Bench) -> str:
    bench.permitted()
    since, begun_s = len(bench.heard), bench.now_s
    bench.inject(0x011, bytes(8))
    return str(stopped(bench, since, begun_s, StopCause.CORRUPTION, bench.allowance_s))


def cause_in_heartbeat(bench: Bench) -> str:
    """The stop frame was lost, the heartbeat still says the cause."""
    bench.permitted()
    since, begun_s = len(bench.heard), bench.now_s
    beat = RuntimeHeartbeat(RuntimeCode.INHIBIT, bench.epoch, StopCause.OPERATOR_STOP)
    bench.inject(
        *bench.encoded(beat)
    )  # at once, for the next cycle's heartbeat would take its place in the queue
    return str(stopped(bench, since, begun_s, StopCause.OPERATOR_STOP, bench.allowance_s))


def _broken(bench: Bench) -> None:
    """A heartbeat with one bit turned, beside the sound ones; its counter is the next one's."""
    tag = bench.endpoint.link.tag
    can_id, data = encode_frame(RuntimeHeartbeat(bench.code, bench.epoch), 0, tag)
    bench.inject(can_id, data[:-1] + bytes([data[-1] ^ 1]))


def two_corrupted(bench: Bench) -> str:
    bench.open()
    for _ in range(2):
        _broken(bench)
    return goes_on(bench, 2 * bench.timeout_s)


def three_corrupted(bench: Bench) -> str:
    bench.open()
    since, begun_s = len(bench.heard), bench.now_s
    for _ in range(3):
        _broken(bench)
    return str(stopped(bench, since, begun_s, StopCause.CORRUPTION, bench.allowance_s))


def repeated(bench: Bench) -> str:
    bench.open()
    can_id, data = bench.encoded(RuntimeHeartbeat(bench.code, bench.epoch))
    for _ in range(3):
        bench.inject(can_id, data)
    return goes_on(bench, 2 * bench.timeout_s)


def lost(frames: int) -> Callable[[Bench], None]:
    """So many heartbeats are missing."""

    def lose(bench: Bench) -> None:
        bench.open()
        for _ in range(frames):
            bench.encoded(RuntimeHeartbeat(bench.code, bench.epoch))

    return lose


def two_lost(bench: Bench) -> str:
    lost(2)(bench)
    return goes_on(bench, 2 * bench.timeout_s)


def three_lost(bench: Bench) -> str:
    lost(3)(bench)
    since, begun_s = len(bench.heard), bench.now_s
    return str(
        stopped(bench, since, begun_s, StopCause.SEQUENCE_ERROR, bench.heartbeat_s + bench.allowance_s)
    )


def counter_reused(bench: Bench) -> str:
    """The last counter once more with other content."""
    bench.open()
    can_id, data = bench.encoded(RuntimeHeartbeat(bench.code, bench.epoch))
    bench.inject(can_id, data)
    since, begun_s = len(bench.heard), bench.now_s
    other = RuntimeHeartbeat(bench.code, (bench.epoch + 1) % EPOCHS)
    bench.inject(*encode_frame(other, data[2], bench.endpoint.link.tag))
    return str(stopped(bench, since, begun_s, StopCause.SEQUENCE_ERROR, bench.allowance_s))


def other_session_record(bench: Bench) -> str:
    bench.open()
    since = len(bench.heard)
    other = bench.endpoint.session ^ 1 or 2
    bench.say(records.NonceRequest(purpose=Purpose.PERMIT), session=other)
    bench.run(5 * bench.timeout_s)
    if bench.first(records.Nonce, since) is not None:
        raise DeviationError("a nonce was given")
    return goes_on(bench, bench.timeout_s)


def other_session_heartbeats(bench: Bench) -> str:
    """Heartbeats under another tag, beside none of the session's own."""
    bench.open()
    since, begun_s = len(bench.heard), bench.now_s
    bench.beating = False
    other = bench.endpoint.link.tag ^ 1 or 2
    for counter in range(3):
        bench.inject(*encode_frame(RuntimeHeartbeat(bench.code, bench.epoch), counter, other))
    return str(stopped(bench, since, begun_s, StopCause.CORRUPTION, bench.allowance_s))


def outside_session_heartbeats(bench: Bench) -> str:
    """Heartbeats under tag 0 keep nothing alive."""
    bench.open()
    since, begun_s = len(bench.heard), bench.now_s
    bench.beating = False
    due = [begun_s]

    def stop() -> Stop | None:
        if bench.now_s >= due[0]:
            due[0] += bench.heartbeat_s
            bench.inject(*encode_frame(RuntimeHeartbeat(bench.code, bench.epoch), 0, 0))
        return bench.stop_sign(since, begun_s)

    found = bench.until(stop, bench.timeout_s + bench.allowance_s)
    if found is None or found.cause is not StopCause.HEARTBEAT_LOST:
        raise DeviationError(str(found) if found else "no stop")
    bench.latency_s = found.after_s
    return str(found)


def claimed_withdrawal(bench: Bench) -> str:
    """A STOP frame carries no code: it stops and withdraws nothing, and the heartbeat does not say after it that it did."""
    bench.loaded()
    since, begun_s = len(bench.heard), bench.now_s
    bench.stop(StopCause.REGISTRATION_WITHDRAWN)
    found = stopped(bench, since, begun_s, StopCause.PROTOCOL_VIOLATION, bench.allowance_s)
    bench.finish()
    bench.permitted()
    return f"{found}; in the next session Reply ACCEPTED"


def withdrawn(bench: Bench) -> str:
    """A withdrawn place is refused at once and in the next session, under another digest and a later time as well.

    Whatever comes of it, the cases after this one use another place.
    """
    bench.loaded()
    bench.withdraw(bench.place, records.NO_TIME)
    try:
        refused(bench, bench.permit(), Refusal.REGISTRATION_WITHDRAWN)
        bench.finish()
        bench.registration = bytes(32)
        bench.loaded()
        return refused(bench, bench.permit(), Refusal.REGISTRATION_WITHDRAWN)
    finally:
        bench.renew_registration()


def too_early(bench: Bench) -> str:
    """A registration that is not later than the barrier is refused, whatever its place; a later one is not."""
    bench.loaded()
    taken_us = max(REGISTERED_US, bench.barrier_us + 1)
    bench.withdraw(records.NO_PLACE, taken_us)
    found = refused(bench, bench.permit(), Refusal.REGISTRATION_TOO_EARLY)
    bench.finish()
    bench.permitted()
    return f"{found}; a later one: Reply ACCEPTED"


def withdrawn_by_heartbeat(bench: Bench) -> str:
    """A tagged cause withdraws; until a Withdraw has told the barrier nothing is permitted, which OPENED says."""
    bench.loaded()
    since, begun_s = len(bench.heard), bench.now_s
    beat = RuntimeHeartbeat(RuntimeCode.INHIBIT, bench.epoch, StopCause.BONE_MOVED)
    bench.inject(*bench.encoded(beat))
    stopped(bench, since, begun_s, StopCause.BONE_MOVED, bench.allowance_s)
    bench.finish()
    bench.renew_registration()
    answer = bench.open_unacknowledged()
    bench.acknowledge(answer.cause)
    if not answer.withdrawal_due:
        raise DeviationError("Opened does not say that a withdrawal is due")
    bench.load()
    found = refused(bench, bench.permit(), Refusal.WITHDRAWAL_DUE)
    bench.withdraw(records.NO_PLACE, records.NO_TIME)
    return f"{found}; Withdraw: Reply ACCEPTED"


def acknowledge_of_another_epoch(bench: Bench) -> str:
    bench.open()
    request = records.Acknowledge((bench.epoch + 1) % EPOCHS, StopCause.NONE)
    return refused(bench, request, Refusal.EPOCH)


# ---------------------------------------------------------------- what latches


def latched(bench: Bench, since: int, begun_s: float, cause: StopCause) -> str:
    """The controller latches; a new session does not lead out, and no permit is given in it."""
    found = stopped(bench, since, begun_s, cause, bench.allowance_s + bench.reply_s)
    if not found.latched:
        raise DeviationError(f"{found}, must be latched")
    announced = bench.finish()
    if announced.state is not ControllerState.FAULT:
        raise DeviationError(f"{found}; END led to {announced.state.name}")
    return str(found)


def wrong_mac(record: Callable[[Bench], Any]) -> Run:
    """A record whose code is not right by one bit."""

    def run(bench: Bench) -> str:
        sound = bench.endpoint.signed_next(record(bench))
        false = sound.with_mac(bytes([sound.code[0] ^ 1]) + sound.code[1:])
        since, begun_s = len(bench.heard), bench.now_s
        sequence = bench.say(false)

        def seen() -> records.Reply | None:
            return bench.reply(type(false), sequence, since)

        answer = bench.until(seen, bench.reply_s)
        if answer is None or answer.refusal is not Refusal.MAC_INVALID:
            raise DeviationError(shown(answer))
        return f"{shown(answer)}; {latched(bench, since, begun_s, StopCause.AUTHENTICATION_FAILED)}"

    return run


def right_permit(bench: Bench) -> Permit:
    bench.loaded()
    return bench.permit()


def right_start(bench: Bench) -> Start:
    return bench.start(bench.permitted())


def right_acknowledge(bench: Bench) -> records.Acknowledge:
    bench.open()
    return records.Acknowledge(bench.epoch, StopCause.NONE)


def right_withdraw(bench: Bench) -> records.Withdraw:
    bench.open()
    return records.Withdraw(records.NO_PLACE, records.NO_TIME)


def second_node(bench: Bench) -> str:
    bench.open()
    since, begun_s = len(bench.heard), bench.now_s
    bench.inject(IDS[ControllerHeartbeat], bytes(8))
    return latched(bench, since, begun_s, StopCause.SECOND_NODE)


def held_in_fault(bench: Bench) -> str:
    """A latched fault is left by acknowledge and reset alone, in this order, and leads to OPEN."""
    second_node(bench)
    answer = bench.open_unacknowledged()
    if answer.state is not ControllerState.FAULT:
        raise DeviationError(f"a new session is in {answer.state.name}, must be in FAULT")
    early = bench.ask(bench.reset(StopCause.SECOND_NODE))
    if early is None or early.refusal is not Refusal.UNACKNOWLEDGED_STOP:
        raise DeviationError(f"Reset before Acknowledge: {shown(early)}")
    bench.acknowledge(StopCause.SECOND_NODE)
    bench.stays(ControllerState.FAULT)
    other = bench.ask(bench.reset(StopCause.AUDIT_FAILED))
    if other is None or other.refusal is not Refusal.WRONG_CAUSE:
        raise DeviationError(f"Reset for another cause: {shown(other)}")
    latency = bench.ask(bench.reset(StopCause.SECOND_NODE))
    if latency is None or latency.refusal is not Refusal.ACCEPTED:
        raise DeviationError(f"Reset: {shown(latency)}")
    if not bench.reaches(ControllerState.OPEN):
        raise DeviationError(f"after Reset {bench.state_name}")
    return "FAULT in the new session; Reset UNACKNOWLEDGED_STOP; after Acknowledge WRONG_CAUSE, then ACCEPTED, OPEN"


def nothing_moved(bench: Bench) -> str:
    watched = bench.standstill
    if watched.abnormal:
        raise DeviationError("; ".join(dict.fromkeys(watched.abnormal)))
    return f"joints within {watched.moved:.3f} deg or mm, cutting mode only in PERMITTED"
