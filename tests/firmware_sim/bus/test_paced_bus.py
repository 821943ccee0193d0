"""A hub that models the wire, seen through python-can and through `cutgate bus stat` and `inject`."""

import fcntl
import json
import os
import select
import signal
import socket
import subprocess
import termios
import threading
import time
from array import array
from pathlib import Path

import can
import pytest

from cutgate.config.interpreter import program
from cutgate.firmware_sim.bus import ask, wire
from cutgate.firmware_sim.bus.ask import NotAnsweredError, counts, let_err
from cutgate.firmware_sim.bus.client import VirtualBus
from cutgate.firmware_sim.bus.medium.bits import frame_bits
from cutgate.firmware_sim.bus.messages import frame_of
from cutgate.firmware_sim.bus.serve import main
from cutgate.firmware_sim.hil.hub import hub_process
from tests.firmware_sim.bus.every_bus import WAIT_S, frame
from tests.firmware_sim.bus.test_bus import false_hub, fill

pytestmark = pytest.mark.processes

SLOW = ("--bitrate", "10k")
"""A frame takes 11 ms: a test has time to look."""


@pytest.fixture
def slow_bus(place):
    path = place / "bus.sock"
    with hub_process(path, *SLOW):
        yield path


def stopped(hub):
    hub.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, hub.pid, os.WSTOPPED)


def test_a_full_transmit_queue_answers_as_socketcan_does(place, join):
    path = place / "bus.sock"
    with hub_process(path, *SLOW, "--queue", "3") as hub:
        bus, other = join(path), join(path)
        stopped(hub)  # nothing leaves: the queue alone counts
        for _ in range(3):
            bus.send(frame(), timeout=0)
        for timeout in (0, 0.01):
            with pytest.raises(can.CanTimeoutError, match="of 3 frames, is full"):
                bus.send(frame(), timeout=timeout)
        hub.send_signal(signal.SIGCONT)
        for _ in range(3):
            assert other.recv(WAIT_S) is not None
        bus.send(frame(2), timeout=WAIT_S)
        assert other.recv(WAIT_S).arbitration_id == 2


def test_a_send_that_waits_for_room_goes_when_there_is_some(slow_bus, join):
    bus, other = join(slow_bus), join(slow_bus)
    for number in range(20):
        bus.send(frame(number))
    assert [other.recv(WAIT_S).arbitration_id for _ in range(20)] == list(range(20))


def test_frames_are_as_far_apart_as_their_bits_are_long(slow_bus, join):
    bus, other = join(slow_bus), join(slow_bus)
    message = frame(5, b"12345678")
    for _ in range(10):
        bus.send(message)
    stamps = [other.recv(WAIT_S).timestamp for _ in range(10)]
    period_s = (frame_bits(frame_of(message, fd=False)).nominal + 3) / 10_000
    assert (stamps[-1] - stamps[0]) / 9 == pytest.approx(period_s, rel=1e-4)


def test_the_lower_identifier_goes_first_whoever_was_first(slow_bus, join):
    one, two, listener = join(slow_bus), join(slow_bus), join(slow_bus)
    one.send(frame(0x7FF))  # on the wire for 5 ms and more; meanwhile
    for number in (0x300, 0x301):
        one.send(frame(number))
    two.send(frame(0x100))
    order = [listener.recv(WAIT_S).arbitration_id for _ in range(4)]
    assert order in ([0x7FF, 0x100, 0x300, 0x301], [0x100, 0x7FF, 0x300, 0x301], [0x7FF, 0x300, 0x100, 0x301])
    assert order[0] == 0x7FF


def test_who_waits_for_room_is_told_when_the_hub_ends(place, join):
    path = place / "bus.sock"
    with hub_process(path, *SLOW, "--queue", "1") as hub:
        bus, _other = join(path), join(path)
        stopped(hub)
        bus.send(frame(), timeout=0)
        ended = []

        def waits():
            try:
                bus.send(frame())
            except can.CanOperationError as error:
                ended.append(str(error))

        thread = threading.Thread(target=waits)
        thread.start()
        hub.kill()
        thread.join(WAIT_S)
        assert "has ended" in ended[0]
        with pytest.raises(can.CanOperationError, match="has ended"):
            bus.send(frame(), timeout=0)
        bus.shutdown()


def test_fd_needs_the_bit_rate_of_its_data(place, join, slow_bus):
    with pytest.raises(can.CanInitializationError, match=r"carries no FD frames; give it .*bus serve --fd"):
        join(slow_bus, fd=True)


def test_a_node_that_goes_off_and_comes_back_is_told_so(place, join):
    path = place / "bus.sock"
    with hub_process(path, "--bitrate", "500k", "--restart-ms", "20"):
        bus, other = join(path), join(path)
        assert let_err(path, {"error": "bit", "sender": 1, "count": 32}) == "to come: 32 x bit"
        bus.send(frame(5))
        numbers = [bus.recv(WAIT_S).arbitration_id for _ in range(4)]
        assert numbers == [0x204, 0x204, 0x240, 0x300]
        bus.send(frame(6), timeout=WAIT_S)
        assert other.recv(WAIT_S).arbitration_id == 6


def test_what_was_queued_goes_although_its_program_has_ended(slow_bus, join):
    listener = join(slow_bus)
    brief = join(slow_bus)
    for number in range(5):
        brief.send(frame(number))
    brief.shutdown()
    assert [listener.recv(WAIT_S).arbitration_id for _ in range(5)] == list(range(5))


# ---------------------------------------------------------------- bus stat, bus inject


def test_stat_counts_what_everybody_does(slow_bus, join):
    bus, other = join(slow_bus), join(slow_bus)
    bus.send(frame(5))
    assert other.recv(WAIT_S) is not None
    document = counts(slow_bus)
    assert document["schema"] == "cutgate.bus/1"
    assert [entry["sent"] for entry in document["clients"]] == [1, 0]
    assert document["clients"][0]["name"] == f"client 1 (process {os.getpid()})"


def said(*arguments):
    command = program("cutgate.firmware_sim", "bus", *map(str, arguments))
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=WAIT_S)


def test_the_command_shows_load_and_errors(slow_bus, join):
    bus, other = join(slow_bus), join(slow_bus)
    done = said("inject", "crc", "--id", "7FF", "--socket", slow_bus)
    assert (done.returncode, done.stdout) == (0, "to come: 1 x crc\n")
    bus.send(frame(0x7FF))
    assert other.recv(WAIT_S) is not None
    done = said("stat", "--socket", slow_bus, "--interval", "0.05", "--count", "2")
    assert done.returncode == 0, done.stderr
    assert "10 kbit/s: load 0.0%, 0 frames/s, 0 error frames in 0." in done.stdout
    assert ", 1 in all" in done.stdout
    assert all(len(line) <= 80 for line in done.stdout.splitlines())
    document = json.loads(said("stat", "--socket", slow_bus, "--json").stdout)
    assert document["error_frames"] == 1


def test_the_page_goes_on_until_it_is_ended(slow_bus):
    command = program("cutgate.firmware_sim", "bus", "stat", "--socket", str(slow_bus), "--interval", "0.01")
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as shown:
        for _ in range(3):
            assert shown.stdout.readline() != ""
        shown.send_signal(signal.SIGINT)
        shown.stdout.read()
        assert shown.wait(WAIT_S) == 0


def test_a_reader_who_stops_reading_does_not_keep_it_from_ending(slow_bus):
    command = program("cutgate.firmware_sim", "bus", "stat", "--socket", str(slow_bus), "--interval", "0.001")
    with subprocess.Popen(command, stdout=subprocess.PIPE, bufsize=0) as shown:
        room = fcntl.fcntl(shown.stdout, fcntl.F_SETPIPE_SZ, 4096)
        until_s = time.monotonic() + WAIT_S
        while array("i", fcntl.ioctl(shown.stdout, termios.FIONREAD, bytes(4)))[0] < 0.9 * room:
            assert time.monotonic() < until_s
            select.select([], [], [], 0.01)
        shown.send_signal(signal.SIGTERM)
        assert shown.wait(WAIT_S) == 0


@pytest.mark.parametrize(
    "asked", [("stat", "--json"), ("stat", "--count", "1", "--interval", "0.01"), ("inject", "bit")]
)
def test_what_nobody_gets_is_no_success(slow_bus, asked):
    command = program("cutgate.firmware_sim", "bus", *asked, "--socket", str(slow_bus))
    reading, unread = os.pipe()
    os.close(reading)
    for output, code in ((unread, 141), (os.open("/dev/full", os.O_WRONLY), 74)):
        assert subprocess.run(command, stdout=output, check=False, timeout=WAIT_S).returncode == code
        os.close(output)


def test_what_cannot_be_injected_is_refused_with_code_2(slow_bus, virtual_bus):
    done = said("inject", "bit", "--sender", "9", "--socket", slow_bus)
    assert (done.returncode, done.stdout) == (2, "")
    assert "refused: sender is 9" in done.stderr
    assert "has no wire to err" in said("inject", "bit", "--socket", virtual_bus).stderr


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("serve", "--fd", "5M"), "give --bitrate as well"),
        (("serve", "--bitrate", "9M"), "give 10k to 8M"),
        (("serve", "--bitrate", "fast"), "give 10k to 8M"),
        (("serve", "--bitrate", "1M", "--queue", "0"), "give a whole number of 1 to 10000"),
        (("inject", "bit", "--id", "xyz"), "in hexadecimal"),
        (("stat", "--interval", "0"), "give seconds above 0"),
        (("stat", "--interval", "-1"), "give seconds above 0"),
        (("stat", "--count", "0"), "give a whole number of 1"),
    ],
)
def test_what_is_wrong_on_the_command_line_is_named(place, capfd, arguments, why):
    try:
        code = main([*arguments, "--socket", str(place / "bus.sock")])
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert why in capfd.readouterr().err


def test_without_a_hub_there_is_nothing_to_count(place, capfd):
    assert main(["stat", "--socket", str(place / "none.sock")]) == 2
    assert "no hub is serving there: start one with `cutgate bus serve`" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (wire.text(wire.HubKind.STATUS, "[" * 5000).pack(), "cannot be read"),
        (wire.text(wire.HubKind.STATUS, "{}").pack(), "does not count as cutgate.bus/1"),
        (wire.refused("no").pack(), "no$"),
        (b"\x07", "record of 1 bytes"),
        (b"", "record of 0 bytes"),
    ],
)
def test_what_is_no_count_is_refused(place, answer, why):
    with false_hub(place / "bus.sock", *([answer] if answer else [])) as done:
        if not answer:
            done.set()
        with pytest.raises(NotAnsweredError, match=why):
            counts(place / "bus.sock")


def test_a_hub_that_does_not_answer_is_waited_for_a_bounded_time(place, monkeypatch):
    monkeypatch.setattr(ask, "ANSWER_S", 0.01)
    with (
        false_hub(place / "bus.sock"),
        pytest.raises(NotAnsweredError, match=r"did not answer within 0\.01 s"),
    ):
        counts(place / "bus.sock")


def test_a_hub_of_another_user_is_asked_nothing(slow_bus, monkeypatch):
    mine = os.geteuid()
    monkeypatch.setattr("cutgate.firmware_sim.bus.peer.os.geteuid", lambda: mine + 1)
    with pytest.raises(NotAnsweredError, match="not ours"):
        counts(slow_bus)


# ---------------------------------------------------------------- hubs that lie about the queue


def test_a_hub_that_says_a_queue_and_counts_no_room_is_refused(place):
    welcome = wire.HubRecord(wire.HubKind.WELCOME, number=10).pack()
    with (
        false_hub(place / "bus.sock", welcome),
        pytest.raises(can.CanInitializationError, match="gives no room for it"),
    ):
        VirtualBus(str(place / "bus.sock"))


def descriptors():
    return len(list(Path("/proc/self/fd").iterdir()))


def test_a_descriptor_that_comes_with_a_refusal_is_closed(place):
    path = place / "bus.sock"
    before = descriptors()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(path))
        listener.listen()

        def answers():
            connection, _ = listener.accept()
            connection.recv(2000)
            socket.send_fds(connection, [wire.refused("no").pack()], [listener.fileno()])
            connection.close()

        thread = threading.Thread(target=answers)
        thread.start()
        with pytest.raises(can.CanInitializationError, match="the hub refused: no"):
            VirtualBus(str(path))
        thread.join(WAIT_S)
    assert descriptors() == before


def test_room_is_given_back_where_the_socket_takes_nothing(place, join, monkeypatch):
    """A hub that stands still with its socket full: what was not sent has taken no place."""
    path = place / "bus.sock"
    with hub_process(path, "--bitrate", "1M", "--queue", "5000") as hub:
        bus, other = join(path), join(path)
        stopped(hub)
        sent = fill(bus)
        with pytest.raises(can.CanTimeoutError, match="did not take the frame"):
            bus.send(frame(), timeout=0)
        hub.send_signal(signal.SIGCONT)
        for _ in range(sent):
            assert other.recv(WAIT_S) is not None
        deadline = time.monotonic() + WAIT_S
        for _ in range(5000):
            bus.send(frame(2), timeout=deadline - time.monotonic())
