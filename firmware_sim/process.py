"""The simulated controller's loop: bus, clock, terminal and plant wired to the table. It decides nothing.

One turn: look at the clocks, read the bus and the terminal, feed the table, move the arm if it may move, send the
heartbeat, flush. The heartbeat is the last act of a turn in which the table was evaluated.
"""

import contextlib
import math
import os
import select
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path as FilePath
from typing import assert_never

import can

from cutgate.config.terminal import WordReader
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.approach import Approach, Ends, own_ends
from cutgate.firmware_sim.faults import FaultName, FaultSpec
from cutgate.firmware_sim.kinematics import GOES_RAD, Joints, KinematicsError, calibrated_arm
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.firmware_sim.plant import Plant, PlantState, StoredPath
from cutgate.firmware_sim.state import (
    AbortTransfers,
    AcknowledgeReceived,
    BoneMoved,
    CloseLink,
    CollectReceived,
    Controller,
    Effect,
    Event,
    Fault,
    HeartbeatLost,
    HeartbeatReceived,
    InputsChanged,
    JointsMeasured,
    LimitsChanged,
    Memory,
    NonceRequested,
    OpenLink,
    OpenReceived,
    PathChecked,
    PathFinished,
    PermitReceived,
    Persist,
    Persisted,
    PersistFailed,
    ResetReceived,
    Send,
    SendFault,
    StartReceived,
    StopReceived,
    Tick,
)
from cutgate.firmware_sim.table import step
from cutgate.protocol import records
from cutgate.protocol.cycle import Cycle
from cutgate.protocol.endpoint import RecordReceived, Undelivered
from cutgate.protocol.frames import (
    FRACTION_MAX,
    ControllerFault,
    ControllerHeartbeat,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
    joint_frames,
)
from cutgate.protocol.link import Accepted, Violation
from cutgate.protocol.path import PathHeader
from cutgate.protocol.permit import fingerprint
from cutgate.protocol.port import Port
from cutgate.protocol.states import ControllerState, Refusal, StopCause

FIRMWARE_VERSION = "sim-0.1"
CHECK_POSES_PER_TURN = 512
OFF_START_DEG = 2.0
HANG_S = 1.0
DRIFT_DEG_S = 1.0
RUSH = 3.0


class Word(StrEnum):
    """What the person at the simulated controller can do."""

    HOLD = "hold"
    RELEASE = "release"
    ESTOP = "estop"
    BONE_MOTION = "bone-motion"
    LIMIT = "limit"


@dataclass(frozen=True)
class Options:
    """How this simulated controller behaves.

    ``time_scale``: seconds of the plant in one of the clock, announced in whole thousandths;
    ``joints``: where the arm stands at power-up, rad and mm.
    """

    time_scale: float = 1.0
    announce_s: float = 0.2
    faults: tuple[FaultSpec, ...] = ()
    hold_roll_rad: float | None = None
    joints: Joints | None = None


class Process:
    """The controller at work.

    Args:
        controller: its state at power-up.
        port: its side of the bus.
        memory_file: non-volatile memory.
        options: time scale and faults.
        words: the terminal, None without one.
        say: shows one line to the person at the controller.
        clock: monotonic seconds.
        random: the operating system's generator.
        sleep: stands still for so many seconds, for the fault that hangs the loop.
    """

    def __init__(
        self,
        controller: Controller,
        port: Port,
        memory_file: FilePath,
        *,
        options: Options,
        words: WordReader[Word] | None = None,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        random: Callable[[int], bytes] = os.urandom,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.controller = controller
        self.port = port
        self._memory = memory_file
        self._memory_works = True
        self._options = options
        self._words = words
        self._say = say
        self._clock = clock
        self._random = random
        self._sleep = sleep
        self._faults = list(options.faults)
        self._silent = False
        self._undelivered = ""
        self._cycle = Cycle(port, clock)
        self._next_announce_s = self._cycle.now_s
        self._assembly = records.Assembly()
        self._check: PathCheck | None = None
        self._checked_path = b""
        self._stored: StoredPath | None = None
        self._plant = self._new_plant()
        self._approach: Approach | None = None
        self._arm_state = PlantState(options.joints or middle_of(self._plant.limits))
        self._executed = 0
        self._speed_ratio = 0.0
        self._drifts_since_s: float | None = None
        self._frozen: Joints | None = None
        self._measured_joints = self._arm_state.joints
        self._rush = 1.0

    # ------------------------------------------------------------ the loop

    def run(self, wake: int) -> None:
        """Turn until something arrives on ``wake``. A failed bus stops the arm and ends the process."""
        poller = select.poll()
        poller.register(wake, select.POLLIN)
        poller.register(self.port.bus.fileno(), select.POLLIN)
        if self._words_descriptor is not None:
            poller.register(self._words_descriptor, select.POLLIN)
        while True:
            ready = {descriptor for descriptor, _ in poller.poll(1000.0 * self._wait_s())}
            if wake in ready:
                self._feed(Fault(StopCause.OPERATOR_QUIT))
                self.port.flush_last()
                return
            descriptor = self._words_descriptor
            self.turn(ready)
            if descriptor is not None and self._words_descriptor is None:  # end of file
                poller.unregister(descriptor)

    def turn(self, ready: Collection[int] = ()) -> None:
        """One turn of the loop. After anything that is raised the arm stands, for nothing else moves it.

        Args:
            ready: descriptors that can be read.

        Raises:
            can.CanError: the bus failed.
        """
        try:
            self._turn(ready)
        except can.CanError:
            self._feed(Fault(StopCause.BUS_FAILED))
            raise
        except BaseException:
            self._give_up()
            raise

    def _turn(self, ready: Collection[int]) -> None:
        cycle = self._cycle
        cycle.begin()
        for violation in cycle.late():
            self._late(violation)
        for item in cycle.read():
            self._item(item)
        self._read_words(ready)
        self._continue_check()
        self._feed(Tick())
        self._move(cycle.gap_s)
        self._inject()
        self._speak(cycle.now_s)
        if not self._silent:
            self.port.flush()

    def _give_up(self) -> None:
        """The program itself failed: latch, tell the runtime if the bus still carries it, send nothing else."""
        self.controller, effects = step(self.controller, Fault(StopCause.INTERNAL_ERROR), self._clock())
        self.port.endpoint.abort()
        for effect in effects:
            if isinstance(effect, SendFault):
                self._carry_out(effect)
        if not self._silent:
            with contextlib.suppress(can.CanError):  # heartbeats cease: the runtime stops within the time-out
                self.port.flush_last()
        self._remember(self.controller.memory)

    def _leave_now(self) -> None:
        if not self._silent:
            self.port.leave_now()

    def _remember(self, wanted: Memory) -> bool:
        """Write non-volatile memory; False, said once until it works again, where it cannot be written."""
        try:
            memory.save(self._memory, wanted)
        except memory.ControllerMemoryError as error:
            if self._memory_works:
                self._say(str(error))
            self._memory_works = False
            return False
        self._memory_works = True
        return True

    def _wait_s(self) -> float:
        if self._check is not None:
            return 0.0
        return self._cycle.wait_s(None if self._link_open else self._next_announce_s)

    @property
    def _words_descriptor(self) -> int | None:
        return self._words.descriptor if self._words is not None else None

    @property
    def _link_open(self) -> bool:
        return self.port.endpoint.link.is_open

    def _late(self, violation: Violation) -> None:
        self._say(violation.detail)
        lost = violation.cause is StopCause.HEARTBEAT_LOST
        self._feed(HeartbeatLost() if lost else Fault(violation.cause))

    # ------------------------------------------------------------ what arrives

    def _item(self, item: object) -> None:
        match item:
            case Accepted(frame=RuntimeHeartbeat() as beat, fresh=fresh):
                self._feed(HeartbeatReceived(beat.code, beat.epoch, beat.cause, fresh))
            case Accepted(frame=RuntimeStop() as stop):
                self._feed(StopReceived(stop.code, stop.cause))
            case Violation(cause=StopCause.LOOP_STALLED):
                self._late(item)
            case Violation():
                self._say(f"refused: {item.detail}")
                self._feed(Fault(item.cause))
            case Undelivered(detail) if detail != self._undelivered:  # announcements come five times a second
                self._undelivered = detail
                self._say(detail)
            case RecordReceived():
                self._record(item)

    def _record(self, item: RecordReceived) -> None:
        """A checked record becomes an event; what belongs to no session any more is ignored."""
        session, record = self.controller.session, item.record
        inside = session is not None and item.session == session.tag
        match record:
            case records.Open():
                self._feed(OpenReceived(record, item.sequence))
            case _ if not inside:
                return
            case records.Collect():
                self._feed(CollectReceived())
            case records.PathBlock():
                self._block(record)
            case records.NonceRequest():
                self._feed(NonceRequested(record.purpose, self._random(16)))
            case records.Permit():
                self._measure()
                self._feed(PermitReceived(record, item.sequence))
            case records.Start():
                self._measure()
                self._feed(StartReceived(record, item.sequence))
            case records.Reset():
                self._feed(ResetReceived(record, item.sequence))
            case records.Acknowledge():
                self._feed(AcknowledgeReceived(record.cause, item.sequence))

    def _block(self, block: records.PathBlock) -> None:
        """Store one block; the last one starts the check of the whole path."""
        if self.controller.state not in (ControllerState.OPEN, ControllerState.LOADED):
            return
        try:
            if block.index == 0:
                self._assembly = records.Assembly()
            self._assembly = self._assembly.add(block)
            path = records.PathCodes.parse(self._assembly.data) if self._assembly.complete else None
        except records.RecordError as error:
            self._say(f"path refused: {error}")
            self._feed(PathChecked(b"", Refusal.PATH_MALFORMED, 0, None))
            return
        self._send(records.BlockStored(index=block.index))
        if path is not None:
            held = self.controller.holdings
            self._checked_path = self._assembly.data
            self._check = PathCheck(
                path,
                records.Limits.parse(held.limits),
                records.Calibration.parse(held.calibration),
                records.Tool.parse(held.tool),
                hold_roll_rad=self._options.hold_roll_rad,
            )

    def _continue_check(self) -> None:
        """A part of the path check, then back to the heartbeats."""
        if self._check is None or not self._check.step(CHECK_POSES_PER_TURN):
            return
        check, self._check = self._check, None
        verdict = check.verdict
        assert verdict is not None  # noqa: S101 - step() has just said that it is done
        refusal, pose, detail = verdict
        if refusal is not Refusal.ACCEPTED:
            self._say(f"path refused: {refusal.name} at pose {pose}: {detail}")
        self._feed(PathChecked(self._checked_path, refusal, pose, self._own_ends(check)))

    def _own_ends(self, check: PathCheck) -> Ends | None:
        """Entry and exit of the checked path; None, said why, where the arm cannot reach them."""
        held, session = self.controller.holdings, self.controller.session
        first, last = check.first_joints, check.last_joints
        if session is None or first is None or last is None:
            return None
        path = check.path
        arm = calibrated_arm(
            records.Calibration.parse(held.calibration),
            tool_mm=path.tool_length_mm,
            elbow=path.elbow,
            hold_roll_rad=self._options.hold_roll_rad,
        )
        limits = records.Limits.parse(held.limits)
        try:
            return own_ends(path, arm, limits, first, last, clearance_um=session.approach_clearance_um)
        except KinematicsError as error:
            self._say(f"no approach: {error}")
            return None

    # ------------------------------------------------------------ the person at the controller

    def _read_words(self, ready: Collection[int]) -> None:
        if self._words is None or self._words.descriptor not in ready:
            return
        for word in self._words.read():
            if isinstance(word, Word):
                self.act(word)
            else:
                self._say(f"{word!r} is not a word here; say one of {', '.join(Word)}")

    def act(self, word: Word) -> None:
        """Carry out one word."""
        inputs = self.controller.inputs
        match word:
            case Word.HOLD:
                self._inputs(replace(inputs, device_pressed=True), "enabling device pressed")
            case Word.RELEASE:
                self._inputs(replace(inputs, device_pressed=False), "enabling device released")
            case Word.ESTOP:
                clear = not inputs.emergency_stop_clear
                text = "emergency stop released" if clear else "emergency stop pressed"
                self._inputs(replace(inputs, emergency_stop_clear=clear), text)
            case Word.BONE_MOTION:
                self._say("bone motion reported")
                self._feed(BoneMoved())
            case Word.LIMIT:
                self._say("a joint limit was changed")
                self._feed(LimitsChanged(self._changed_limits()))
            case _:
                assert_never(word)

    def _inputs(self, inputs: object, text: str) -> None:
        self._say(text)
        self._feed(InputsChanged(inputs))  # type: ignore[arg-type]

    def _changed_limits(self) -> bytes:
        """The limits with q0 one degree narrower."""
        limits = records.Limits.parse(self.controller.holdings.limits)
        upper = (limits.q_max_u[0] - records.UNIT, *limits.q_max_u[1:])
        return replace(limits, q_max_u=upper).body()

    # ------------------------------------------------------------ the table and its effects

    def _feed(self, event: Event) -> None:
        before = self.controller
        self.controller, effects = step(before, event, self._clock())
        if before.state is not self.controller.state or before.cause is not self.controller.cause:
            self._show(event)
        if before.holdings.path is not self.controller.holdings.path:
            self._load()
        if self.controller.state is ControllerState.CUTTING and before.state is not ControllerState.CUTTING:
            self._begin()
        for effect in effects:
            self._carry_out(effect)

    def _show(self, event: Event) -> None:
        now = self.controller
        cause = "" if now.cause is StopCause.NONE else f" ({now.cause.name})"
        detail = ""
        if isinstance(event, PathFinished):
            detail = (
                f": {self._executed} segments executed, peak joint speed {self._speed_ratio:.0%} of its limit"
            )
        self._say(f"state {now.state.name}{cause}{detail}")

    def _carry_out(self, effect: Effect) -> None:
        endpoint = self.port.endpoint
        match effect:
            case Send():
                self._reply(effect)
            case SendFault():
                if self._link_open:
                    endpoint.send_frame(ControllerFault(effect.code, effect.cause), self._clock())
            case OpenLink(session=session):
                endpoint.stop_sending()  # an announcement that crossed OPEN must not hold up the answer
                endpoint.use_timing(heartbeat_s=session.heartbeat_s, timeout_s=session.timeout_s)
                endpoint.use_session(session.tag)
                endpoint.link.open(session.tag, self._clock())
                self._cycle.next_heartbeat_s = self._clock()
            case CloseLink():
                endpoint.end_session()
                self._next_announce_s = self._clock() + self._options.announce_s
            case AbortTransfers():
                endpoint.abort()
                self._assembly = records.Assembly()
                self._check = None
            case Persist(memory=wanted):
                self._leave_now()
                self._feed(Persisted(wanted) if self._remember(wanted) else PersistFailed())
            case _:
                assert_never(effect)

    def _reply(self, effect: Send) -> None:
        if isinstance(effect.record, records.Reply) and effect.record.refusal is not Refusal.ACCEPTED:
            self._say(f"refused: {effect.record.refusal.name}{self._why(effect.record.refusal)}")
        now_s = self._clock()
        self.port.endpoint.send_record(effect.record, now_s, session=effect.session)
        if not self._link_open:  # a refusal of OPEN: the next announcement would cut it off
            self._next_announce_s = max(self._next_announce_s, now_s + self._options.announce_s)

    def _why(self, refusal: Refusal) -> str:
        """What the person at the controller can do about it, and the runtime's people cannot."""
        if refusal is Refusal.MAC_INVALID:
            own = fingerprint(self.controller.identity.key)
            return f": the runtime has another key file; this one's fingerprint is {own}, compare it with the runtime's"
        if refusal is Refusal.EMERGENCY_STOP:
            return ": the emergency stop is pressed; say estop to release it"
        if refusal is Refusal.DEVICE_NOT_RELEASED_AND_PRESSED:
            return ": say release, then hold"
        return ""

    def _send(self, record: records.Record) -> None:
        self.port.endpoint.send_record(record, self._clock())

    # ------------------------------------------------------------ the arm

    def _new_plant(self) -> Plant:
        held = self.controller.holdings
        return Plant(
            limits=records.Limits.parse(held.limits),
            calibration=records.Calibration.parse(held.calibration),
            hold_roll_rad=self._options.hold_roll_rad,
        )

    def _load(self) -> None:
        """The stored path has changed; the arm keeps its place."""
        stored = self.controller.holdings.path
        self._plant = self._new_plant()
        self._stored = StoredPath.of(stored) if stored is not None else None
        self._approach = None

    def _begin(self) -> None:
        """The start was accepted: from where the arm stands along the permitted legs."""
        permit = self.controller.permit
        assert permit is not None  # noqa: S101 - NO_PERMIT stands in the rules
        self._approach = Approach.of(permit)
        self._arm_state = PlantState(self._arm_state.joints)
        self._executed, self._speed_ratio = 0, 0.0
        self._measured_joints = self._arm_state.joints

    def _measure(self) -> None:
        """Where the arm stands, for PERMIT, START and the end of the retract."""
        self._feed(JointsMeasured(records.joints_to_counts(self._arm_state.joints)))

    @property
    def _reported(self) -> Joints:
        """The joints as the bus hears them; others than the controller goes by only with a fault."""
        q0, q1, q2, q3, q4 = self._frozen or self._arm_state.joints
        if self._drifts_since_s is not None:
            q0 += math.radians(DRIFT_DEG_S) * (self._clock() - self._drifts_since_s)
        return q0, q1, q2, q3, q4

    def _move(self, gap_s: float) -> None:
        if self.controller.state is not ControllerState.CUTTING:
            return
        assert self._stored is not None and self._approach is not None  # noqa: S101, PT018 - CUTTING has both
        advance = self._plant.advance(
            self._arm_state,
            self._stored,
            self._approach,
            dt_s=gap_s if self.controller.may_move else 0.0,
            moving=self.controller.may_move,
            cutter=self.controller.cutting_mode,
            time_scale=self._options.time_scale * self._rush,
        )
        self._arm_state = advance.state
        self._executed += len(advance.executed)
        self._speed_ratio = max(self._speed_ratio, advance.speed_ratio)
        before, self._measured_joints = self._measured_joints, self._arm_state.joints
        plant_s = gap_s * self._options.time_scale
        fault = advance.fault or self._plant.too_fast(before, self._measured_joints, plant_s)
        if fault is not None:
            self._say(f"the arm stopped by itself: {fault.detail}")
            self._feed(Fault(fault.cause))
        elif advance.state.done:
            self._measure()
            self._feed(PathFinished())

    # ------------------------------------------------------------ what is sent

    def _speak(self, now_s: float) -> None:
        """Heartbeat, joints and progress in a session; announcements outside one."""
        if self._link_open:
            if self._cycle.heartbeat_due():
                self._heartbeat(now_s)
        elif now_s >= self._next_announce_s:
            self._announce(now_s)

    def _heartbeat(self, now_s: float) -> None:
        endpoint, controller = self.port.endpoint, self.controller
        endpoint.send_frame(
            ControllerHeartbeat(
                state=controller.state,
                epoch=controller.epoch,
                cause=controller.cause,
                device_pressed=controller.inputs.device_pressed,
                emergency_stop_ok=controller.inputs.emergency_stop_clear,
                cutting_mode=controller.cutting_mode,
            ),
            now_s,
        )
        for frame in joint_frames(self._reported):
            endpoint.send_frame(frame, now_s)
        if controller.state in (ControllerState.CUTTING, ControllerState.DONE):
            segment, fraction = self._arm_state.progress
            endpoint.send_frame(Progress(segment, round(fraction * FRACTION_MAX)), now_s)

    def _announce(self, now_s: float) -> None:
        self._next_announce_s = now_s + self._options.announce_s
        if self.port.endpoint.receiving:  # most likely an OPEN
            return
        self.port.endpoint.abort()  # an announcement nobody took
        self.port.endpoint.send_record(
            records.Announce(
                protocol_version=self.controller.identity.protocol_version,
                firmware_version=FIRMWARE_VERSION,
                serial=self.controller.identity.serial,
                boot_nonce=self.controller.identity.boot_nonce,
                plant_speed_permille=round(1000 * self._options.time_scale),
                state=self.controller.state,
                cause=self.controller.cause,
            ),
            now_s,
        )

    # ------------------------------------------------------------ faults on demand

    def _inject(self) -> None:
        due = [fault for fault in self._faults if fault.state is self.controller.state]
        for fault in due:
            self._faults.remove(fault)
            self._say(f"fault injected: {fault.name}")
            self._happen(fault.name)

    def _happen(self, name: FaultName) -> None:
        held = self.controller.holdings
        match name:
            case FaultName.FLIP_PATH_BIT:
                self._flip_path_bit()
            case FaultName.OFF_START:
                q0, q1, q2, q3, q4 = self._arm_state.joints
                joints = (q0 + math.radians(OFF_START_DEG), q1, q2, q3, q4)
                self._arm_state = replace(self._arm_state, joints=joints)
            case FaultName.HANG:
                self._sleep(HANG_S)
            case FaultName.SILENT:
                self._silent = True
            case FaultName.CHANGE_LIMIT:
                changed = replace(held, limits=self._changed_limits())
                self.controller = replace(self.controller, holdings=changed)
            case FaultName.REBOOT:
                self._reboot()
            case FaultName.DRIFT:
                self._drifts_since_s = self._clock()
            case FaultName.FREEZE:
                self._frozen = self._arm_state.joints
            case FaultName.RUSH:
                self._rush = RUSH
            case _:
                assert_never(name)

    def _flip_path_bit(self) -> None:
        """The lowest bit of the last stored byte; the CRCs stay as received."""
        stored = self.controller.holdings.path
        if stored is None:
            return
        received = records.split(stored)
        flipped = stored[:-1] + bytes([stored[-1] ^ 1])
        blocks = [flipped[block.offset : block.offset + len(block.data)] for block in received]
        crc32s = [block.block_crc32 for block in received]
        self._stored = StoredPath(PathHeader.of(stored), blocks, crc32s)
        holdings = replace(self.controller.holdings, path=flipped)
        self.controller = replace(self.controller, holdings=holdings)

    def _reboot(self) -> None:
        old = self.controller
        self.port.endpoint.end_session()
        self._assembly, self._check = records.Assembly(), None
        self.controller = Controller.powered_up(
            replace(old.identity, boot_nonce=self._random(16)),
            replace(old.holdings, path=None, ends=None),
            memory.load(self._memory),
        )
        self._load()
        self._next_announce_s = self._clock()


def middle_of(limits: records.Limits) -> Joints:
    """Each joint in the middle of its limits; a turning joint with half a turn left on either side of 0 stands at 0.

    Of limits beyond what a joints frame reports, in the middle of the part where the joint may go; if there is any.
    """

    def middle(joint: int, low: float, high: float) -> float:
        if joint != 2 and low <= GOES_RAD and high >= -GOES_RAD:
            low, high = max(low, -GOES_RAD), min(high, GOES_RAD)
        return 0.0 if joint != 2 and low <= -math.pi and math.pi <= high else (low + high) / 2.0

    q0, q1, q2, q3, q4 = (
        middle(joint, float(low), float(high))
        for joint, (low, high) in enumerate(zip(limits.q_min, limits.q_max, strict=True))
    )
    return q0, q1, q2, q3, q4
