"""The oracle: looks at arm, power, people and bus after every turn, and at every log; knows nothing of the rules inside."""

import fcntl
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any

from cutgate.protocol import permit as permits
from cutgate.protocol import records
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.states import ControllerState
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.interlock.state import Phase, Send
from tests.runtime.session.pair import KEY, Pair

MOVING = (Phase.STARTING, Phase.CUTTING)


@dataclass
class Oracle:
    """What has been seen of one pair.

    Attributes:
        permits, starts: authentic ones that reached the controller since it was switched on.
        upheld_s: when a runtime that turned last wanted the arm to move.
        cutting_s: when a controller that turned last said that it cuts.
        named: registrations that the controller opened sessions for since the bone has moved.
        gone: registrations of bones that have moved.
        wrong: what must never be, and was.
    """

    pair: Pair
    permits: list[records.Permit] = field(default_factory=list)
    starts: list[records.Start] = field(default_factory=list)
    resets: int = 0
    upheld_s: float = -1.0
    cutting_s: float = -1.0
    named: set[bytes] = field(default_factory=set)
    gone: set[bytes] = field(default_factory=set)
    wrong: list[str] = field(default_factory=list)
    moved: int = 0
    ends: list[Phase] = field(default_factory=list)
    _sent: int = 0
    _said: int = 0
    _seen: tuple[Any, Any, Any] = (None, None, None)

    def __post_init__(self) -> None:
        timing = self.pair.job.timing
        self.bound_s = (2 * timing.timeout_ms + timing.heartbeat_ms) / 1000 + 2 * self.pair.cycle_s
        """docs/controllers.md, reaction time: a dead runtime on a bus that delays as much as is tolerated."""

    # ------------------------------------------------------------ the controller

    def controller_powered(self) -> None:
        """A controller that has just been switched on: listen to what reaches it."""
        self.permits, self.starts = [], []
        self._listen(self.pair.process.port.endpoint)
        _, state, resets = self._seen
        self._seen = (None, state, resets)  # a latch outlasts a loss of power

    def _listen(self, endpoint: Endpoint) -> None:
        receive = endpoint.receive

        def listening(*args: Any, **options: Any) -> list[Any]:
            items = receive(*args, **options)
            for item in items:
                if isinstance(item, RecordReceived) and isinstance(item.record, records.SignedRecord):
                    self._signed(item.record)
            return items

        endpoint.receive = listening  # type: ignore[method-assign]

    def _signed(self, record: records.SignedRecord) -> None:
        if not permits.verify(KEY, record):
            return
        match record:
            case records.Permit():
                self.permits.append(record)
            case records.Start():
                self.starts.append(record)
            case records.Reset():
                self.resets += 1

    # ------------------------------------------------------------ every turn

    def look(self) -> None:
        """After a turn of both."""
        pair, now_s = self.pair, self.pair.clock()
        process, controller = pair.process, pair.controller
        arm = process.arm.state.joints
        before, state, resets = self._seen
        self._seen = (arm, controller.state, self.resets)
        if before is not None and arm != before:
            self.moved += 1
            self._motion(now_s)
        if controller.session is not None:
            self.named.add(controller.session.registration)
        if "bone motion reported" in pair.said[self._said :]:
            self.gone |= self.named
            self.named = set()
        self._said = len(pair.said)
        if state is ControllerState.FAULT is not controller.state and resets == self.resets:
            self.wrong.append("a latch was left without an authentic reset")
        if pair.controller_runs and controller.state in (ControllerState.CUTTING, ControllerState.DONE):
            self.cutting_s = now_s
        self._runtime(now_s)

    def _motion(self, now_s: float) -> None:
        controller = self.pair.controller
        inputs, held = controller.inputs, controller.holdings
        if not (inputs.device_pressed and inputs.emergency_stop_clear):
            self.wrong.append("the arm moved with the device released or the emergency stop pressed")
        if not self.permits or not self.starts:
            self.wrong.append("the arm moved without an authentic permit and start")
            return
        permit, start = self.permits[-1], self.starts[-1]
        if start.permit_digest != permit.digest:
            self.wrong.append("the arm moved on a start for another permit")
        if permit.boot_nonce != controller.identity.boot_nonce:
            self.wrong.append("the arm moved on a permit from before a reboot")
        if permit.registration_digest in self.gone:
            self.wrong.append("the arm moved on the registration of a bone that had moved")
        holds = tuple(sha256(data or b"").digest() for data in (held.limits, held.calibration, held.tool))
        if holds != (permit.limits_digest, permit.calibration_digest, permit.tool_digest):
            self.wrong.append("the arm moved with other parameters than permitted")
        if held.path is not None and sha256(held.path).digest() != permit.path_digest:
            self.wrong.append("the arm moved along another path than permitted")
        if not now_s - self.upheld_s <= self.bound_s:
            self.wrong.append(f"the arm moved {now_s - self.upheld_s:.3f} s after the runtime wanted it to")

    def _runtime(self, now_s: float) -> None:
        pair = self.pair
        if pair.session is None or not pair.runtime_runs:
            return
        if pair.phase in MOVING:
            self.upheld_s = now_s
        if pair.phase is Phase.CUTTING and not now_s - self.cutting_s <= self.bound_s:
            self.wrong.append(
                f"the runtime takes the arm for cutting, {now_s - self.cutting_s:.3f} s after it did"
            )
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
        self._sent = 0

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
            return
        log = pair.read()
        if log.report.status is not Status.OK:
            self.wrong.append(f"a closed log is {log.report.status.name}: {log.report.reasons}")
        causes = {entry.get("first_out") for entry in log.of("/audit/decision")} - {None}
        if len(causes) > 1:
            self.wrong.append(f"several first causes: {causes}")
        if pair.replayed().outcome is ReplayOutcome.DIFFERS:
            self.wrong.append(f"replayed differently: {pair.replayed().differences}")
