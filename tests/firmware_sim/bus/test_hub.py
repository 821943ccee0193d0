"""The hub itself, in a thread of this process, and everything a client may do wrong."""

import errno
import fcntl
import io
import os
import re
import socket
import stat
import threading
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace

import can
import pytest

from cutgate.firmware_sim.bus import hub as hub_module
from cutgate.firmware_sim.bus import peer, socket_place, wire
from cutgate.firmware_sim.bus.client import ERROR_CONTROLLER, RECEIVE_OVERFLOW
from cutgate.firmware_sim.bus.frame import Flag
from cutgate.firmware_sim.bus.hub import Hub, HubError, is_served, log_line
from cutgate.firmware_sim.bus.wire import HubKind, HubRecord

WAIT_S = 20.0


@contextmanager
def running(hub):
    thread = threading.Thread(target=hub.serve)
    thread.start()
    try:
        yield hub
    finally:
        hub.stop()
        thread.join(WAIT_S)
        hub.close()
        assert not thread.is_alive()


@pytest.fixture
def path(place):
    return place / "bus.sock"


@contextmanager
def raw_client(path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as sock:
        sock.settimeout(WAIT_S)
        sock.connect(str(path))
        yield sock


def frame(number=1, data=b""):
    return can.Message(arbitration_id=number, data=data, is_extended_id=False)


HELLO = wire.hello(fd=False, own=False).pack()


def test_the_socket_is_the_users_alone_whatever_the_umask(path):
    before = os.umask(0)
    try:
        with Hub(path):
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
    finally:
        os.umask(before)


def test_the_socket_is_gone_after_a_clean_end(path):
    hub = Hub(path)
    with running(hub):
        assert is_served(path)
    assert not path.exists()
    hub.close()


def test_a_dead_hubs_socket_is_replaced(path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(path))
    assert path.exists()
    assert not is_served(path)
    with Hub(path):
        assert is_served(path)


def test_a_living_hub_is_never_replaced(path):
    with Hub(path) as first:
        with pytest.raises(HubError, match="already serving"):
            Hub(path)
        assert is_served(path)
        with running(first):
            pass


def test_a_hub_whose_queue_of_connections_is_full_counts_as_living(path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as busy, raw_socket() as waiting:
        busy.bind(str(path))
        busy.listen(0)
        waiting.connect(str(path))
        assert is_served(path)


def raw_socket():
    return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)


@pytest.mark.parametrize("kind", ["file", "directory", "stream socket"])
def test_what_is_no_hubs_socket_is_left_alone(path, kind):
    other = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    if kind == "file":
        path.write_text("precious")
    elif kind == "directory":
        path.mkdir()
    else:
        other.bind(str(path))
        other.listen()
    with other, pytest.raises(HubError, match="give another path"):
        Hub(path)
    assert path.exists()


def test_places_no_socket_can_have_are_refused(place):
    with pytest.raises(HubError, match="at most 107"):
        Hub(place / ("x" * 120))
    with pytest.raises(HubError, match="make it first"):
        Hub(place / "missing" / "bus.sock")
    with pytest.raises(HubError, match="at least 2"):
        Hub(place / "bus.sock", queue_frames=1)


def test_a_directory_that_stays_locked_is_refused(path, monkeypatch):
    monkeypatch.setattr(socket_place, "_LOCK_PAUSE_S", 0.0)
    held = os.open(path.parent, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    try:
        with pytest.raises(HubError, match="stays locked"):
            Hub(path)
    finally:
        os.close(held)
    Hub(path).close()


def test_a_place_that_cannot_be_bound_is_refused(path, monkeypatch):
    def refuse(_path):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(socket_place, "_clear_place", refuse)
    with pytest.raises(HubError, match=r"Permission denied; give a path"):
        Hub(path)


def test_a_hub_does_not_remove_a_socket_that_is_not_its_own_any_more(path):
    with Hub(path):
        path.unlink()
        path.write_text("another's")
    assert path.read_text() == "another's"


def test_a_slow_client_is_told_what_it_lost_and_nobody_else_loses_anything(path, join):
    told = []
    count = 4000
    with running(Hub(path, queue_frames=500, report=told.append)):
        sender, slow, quick = (
            join(path),
            join(path, can_filters=[{"can_id": 1, "can_mask": 0x7FF}]),
            join(path),
        )
        for index in range(count):
            sender.send(frame(1, index.to_bytes(4, "big")))
            assert quick.recv(WAIT_S).data == index.to_bytes(4, "big")
        first = slow.recv(WAIT_S)
        received, losses = [first], []
        while len(received) + sum(losses) < count:
            message = slow.recv(WAIT_S)
            if message.is_error_frame:
                assert message.arbitration_id == ERROR_CONTROLLER  # although the filter does not name it
                assert message.data[1] == RECEIVE_OVERFLOW
                losses.append(int.from_bytes(message.data[4:8], "big"))
            else:
                received.append(message)
        sender.send(frame(1, b"after"))
        assert slow.recv(WAIT_S).data == b"after"
        assert losses
        assert slow.lost_frames == sum(losses) > 0
        assert len(received) >= 500
        assert quick.lost_frames == 0
    numbers = [int.from_bytes(m.data, "big") for m in received]
    assert numbers == sorted(numbers)
    assert len(told) == len(losses)
    assert re.fullmatch(r"client 2 \(process \d+\) lost \d+ frames: it reads too slowly", told[0])


def test_frames_before_the_loss_come_before_the_error_frame(path, join):
    with running(Hub(path, queue_frames=100, report=lambda _: None)):
        sender, slow, quick = join(path), join(path), join(path)
        for index in range(2000):
            sender.send(frame(1, index.to_bytes(4, "big")))
            quick.recv(WAIT_S)
        expected = 0
        while not (message := slow.recv(WAIT_S)).is_error_frame:
            assert int.from_bytes(message.data, "big") == expected
            expected += 1
        assert expected + int.from_bytes(message.data[4:8], "big") == 2000


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (b"\x01", "record of 1 bytes"),
        (bytes(9000), "datagram of more than 8192 bytes"),
        (HubRecord(HubKind.FRAME).pack(), "FRAME is out of place"),
        (HubRecord(HubKind.HELLO, length=3, data=b"abc").pack(), "HELLO is out of place"),
        (b"\x03" + HELLO[1:], "framing version 3"),
        (HELLO[:1] + b"\x63" + HELLO[2:], "unknown kind 99"),
        (HELLO[:2] + b"\x80\x00" + HELLO[4:], "unknown flags"),
        (HELLO[:-1], "brings 10"),
    ],
)
def test_a_client_that_opens_wrongly_is_refused_with_the_reason(path, said, why):
    told = []
    with running(Hub(path, report=told.append)), raw_client(path) as sock:
        sock.send(said)
        answer = wire.parse(sock.recv(2000))
        assert answer.kind is HubKind.REFUSED
        assert why in answer.data.decode()
        assert sock.recv(2000) == b""
    assert why in told[0]


@pytest.mark.parametrize(
    ("record", "why"),
    [
        (HubRecord(HubKind.FRAME, number=0x800), "identifier 0x800"),
        (HubRecord(HubKind.FRAME, flags=Flag.OWN), "flag OWN"),
        (HubRecord(HubKind.WELCOME), "WELCOME is out of place"),
        (wire.hello(fd=False, own=False), "HELLO is out of place"),
    ],
)
def test_a_client_that_sends_no_frame_is_closed_and_hears_nothing_more(path, join, record, why):
    with running(Hub(path, report=lambda _: None)):
        bus, other = join(path), join(path)
        bus._sock.send(record.pack())
        for _ in range(2):
            with pytest.raises(can.CanOperationError, match=f"closed this connection: .*{why}"):
                bus.recv(WAIT_S)
        other.send(frame())  # and nobody else is harmed
        assert other.recv(0) is None


def test_before_its_hello_a_client_hears_nothing(path, join):
    with running(Hub(path)), raw_client(path) as silent:
        one, two = join(path), join(path)
        one.send(frame())
        assert two.recv(WAIT_S) is not None
        silent.send(HELLO)
        assert wire.parse(silent.recv(100)).kind is HubKind.WELCOME


def test_one_client_too_many_is_refused(path, join, monkeypatch):
    hub = Hub(path, report=lambda _: None)
    monkeypatch.setattr(hub_module, "MAX_CLIENTS", 2)
    with running(hub):
        join(path), join(path)
        with pytest.raises(can.CanInitializationError, match="2 clients already"):
            join(path)


def test_a_crowd_that_never_says_hello_keeps_nobody_out(path, join, monkeypatch):
    hub = Hub(path, report=lambda _: None)  # it listens with the full length of its queue of connections
    monkeypatch.setattr(hub_module, "HELLO_S", 1000.0)
    monkeypatch.setattr(hub_module, "MAX_CLIENTS", 4)
    with running(hub), ExitStack() as stack:
        silent = [stack.enter_context(raw_client(path)) for _ in range(2 * hub_module.MAX_CLIENTS)]
        one, two = join(path), join(path)
        one.send(frame(7))
        assert two.recv(WAIT_S).arbitration_id == 7
        for sock in silent[: hub_module.MAX_CLIENTS]:  # the oldest have made room
            assert b"too many connections without a HELLO" in sock.recv(1000)
            assert sock.recv(1000) == b""
        silent[-1].send(HELLO)
        assert wire.parse(silent[-1].recv(100)).kind is HubKind.WELCOME


def test_who_says_no_hello_is_dropped_soon_and_who_joined_never(path, join, monkeypatch):
    told = []
    with running(Hub(path, report=told.append)):
        joined, other = join(path), join(path)
        monkeypatch.setattr(hub_module, "HELLO_S", 0.05)
        with raw_client(path) as silent, raw_client(path) as another:
            for sock in (silent, another):
                assert b"no HELLO within 0.05 s" in sock.recv(1000)
                assert sock.recv(1000) == b""
        other.send(frame(7))
        assert joined.recv(WAIT_S).arbitration_id == 7
    assert [re.sub(r"[0-9]+ .process [0-9]+.", "N", line) for line in told] == [
        "client N refused: it said no HELLO within 0.05 s"
    ] * 2


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE])
def test_without_a_descriptor_for_another_the_oldest_silent_connection_is_given_up(path, monkeypatch, number):
    with Hub(path) as hub, raw_client(path) as silent:
        hub._accept()
        accept, failed = hub._listener.accept, []

        def none_left():
            if not failed:
                failed.append(number)
                raise OSError(number, "too many open files")
            return accept()

        monkeypatch.setattr(
            hub,
            "_listener",
            SimpleNamespace(accept=none_left, fileno=hub._listener.fileno, close=hub._listener.close),
        )
        with raw_client(path) as another:
            hub._accept()
            hub._drop_lost_clients()
            assert b"no descriptor is left" in silent.recv(1000)
            hub._accept()
            assert len(hub._silent) == 1
            assert another


def test_without_a_descriptor_and_nobody_silent_the_hub_says_what_it_lacks(path, monkeypatch):
    with Hub(path) as hub:

        def none_left():
            raise OSError(errno.EMFILE, "too many open files")

        monkeypatch.setattr(
            hub,
            "_listener",
            SimpleNamespace(accept=none_left, fileno=hub._listener.fileno, close=hub._listener.close),
        )
        with pytest.raises(OSError, match="too many open files"):
            hub._accept()


def test_a_hub_where_nobody_is_silent_waits_for_no_clock(path, join):
    hub = Hub(path)
    with running(hub):
        join(path)
        assert hub._patience_s() is None


def test_a_client_of_another_user_is_refused_and_named(path, monkeypatch):
    told = []
    mine = os.geteuid()
    with running(Hub(path, report=told.append)):
        monkeypatch.setattr(peer.os, "geteuid", lambda: mine + 1)
        with raw_client(path) as sock:
            assert wire.parse(sock.recv(1000)).kind is HubKind.REFUSED
            assert sock.recv(1000) == b""
        monkeypatch.undo()
    assert re.fullmatch(
        rf"client 1 .process {os.getpid()}. refused: it is run by .*uid {mine}\), must be .*uid {mine + 1}\) .*",
        told[0],
    )


def test_a_hub_of_another_user_is_not_joined_and_named(path, monkeypatch):
    mine = os.geteuid()
    with running(Hub(path)):
        monkeypatch.setattr(peer.os, "geteuid", lambda: mine + 1)
        with pytest.raises(
            can.CanInitializationError, match=rf"not ours, it is run by .*uid {mine}\), must be"
        ):
            can.Bus(interface="cutgate", channel=str(path), ignore_config=True)
        monkeypatch.undo()


def test_a_client_that_leaves_makes_room_and_disturbs_nobody(path, join):
    with running(Hub(path)):
        one, two = join(path), join(path)
        for _ in range(hub_module.MAX_CLIENTS + 5):
            with can.Bus(interface="cutgate", channel=str(path)) as brief:
                brief.send(frame(7))
            assert two.recv(WAIT_S).arbitration_id == 7
            assert one.recv(WAIT_S).arbitration_id == 7


def test_a_client_that_dies_with_frames_waiting_is_dropped(path, join):
    with running(Hub(path, report=lambda _: None)):
        one, two, gone = join(path), join(path), join(path)
        for _ in range(600):
            one.send(frame(1))
            two.recv(WAIT_S)
        gone.shutdown()
        one.send(frame(2))
        assert two.recv(WAIT_S).arbitration_id == 2


def test_every_frame_is_logged_in_the_order_of_the_bus_as_python_can_reads_it(path, join):
    log = io.StringIO()
    hub = Hub(path)
    hub.log_to(log)
    sent = [
        frame(0x123, b"\xde\xad"),
        can.Message(arbitration_id=0x1234567, is_extended_id=True, data=b"\x01"),
        can.Message(arbitration_id=5, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(arbitration_id=6, is_extended_id=False, is_fd=True, bitrate_switch=True, data=bytes(12)),
    ]
    with running(hub):
        sender, receiver = join(path, fd=True), join(path, fd=True)
        for message in sent:
            sender.send(message)
        stamps = [receiver.recv(WAIT_S).timestamp for _ in sent]
    log.seek(0)
    read = list(can.CanutilsLogReader(log))
    assert [m.channel for m in read] == ["bus"] * len(sent)
    for message, original, stamp in zip(read, sent, stamps, strict=True):
        assert message.equals(original, timestamp_delta=None, check_channel=False)
        assert abs(message.timestamp - stamp) < 2e-6


@pytest.mark.parametrize(
    ("record", "line"),
    [  # as `candump -L` of can-utils prints the same frames
        (HubRecord(HubKind.FRAME, number=0x80, time_ns=1_700_000_000_123_456_789, length=2, data=b"\x0a\xff"),
         "(1700000000.123456) bus 080#0AFF\n"),
        (HubRecord(HubKind.FRAME, number=0x7FF, time_ns=5_000), "(0.000005) bus 7FF#\n"),
        (HubRecord(HubKind.FRAME, Flag.EXTENDED, 0x12), "(0.000000) bus 00000012#\n"),
        (HubRecord(HubKind.FRAME, Flag.REMOTE, 0x12), "(0.000000) bus 012#R\n"),
        (HubRecord(HubKind.FRAME, Flag.REMOTE, 0x12, length=8), "(0.000000) bus 012#R8\n"),
        (HubRecord(HubKind.FRAME, Flag.ERROR, 0x4, length=8, data=bytes(8)), "(0.000000) bus 20000004#0000000000000000\n"),
        (HubRecord(HubKind.FRAME, Flag.FD | Flag.BIT_RATE_SWITCH, 1, length=1, data=b"\x01"), "(0.000000) bus 001##501\n"),
        (HubRecord(HubKind.FRAME, Flag.FD | Flag.ERROR_STATE, 1), "(0.000000) bus 001##6\n"),
    ],
)  # fmt: skip
def test_log_lines_have_the_form_of_candump(record, line):
    assert log_line(record, "bus") == line


class FullDisk(io.StringIO):
    name = "frames.log"

    def __init__(self, failing):
        super().__init__()
        self.failing = failing

    def write(self, text):
        if self.failing == "write":
            raise OSError(28, "No space left on device")
        return super().write(text)

    def flush(self):
        if self.failing == "flush" and self.tell():
            raise OSError(28, "No space left on device")


@pytest.mark.parametrize("failing", ["write", "flush"])
def test_a_bus_whose_log_has_a_gap_does_not_go_on(path, join, failing):
    hub = Hub(path)
    hub.log_to(FullDisk(failing))
    ended = []

    def serve():
        try:
            hub.serve()
        except HubError as error:
            ended.append(str(error))
        hub.close()

    thread = threading.Thread(target=serve)
    thread.start()
    bus = join(path)
    bus.send(frame())
    thread.join(WAIT_S)
    assert "frames.log cannot be written: No space left" in ended[0]
    with pytest.raises(can.CanOperationError):
        bus.recv(WAIT_S)


def test_records_survive_packing():
    record = HubRecord(HubKind.FRAME, int(Flag.FD), 0x1FF, 12345, 12, bytes(range(12)))
    assert wire.parse(record.pack()) == record


def test_a_hub_that_has_nobody_to_report_to_says_nothing(path, capfd):
    with Hub(path) as hub:
        hub._report("client 1 lost 3 frames")
    assert capfd.readouterr() == ("", "")
