"""The command line of the simulated controller."""

import argparse
import hashlib
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import can

from cutgate.config.bus import RuntimeDirectoryError, default_interface, open_bus
from cutgate.config.constants import CONSTANTS
from cutgate.config.exits import INTERNAL, OK, REFUSED
from cutgate.config.key import load_key
from cutgate.config.load import InputError, load_robot
from cutgate.config.model import Robot
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.config.screen import STDOUT, diverted, last_words, screens
from cutgate.config.signals import ENDING, handled, wake
from cutgate.config.terminal import typed
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.arm import middle_of
from cutgate.firmware_sim.arrivals import NONCE_BYTES
from cutgate.firmware_sim.bone import BoneMotion
from cutgate.firmware_sim.console import ConsoleCommand
from cutgate.firmware_sim.drives import TIME_SCALE_MAX
from cutgate.firmware_sim.fault_language import MessageFault, parse_fault
from cutgate.firmware_sim.faults import FaultName, FaultSpec
from cutgate.firmware_sim.faulty_bus import FaultyBus
from cutgate.firmware_sim.kinematics import Joints, as_joints, limit_text
from cutgate.firmware_sim.loop import NS_PER_US, Options, Process
from cutgate.firmware_sim.message_faults import Tell
from cutgate.firmware_sim.state import Controller, Holdings, Identity, Memory
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.frames import FRAMES, TRANSFER_IDS, FrameError, joint_frames
from cutgate.protocol.parameters import counts_nearest
from cutgate.protocol.port import Port
from cutgate.protocol.records import PLANT_SPEED_PERMILLE_MAX, Calibration, Limits, Side, joints_to_memory
from cutgate.protocol.states import StopCause

LISTEN_S: Final = 0.6
"""How long the bus is listened to before anything is sent: longer than any period of cutgate's frames."""
TRANSFER_TIMEOUT_S: Final = 2.0
FAULTS_TOLD: Final = 10
"""So often each fault of a message is shown on the screen."""
SLOW_MS_MAX: Final = 10_000


class RefusedError(Exception):
    """Bad input, key or bus; one line for the user."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the simulated controller until Ctrl-C or another signal that ends programs.

    Returns:
        0 after a clean end, 2 on bad input, key or bus, 70 on an internal error.
    """
    options = _parser().parse_args(arguments)
    try:
        _run(options)
    except (
        InputError,
        RefusedError,
        RuntimeDirectoryError,
        memory.ControllerMemoryError,
    ) as error:
        last_words(f"cutgate sim: {error}")
        return REFUSED
    except (can.CanInitializationError, can.CanError) as error:
        last_words(f"cutgate sim: bus: {error}")
        return REFUSED
    except Exception as error:  # noqa: BLE001 - the arm stands already; one line and a code, never a traceback
        text = f"{type(error).__name__}: {error}".replace("\n", " ")
        last_words(f"cutgate sim: internal error: {text}")
        return INTERNAL
    return OK


def _run(options: argparse.Namespace) -> None:
    robot = load_robot(options.robot).value
    if options.key is None:
        raise RefusedError(
            "no key file is given (--key); name the one that the runtime has too, or make one for both with: cutgate key new FILE"
        )
    key, memory_file = load_key(options.key), memory.beside(options.key)
    faults = [parse_fault(text, "--fault") for text in options.fault]
    settings = _options(options, robot, tuple(fault for fault in faults if isinstance(fault, FaultSpec)))
    remembered = memory.load(memory_file, now_us=time.time_ns() // NS_PER_US)
    memory.save(memory_file, remembered)  # one that cannot be written is found before anything depends on it
    controller = _controller(robot, key, remembered, options.serial)
    interface, channel = _bus_of(options)
    reading, writing = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    with (
        handled(ENDING, lambda _number: wake(writing)),
        screens(STDOUT) as (screen,),
        diverted(screen),
        open_bus(interface, channel, fd=options.fd) as bus,
    ):
        _refuse_a_used_bus(bus)
        say = screen.say
        say(
            f"controller {controller.identity.serial} on {interface}/{channel}, key {options.key}, "
            f"fingerprint {controller.identity.key_fingerprint}"
        )
        say(f"state {controller.state.name}; enabling device released; commands: {', '.join(ConsoleCommand)}")
        if settings.time_scale != 1.0:
            say(f"simulation only: the plant runs {settings.time_scale:g} times as fast as the clock")
        if remembered.latched is not StopCause.NONE:
            say(
                f"a fault was latched before power-up ({remembered.latched.name}): acknowledge it, then reset"
            )
        of_messages = [fault for fault in faults if isinstance(fault, MessageFault)]
        faulty = FaultyBus(bus, of_messages, tell=_told(say)) if of_messages else None
        if faulty is not None:
            settings = replace(settings, late_wait_s=faulty.late_wait_s)
        process = Process(
            controller,
            Port(faulty or bus, _endpoint(key, fd=options.fd)),
            memory_file,
            options=settings,
            commands=typed(ConsoleCommand),
            say=say,
        )
        if faulty is not None:
            faulty.controller_state = lambda: process.controller.state
        process.run(reading)


def _told(say: Callable[[str], None]) -> Tell:
    """Shows the first times that each fault happens; one of every frame would be all that is read."""

    def tell(fault: MessageFault, times: int, _message: can.Message) -> None:
        if times <= FAULTS_TOLD:
            last = "; no more of these are shown" if times == FAULTS_TOLD else ""
            say(f"fault injected: {fault} ({times}){last}")

    return tell


def _controller(robot: Robot, key: bytes, remembered: Memory, serial: str | None) -> Controller:
    holdings = Holdings(
        limits=limits_record(robot).body(),
        calibration=calibration_record(robot).body(),
        tool=tool_record(robot).body(),
    )
    number = serial or f"SIM-{hashlib.sha256(robot.name.encode()).hexdigest()[:8].upper()}"
    identity = Identity(number, fingerprint(key))
    return Controller.powered_up(identity, holdings, remembered, os.urandom(NONCE_BYTES))


def _options(options: argparse.Namespace, robot: Robot, faults: tuple[FaultSpec, ...]) -> Options:
    permille = options.time_scale * 1000
    if not (1 <= permille <= PLANT_SPEED_PERMILLE_MAX and abs(permille - round(permille)) <= 1e-9 * permille):
        raise RefusedError(
            f"--time-scale is {options.time_scale:g}, must be 0.001 to {PLANT_SPEED_PERMILLE_MAX / 1000:g} "
            "in whole thousandths, as it is announced"
        )
    hold = math.radians(robot.wrist.hold_roll_deg) if robot.wrist.hold_roll_when_vertical else None
    joints = joints_at_power_up(options.joints, limits_record(robot))
    if not options.dynamics and any(fault.name is FaultName.WEAK_DRIVE for fault in faults):
        raise RefusedError(f"--fault: {FaultName.WEAK_DRIVE} needs drives; add --dynamics")
    if options.dynamics and not options.time_scale <= TIME_SCALE_MAX:
        raise RefusedError(
            f"--time-scale is {options.time_scale:g}, must be at most {TIME_SCALE_MAX:g} with --dynamics: the drives of a "
            "plant that is faster take more steps than a cycle has time for"
        )
    return Options(
        options.time_scale,
        faults=faults,
        hold_roll_rad=hold,
        joints=joints,
        true_calibration=_true_calibration(options.true_calibration, robot),
        dynamics=options.dynamics,
        bone_motion=_bone_motion(options.bone_motion),
        slow_s=_slow_s(options.slow_ms),
    )


def _bone_motion(text: str | None) -> BoneMotion | None:
    try:
        return None if text is None else BoneMotion.parse(text)
    except ValueError as error:
        raise RefusedError(f"--bone-motion: {error}") from None


def _slow_s(slow_ms: float) -> float:
    if not 0.0 < slow_ms <= SLOW_MS_MAX:
        raise RefusedError(f"--slow-ms is {slow_ms:g}, must be more than 0 and at most {SLOW_MS_MAX}")
    return slow_ms / 1000.0


def _true_calibration(file: Path | None, robot: Robot) -> Calibration | None:
    """The calibration of the arm as it is: of a robot file that is the other one's but for links and calibration."""
    if file is None:
        return None
    true = load_robot(file).value
    for name, record in (("[limits]", limits_record), ("[tool]", tool_record)):
        if record(true) != record(robot):
            raise RefusedError(
                f"--true-calibration: {file}: {name} is not that of --robot, and only [arm] and [calibration] are taken "
                f"from this file; write the {name} of --robot into it"
            )
    return calibration_record(true)


def joints_at_power_up(text: str | None, limits: Limits) -> Joints:
    """Where the arm stands at power-up, q0,q1,q2,q3,q4 in deg and mm; None: in the middle of its limits.

    Raises:
        RefusedError: they are outside the limits, or no frame can report them.
    """
    try:
        joints = middle_of(limits) if text is None else _five(text)
        joint_frames(joints)
    except FrameError as error:
        if text is None:
            raise RefusedError(f"no place inside the limits of robot.toml can be reported: {error}") from None
        raise RefusedError(f"--joints: {error}; name joints that the bus can report") from None
    except ValueError:
        raise RefusedError(
            f"--joints is {text!r}, must be five numbers q0,q1,q2,q3,q4 in deg and mm, for example 0,70,250,0,55"
        ) from None
    outside = limit_text(joints, as_joints(limits.q_min), as_joints(limits.q_max))
    if outside:
        raise RefusedError(f"--joints: {outside}; name joints inside the limits of robot.toml")
    return joints


def _five(text: str) -> Joints:
    """Raises ValueError unless these are five finite numbers."""
    counts = tuple(counts_nearest(float(part), "joint") for part in text.split(","))
    if len(counts) != 5:
        raise ValueError(text)
    return as_joints(joints_to_memory(counts))


def _bus_of(options: argparse.Namespace) -> tuple[str, str]:
    if options.interface is None:
        interface, channel = default_interface()
        return interface, options.channel or channel
    if options.channel is None:
        raise RefusedError("--interface needs --channel as well")
    return options.interface, options.channel


def _endpoint(key: bytes, *, fd: bool) -> Endpoint:
    """Timing until a session agrees on its own."""
    return Endpoint(
        Side.CONTROLLER,
        key,
        heartbeat_s=CONSTANTS["heartbeat_ms"].default / 1000,
        timeout_s=CONSTANTS["timeout_ms"].default / 1000,
        transfer_timeout_s=TRANSFER_TIMEOUT_S,
        fd=fd,
    )


def _refuse_a_used_bus(bus: can.BusABC) -> None:
    """A bus that already carries cutgate frames has a controller or a session on it."""
    ours = set(FRAMES) | {can_id for side in TRANSFER_IDS.values() for can_id in side.values()}
    until_s = time.monotonic() + LISTEN_S
    while (left_s := until_s - time.monotonic()) > 0.0:
        message = bus.recv(timeout=left_s)
        if message is not None and not message.is_extended_id and message.arbitration_id in ours:
            raise RefusedError(
                f"the bus already carries cutgate frames (0x{message.arbitration_id:03X}); end the other controller"
            )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cutgate sim",
        description="A simulated robot controller on the bus. Commands on its terminal: "
        + ", ".join(ConsoleCommand)
        + ".",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--robot", type=Path, required=True, help="robot.toml or a preset: the limits it reports"
    )
    parser.add_argument("--key", type=Path, help="pre-shared key; its memory is kept beside it")
    parser.add_argument("--interface", help="python-can interface; default vcan0, else the local virtual bus")
    parser.add_argument("--channel", help="channel of the interface")
    parser.add_argument("--fd", action="store_true", help="bulk records in CAN FD frames, as the runtime")
    parser.add_argument("--serial", help="serial number; default made from the robot's name")
    parser.add_argument(
        "--time-scale", type=float, default=1.0, help="the plant runs this many times faster than the clock"
    )
    parser.add_argument(
        "--joints",
        metavar="q0,q1,q2,q3,q4",
        help="where the arm stands at power-up, deg and mm (write --joints=...); default the middle of the limits",
    )
    parser.add_argument(
        "--dynamics",
        action="store_true",
        help="the joints follow their command by drives with mass, and brake along the path instead of standing at once",
    )
    parser.add_argument(
        "--bone-motion",
        metavar="SECONDS,MM",
        help="the bone moves by itself so long after a cut was started; its sensor tells of 0.2 mm and more",
    )
    parser.add_argument(
        "--slow-ms",
        type=float,
        default=1000.0 * Options().slow_s,
        help=f"how late each cycle is with the fault {FaultName.SLOW}; default 30",
    )
    parser.add_argument(
        "--true-calibration",
        type=Path,
        metavar="FILE",
        help="a robot.toml whose [arm] and [calibration] are those of the arm as it is; what is reported stays --robot's",
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="FAULT",
        help="NAME@STATE, or what happens to messages on their way: lose ControllerHeartbeat @cutting x3; see docs/hil.md",
    )
    return parser
