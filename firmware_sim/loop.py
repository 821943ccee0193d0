"""The simulated controller's loop: bus, clock, console, memory and arm wired to the table. It decides nothing.

One cycle: look at the clocks, read the bus and the console, feed the table, move the arm if it may move, send the
heartbeat, flush. The heartbeat is the last act of a cycle in which the table was evaluated.
"""

import contextlib
import math
import os
import select
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path as FilePath
from typing import Final, assert_never

import can

from cutgate.config.terminal import CommandReader
from cutgate.firmware_sim import arrivals, console, faults, memory, reports
from cutgate.firmware_sim.arm import PlantArm
from cutgate.firmware_sim.arrivals import NONCE_BYTES
from cutgate.firmware_sim.bone import BoneMotion
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.faults import FaultName, Faults, FaultSpec
from cutgate.firmware_sim.kinematics import Joints
from cutgate.firmware_sim.state import (
    AbortTransfers,
    BoneMoved,
    CloseLink,
    Controller,
    ControllerSession,
    Effect,
    Event,
    FaultArisen,
    JointsMeasured,
    Memory,
    OpenLink,
    PathFinished,
    Persist,
    Persisted,
    PersistFailed,
    Send,
    SendFault,
    Tick,
)
from cutgate.firmware_sim.table import step
from cutgate.firmware_sim.upload import MALFORMED, Upload
from cutgate.protocol import records
from cutgate.protocol.cycle import Cycle
from cutgate.protocol.endpoint import Item, RecordReceived, Undelivered
from cutgate.protocol.frames import ControllerFault, joint_frames
from cutgate.protocol.link import Accepted, Violation
from cutgate.protocol.port import Port
from cutgate.protocol.states import ControllerState, Refusal, StopCause

HANG_S: Final = 1.0
POWERLESS_S: Final = 1.0
DARK_CYCLE_S: Final = 0.02
"""So often a controller without power, or one that hangs, is looked at: its arm may still be coming to rest."""
FAULT_MM: Final = 1.0
"""So far the bone moves by a fault."""
NS_PER_US: Final = 1000


@dataclass(frozen=True)
class Options:
    """How this simulated controller behaves.

    ``time_scale``: seconds of the plant in one of the clock, announced in whole thousandths;
    ``joints``: where the arm stands at power-up, rad and mm;
    ``late_wait_s``: until when a frame waits that the bus holds back, for injected delays.
    ``true_calibration``: the arm as it is, where it is another one than is reported;
    ``dynamics``: whether the joints follow their command by drives with mass;
    ``bone_motion``: how the bone moves by itself while it is cut;
    ``slow_s``: how late each cycle is with the fault that makes it slow.
    """

    time_scale: float = 1.0
    announce_s: float = 0.2
    faults: tuple[FaultSpec, ...] = ()
    hold_roll_rad: float | None = None
    joints: Joints | None = None
    late_wait_s: Callable[[], float] = lambda: math.inf
    true_calibration: records.Calibration | None = None
    dynamics: bool = False
    bone_motion: BoneMotion | None = None
    slow_s: float = 0.03


class PowerLostError(Exception):
    """Nothing of this cycle goes on."""


class Process:
    """The controller at work.

    Args:
        controller: its state at power-up.
        port: its side of the bus.
        memory_file: non-volatile memory.
        options: time scale and faults.
        commands: what is typed at its console, None without one.
        say: shows one line to the person at the controller.
        clock: monotonic seconds.
        random: the operating system's generator.
        sleep: stands still for so many seconds, for the fault that hangs the loop.

    Attributes:
        controller: the table's state.
        arm: where the arm stands and what it executes.
        upload: the path that is coming in, or is being checked.
    """

    def __init__(
        self,
        controller: Controller,
        port: Port,
        memory_file: FilePath,
        *,
        options: Options,
        commands: CommandReader[ConsoleCommand] | None = None,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        random: Callable[[int], bytes] = os.urandom,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        speed_permille = round(1000 * options.time_scale)
        self.controller = replace(
            controller, identity=replace(controller.identity, plant_speed_permille=speed_permille)
        )
        self.port = port
        self._memory = memory_file
        self._memory_works = True
        self._options = options
        self._commands = commands
        self._say = say
        self._clock = clock
        self._random = random
        self._sleep = sleep
        self._faults = Faults(options.faults)
        self._silent = self._slow = False
        self._dark_until_s: float | None = None
        """Without power, or hanging, until then; None while it works."""
        self._cuts_write: FaultName | None = None
        self._bone_motion = options.bone_motion
        self._undelivered = ""
        self._refused_opens: set[Refusal] = set()
        """Shown since the state last changed: an OPEN may be anybody's, and come again and again."""
        self._cycle = Cycle(port, clock)
        self._next_announce_s = self._cycle.now_s
        self.upload = Upload(options.hold_roll_rad)
        self.arm = PlantArm(
            controller.holdings,
            joints=options.joints,
            hold_roll_rad=options.hold_roll_rad,
            time_scale=options.time_scale,
            true_calibration=options.true_calibration,
            dynamics=options.dynamics,
        )

    # ------------------------------------------------------------ the loop

    def run(self, wake: int) -> None:
        """Cycle until something arrives on ``wake``. A failed bus stops the arm and ends the process."""
        poller = select.poll()
        poller.register(wake, select.POLLIN)
        poller.register(self.port.bus.fileno(), select.POLLIN)
        if self._console_descriptor is not None:
            poller.register(self._console_descriptor, select.POLLIN)
        while True:
            ready = {descriptor for descriptor, _ in poller.poll(1000.0 * self._wait_s())}
            if wake in ready and self._dark_until_s is not None:
                return
            if wake in ready:
                self._feed(FaultArisen(StopCause.OPERATOR_QUIT))
                self.port.flush_last()
                return
            descriptor = self._console_descriptor
            self.run_cycle(ready)
            if descriptor is not None and self._console_descriptor is None:  # end of file
                poller.unregister(descriptor)

    def run_cycle(self, ready: Collection[int] = ()) -> None:
        """One cycle of the loop. After anything that is raised the arm stands, for nothing else moves it.

        Args:
            ready: descriptors that can be read.

        Raises:
            can.CanError: the bus failed.
        """
        if self._dark_until_s is not None:
            self._stay_dark(ready, self._dark_until_s)
            return
        if self._slow:
            self._sleep(self._options.slow_s)
        try:
            self._run_cycle(ready)
        except PowerLostError:
            self._lose_power()
        except can.CanError:
            self._feed(FaultArisen(StopCause.BUS_FAILED))
            raise
        except BaseException:
            self._give_up()
            raise

    def _run_cycle(self, ready: Collection[int]) -> None:
        cycle = self._cycle
        cycle.begin()
        for violation in cycle.late():
            self._late(violation)
        for item in cycle.read():
            self._item(item)
        self._read_console(ready)
        self._sense_bone(cycle.now_s)
        self._continue_check()
        self._feed(Tick())
        self._move(cycle.gap_s)
        self._inject()
        if self._dark_until_s is not None:
            return
        self._speak(cycle.now_s)
        if not self._silent:
            self.port.flush()

    def _give_up(self) -> None:
        """The program itself failed: latch, tell the runtime if the bus still carries it, send nothing else."""
        self.controller, effects = step(self.controller, FaultArisen(StopCause.INTERNAL_ERROR), self._clock())
        self.port.endpoint.abort()
        for effect in effects:
            if isinstance(effect, SendFault):
                self._carry_out(effect)
        if not self._silent:
            with contextlib.suppress(can.CanError):  # heartbeats cease: the runtime stops within the time-out
                self.port.flush_last()
        self._remember(self.controller.memory)

    def _wait_s(self) -> float:
        if self._dark_until_s is not None:
            return DARK_CYCLE_S
        if self.upload.check is not None:
            return 0.0
        wait_s = self._cycle.wait_s(None if self._link_open else self._next_announce_s)
        return min(wait_s, self._options.late_wait_s())

    @property
    def _console_descriptor(self) -> int | None:
        return self._commands.descriptor if self._commands is not None else None

    @property
    def _link_open(self) -> bool:
        return self.port.endpoint.link.is_open

    # ------------------------------------------------------------ what arrives

    def _late(self, violation: Violation) -> None:
        self._say(violation.detail)
        self._feed(arrivals.of_lateness(violation))

    def _item(self, item: Item) -> None:
        match item:
            case Accepted():
                self._feed_any(arrivals.of_frame(item))
            case Violation(cause=StopCause.LOOP_STALLED):
                self._late(item)
            case Violation():
                self._say(f"refused: {item.detail}")
                self._feed(FaultArisen(item.cause))
            case Undelivered(detail) if detail != self._undelivered:  # announcements come five times a second
                self._undelivered = detail
                self._say(detail)
            case RecordReceived() if arrivals.belongs(item, self.controller.session):
                self._record(item)

    def _record(self, item: RecordReceived) -> None:
        if isinstance(item.record, records.PathBlock):
            self._block(item.record)
            return
        if isinstance(item.record, arrivals.JUDGED_WHERE_THE_ARM_STANDS):
            self._measure()
        self._feed_any(arrivals.of_record(item, self._random))

    def _feed_any(self, event: Event | None) -> None:
        if event is not None:
            self._feed(event)

    def _read_console(self, ready: Collection[int]) -> None:
        if self._commands is None or self._commands.descriptor not in ready:
            return
        for command in self._commands.read():
            if isinstance(command, ConsoleCommand):
                self.act(command)
            else:
                self._say(console.not_known(command))

    def act(self, command: ConsoleCommand) -> None:
        """Carry out one operator command."""
        line, event = console.event_of(command, self.controller)
        self._say(line)
        self._feed(event)

    # ------------------------------------------------------------ the path

    def _block(self, block: records.PathBlock) -> None:
        """Store one block; the last one starts the check of the whole path."""
        if self.controller.state not in (ControllerState.OPEN, ControllerState.LOADED):
            return
        try:
            path = self.upload.add(block)
        except records.RecordError as error:
            self._say(f"path refused: {error}")
            self._feed(MALFORMED)
            return
        self._send(records.BlockStored(index=block.index))
        if path is not None:
            self.upload.begin_check(path, self.controller.holdings)

    def _continue_check(self) -> None:
        session = self.controller.session
        if session is None:  # what ended it has voided the check
            return
        checked = self.upload.continue_check(self.controller.holdings, session.approach_clearance_um)
        if checked is not None:
            for line in checked.lines:
                self._say(line)
            self._feed(checked.event)

    # ------------------------------------------------------------ the table and its effects

    def _feed(self, event: Event) -> None:
        before = self.controller
        self.controller, effects = step(before, event, self._clock())
        if before.state is not self.controller.state or before.cause is not self.controller.cause:
            self._show(event)
        if before.holdings.path is not self.controller.holdings.path:
            self.arm.load(self.controller.holdings)
        if self.controller.state is ControllerState.CUTTING and before.state is not ControllerState.CUTTING:
            assert self.controller.permit is not None  # noqa: S101 - NO_PERMIT stands in the rules
            self.arm.begin(self.controller.permit)
        for effect in effects:
            self._carry_out(effect)

    def _show(self, event: Event) -> None:
        self._refused_opens.clear()
        line = console.state_line(self.controller)
        if isinstance(event, PathFinished):
            for text in console.distance_lines(self.arm.distances):
                self._say(text)
            line += f": {console.executed_line(self.arm.executed, self.arm.speed_ratio)}"
        self._say(line)

    def _carry_out(self, effect: Effect) -> None:
        endpoint = self.port.endpoint
        match effect:
            case Send():
                self._reply(effect)
            case SendFault():
                if self._link_open:
                    endpoint.send_frame(ControllerFault(effect.code, effect.cause), self._clock())
            case OpenLink(session=session):
                self._open_link(session)
            case CloseLink():
                endpoint.end_session()
                self._next_announce_s = self._clock() + self._options.announce_s
            case AbortTransfers():
                endpoint.abort()
                self.upload.void()
            case Persist(memory=wanted):
                if not self._silent:
                    self.port.leave_now()
                self._lose_power_writing(wanted)
                self._feed(Persisted(wanted) if self._remember(wanted) else PersistFailed())
            case _:
                assert_never(effect)

    def _open_link(self, session: ControllerSession) -> None:
        endpoint = self.port.endpoint
        endpoint.stop_sending()  # an announcement that crossed OPEN must not hold up the answer
        endpoint.use_timing(heartbeat_s=session.heartbeat_s, timeout_s=session.timeout_s)
        endpoint.use_session(session.digest)
        endpoint.open_link(self._clock())
        self._cycle.next_heartbeat_s = self._clock()

    def _reply(self, effect: Send) -> None:
        if isinstance(effect.record, records.Reply) and effect.record.refusal is not Refusal.ACCEPTED:
            self._show_refusal(effect.record)
        now_s = self._clock()
        self.port.endpoint.send_record(effect.record, now_s, session=effect.session)
        if not self._link_open:  # a refusal of OPEN: the next announcement would cut it off
            self._next_announce_s = max(self._next_announce_s, now_s + self._options.announce_s)

    def _show_refusal(self, reply: records.Reply) -> None:
        """Each one; of an OPEN the same reason only once until something else happens."""
        if reply.request_type == records.Open.TYPE:
            if reply.refusal in self._refused_opens:
                return
            self._refused_opens.add(reply.refusal)
        self._say(console.refusal_line(reply.refusal, self.controller.identity))

    def _send(self, record: records.Record) -> None:
        self.port.endpoint.send_record(record, self._clock())

    def _remember(self, wanted: Memory) -> bool:
        """Write non-volatile memory; False, shown once until it works again, where it cannot be written."""
        try:
            memory.save(self._memory, wanted)
        except memory.ControllerMemoryError as error:
            if self._memory_works:
                self._say(str(error))
            self._memory_works = False
            return False
        self._memory_works = True
        return True

    # ------------------------------------------------------------ the arm

    def _measure(self) -> None:
        """Where the arm stands, for PERMIT, START and the end of the retract."""
        self._feed(JointsMeasured(records.joints_to_counts(self.arm.reading)))

    def _move(self, gap_s: float) -> None:
        if self.controller.state is not ControllerState.CUTTING:
            self.arm.settle(gap_s)
            return
        fault = self.arm.move(gap_s, moving=self.controller.may_move, cutter=self.controller.cutting_mode)
        if fault is not None:
            self._say(f"the arm stopped by itself: {fault.detail}")
            self._feed(FaultArisen(fault.cause))
        elif self.arm.done:
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
        endpoint = self.port.endpoint
        endpoint.send_frame(reports.heartbeat(self.controller), now_s)
        for frame in joint_frames(self.arm.reported(self._clock())):
            endpoint.send_frame(frame, now_s)
        progress = reports.progress(self.controller, self.arm.seen)
        if progress is not None:
            endpoint.send_frame(progress, now_s)

    def _announce(self, now_s: float) -> None:
        self._next_announce_s = now_s + self._options.announce_s
        endpoint = self.port.endpoint
        if endpoint.receiving:  # most likely an OPEN
            return
        endpoint.abort()  # an announcement nobody took
        endpoint.send_record(reports.announcement(self.controller), now_s)

    # ------------------------------------------------------------ faults on demand

    def _inject(self) -> None:
        for name in self._faults.due(self.controller.state):
            self._say(f"fault injected: {name}")
            self._happen(name)

    def _happen(self, name: FaultName) -> None:
        own = self._own_faults.get(name)
        if own is not None:
            own()
        else:
            self.controller = faults.happen(name, self.controller, self.arm, self._clock())

    @property
    def _own_faults(self) -> dict[FaultName, Callable[[], None]]:
        """What goes wrong with the loop, its bus, its sensors or its memory; the rest is not its own."""

        def becomes(name: str, value: object) -> Callable[[], None]:
            return partial(setattr, self, name, value)

        return {
            FaultName.HANG: partial(self._sleep, HANG_S),
            FaultName.SLOW: becomes("_slow", value=True),
            FaultName.HUNG: becomes("_dark_until_s", math.inf),
            FaultName.SILENT: becomes("_silent", value=True),
            FaultName.REBOOT: self._reboot,
            FaultName.POWER_LOSS: self._lose_power,
            FaultName.TORN_WRITE: becomes("_cuts_write", FaultName.TORN_WRITE),
            FaultName.UNANSWERED_WRITE: becomes("_cuts_write", FaultName.UNANSWERED_WRITE),
            FaultName.FLIP_MEMORY_BIT: partial(memory.flip_bit, self._memory),
            FaultName.BONE_MOTION: partial(self._move_bone, BoneMotion(0.0, FAULT_MM)),
            FaultName.SECOND_CONTROLLER: partial(self._hear_stranger, FaultName.SECOND_CONTROLLER),
            FaultName.SECOND_RUNTIME: partial(self._hear_stranger, FaultName.SECOND_RUNTIME),
        }

    def _hear_stranger(self, name: FaultName) -> None:
        """Another node says this: everybody on the bus hears it, this side as well."""
        can_id, data = faults.masquerade(name, self.controller, self.port.endpoint.link)
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        with contextlib.suppress(can.CanTimeoutError):
            self.port.bus.send(message, timeout=0)
        for item in self.port.endpoint.receive(can_id, data, now_s=self._clock()):
            self._item(item)

    def _sense_bone(self, now_s: float) -> None:
        motion, cutting = self._bone_motion, self.controller.state is ControllerState.CUTTING
        if motion is not None and cutting and now_s - self.controller.started_at_s >= motion.after_s:
            self._bone_motion = None
            self._move_bone(motion)

    def _move_bone(self, motion: BoneMotion) -> None:
        self._say(motion.told())
        if motion.is_seen:
            self._feed(BoneMoved())

    # ------------------------------------------------------------ without power

    def _lose_power_writing(self, wanted: Memory) -> None:
        """With such a fault: in the middle of writing, or after it."""
        name, self._cuts_write = self._cuts_write, None
        if name is FaultName.TORN_WRITE:
            memory.cut_short(self._memory, wanted)
            raise PowerLostError
        if name is FaultName.UNANSWERED_WRITE:
            self._remember(wanted)
            raise PowerLostError

    def _lose_power(self, until_s: float | None = None) -> None:
        """Nothing is sent or heard, the brakes are on; power comes back after a while, or then."""
        self._dark_until_s = self._clock() + POWERLESS_S if until_s is None else until_s
        self.port.endpoint.end_session()
        self.port.endpoint.abort()
        self.upload.void()
        self.arm.power(on=False)

    def _stay_dark(self, ready: Collection[int], until_s: float) -> None:
        """What comes in is lost. Nothing commands the arm; what was commanded before, its drives carry out or brake."""
        self._cycle.begin()
        self.port.discard()
        if self._commands is not None and self._commands.descriptor in ready:
            self._commands.read()
        self.arm.settle(self._cycle.gap_s)
        if self._cycle.now_s >= until_s:
            self._dark_until_s = None
            self._say("power is back")
            self._reboot()

    def _reboot(self) -> None:
        """Power-up; one whose memory cannot be believed does not come up."""
        old = self.controller
        self.port.endpoint.end_session()
        self.upload.void()
        self.arm.power(on=True)
        try:
            remembered = memory.load(self._memory, now_us=time.time_ns() // NS_PER_US)
        except memory.ControllerMemoryError as error:
            self._say(f"the controller does not start: {error}")
            self._lose_power(math.inf)
            return
        self.controller = Controller.powered_up(
            old.identity,
            replace(old.holdings, path=None, ends=None),
            remembered,
            self._random(NONCE_BYTES),
        )
        self.arm.load(self.controller.holdings)
        self._next_announce_s = self._clock()
