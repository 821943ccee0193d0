"""Which bus is used where none is named, and how a bus is opened."""

import errno
import socket

import can
import pytest
from can.interfaces.socketcan import SocketcanBus

from cutgate.config import bus as module
from cutgate.config.bus import (
    LatchingSocketcanBus,
    RuntimeDirectoryError,
    default_interface,
    has_socketcan,
    open_bus,
    runtime_directory,
    socket_path,
)


@pytest.mark.parametrize(
    ("present", "expected"), [(True, ("socketcan", "vcan0")), (False, ("cutgate", "bus0"))]
)
def test_vcan0_is_the_default_where_the_kernel_has_it_else_the_local_bus(monkeypatch, present, expected):
    monkeypatch.setattr(module, "has_socketcan", lambda: present)
    assert default_interface() == expected


class Probe:
    def __init__(self, error):
        self.error = error

    def __call__(self, *_):
        return self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def bind(self, address):
        assert address == ("vcan7",)
        if self.error:
            raise self.error


@pytest.mark.parametrize(("error", "expected"), [(None, True), (OSError(19, "No such device"), False)])
def test_the_kernel_has_a_channel_if_a_socket_can_be_bound_to_it(monkeypatch, error, expected):
    monkeypatch.setattr(socket, "socket", Probe(error))
    assert has_socketcan("vcan7") is expected


def test_a_python_without_can_sockets_has_no_channel(monkeypatch):
    monkeypatch.delattr(socket, "AF_CAN")
    assert not has_socketcan()


def test_the_runtime_directory_is_made_private_under_xdg(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    directory = runtime_directory()
    assert directory == tmp_path / "cutgate"
    assert directory.stat().st_mode & 0o777 == 0o700
    assert socket_path("bus7") == directory / "bus7.sock"


@pytest.mark.parametrize("given", [None, "", "relative", "/nowhere/at/all"])
def test_without_a_usable_xdg_directory_it_lies_in_the_temporary_one(monkeypatch, tmp_path, given):
    monkeypatch.setattr(module.tempfile, "gettempdir", lambda: str(tmp_path))
    if given is None:
        monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    else:
        monkeypatch.setenv("XDG_RUNTIME_DIR", given)
    assert runtime_directory() == tmp_path / f"cutgate-{module.os.getuid()}"


@pytest.mark.parametrize("kind", ["open to others", "file", "link", "another's"])
def test_a_runtime_directory_that_is_not_ours_alone_is_refused(monkeypatch, tmp_path, kind):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    directory = tmp_path / "cutgate"
    if kind == "open to others":
        directory.mkdir()
        directory.chmod(0o750)
    elif kind == "file":
        directory.write_text("")
    elif kind == "link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        directory.symlink_to(tmp_path / "elsewhere")
    else:
        monkeypatch.setattr(module.tempfile, "gettempdir", lambda: str(tmp_path))
        uid = module.os.getuid() + 1
        (tmp_path / f"cutgate-{uid}").mkdir(mode=0o700)
        monkeypatch.setattr(module.os, "getuid", lambda: uid)
    with pytest.raises(RuntimeDirectoryError, match="or name a socket"):
        runtime_directory()


@pytest.mark.parametrize("name", ["", "..", "a b", "-x", "x" * 33, "bus\n"])
def test_a_channel_is_a_path_or_a_plain_name(name):
    with pytest.raises(ValueError, match="give a path with a '/'"):
        socket_path(name)
    assert str(socket_path("/some/where.sock")) == "/some/where.sock"


@pytest.mark.parametrize("interface", ["udp_multicast", "socketcand"])
def test_a_bus_that_leaves_the_machine_is_refused(interface):
    with pytest.raises(can.CanInitializationError, match="must be private"):
        open_bus(interface, "239.74.163.2")


@pytest.mark.parametrize(
    ("interface", "channel"),
    [("no-such-interface", "x"), ("cutgate", "no such name")],
)
def test_a_bus_that_cannot_be_opened_says_which_and_what_to_do(interface, channel):
    with pytest.raises(
        can.CanInitializationError, match=f"bus {interface}/{channel} cannot be opened: .*; check"
    ):
        open_bus(interface, channel)


def test_a_local_bus_without_a_hub_says_how_to_start_one():
    with pytest.raises(can.CanInitializationError, match="start one with `cutgate bus serve`"):
        open_bus("cutgate", "/nowhere/none.sock")


def test_a_socketcan_interface_that_the_kernel_does_not_have_is_refused():
    with pytest.raises(can.CanInitializationError, match="socketcan/nocan9: the kernel has no such"):
        open_bus("socketcan", "nocan9")


def test_a_socketcan_interface_that_the_kernel_has_is_opened(latching, monkeypatch):
    latching()
    monkeypatch.setattr(module, "has_socketcan", lambda _channel: True)
    assert isinstance(open_bus("socketcan", "vcan0"), LatchingSocketcanBus)


def test_any_other_interface_of_python_can_is_opened_by_name():
    with open_bus("virtual", "test-config-bus") as one, open_bus("virtual", "test-config-bus") as two:
        one.send(can.Message(arbitration_id=5, is_extended_id=False))
        assert two.recv(10.0).arbitration_id == 5


@pytest.mark.parametrize(
    ("fd", "rates"), [(False, {"bitrate": 250_000}), (True, {"bitrate": 250_000, "data_bitrate": 5_000_000})]
)
def test_an_interface_that_python_can_sets_up_is_told_its_bit_rates(monkeypatch, fd, rates):
    asked = {}
    monkeypatch.setattr(can, "Bus", lambda **options: asked.update(options))
    open_bus("pcan", "PCAN_USBBUS1", fd=fd, bitrate_bit_s=250_000)
    assert asked == {"channel": "PCAN_USBBUS1", "interface": "pcan", "fd": fd, "ignore_config": True, **rates}


class FakeSocket:
    """A CAN socket that records which buffer options succeeded."""

    def __init__(self, *, privileged):
        self.privileged = privileged
        self.set = []

    def setsockopt(self, _level, option, value):
        if option == module._SO_RCVBUFFORCE and not self.privileged:
            raise PermissionError(1, "Operation not permitted")
        self.set.append((option, value))

    def getsockopt(self, _level, option):
        assert option == socket.SO_RCVBUF
        return 2 * self.set[-1][1]


@pytest.fixture
def latching(monkeypatch):
    def open_one(*, privileged=True):
        def init(bus, channel, fd):
            bus.socket = FakeSocket(privileged=privileged)

        monkeypatch.setattr(SocketcanBus, "__init__", init)
        return LatchingSocketcanBus("vcan0")

    return open_one


@pytest.mark.parametrize("privileged", [True, False])
def test_the_receive_buffer_is_raised_with_or_without_privilege(latching, privileged):
    bus = latching(privileged=privileged)
    options = [socket.SO_RCVBUF, module._SO_RCVBUFFORCE] if privileged else [socket.SO_RCVBUF]
    assert bus.socket.set == [(option, module.RECEIVE_BUFFER_BYTES) for option in options]
    assert bus.receive_buffer_bytes == 2 * module.RECEIVE_BUFFER_BYTES


def raising(*errors):
    """A method that raises these in turn, then answers nothing."""
    left = list(errors)

    def method(*_):
        if left:
            raise left.pop(0)

    return method


def test_a_socketcan_failure_in_recv_is_raised_again_every_time(latching, monkeypatch):
    bus = latching()
    monkeypatch.setattr(SocketcanBus, "_recv_internal", raising(can.CanOperationError("down", 100)))
    for _ in range(3):
        with pytest.raises(can.CanOperationError, match="down"):
            bus._recv_internal(0)
    with pytest.raises(can.CanOperationError, match="not opened anew"):
        bus.send(can.Message())


FULL = [
    can.CanOperationError("Transmit buffer full"),  # python-can's own word: the socket is not writable
    can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS),
    can.CanOperationError("Failed to transmit: Resource temporarily unavailable", errno.EAGAIN),
]


@pytest.mark.parametrize("full", FULL, ids=str)
def test_a_full_transmit_queue_is_no_failure_and_says_that_nothing_was_sent(latching, monkeypatch, full):
    bus = latching()
    monkeypatch.setattr(SocketcanBus, "send", raising(full, full))
    monkeypatch.setattr(SocketcanBus, "_recv_internal", lambda *_: (None, True))
    for _ in range(2):
        with pytest.raises(can.CanTimeoutError, match="the transmit queue is full"):
            bus.send(can.Message())
    assert bus._recv_internal(0) == (None, True)
    bus.send(can.Message())


def test_any_other_socketcan_failure_in_send_is_raised_again_every_time(latching, monkeypatch):
    bus = latching()
    monkeypatch.setattr(SocketcanBus, "send", raising(can.CanOperationError("deleted", errno.ENXIO)))
    for _ in range(2):
        with pytest.raises(can.CanOperationError, match="deleted"):
            bus.send(can.Message())
    with pytest.raises(can.CanOperationError, match="deleted"):
        bus._recv_internal(0)
