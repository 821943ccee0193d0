"""A session as can-utils record it, read by ``cutgate decode``, and played again to either side: it enables nothing."""

import json
import os
import shutil
import signal
import subprocess
from collections import Counter
from contextlib import contextmanager

import can
import pytest

from cutgate.config.bus import has_socketcan, open_bus
from cutgate.protocol import records
from cutgate.protocol.frames import CONTROL_IDS, FRAMES, SENT_BY, ControllerHeartbeat
from cutgate.protocol.records import Side
from cutgate.runtime.commands.app import execute
from tests.logs import judged
from tests.system.harness import FAST, Rig, state_of
from tests.vcan.interfaces import OWN, interfaces
from tests.vcan.sessions import assert_sound

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(not has_socketcan(), reason="the kernel has no vcan0"),
    pytest.mark.skipif(
        not (shutil.which("candump") and shutil.which("canplayer")),
        reason="needs candump and canplayer: apt-get install can-utils",
    ),
]

END_S = 10.0
PLAY_S = 30.0
MARK = can.Message(arbitration_id=0x7FF, is_extended_id=False)


@contextmanager
def candump(rig, file):
    """Every frame on the rig's bus meanwhile, in a file as ``candump -L`` writes it; first of all a mark."""
    command = ["candump", "-L", "-r", "1000000", rig.channel]
    with file.open("wb") as out, subprocess.Popen(command, stdout=out) as process:
        try:
            with open_bus(rig.interface, rig.channel) as bus:
                rig.until(lambda: bus.send(MARK) or file.stat().st_size)
            yield
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(END_S)


def canplayer(file, *how):
    """Play a recorded file to its end, as it was unless told otherwise: with its own pauses."""
    subprocess.run(["canplayer", *how, "-I", str(file)], check=True, timeout=PLAY_S, capture_output=True)


def of_one_side(recorded, side, target):
    """What one side sent of a recorded session, in a file of its own."""
    lines = recorded.read_text(encoding="ascii").splitlines(keepends=True)
    target.write_text("".join(line for line in lines if identifier(line) in SENT_BY[side]), encoding="ascii")
    assert target.stat().st_size
    return target


def identifier(line):
    """Of a line of ``candump -L``."""
    return int(line.split()[2].partition("#")[0], 16)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the parts of all sessions lie, on a bus of its own."""
    if os.geteuid() != 0:
        pytest.skip("needs root to make an interface")
    with interfaces("vcan", OWN):
        yield tmp_path_factory.mktemp("recorded")


@pytest.fixture(scope="module")
def recorded(folder):
    """A session that has cut, as candump saw it, and the frames that another socket saw."""
    file = folder / "session.log"
    with Rig(folder, "socketcan", OWN) as rig, candump(rig, file):
        sim, run = rig.cutting(scale=FAST)
        assert run.exit() == 0
        sim.signal(signal.SIGINT)
        assert sim.exit() == 0
    lines = file.read_text(encoding="ascii").splitlines(keepends=True)
    file.write_text(
        "".join(line for line in lines if identifier(line) != MARK.arbitration_id), encoding="ascii"
    )
    return file, [m for m in rig.bus.frames if m.arbitration_id != MARK.arbitration_id]


def test_candump_sees_what_every_socket_sees_and_decode_reads_it(recorded, capsys):
    file, seen = recorded
    lines = [line.split()[2] for line in file.read_text(encoding="ascii").splitlines()]
    assert lines == [f"{m.arbitration_id:03X}#{m.data.hex().upper()}" for m in seen]
    capsys.readouterr()
    assert execute(["decode", "--json", str(file)]) == 0
    read = capsys.readouterr()
    told = [json.loads(line) for line in read.out.splitlines()]
    single = Counter(
        message["message"] for message in told if message["id"] in {f"0x{n:03X}" for n in FRAMES}
    )
    assert single == Counter(FRAMES[m.arbitration_id].__name__ for m in seen if m.arbitration_id in FRAMES)
    assert {"Open", "Opened", "Permit", "Start", "PathBlock"} <= {message["message"] for message in told}
    names = [message["message"] for message in told]
    session = told[names.index("Open") : names.index("RuntimeStop")]
    # Before and after it the controller announces itself to nobody.
    assert not [message for message in session if message["notes"]]


def test_what_the_runtime_said_enables_nothing_when_it_is_played_to_the_controller_again(folder, recorded):
    played = of_one_side(recorded[0], Side.RUNTIME, folder / "runtime.log")
    with Rig(folder, "socketcan", OWN) as rig:
        sim = rig.sim()
        canplayer(played)
        sim.line("refused: ANNOUNCE_NONCE")
        assert state_of(sim) == "INHIBITED"
        assert not rig.bus.all(ControllerHeartbeat)  # no session
        canplayer(recorded[0], "-t")  # its own words as well: somebody else says them
        sim.line(r"state FAULT \(SECOND_NODE\)")
        assert state_of(sim) == "FAULT (SECOND_NODE)"
        assert "state OPEN" not in sim.told


def test_what_the_controller_said_enables_nothing_when_it_is_played_to_a_runtime_again(
    folder, recorded, capsys
):
    played = of_one_side(recorded[0], Side.CONTROLLER, folder / "controller.log")
    with Rig(folder, "socketcan", OWN) as rig:
        run = rig.run(logs="deceived")
        rig.until(lambda: rig.logs("deceived"))
        # It plays the announcement first, perhaps before the runtime hears anything.
        rig.until(lambda: canplayer(played) or rig.bus.records(CONTROL_IDS[Side.RUNTIME]))
        assert run.exit() == 1
        assert "the controller did not open the session" in run.told
        (log,) = rig.logs("deceived")
        assert "permitted:" not in run.told
        assert judged(log).of("/audit/decision")[-1]["first_out"] == "NOT_ADMITTED"
        assert_sound(log, capsys)
        said = {e.record for e in rig.bus.records(CONTROL_IDS[Side.RUNTIME])}
        assert {type(record) for record in said} == {records.Open}
