"""Whole sessions on real SocketCAN, every part a process of its own; the first ones and the demo started as a user starts them."""

import json
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import can
import pytest

from cutgate.config.bus import SOCKETCAN_CHANNEL, has_socketcan, open_bus
from cutgate.protocol.frames import BULK_IDS, ControllerFault
from cutgate.protocol.states import StopCause
from tests.system.harness import FAST, POSES, Observer, Rig, registration, state_of
from tests.vcan.interfaces import WIRE, ip, refused_frames, slow_down
from tests.vcan.sessions import assert_cut, assert_sound

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(not has_socketcan(), reason="the kernel has no vcan0"),
]

VCAN0 = ("socketcan", SOCKETCAN_CHANNEL)
QUEUE_FRAMES = 10
FILLING_S = 0.04
"""Seldom enough that all who hear it have the time: on a busy machine a loop would stand still."""
MARK = can.Message(arbitration_id=0x7FF, is_extended_id=False)
DEMO = [sys.executable, "-m", "cutgate.runtime.cli", "demo", "--json"]


@pytest.fixture
def rig(tmp_path):
    """Sessions on vcan0."""
    with Rig(tmp_path, *VCAN0) as made:
        yield made


def test_a_session_cuts_every_segment_and_leaves_a_sound_log(rig, capsys):
    sim, run = rig.sim(scale=FAST, fresh=True), rig.run(json=True, fresh=True)
    run.line("permitted:")
    rig.begin(sim, run)
    assert run.exit() == 0
    assert f"DONE: {POSES - 1} segments executed" in sim.line("state DONE")
    assert rig.at_rest(sim) == "INHIBITED"
    document = json.loads(run.document)
    assert (document["outcome"], document["cause"], document["log"]["closed"]) == ("completed", "NONE", True)
    assert_sound(rig.logs()[-1], capsys)


def test_a_path_that_leaves_the_workspace_is_refused(rig, capsys):
    shifted = registration("shifted", (600, 0, 200))
    (rig.folder / "shifted.json").write_text(json.dumps(shifted), encoding="utf-8")
    sim, run = rig.sim(fresh=True), rig.run(json=True, registration="shifted.json", fresh=True)
    assert run.exit() == 1
    document = json.loads(run.document)
    assert (document["outcome"], document["verdict"]["verdict"]) == ("not_admitted", "inadmissible")
    assert rig.at_rest(sim) == "INHIBITED"
    assert "state PERMITTED" not in sim.told
    assert_sound(rig.logs()[-1], capsys)


def test_the_operator_stops_a_cut(rig, capsys):
    sim, run = rig.cutting()
    run.say("stop")
    assert run.exit() == 3
    rig.bus.single(ControllerFault, lambda fault: fault.cause is StopCause.OPERATOR_STOP)
    assert rig.at_rest(sim) == "INHIBITED (OPERATOR_STOP)"
    assert_sound(rig.logs()[-1], capsys)


@pytest.mark.parametrize(
    ("fails", "cured"),
    [
        ("set {} down", ["set {} up"]),
        ("del {}", ["add dev {} type vcan", "set {} up"]),
    ],
    ids=["down", "deleted"],
)
def test_an_interface_that_fails_in_mid_cut_stops_both_sides_and_once_it_is_back_the_next_session_cuts(
    tmp_path, own_interface, capsys, fails, cured
):
    """Down is what a driver in trouble does, deleted an adapter that is pulled out."""
    with Rig(tmp_path, "socketcan", own_interface) as rig:
        sim, run = rig.cutting()
        ip(*fails.format(own_interface).split())
        assert run.exit() == 3
        assert sim.exit() == 2
        assert state_of(sim) == "INHIBITED (BUS_FAILED)"
        assert "state DONE" not in sim.told
        assert rig.log().of("/audit/decision")[-1]["first_out"] == "BUS_FAILED"
        # who notices first, who reads or who writes, is the kernel's affair, and so is the word for it
        assert re.search(r"the bus failed: .*(Network is down|No such device)", run.told), run.told
        assert_sound(rig.logs()[-1], capsys)
    for words in cured:
        ip(*words.format(own_interface).split())
    with Rig(tmp_path, "socketcan", own_interface) as rig:
        sim, run = rig.cutting(scale=FAST)
        assert_cut(rig, sim, run, capsys)
        assert len(rig.logs()) == 2


@contextmanager
def crowded(interface: str) -> Iterator[list[int]]:
    """Another node that fills the transmit queue again and again with the least urgent frames; how often it found it full."""
    ended, refusals = threading.Event(), [0]

    def fill() -> None:
        with open_bus("socketcan", interface) as bus:
            while not ended.wait(FILLING_S):
                try:
                    for _ in range(2 * QUEUE_FRAMES):  # where they leave as fast as they come it never is
                        bus.send(MARK, timeout=0)
                except can.CanTimeoutError:
                    refusals[0] += 1

    thread = threading.Thread(target=fill)
    thread.start()
    try:
        yield refusals
    finally:
        ended.set()
        thread.join()


@pytest.mark.parametrize("fd", [False, True], ids=["classic", "fd"])
def test_a_full_transmit_queue_holds_up_neither_upload_nor_cut(tmp_path, narrow_interface, capsys, fd):
    with Rig(tmp_path, "socketcan", narrow_interface) as rig:
        slow_down(narrow_interface, "100kbit")  # ten frames in 13 ms: a third of the time the queue is full
        with crowded(narrow_interface) as refusals:
            run, sim = rig.run(fd=fd), rig.sim(scale=FAST, fd=fd)
            run.line("permitted:")
        # What was refused beside the crowd's own was ours.
        assert refused_frames(narrow_interface) > refusals[0], "the queue was full, and nobody noticed"
        slow_down(narrow_interface, WIRE)
        rig.begin(sim, run)
        assert run.exit() == 0
        assert f"DONE: {POSES - 1} segments executed" in sim.line("state DONE")
        assert_sound(rig.logs()[-1], capsys)


def test_a_queue_that_another_node_fills_while_it_cuts_holds_up_neither_cut_nor_stop(
    tmp_path, narrow_interface, capsys
):
    with Rig(tmp_path, "socketcan", narrow_interface) as rig:
        sim, run = rig.cutting()
        # ten frames in 26 ms: filled each 40 ms the queue is seldom empty
        slow_down(narrow_interface, "50kbit")
        before = refused_frames(narrow_interface)
        with crowded(narrow_interface) as refusals:
            rig.until(lambda: refusals[0] > 50)
            run.say("stop")
            assert run.exit() == 3
        # What was refused beside the crowd's own was ours.
        assert refused_frames(narrow_interface) - before > refusals[0]
        rig.bus.single(ControllerFault, lambda fault: fault.cause is StopCause.OPERATOR_STOP)
        assert rig.at_rest(sim) == "INHIBITED (OPERATOR_STOP)"
        assert_sound(rig.logs()[-1], capsys)


@pytest.mark.parametrize("fd", [False, True], ids=["classic", "fd"])
def test_the_demo_goes_as_told_and_its_logs_hold_what_the_kernel_carried(tmp_path, fd):
    command = [*DEMO, "--out", str(tmp_path / "demo"), *["--fd"] * fd]
    with closing(Observer(*VCAN0)) as observer:
        done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
        with open_bus(*VCAN0) as bus:
            bus.send(MARK)
        observer.frame(lambda message: message.arbitration_id == MARK.arbitration_id)
    assert done.returncode == 0, done.stderr
    assert "using socketcan/vcan0" in done.stderr
    document = json.loads(done.stdout)
    assert document["as_told"] is True
    reviews = [(review["verify"], review["replay"]) for review in document["reviews"]]
    assert reviews == [("OK", "IDENTICAL")] * 2

    assert all(m.is_fd is m.bitrate_switch is (fd and m.arbitration_id in BULK_IDS) for m in observer.frames)
    assert max(len(m.data) for m in observer.frames) == (64 if fd else 8)
    carried = by_identifier(candump_words(message) for message in observer.frames)
    for session in document["sessions"]:
        lines = Path(session["log"]["candump"]).read_text(encoding="ascii").splitlines()
        for can_id, kept in by_identifier(line.split()[2] for line in lines).items():
            assert kept in carried[can_id], can_id  # the controller also speaks before and after a session


def candump_words(message: can.Message) -> str:
    """A frame as candump writes it; of FD flags it shows bit rate switch (1) and FD itself (4)."""
    return f"{message.arbitration_id:03X}#{'#5' if message.is_fd else ''}{message.data.hex().upper()}"


def by_identifier(words) -> dict[str, str]:
    """All frames of each identifier, in order; between two senders the order is each reader's own."""
    found: dict[str, str] = {}
    for word in words:
        can_id = word.partition("#")[0]
        found[can_id] = found.get(can_id, " ") + word + " "
    return found
