"""The command line of the simulated controller: what it refuses, and with which exit code it ends."""

import hashlib
import json
import math
import os
import re
import shutil
import signal
import time
from dataclasses import replace
from pathlib import Path

import can
import pytest

from cutgate.config.bus import RuntimeDirectoryError
from cutgate.config.load import SHIPPED
from cutgate.firmware_sim import __main__ as entry
from cutgate.firmware_sim import command, memory
from cutgate.firmware_sim.bone import BoneMotion
from cutgate.firmware_sim.state import Memory
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.frames import IDS, RuntimeHeartbeat
from cutgate.protocol.states import ControllerState, StopCause

ROBOT = SHIPPED / "config" / "presets" / "example.toml"


class Bus:
    """An empty bus; or one that carries this message."""

    channel_info, protocol = "a bus", can.CanProtocol.CAN_20

    def __init__(self, message=None):
        self.message = message

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def recv(self, timeout):
        assert timeout > 0
        return self.message


@pytest.fixture
def given(tmp_path, monkeypatch):
    """Arguments that pass, on a bus that is free; the controller ends at once."""
    key = tmp_path / "key"
    key.write_text(bytes(range(32)).hex())
    key.chmod(0o600)
    shutil.copy(ROBOT, tmp_path / "robot.toml")
    monkeypatch.setattr(command, "LISTEN_S", 0.0)
    monkeypatch.setattr(command, "open_bus", lambda *_, **_fd: Bus())
    monkeypatch.setattr(command, "typed", lambda words: ("what is typed", words))
    processes = []

    def run(self, wake):
        processes.append((self, wake))
        signal.raise_signal(signal.SIGHUP)  # only wakes the loop

    monkeypatch.setattr(command.Process, "run", run)
    before = signal.getsignal(signal.SIGHUP)
    pipes, pipe2 = [], os.pipe2
    monkeypatch.setattr(command.os, "pipe2", lambda flags: pipes.append(pipe2(flags)) or pipes[-1])
    arguments = [
        "--robot",
        str(tmp_path / "robot.toml"),
        "--key",
        str(key),
        "--interface",
        "x",
        "--channel",
        "y",
    ]
    yield arguments, processes
    signal.signal(signal.SIGHUP, before)
    for descriptor in (end for pipe in pipes for end in pipe):
        os.close(descriptor)


def refused(capfd, arguments, *texts):
    assert command.main(arguments) == command.REFUSED
    error = capfd.readouterr().err
    assert error.startswith("cutgate sim: ")
    assert error.count("\n") == 1
    assert all(text in error for text in texts), error


def test_faults_of_messages_lie_on_its_bus_know_its_state_and_are_shown_a_few_times(given, capfd):
    arguments, processes = given
    lines = ["lose any @cutting p=1", "hang@done", "delay Joints01 by 40ms"]
    words = [word for line in lines for word in ("--fault", line)]
    assert command.main([*arguments, *words]) == command.OK
    ((process, _wake),) = processes
    bus = process.port.bus
    assert [str(fault) for fault in bus.faults.done] == [lines[0], lines[2]]
    assert [str(fault) for fault in process._options.faults] == [lines[1]]
    assert bus.controller_state() is process.controller.state is ControllerState.INHIBITED
    assert process._wait_s() < 1.0
    joints = can.Message(arbitration_id=0x300, data=bytes(8), is_extended_id=False)
    bus.send(joints)
    assert 0.0 <= process._options.late_wait_s() <= 0.04
    process.controller = replace(process.controller, state=ControllerState.CUTTING)
    capfd.readouterr()
    said = []
    tell = command._told(said.append)
    for times in range(1, command.FAULTS_TOLD + 3):
        tell("F", times, joints)
    assert said == [
        *(f"fault injected: F ({n})" for n in range(1, 10)),
        "fault injected: F (10); no more of these are shown",
    ]
    assert bus.controller_state() is ControllerState.CUTTING


def test_the_controller_starts_with_what_the_robot_file_says(given, capfd):
    arguments, processes = given
    assert command.main([*arguments, "--time-scale", "5", "--fault", "hang@cutting"]) == command.OK
    ((process, wake),) = processes
    assert process.controller.identity.serial.startswith("SIM-")
    assert process._options.time_scale == 5.0
    assert [fault.name for fault in process._options.faults] == ["hang"]
    out = capfd.readouterr().out
    assert "state INHIBITED; enabling device released" in out
    assert os.read(wake, 10) == b"\0"


def test_the_entry_point_names_the_controller(given):
    arguments, processes = given
    assert entry.main(["sim", *arguments, "--serial", "A-1"]) == 0
    assert entry.main([*arguments, "--serial", "A-2"]) == 0
    assert [process.controller.identity.serial for process, _ in processes] == ["A-1", "A-2"]


def test_the_arm_stands_where_joints_say_and_else_in_the_middle(given):
    arguments, processes = given
    assert command.main([*arguments, "--joints=-10.5,70,250,20,55"]) == 0
    assert command.main(arguments) == 0
    shown = [
        [joint if index == 2 else math.degrees(joint) for index, joint in enumerate(process.arm.state.joints)]
        for process, _ in processes
    ]
    assert shown[0] == pytest.approx([-10.5, 70, 250, 20, 55])
    assert shown[1] == pytest.approx([0, 72.5, 250, 0, 55])


def _true_file(given, old, new):
    """A copy of the robot file with another text in the place of this one."""
    file = Path(given[0][1]).with_name("true.toml")
    text = ROBOT.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")
    return str(file)


def test_the_true_arm_may_be_another_one_than_is_reported(given):
    arguments, processes = given
    file = _true_file(given, "upper_link_mm = 450.0", "upper_link_mm = 448.0")
    assert command.main([*arguments, "--true-calibration", file]) == command.OK
    assert command.main(arguments) == command.OK
    (other, _), (same, _) = processes
    assert (other.arm.mechanical.arm.upper_mm, other.arm.plant.calibration.upper_mm) == (448.0, 450.0)
    assert same._options.true_calibration is None
    assert same.arm.mechanical.arm == same.arm.mechanical.believed


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [("length_mm = 160.0", "length_mm = 150.0", "[tool]"), ("[-80.0, 80.0]", "[-80.0, 70.0]", "[limits]")],
)
def test_of_the_true_arm_only_links_and_calibration_may_be_others(given, capfd, old, new, named):
    arguments, _ = given
    file = _true_file(given, old, new)
    refused(capfd, [*arguments, "--true-calibration", file], file, f"{named} is not that of --robot")


def test_the_joints_have_mass_where_that_is_asked_for(given, capfd):
    arguments, processes = given
    assert command.main([*arguments, "--dynamics", "--time-scale", "10"]) == command.OK
    assert command.main(arguments) == command.OK
    assert [process.arm.driven is not None for process, _ in processes] == [True, False]
    capfd.readouterr()
    refused(
        capfd,
        [*arguments, "--dynamics", "--time-scale", "10.001"],
        "--time-scale is 10.001, must be at most 10",
    )


def test_a_weak_drive_needs_drives(given, capfd):
    arguments, _ = given
    refused(capfd, [*arguments, "--fault", "weak-drive@cutting"], "weak-drive needs drives; add --dynamics")
    assert command.main([*arguments, "--fault", "weak-drive@cutting", "--dynamics"]) == command.OK


def test_the_bone_moves_and_cycles_are_late_as_is_asked_for(given, capfd):
    arguments, processes = given
    assert command.main([*arguments, "--bone-motion", "2.5,1", "--slow-ms", "80"]) == command.OK
    assert command.main(arguments) == command.OK
    asked = [(process._options.bone_motion, process._options.slow_s) for process, _ in processes]
    assert asked == [(BoneMotion(2.5, 1.0), 0.08), (None, 0.03)]
    capfd.readouterr()
    refused(capfd, [*arguments, "--bone-motion", "2.5"], "--bone-motion: '2.5' must be SECONDS,MM")
    for slow in ("0", "-1", "nan", "10001"):
        refused(capfd, [*arguments, f"--slow-ms={slow}"], "must be more than 0 and at most 10000")


def test_every_boot_has_a_nonce_of_its_own(given):
    arguments, processes = given
    command.main(arguments)
    command.main(arguments)
    first, second = (process.controller.announce_nonce for process, _ in processes)
    assert first != second
    assert len(first) == 16


def test_the_memory_beside_the_key_is_read(given, capfd):
    arguments, processes = given
    file = memory.beside(Path(arguments[3]))
    remembered = Memory(withdrawn=frozenset({b"n" * 32}), earlier=frozenset({b"r" * 32}), barrier_us=17)
    memory.save(file, remembered)
    command.main(arguments)
    assert processes[0][0].controller.memory == remembered
    file.write_text("{")
    refused(capfd, arguments, file.name)


def test_a_memory_of_the_schema_before_is_converted_now_and_written(given):
    arguments, processes = given
    file = memory.beside(Path(arguments[3]))
    content = {"named": [], "withdrawn": ["aa" * 32], "latched": "NONE"}
    digest = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    document = {"schema": "cutgate.sim-memory/1", "content": content, "sha256": digest}
    file.write_text(json.dumps(document), encoding="ascii")
    file.chmod(0o600)
    before_us = time.time_ns() // 1000
    command.main(arguments)
    remembered = processes[0][0].controller.memory
    assert before_us <= remembered.barrier_us <= time.time_ns() // 1000
    assert remembered == Memory(earlier=frozenset({b"\xaa" * 32}), barrier_us=remembered.barrier_us)
    assert memory.load(file, now_us=0) == remembered


def test_the_controller_and_its_endpoint_have_the_key_of_the_file(given, capfd):
    arguments, processes = given
    command.main(arguments)
    ((process, _),) = processes
    own = fingerprint(bytes(range(32)))
    assert process.controller.identity.key_fingerprint == own
    assert f"key {arguments[3]}, fingerprint {own}" in capfd.readouterr().out
    assert process.port.endpoint._key.fingerprint == own


def test_a_memory_that_cannot_be_written_stops_the_start(given, capfd, monkeypatch):
    arguments, processes = given

    def fail(_descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", fail)
    refused(capfd, arguments, "sim-memory.json: the memory cannot be written: ", "No space left")
    assert processes == []


def test_a_memory_is_written_at_the_first_start(given):
    arguments, _ = given
    command.main(arguments)
    assert memory.beside(Path(arguments[3])).exists()


def test_a_fault_that_was_latched_is_said_at_the_start(given, capfd):
    arguments, processes = given
    memory.save(memory.beside(Path(arguments[3])), Memory(latched=StopCause.SECOND_NODE))
    command.main(arguments)
    out = capfd.readouterr().out
    assert "state FAULT; " in out
    assert "a fault was latched before power-up (SECOND_NODE): acknowledge it, then reset" in out
    assert processes[0][0].controller.cause is StopCause.SECOND_NODE


def test_a_time_scale_is_said_to_be_for_simulation_only(given, capfd):
    arguments, _ = given
    command.main([*arguments, "--time-scale", "5"])
    assert "simulation only: the plant runs 5 times as fast as the clock" in capfd.readouterr().out
    command.main(arguments)
    assert "simulation only" not in capfd.readouterr().out


@pytest.mark.parametrize(
    ("more", "texts"),
    [
        (["--time-scale", "0"], ["--time-scale is 0", "must be 0.001 to 1000"]),
        (["--time-scale", "1.0005"], ["--time-scale is 1.0005", "in whole thousandths"]),
        (["--time-scale", "0.0005"], ["--time-scale is 0.0005"]),
        (["--time-scale", "inf"], ["--time-scale is inf"]),
        (["--time-scale", "nan"], ["--time-scale is nan"]),
        (["--time-scale", "1e9"], ["must be 0.001 to 1000"]),
        (["--joints", "0,70,250,0"], ["--joints is '0,70,250,0'", "five numbers"]),
        (["--joints", "0,70,250,0,nan"], ["--joints is ", "five numbers"]),
        (["--joints", "0,70,250,0,x"], ["--joints is ", "five numbers"]),
        (
            ["--joints=-81,70,451,0,55"],
            ["--joints: ", "q0 = -81.000000 deg is outside", "q2 = 451.000000 mm"],
        ),
        (["--joints", "9000,70,250,0,55"], ["--joints: ", "name joints that the bus can report"]),
        (["--fault", "explode"], ["--fault: ", "'explode' is not known"]),
        (["--fault", "hang@moon"], ["--fault: ", "state must be one of"]),
        (["--fault", "lose Heartbeat"], ["--fault: ", "message must be one of ControllerFault"]),
        (["--robot", "nowhere.toml"], ["nowhere.toml"]),
        (["--key", "nowhere.key"], ["nowhere.key"]),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(given, capfd, more, texts):
    refused(capfd, [*given[0], *more], *texts)


def test_limits_without_any_place_that_the_bus_can_report_are_said_in_degrees(given, capfd, tmp_path):
    text = Path(given[0][1]).read_text(encoding="utf-8")
    far = tmp_path / "far.toml"
    far.write_text(re.sub(r"q3_deg = .*", "q3_deg = [3000.0, 4000.0]", text), encoding="utf-8")
    refused(
        capfd,
        [*given[0], "--robot", str(far)],
        "no place inside the limits of robot.toml can be reported: q3 is 3500.000 deg, a joints frame carries +-2621",
    )


def test_there_is_no_key_built_in(given, capfd):
    refused(capfd, given[0][:2], "no key file is given (--key)")


def test_an_interface_needs_its_channel(given, capfd):
    refused(capfd, given[0][:-2], "--interface needs --channel")


@pytest.mark.parametrize(
    ("more", "channel", "fd"),
    [([], "there", False), (["--channel", "other"], "other", False), (["--fd"], "there", True)],
)
def test_without_an_interface_the_default_is_taken(given, monkeypatch, more, channel, fd):
    opened = []
    monkeypatch.setattr(command, "default_interface", lambda: ("cutgate", "there"))
    monkeypatch.setattr(command, "open_bus", lambda *place, fd: opened.append((*place, fd)) or Bus())
    assert command.main([*given[0][:4], *more]) == command.OK
    assert opened == [("cutgate", channel, fd)]
    ((process, _),) = given[1]
    assert process.port.endpoint.is_fd(0x641) is fd


@pytest.mark.parametrize(
    "error",
    [can.CanInitializationError("no bus"), can.CanOperationError("gone"), RuntimeDirectoryError("mode")],
)
def test_a_bus_that_cannot_be_used_is_exit_code_2(given, capfd, monkeypatch, error):
    def fail(*_, **_fd):
        raise error

    monkeypatch.setattr(command, "open_bus", fail)
    refused(capfd, given[0], str(error))


@pytest.mark.parametrize(
    ("message", "used"),
    [
        (can.Message(arbitration_id=IDS[RuntimeHeartbeat], is_extended_id=False), True),
        (can.Message(arbitration_id=0x601, is_extended_id=False), True),
        (can.Message(arbitration_id=0x123, is_extended_id=False), False),
        (can.Message(arbitration_id=IDS[RuntimeHeartbeat], is_extended_id=True), False),
        (None, False),
    ],
)
def test_a_bus_that_carries_our_frames_already_is_refused(given, capfd, monkeypatch, message, used):
    monkeypatch.setattr(command, "LISTEN_S", 0.01)
    monkeypatch.setattr(command, "open_bus", lambda *_, **_fd: Bus(message))
    if used:
        refused(capfd, given[0], "already carries cutgate frames", f"0x{message.arbitration_id:03X}")
    else:
        assert command.main(given[0]) == command.OK


def test_an_error_of_the_program_is_one_line_and_exit_code_70(given, capfd, monkeypatch):
    def fail(*_):
        raise ValueError("one\ntwo")

    monkeypatch.setattr(command.Process, "run", fail)
    assert command.main(given[0]) == command.INTERNAL
    assert capfd.readouterr().err == "cutgate sim: internal error: ValueError: one two\n"


def test_words_are_read_without_sharing_the_terminal(given):
    arguments, processes = given
    command.main(arguments)
    assert processes[0][0]._commands == ("what is typed", command.ConsoleCommand)
