"""Records and the kernel's own ISO-TP (ISO 15765-2), which shares no line with ours: each takes what the other sends."""

import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager

import can
import pytest

from cutgate.config.bus import SOCKETCAN_CHANNEL, has_socketcan, open_bus
from cutgate.protocol import records
from cutgate.protocol.frames import BULK_IDS, CONTROL_IDS
from cutgate.protocol.path import split
from cutgate.protocol.states import Refusal
from cutgate.protocol.transfer import (
    BLOCK_FRAMES,
    FD_FRAME_BYTES,
    FRAME_BYTES,
    PAYLOAD_BYTES_MAX,
    Transfer,
)
from tests.protocol.sessions import OPEN
from tests.system.harness import Rig


def has_isotp() -> bool:
    """Whether the kernel has sockets that speak ISO-TP."""
    if not hasattr(socket, "AF_CAN"):
        return False
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_ISOTP):
            return True
    except OSError:
        return False


pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(not has_socketcan(), reason="the kernel has no vcan0"),
    pytest.mark.skipif(
        not has_isotp(),
        reason="the kernel has no ISO-TP: modprobe can-isotp; for the virtual machine run-in-vcan-vm --install --isotp",
    ),
]

WAIT_S = 20.0
SOL_CAN_ISOTP, OPTIONS, FLOW_CONTROL, LINK_LAYER = 106, 1, 2, 5
PADS, IS_PADDED, PADDED_TO_LENGTH, PADDED_WITH = 0x04, 0x08, 0x10, 0x20
"""Of linux/can/isotp.h: what is sent is padded; what is received must be, to the right length, with the right byte."""
BIT_RATE_SWITCH = 0x01
ANNOUNCED_MAX = 10
PADDING = 0xCC
"""As docs/protocol.md has it."""
PATH = bytes(range(256)) * 60
BLOCK = (FRAME_BYTES - 2) + BLOCK_FRAMES * (FRAME_BYTES - 1)
FD_BLOCK = (FD_FRAME_BYTES - 2) + BLOCK_FRAMES * (FD_FRAME_BYTES - 1)
LENGTHS = sorted(
    {1, FRAME_BYTES - 1, FRAME_BYTES, 13, 14, 111, 112, PAYLOAD_BYTES_MAX}
    | {BLOCK - 1, BLOCK, BLOCK + 1, FD_BLOCK, FD_BLOCK + 1}
    | {FD_FRAME_BYTES - 2, FD_FRAME_BYTES - 1, FD_FRAME_BYTES, 125, 126}
)
"""About where a frame, a block and the sequence number of four bits end."""


@contextmanager
def kernels_end(
    receives: int, sends: int, *, fd: bool = False, blocks: int = BLOCK_FRAMES
) -> Iterator[socket.socket]:
    """A socket that sends and receives whole records on these identifiers, and insists on our padding."""
    with socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_ISOTP) as made:
        flags = PADS | IS_PADDED | PADDED_TO_LENGTH | PADDED_WITH
        made.setsockopt(SOL_CAN_ISOTP, OPTIONS, struct.pack("=IIBBBB", flags, 0, 0, PADDING, PADDING, 0))
        made.setsockopt(SOL_CAN_ISOTP, FLOW_CONTROL, struct.pack("=BBB", blocks, 0, 0))
        if fd:
            made.setsockopt(
                SOL_CAN_ISOTP, LINK_LAYER, struct.pack("=BBB", 72, FD_FRAME_BYTES, BIT_RATE_SWITCH)
            )
        made.bind((SOCKETCAN_CHANNEL, receives, sends))
        made.settimeout(WAIT_S)
        yield made


class OwnEnd:
    """Our transfer on a raw socket, driven as a loop drives it."""

    def __init__(self, bus: can.BusABC, transfer: Transfer) -> None:
        self.transfer = transfer
        self._bus = bus

    def _put(self, can_id: int, data: bytes) -> bool:
        fd = self.transfer.fd
        self._bus.send(
            can.Message(arbitration_id=can_id, data=data, is_extended_id=False, is_fd=fd, bitrate_switch=fd)
        )
        return True

    def _take(self) -> None:
        message = self._bus.recv(WAIT_S)
        assert message is not None, "the kernel says nothing more"
        if message.arbitration_id == self.transfer.rx_id:
            assert message.is_fd is message.bitrate_switch is self.transfer.fd
            self.transfer.feed(bytes(message.data))
            self.transfer.hand_out(self._put)

    def send(self, payload: bytes) -> None:
        """A record, to its last frame."""
        self.transfer.send(payload, 0.0)
        self.transfer.hand_out(self._put)
        while self.transfer.sending:
            self._take()

    def recv(self) -> bytes:
        """The next record."""
        while not (whole := self.transfer.received()):
            self._take()
        (payload,) = whole
        return payload


@pytest.fixture(params=[False, True], ids=["classic", "fd"])
def ends(request):
    """Ours, and the kernel's, of the bulk channel: the runtime's end is ours."""
    fd = request.param
    own, others = BULK_IDS
    with kernels_end(own, others, fd=fd) as kernel, open_bus("socketcan", SOCKETCAN_CHANNEL, fd=fd) as bus:
        yield OwnEnd(bus, Transfer(own, others, fd=fd)), kernel


def test_of_every_length_each_side_receives_what_the_other_sends(ends):
    ours, kernel = ends
    for length in LENGTHS:
        payload = bytes((length + number) % 251 for number in range(length))
        ours.send(payload)
        assert kernel.recv(PAYLOAD_BYTES_MAX + 1) == payload, length
        kernel.send(payload)
        assert ours.recv() == payload, length
    assert ours.transfer.errors() == []


def test_the_records_of_a_path_go_through_the_kernel_both_ways(ends):
    ours, kernel = ends
    for sequence, record in enumerate([*split(PATH), records.BlockStored(0)]):
        whole = records.pack(record, 0x1234, sequence)
        ours.send(whole)
        heard = kernel.recv(PAYLOAD_BYTES_MAX + 1)
        assert records.unpack(heard).record == record
        kernel.send(heard)
        assert ours.recv() == whole


def test_blocks_without_an_end_which_the_kernel_asks_for_by_itself_are_refused():
    own, others = BULK_IDS
    with (
        kernels_end(own, others, blocks=0) as kernel,
        open_bus("socketcan", SOCKETCAN_CHANNEL) as bus,
    ):
        ours = OwnEnd(bus, Transfer(own, others))
        ours.send(bytes(100))
        (error,) = ours.transfer.errors()
        assert error.refused
        assert error.reason == f"flow control asks for blocks of 0, must be 1..{BLOCK_FRAMES}"
        kernel.settimeout(0.0)
        with pytest.raises(BlockingIOError):
            kernel.recv(PAYLOAD_BYTES_MAX)


def test_a_controller_announces_itself_to_the_kernel_and_answers_it(tmp_path):
    """In the place of a runtime that leaves transfers to its kernel, but has no key."""
    with (
        Rig(tmp_path, "socketcan", SOCKETCAN_CHANNEL) as rig,
        kernels_end(CONTROL_IDS[1], CONTROL_IDS[0]) as kernel,
    ):
        sim = rig.sim()
        assert isinstance(records.unpack(kernel.recv(PAYLOAD_BYTES_MAX)).record, records.Announce)
        kernel.send(records.pack(OPEN, 0, 1))
        heard = (records.unpack(kernel.recv(PAYLOAD_BYTES_MAX)).record for _ in range(ANNOUNCED_MAX))
        answer = next(record for record in heard if not isinstance(record, records.Announce))
        assert isinstance(answer, records.Reply)
        assert (answer.request_type, Refusal(answer.refusal)) == (OPEN.TYPE, Refusal.MAC_INVALID)
        sim.line("refused: MAC_INVALID")
