"""The oracle: looks at arm, power, people and bus after every cycle, and at every log; knows nothing of the rules inside.

It holds the key and judges every code itself: what a session may do it knows from the OPEN that passed on the bus.
"""

import fcntl
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any

import can

from cutgate.firmware_sim.state import ControllerSession, Memory
from cutgate.protocol import records
from cutgate.protocol.codes import NO_ECHO, PresharedKey
from cutgate.protocol.e2e import COUNTER_MODULUS, intact
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.frames import (
    DATA_IDS,
    ECHO_NONE,
    IDS,
    ControllerHeartbeat,
    RuntimeHeartbeat,
    decode_frame,
)
from cutgate.protocol.records import Side
from cutgate.protocol.states import WITHDRAWING, ControllerState, RuntimeCode, StopCause
from cutgate.runtime.audit.inspect import Log, Status, read_log
from cutgate.runtime.audit.replay import ReplayOutcome, replay
from cutgate.runtime.interlock.state import OperatorCommand, Phase, Send
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified
from tests.fault_injection.tap import SENDER, Tap
from tests.runtime.session.pair import KEY, Pair

HEARTBEAT_IDS = {IDS[RuntimeHeartbeat], IDS[ControllerHeartbeat]}
BELIEVED = {
    Phase.PERMITTED: ControllerState.PERMITTED,
    Phase.CUTTING: ControllerState.CUTTING,
    Phase.FINISHING: ControllerState.DONE,
}
"""What the controller's heartbeat must have said before the runtime may say so."""
ACKNOWLEDGED = {"permit": ControllerState.PERMITTED, "start": ControllerState.CUTTING}
"""Likewise before the log may."""


class Session:
    """One session, by the OPEN that passed: what either side really sent in it.

    Attributes:
        cut_s: when the runtime sent its last heartbeat that said CUT.
        cutting_s: when the controller sent its last one that said CUTTING or DONE.
        states: that the controller's heartbeats have said.
        withdrawing: the sides whose heartbeats have named a withdrawing cause.
        permits, starts: with a code that fits, that reached the controller.
        answers: OPENED of the controller, with a code that fits.
    """

    def __init__(self, request: records.Open) -> None:
        self.request = request
        self.codes = PresharedKey(KEY).session(records.session_digest(request))
        self.cut_s = self.cutting_s = -1.0
        self.states: set[ControllerState] = set()
        self.withdrawing: set[Side] = set()
        self.permits: list[records.Permit] = []
        self.starts: list[records.Start] = []
        self.answers: list[records.Opened] = []
        self._made: dict[Side, int | None] = dict.fromkeys(Side)
        self._reached: set[int] = set()

    def first(self, sequence: int) -> bool:
        """Whether no record with this sequence has reached the controller before."""
        new = sequence not in self._reached
        self._reached.add(sequence)
        return new

    def beat(self, side: Side, data: bytes, now_s: float) -> bool:
        """A heartbeat as it left; whether its tag fits, and it answers one of the other side's."""
        last, peer = self._made[side], self._made[side.peer]
        counter = data[2] if last is None else last + (data[2] - last) % COUNTER_MODULUS
        self._made[side] = counter
        echoes = [] if peer is None else [peer - (peer - data[5]) % COUNTER_MODULUS]
        echoes += [NO_ECHO] if data[5] == ECHO_NONE else []
        sent = int.from_bytes(data[3:5], "little")
        fits = any(
            echo >= 0 and self.codes.heartbeat_tag(side, counter, echo, data[-2:]) == sent for echo in echoes
        )
        self._said(decode_frame(IDS[(RuntimeHeartbeat, ControllerHeartbeat)[side]], data), side, now_s)
        return fits

    def _said(self, frame: Any, side: Side, now_s: float) -> None:
        if frame.cause in WITHDRAWING:
            self.withdrawing.add(side)
        match frame:
            case RuntimeHeartbeat(code=RuntimeCode.CUT):
                self.cut_s = now_s
            case ControllerHeartbeat(state=state):
                self.states.add(state)
                if state in (ControllerState.CUTTING, ControllerState.DONE):
                    self.cutting_s = now_s


@dataclass
class Seen:
    """The controller as the last look found it."""

    arm: Any
    state: ControllerState
    cause: StopCause
    session: ControllerSession | None
    memory: Memory
    resets: int
    acknowledged: int
    opened: int


@dataclass
class Oracle:
    """What has been seen of one pair.

    Attributes:
        sessions: by digest, those whose OPEN a holder of the key has made.
        opened: digests of the sessions that a controller has opened, in order.
        heard_in: how many sessions had been opened when a motion or a withdrawal was heard of last.
        moved_us: only a registration later than this counts: the bone's last motion, or an authentic barrier; since 1970.
        wrong: what must never be, and was.
        steps: decisions of logs that were held against the tables.
    """

    pair: Pair
    sessions: dict[bytes, Session] = field(default_factory=dict)
    opened: list[bytes] = field(default_factory=list)
    heard_in: int = -1
    resets: int = 0
    acknowledged: int = 0
    withdraws: list[records.Withdraw] = field(default_factory=list)
    moved_us: int = records.NO_TIME
    wrong: list[str] = field(default_factory=list)
    moved: int = 0
    steps: int = 0
    ends: list[Phase] = field(default_factory=list)
    commands: set[str] = field(default_factory=set)
    _sent: int = 0
    _phases: int = 0
    _said: int = 0
    _seen: Seen | None = None
    _unfit: list[str] = field(default_factory=list)
    """Told when all has come to rest: what follows from it is worse, and told at once."""

    def __post_init__(self) -> None:
        timing = self.pair.job.timing
        self.bound_s = timing.timeout_s + timing.heartbeat_s + self.pair.cycle_s
        """docs/controllers.md, reaction time: from the sending of the last heartbeat that said CUT, whoever holds it back."""
        self._tap = Tap()
        self.pair.wire.rules.insert(0, self._passes)

    # ------------------------------------------------------------ the bus, before anybody changes anything

    def _passes(self, message: can.Message) -> list[can.Message]:
        for envelope in self._tap.hear(message):
            self._record(envelope)
        if message.arbitration_id in HEARTBEAT_IDS:
            self._beat(message.arbitration_id, bytes(message.data))
        return [message]

    def _record(self, envelope: records.Envelope) -> None:
        record = envelope.record
        if isinstance(record, records.Open) and PresharedKey(KEY).open_authentic(record):
            self.sessions.setdefault(records.session_digest(record), Session(record))
        session = self._of_tag(envelope.session)
        if (
            isinstance(record, records.Opened)
            and session is not None
            and session.codes.authentic(record, envelope.sequence)
        ):
            session.answers.append(record)

    def _beat(self, can_id: int, data: bytes) -> None:
        for session in reversed(self.sessions.values()):
            if intact(data, DATA_IDS[can_id], session.codes.tag):
                if not session.beat(SENDER[can_id], data, self.pair.clock()):
                    self._unfit.append(
                        f"a heartbeat left that answers none of the other side's: {data.hex()}"
                    )
                return

    def _of_tag(self, tag: int) -> Session | None:
        return next((one for one in self.sessions.values() if one.codes.tag == tag), None)

    def _session(self) -> Session | None:
        """The controller's."""
        session = self.pair.controller.session
        return None if session is None else self.sessions.get(session.digest)

    # ------------------------------------------------------------ the controller

    def controller_powered(self) -> None:
        """A controller that has just been switched on: listen to what reaches it. A latch and its memory outlast that.

        So does what its session withdrew as the power went.
        """
        endpoint = self.pair.process.port.endpoint
        if self._seen is not None:
            self._seen.arm = None
            self._seen.cause = StopCause.NONE
        self._listen(endpoint)

    def _listen(self, endpoint: Endpoint) -> None:
        receive, use_session = endpoint.receive, endpoint.use_session

        def listening(*args: Any, **options: Any) -> list[Any]:
            items = receive(*args, **options)
            for item in items:
                if isinstance(item, RecordReceived) and isinstance(item.record, records.SignedRecord):
                    self._reached(item)
            return items

        def opening(digest: bytes | None) -> None:
            if digest is not None:
                self._opens(digest)
            use_session(digest)

        endpoint.receive = listening  # type: ignore[method-assign]
        endpoint.use_session = opening  # type: ignore[method-assign]

    def _opens(self, digest: bytes) -> None:
        if digest not in self.sessions:
            self.wrong.append("a session was opened that no holder of the key asked for")
        if digest in self.opened:
            self.wrong.append("the same OPEN has opened twice")
        self.opened.append(digest)

    def _reached(self, item: RecordReceived) -> None:
        """A signed record has reached the controller; what counts is this side's own judgement, and only once."""
        session = self._of_tag(item.session)
        record = item.record
        if session is None or not isinstance(record, records.SignedRecord):
            return
        if not session.codes.authentic(record, item.sequence) or not session.first(item.sequence):
            return
        match record:
            case records.Permit():
                session.permits.append(record)
            case records.Start():
                session.starts.append(record)
            case records.Reset():
                self.resets += 1
            case records.Acknowledge():
                self.acknowledged += 1
            case records.Withdraw():
                self.withdraws.append(record)
                self.moved_us = max(self.moved_us, record.barrier_us)

    # ------------------------------------------------------------ every cycle

    def look(self) -> None:
        """After a cycle of both."""
        pair = self.pair
        controller = pair.controller
        before, self._seen = self._seen, self._sight()
        moved_now = "bone motion reported" in pair.said[self._said :]
        self._said = len(pair.said)
        if moved_now:
            self.moved_us = max(self.moved_us, pair.clock.utc_ns() // 1000)
        if before is not None:
            if before.arm is not None and self._seen.arm != before.arm:
                self.moved += 1
                self._motion(pair.clock())
            self._inhibition(before, self._seen)
            self._withdrawals(before, self._seen, moved_now)
        if controller.cutting_mode and not (self._session() and self._session().permits):  # type: ignore[union-attr]
            self.wrong.append("cutting mode without a permit that a holder of the key made")
        self.withdraws.clear()
        self._runtime(pair.clock())

    def _sight(self) -> Seen:
        controller = self.pair.controller
        return Seen(
            arm=self.pair.process.arm.state.joints,
            state=controller.state,
            cause=controller.cause,
            session=controller.session,
            memory=controller.memory,
            resets=self.resets,
            acknowledged=self.acknowledged,
            opened=len(self.opened),
        )

    def _inhibition(self, before: Seen, now: Seen) -> None:
        if before.state is ControllerState.FAULT is not now.state and before.resets == now.resets:
            self.wrong.append("a latch was left without an authentic reset")
        cleared = before.cause is not StopCause.NONE and now.cause is StopCause.NONE
        if cleared and before.acknowledged == now.acknowledged:
            self.wrong.append(f"{before.cause.name} was cleared without an authentic acknowledgement")

    def _withdrawals(self, before: Seen, now: Seen, moved_now: bool) -> None:
        """Only keyed words and the wired input withdraw; nothing restores."""
        named = {withdraw.place_digest for withdraw in self.withdraws}
        heard = moved_now
        for seen in (before.session, now.session):
            session = None if seen is None else self.sessions.get(seen.digest)
            if session is not None and (moved_now or Side.RUNTIME in session.withdrawing):
                named.add(session.request.place_digest)
                heard = True
        was, becomes = before.memory, now.memory
        if becomes.withdrawn - was.withdrawn - named:
            self.wrong.append("a place was withdrawn though neither a keyed word nor a wired input said so")
        if becomes.withdrawal_due and not was.withdrawal_due and not heard:
            self.wrong.append("a withdrawal is due though neither a keyed word nor a wired input said so")
        if becomes.barrier_us > was.barrier_us and becomes.barrier_us not in {
            withdraw.barrier_us for withdraw in self.withdraws
        }:
            self.wrong.append("a barrier was raised without an authentic withdrawal")
        if heard:
            self.heard_in = before.opened
        self._forgotten(was, becomes, now.opened)

    def _forgotten(self, was: Memory, becomes: Memory, opened: int) -> None:
        """Nothing is, but that a withdrawal is due: by a Withdraw of a session that was opened after all that was heard."""
        if was.withdrawal_due and not becomes.withdrawal_due:
            if not self.withdraws:
                self.wrong.append("a bone's motion was forgotten without an authentic withdrawal")
            if self.heard_in == opened:
                self.wrong.append(
                    "a bone's motion was forgotten in its own session: the withdrawal may be of before"
                )
        if was.withdrawn - becomes.withdrawn or becomes.barrier_us < was.barrier_us:
            self.wrong.append("what was withdrawn was restored")

    def _motion(self, now_s: float) -> None:
        controller = self.pair.controller
        inputs, held, session = controller.inputs, controller.holdings, self._session()
        if not (inputs.device_pressed and inputs.emergency_stop_clear):
            self.wrong.append("the arm moved with the device released or the emergency stop pressed")
        if session is None or not session.permits or not session.starts:
            self.wrong.append("the arm moved without an authentic permit and start")
            return
        permit, start = session.permits[-1], session.starts[-1]
        if start.permit_digest != permit.digest:
            self.wrong.append("the arm moved on a start for another permit")
        if permit.announce_nonce != session.request.announce_nonce:
            self.wrong.append("the arm moved on a permit from before a reboot")
        if session.request.registration_time_us <= self.moved_us:
            self.wrong.append("the arm moved on the registration of a bone that had moved")
        holds = tuple(sha256(data or b"").digest() for data in (held.limits, held.calibration, held.tool))
        if holds != (permit.limits_digest, permit.calibration_digest, permit.tool_digest):
            self.wrong.append("the arm moved with other parameters than permitted")
        if held.path is not None and sha256(held.path).digest() != permit.path_digest:
            self.wrong.append("the arm moved along another path than permitted")
        if not now_s - session.cut_s <= self.bound_s:
            self.wrong.append(f"the arm moved {now_s - session.cut_s:.3f} s after the runtime last said CUT")

    # ------------------------------------------------------------ the runtime

    def _runtime(self, now_s: float) -> None:
        pair = self.pair
        if pair.session is None or not pair.runtime_runs:
            return
        state = pair.state
        session = None if state.session is None else self.sessions.get(state.session.digest)
        for phase in pair.notes.phases[self._phases :]:
            if phase in BELIEVED and (session is None or BELIEVED[phase] not in session.states):
                self.wrong.append(f"the runtime says {phase}, which no heartbeat of the controller said")
        self._phases = len(pair.notes.phases)
        if pair.phase is Phase.CUTTING and not (session and now_s - session.cutting_s <= self.bound_s):
            self.wrong.append("the runtime takes the arm for cutting, longer than the bound after it was")
        if state.opened is not None and (session is None or state.opened not in session.answers):
            self.wrong.append("the runtime believes an OPENED that the controller did not say")
        keyed = session is not None and Side.CONTROLLER in session.withdrawing
        if state.registration_withdrawn and not keyed and OperatorCommand.WITHDRAW not in self.commands:
            self.wrong.append("the runtime withdrew a registration on nobody's keyed word")
        orders = [effect for effect in pair.notes.effects[self._sent :] if isinstance(effect, Send)]
        self._sent = len(pair.notes.effects)
        for order in orders:
            self._enabled(order.record)

    def _enabled(self, record: records.Record) -> None:
        """What enables has its record on the disk already."""
        kind = {records.Permit: "permit", records.Start: "start", records.Reset: "reset"}.get(type(record))
        if kind is None:
            return
        durable = read_log(self.pair.log.path.read_bytes()[: self.pair.disk.durable])
        stages = {(entry["stage"], entry["kind"]) for entry in durable.of("/audit/permit")}
        if ("authorised", kind) not in stages:
            self.wrong.append(f"a {kind} left before its record was durable")

    # ------------------------------------------------------------ sessions

    def session_begins(self) -> None:
        self._sent = self._phases = 0
        self.commands = set()
        heard = self.pair.terminal.type

        def typed(text: str) -> None:
            self.commands.add(text)
            heard(text)

        self.pair.terminal.type = typed  # type: ignore[method-assign]

    def at_rest(self) -> None:
        """Nobody moves any more."""
        self.wrong += self._unfit
        self._unfit = []

    def session_ends(self, *, crashed: bool) -> None:
        """Its log is whole, names one first cause, and decides the same again."""
        pair = self.pair
        self.ends.append(pair.phase)
        closed = not crashed and pair.close().closed
        if not closed:  # killed, or the disk answered no more: the system takes back its locks
            fcntl.flock(pair.log._locked, fcntl.LOCK_UN)
            log = read_log(pair.log.path.read_bytes()[: pair.disk.durable])
            if log.report.status is Status.TAMPERED:
                self.wrong.append(f"an unfinished log is {log.report.reasons}")
            self._decided_again(log)
            return
        log = pair.read()
        if log.report.status is not Status.OK:
            self.wrong.append(f"a closed log is {log.report.status.name}: {log.report.reasons}")
        causes = {entry.get("first_out") for entry in log.of("/audit/decision")} - {None}
        if len(causes) > 1:
            self.wrong.append(f"several first causes: {causes}")
        self._acknowledgements(log)
        self._decided_again(log)

    def _decided_again(self, log: Log) -> None:
        """As far as it goes: same verdict, nothing enabled without it, every step a transition of the tables."""
        found = replay(log, certified.verify, verifier=VERIFIER)
        if found.outcome is ReplayOutcome.DIFFERS:
            self.wrong.append(f"replayed differently: {found.differences}")
        self.steps += len(log.of("/audit/decision"))

    def _acknowledgements(self, log: Log) -> None:
        named = self.pair.state.session
        session = None if named is None else self.sessions.get(named.digest)
        states = set() if session is None else session.states
        for entry in log.of("/audit/permit"):
            wanted = ACKNOWLEDGED.get(entry["kind"])
            if entry["stage"] == "acknowledged" and wanted is not None and wanted not in states:
                self.wrong.append(f"the log says that a {entry['kind']} was acknowledged, which nobody said")
