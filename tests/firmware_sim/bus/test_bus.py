"""What the virtual bus guarantees, seen through python-can and a hub in a process of its own."""

import os
import select
import signal
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager, suppress

import can
import pytest

from cutgate.config.bus import open_bus
from cutgate.config.key import new_key_file
from cutgate.firmware_sim import command
from cutgate.firmware_sim.bus import wire
from cutgate.firmware_sim.bus.client import ERROR_CONTROLLER, VirtualBus
from cutgate.firmware_sim.hil.hub import hub_process
from tests.firmware_sim.bus.every_bus import WAIT_S, frame, received

pytestmark = pytest.mark.processes


def numbered(count: int):
    return [frame(index % 0x700, index.to_bytes(8, "big")) for index in range(count)]


def contents(messages):
    return [(m.arbitration_id, bytes(m.data)) for m in messages]


def test_any_python_can_program_joins_by_interface_and_channel(virtual_bus):
    with can.Bus(interface="cutgate", channel=str(virtual_bus)) as bus:
        assert isinstance(bus, VirtualBus)


def test_a_frame_reaches_every_other_client_and_never_its_sender(virtual_bus, join):
    buses = [join(virtual_bus) for _ in range(4)]
    buses[1].send(frame(0x123, b"abc"))
    for other in (0, 2, 3):
        got = buses[other].recv(WAIT_S)
        assert (got.arbitration_id, bytes(got.data), got.is_rx) == (0x123, b"abc", True)
    buses[0].send(frame(0x7))  # had the sender got its own frame, it would stand before this one
    assert buses[1].recv(WAIT_S).arbitration_id == 0x7


def test_own_frames_come_back_only_if_asked_for_and_are_marked(virtual_bus, join):
    bus = join(virtual_bus, receive_own_messages=True)
    bus.send(frame(0x10))
    assert not bus.recv(WAIT_S).is_rx


@pytest.mark.parametrize(
    "message",
    [
        frame(0x7FF, bytes(range(8))),
        frame(0),
        can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=b"\x01"),
        can.Message(arbitration_id=0x5, is_extended_id=False, is_remote_frame=True, dlc=8),
        can.Message(arbitration_id=0x4, is_extended_id=False, is_error_frame=True, data=bytes(8)),
        frame(0x1, bytes(64), is_fd=True, bitrate_switch=True),
        frame(0x1, bytes(12), is_fd=True, error_state_indicator=True),
    ],
)
def test_a_frame_arrives_as_it_was_sent(virtual_bus, join, message):
    sender, receiver = join(virtual_bus, fd=True), join(virtual_bus, fd=True)
    sender.send(message)
    got = receiver.recv(WAIT_S)
    assert got.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    assert got.timestamp > 1e9


def test_fd_frames_reach_only_clients_opened_with_fd(virtual_bus, join):
    sender, classic, flexible = join(virtual_bus, fd=True), join(virtual_bus), join(virtual_bus, fd=True)
    sender.send(frame(0x1, bytes(64), is_fd=True))
    sender.send(frame(0x2))
    assert [m.arbitration_id for m in received(flexible, 2)] == [1, 2]
    assert classic.recv(WAIT_S).arbitration_id == 2


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (can.Message(arbitration_id=0x800, is_extended_id=False), "identifier 0x800"),
        (can.Message(arbitration_id=0x2000_0000, is_extended_id=True), "must be 0x0 to 0x1fffffff"),
        (can.Message(arbitration_id=-1), "identifier -0x1"),
        (can.Message(arbitration_id=1, data=bytes(9)), "must be 0 to 8"),
        (can.Message(arbitration_id=1, data=bytes(65)), "classic frame of 65"),
        (can.Message(arbitration_id=1, data=bytes(9), is_fd=True), "FD frame of 9"),
        (can.Message(arbitration_id=1, is_fd=True, is_error_frame=True), "neither a remote nor an error"),
        (can.Message(arbitration_id=1, bitrate_switch=True), "FD frames only"),
    ],
)
def test_what_no_can_bus_carries_is_refused_and_the_bus_goes_on(virtual_bus, join, message, why):
    sender, receiver = join(virtual_bus, fd=True), join(virtual_bus)
    with pytest.raises(can.CanOperationError, match=why):
        sender.send(message)
    sender.send(frame(0x3))
    assert receiver.recv(WAIT_S).arbitration_id == 3


def test_an_fd_frame_is_refused_on_a_bus_opened_without_fd(virtual_bus, join):
    with pytest.raises(can.CanOperationError, match="fd=True"):
        join(virtual_bus).send(frame(1, is_fd=True))


def test_all_clients_see_one_order(virtual_bus, join):
    count, senders = 400, 3
    buses = [join(virtual_bus, receive_own_messages=True) for _ in range(senders)]

    def send_all(index):
        for message in numbered(count):
            message.arbitration_id = index
            buses[index].send(message)

    threads = [threading.Thread(target=send_all, args=(index,)) for index in range(senders)]
    for thread in threads:
        thread.start()
    seen = [contents(received(bus, count * senders)) for bus in buses]
    for thread in threads:
        thread.join()
    assert seen[0] == seen[1] == seen[2]
    for index in range(senders):
        assert [data for number, data in seen[0] if number == index] == [
            bytes(m.data) for m in numbered(count)
        ]


def test_twenty_thousand_frames_arrive_complete_and_in_order(virtual_bus, join):
    sender, receiver = join(virtual_bus), join(virtual_bus)
    sent = numbered(20_000)
    thread = threading.Thread(target=lambda: [sender.send(message) for message in sent])
    thread.start()
    got = received(receiver, len(sent))
    thread.join()
    assert contents(got) == contents(sent)
    assert receiver.lost_frames == 0
    stamps = [message.timestamp for message in got]
    assert stamps == sorted(stamps)


def test_a_hub_killed_in_mid_traffic_raises_at_every_client_every_time(place, join):
    path = place / "bus.sock"
    with hub_process(path) as hub:
        one, two, idle = join(path), join(path), join(path)
        one.send(frame(1))
        assert two.recv(WAIT_S) is not None
        hub.kill()
        hub.wait()
        for bus in (one, two):
            for _ in range(3):
                with pytest.raises(can.CanOperationError, match=r"hub .* has ended"):
                    received(bus, 2)
        for bus in (one, idle):
            for _ in range(2):
                with pytest.raises(can.CanOperationError, match="has ended"):
                    bus.send(frame(1))


def test_a_reader_that_waits_is_woken_when_the_hub_ends(place, join):
    path = place / "bus.sock"
    with hub_process(path) as hub:
        bus = join(path)
        woken = []

        def wait():
            try:
                bus.recv(None)
            except can.CanOperationError as error:
                woken.append(error)

        thread = threading.Thread(target=wait)
        thread.start()
        hub.terminate()
        thread.join(WAIT_S)
        assert len(woken) == 1


def test_fileno_serves_poll(virtual_bus, join):
    sender, receiver = join(virtual_bus), join(virtual_bus)
    poll = select.poll()
    poll.register(receiver, select.POLLIN)
    assert poll.poll(0) == []
    sender.send(frame(9))
    assert poll.poll(WAIT_S * 1000) == [(receiver.fileno(), select.POLLIN)]
    assert receiver.recv(0).arbitration_id == 9
    assert receiver.recv(0) is None


def test_recv_without_a_frame_is_none_after_its_time(virtual_bus, join):
    bus = join(virtual_bus)
    assert bus.recv(0.01) is None
    assert bus.recv(-1.0) is None


def test_filters_work_as_on_every_bus(virtual_bus, join):
    sender, receiver = join(virtual_bus), join(virtual_bus, can_filters=[{"can_id": 2, "can_mask": 0x7FF}])
    for number in (1, 2, 3, 2):
        sender.send(frame(number))
    assert [m.arbitration_id for m in received(receiver, 2)] == [2, 2]


def fill(bus):
    """Send until nothing more is taken; how many frames were."""
    sent = 0
    while True:
        try:
            bus.send(frame(1), timeout=0)
        except can.CanTimeoutError:
            return sent
        sent += 1


def test_send_gives_up_when_the_hub_does_not_take_frames_and_the_bus_lives_on(place, join):
    path = place / "bus.sock"
    with hub_process(path) as hub:
        sender, receiver = join(path), join(path)
        hub.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, hub.pid, os.WSTOPPED)
        sent = fill(sender)
        for timeout in (0, 0.001):
            with pytest.raises(can.CanTimeoutError, match="did not take the frame"):
                sender.send(frame(1), timeout=timeout)
        hub.send_signal(signal.SIGCONT)
        assert len(received(receiver, sent)) == sent
        sender.send(frame(2))
        assert receiver.recv(WAIT_S).arbitration_id == 2


def test_after_shutdown_every_call_says_so(virtual_bus):
    bus = open_bus("cutgate", str(virtual_bus))
    bus.shutdown()
    bus.shutdown()
    with pytest.raises(can.CanOperationError, match="was shut down"):
        bus.recv(0)
    with pytest.raises(can.CanOperationError, match="was shut down"):
        bus.send(frame(1))


def test_without_a_hub_the_message_says_how_to_start_one(place):
    for _ in range(2):
        with pytest.raises(can.CanInitializationError, match=r"no hub is serving .* `cutgate bus serve`"):
            open_bus("cutgate", str(place / "none.sock"))


def test_the_error_frame_of_lost_frames_is_numbered_as_linux_does():
    assert ERROR_CONTROLLER == 0x4  # CAN_ERR_CRTL of linux/can/error.h


@contextmanager
def false_hub(path, *answers):
    """Something that listens where a hub would, answers the HELLO with these records, and stays."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(path))
        listener.listen()

        def answer():
            connection, _ = listener.accept()
            connection.recv(2000)
            with suppress(ConnectionError):  # whoever is told nonsense may leave before the rest
                for record in answers:
                    connection.send(record)
            done.wait(WAIT_S)
            connection.close()

        done = threading.Event()
        thread = threading.Thread(target=answer)
        thread.start()
        try:
            yield done
        finally:
            done.set()
            thread.join(WAIT_S)


OTHERS_HUB = """
import os, sys
from pathlib import Path
from cutgate.firmware_sim.bus.hub import Hub
os.setgid(65534)
os.setuid(65534)
with Hub(Path(sys.argv[1])) as hub:
    print("ready", flush=True)
    hub.serve()
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes another user, and can join another's hub")
def test_root_joins_nobodys_hub_also_where_its_socket_is_named(place, capfd):
    place.chmod(0o777)
    path, key = place / "bus.sock", place / "site.key"
    new_key_file(key, bytes(32))
    with subprocess.Popen(
        [sys.executable, "-c", OTHERS_HUB, str(path)], stdout=subprocess.PIPE, text=True
    ) as hub:
        try:
            assert hub.stdout.readline() == "ready\n"
            where = ["--interface", "cutgate", "--channel", str(path)]
            assert command.main(["--robot", "example", "--key", str(key), *where]) == 2
        finally:
            hub.terminate()
    said = capfd.readouterr().err
    assert "uid 65534), must be" in said
    assert str(path) in said


WELCOME = wire.HubRecord(wire.HubKind.WELCOME).pack()


@pytest.mark.parametrize(
    ("answers", "ends", "why"),
    [
        ((), False, "did not answer within"),
        ((), True, "ended before it answered"),
        ((b"\x07" + WELCOME[1:],), False, "framing version 7"),
        ((wire.refused("no room").pack(),), False, "the hub refused: no room"),
    ],
)
def test_a_hub_that_does_not_welcome_is_refused_with_the_reason(place, monkeypatch, answers, ends, why):
    monkeypatch.setattr(
        "cutgate.firmware_sim.bus.client.HELLO_TIMEOUT_S", WAIT_S if ends or answers else 0.01
    )
    with false_hub(place / "bus.sock", *answers) as done:
        if ends:
            done.set()
        with pytest.raises(can.CanInitializationError, match=why):
            VirtualBus(str(place / "bus.sock"))


def test_a_hub_that_accepts_nobody_is_refused_at_once(place):
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as busy,
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as waiting,
    ):
        busy.bind(str(place / "bus.sock"))
        busy.listen(0)
        waiting.connect(str(place / "bus.sock"))
        with pytest.raises(can.CanInitializationError, match="accepts no connection"):
            VirtualBus(str(place / "bus.sock"))


def test_a_hub_that_sends_nonsense_fails_for_good(place):
    with false_hub(place / "bus.sock", WELCOME, b"nonsense", wire.HubRecord(wire.HubKind.FRAME).pack()):
        bus = VirtualBus(str(place / "bus.sock"))
        for _ in range(2):
            with pytest.raises(can.CanOperationError, match="unknown record"):
                bus.recv(WAIT_S)
        bus.shutdown()


def test_a_runtime_directory_open_to_others_is_refused(place, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(place))
    (place / "cutgate").mkdir()
    (place / "cutgate").chmod(0o755)
    with pytest.raises(can.CanInitializationError, match="mode 0700"):
        VirtualBus("bus0")


def test_a_frame_sent_while_the_queue_is_full_leaves_as_soon_as_there_is_room(place, join):
    path = place / "bus.sock"
    with hub_process(path) as hub:
        sender, receiver = join(path), join(path)
        hub.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, hub.pid, os.WSTOPPED)
        sent = fill(sender)
        thread = threading.Thread(target=lambda: sender.send(frame(2)))
        thread.start()
        hub.send_signal(signal.SIGCONT)
        assert received(receiver, sent + 1)[-1].arbitration_id == 2
        thread.join(WAIT_S)
