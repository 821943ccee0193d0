"""The simulated controller and a script on a bus in virtual time: minutes of them take a moment, and the same one each time.

Nothing here is a process and nothing waits: time passes while the script reads from its bus with a time-out, or says so.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import can

from cutgate.config.key import load_key
from cutgate.config.load import load_robot, load_site
from cutgate.config.model import Site
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.bus.virtual_time import VirtualTime, VirtualTimeBus
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.fault_language import Fault, MessageFault, parse_fault
from cutgate.firmware_sim.faults import FaultSpec
from cutgate.firmware_sim.faulty_bus import FaultyBus
from cutgate.firmware_sim.hil.child import HilTimeoutError
from cutgate.firmware_sim.hil.inputs import HilFiles
from cutgate.firmware_sim.loop import Options, Process
from cutgate.firmware_sim.state import Controller, Holdings, Identity
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.port import Port
from cutgate.protocol.states import ControllerState
from cutgate.protocol.wire import Side

CYCLE_S: Final = 0.005
"""So often the controller looks at everything, whether or not a frame has come."""
QUEUE_FRAMES: Final = 256
"""Of each node: frames take no time here, so that nothing but a burst of a script's waits in it."""
TRANSFER_TIMEOUT_S: Final = 2.0
NONCE_BYTES: Final = 16


class RepeatableGenerator:
    """Random bytes that are the same in every run."""

    def __init__(self, seed: int) -> None:
        self._state = seed

    def __call__(self, size: int) -> bytes:
        """So many."""
        out = bytearray()
        while len(out) < size:
            self._state = (self._state * 6364136223846793005 + 1442695040888963407) % (1 << 64)
            out += (self._state >> 32).to_bytes(4, "big")
        return bytes(out[:size])


class VirtualController:
    """The simulated controller in virtual time.

    Attributes:
        process: its loop, with the table's state.
        lines: what it has shown to the person beside it.
    """

    def __init__(self, process: Process, lines: list[str]) -> None:
        self.process, self.lines = process, lines

    @property
    def state(self) -> ControllerState:
        """The controller's own, whatever it says on the bus."""
        return self.process.controller.state

    def type(self, command: str) -> None:
        """One operator command at its terminal. Raises ValueError for what is none."""
        self.process.act(ConsoleCommand(command))


class VirtualRig:
    """A bus and a clock of its own.

    Args:
        folder: where the controller's memory is kept.
        files: robot, site and key.
        faults: of the test's markers.

    Attributes:
        time: of everything on this bus.
        key, site: of the files, for whoever takes the runtime's place.
        random: bytes for him that are the same in every run.
    """

    def __init__(self, folder: Path, files: HilFiles, faults: tuple[Fault, ...] = ()) -> None:
        self.time = VirtualTime(queue_frames=QUEUE_FRAMES)
        self._folder, self._files, self._faults = folder, files, faults
        self.key, self.site = files.key, files.site
        self.random = RepeatableGenerator(2)
        self._buses: list[can.BusABC] = []
        self._stands_still = False

    # ------------------------------------------------------------ time

    def now_s(self) -> float:
        """Monotonic seconds of this bus."""
        return self.time.clock()

    def run(self, seconds: float) -> None:
        """Let so much time pass."""
        self.time.run(seconds)

    def until(self, condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
        """Let time pass until it holds. Raises HilTimeoutError where it does not in time."""
        if not self.time.until(condition, timeout_s):
            raise HilTimeoutError(f"the condition did not hold within {timeout_s:g} s of virtual time")

    # ------------------------------------------------------------ who is on the bus

    def open(self, name: str = "script", *, fd: bool = False) -> VirtualTimeBus:
        """One more node, closed after the test; ``recv(timeout)`` lets time pass for everybody."""
        bus = self.time.join(name, fd=fd)
        self._buses.append(bus)
        return bus

    def controller(
        self, *faults: str | Fault, time_scale: float = 1.0, fd: bool = False
    ) -> VirtualController:
        """The simulated controller, with the faults of the markers and these."""
        chosen = [parse_fault(one) if isinstance(one, str) else one for one in (*self._faults, *faults)]
        bus = self.open("controller", fd=fd)
        of_messages = [one for one in chosen if isinstance(one, MessageFault)]
        faulty = FaultyBus(bus, of_messages, clock=self.time.clock)
        self._buses.append(faulty)
        options = Options(time_scale, faults=tuple(one for one in chosen if isinstance(one, FaultSpec)))
        lines: list[str] = []
        process = self._process(Port(faulty, self._endpoint(fd)), options, lines)
        faulty.controller_state = lambda: process.controller.state
        turn = lambda: None if self._stands_still else process.run_cycle()  # noqa: E731 - of one line
        self.time.add(bus, turn, lambda: CYCLE_S)
        return VirtualController(process, lines)

    def wait(self, bus: can.BusABC, seconds: float) -> None:
        """Let time pass until this node has something to read, at most so long."""
        assert isinstance(bus, VirtualTimeBus)  # noqa: S101 - one that was opened here
        self.time.until(lambda: bool(bus.inbox), seconds)

    def close(self) -> None:
        """Everybody leaves."""
        for bus in reversed(self._buses):
            bus.shutdown()
        self._buses.clear()

    def _process(self, port: Port, options: Options, lines: list[str]) -> Process:
        robot, key = load_robot(self._files.robot).value, load_key(self._files.key)
        holdings = Holdings(
            limits=limits_record(robot).body(),
            calibration=calibration_record(robot).body(),
            tool=tool_record(robot).body(),
        )
        random, memory_file = RepeatableGenerator(1), self._folder / "virtual-memory.json"
        return Process(
            Controller.powered_up(
                Identity("SIM-VIRTUAL", fingerprint(key)),
                holdings,
                memory.load(memory_file, now_us=0),
                random(NONCE_BYTES),
            ),
            port,
            memory_file,
            options=options,
            say=lines.append,
            clock=self.time.clock,
            random=random,
            sleep=self._sleep,
        )

    def _sleep(self, seconds: float) -> None:
        """The controller's loop stands still, everybody else goes on."""
        self._stands_still = True
        self.time.run(seconds)
        self._stands_still = False

    def _endpoint(self, fd: bool) -> Endpoint:
        site = load_site(self._files.site).value if self._files.site else Site()
        timing = site.timing
        return Endpoint(
            Side.CONTROLLER,
            load_key(self._files.key),
            heartbeat_s=timing.heartbeat_ms / 1000,
            timeout_s=timing.timeout_ms / 1000,
            transfer_timeout_s=TRANSFER_TIMEOUT_S,
            fd=fd,
        )
