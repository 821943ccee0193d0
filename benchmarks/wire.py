"""What the wire costs and how soon a fault stops it: ``python benchmarks/wire.py [--write FILE]``.

Markdown tables on stdout; with ``--write`` in a file as well.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from statistics import median, quantiles
from typing import Any

import can
from measure import RUNS, machine, seconds
from pages import Rows, document, show
from paths import EXAMPLES, prepared

from firmware_sim.hil.plugin import hub_process
from protocol import records
from protocol.e2e import protect
from protocol.endpoint import Endpoint, RecordReceived
from protocol.frames import (
    DATA_IDS,
    IDS,
    TRANSFER_IDS,
    ControllerFault,
    Frame,
    RuntimeHeartbeat,
    RuntimeStop,
    decode_frame,
    joint_frames,
)
from protocol.link import Accepted, Link
from protocol.path import split
from protocol.permit import KEY_BYTES, new_key_file, sign, verify
from protocol.port import Port
from protocol.records import Side
from protocol.states import RuntimeCode, StopCause, StopCode

sys.path.insert(0, str(Path(__file__).parents[1]))
from runtime.interlock.state import Phase
from runtime.session.job import make_job, read_files
from tests.runtime.audit.build import wire_permit
from tests.runtime.session.pair import Pair, pair_of

Sent = tuple[int, bytes]

CLASSIC_BIT_S, DATA_BIT_S = 1e-6, 0.2e-6
HEARTBEAT_S, TIMEOUT_S = 0.02, 0.1
TRIALS = 200
CRC15, CRC15_BITS = 0x4599, 15
AFTER_CRC = 13
"""CRC delimiter, acknowledge slot and delimiter, end of frame 7, intermission 3: never stuffed."""


# ---------------------------------------------------------------- bits


def bits_of(value: int, count: int) -> list[int]:
    """Most significant bit first."""
    return [value >> place & 1 for place in reversed(range(count))]


def stuffed(bits: list[int]) -> list[bool]:
    """After which bits a stuff bit follows: five equal ones, stuff bits counted (ISO 11898-1)."""
    follows, run, last = [], 0, None
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        follows.append(run == 5)
        if run == 5:
            last, run = 1 - bit, 1
    return follows


def classic_bits(can_id: int, data: bytes) -> int:
    """Bits of one classic frame on the bus, stuff bits and intermission included."""
    head = [0, *bits_of(can_id, 11), 0, 0, 0, *bits_of(len(data), 4)]
    covered = head + [bit for byte in data for bit in bits_of(byte, 8)]
    crc = 0
    for bit in covered:
        crc = (crc << 1 & 0x7FFF) ^ (CRC15 if bit ^ crc >> 14 else 0)
    whole = covered + bits_of(crc, CRC15_BITS)
    return len(whole) + sum(stuffed(whole)) + AFTER_CRC


def fd_seconds(can_id: int, data: bytes) -> float:
    """Duration of one FD frame with bit rate switch, 1 and 5 Mbit/s: exact stuff bits before the CRC, fixed in it."""
    length = next(size for size in (8, 12, 16, 20, 24, 32, 48, 64) if size >= len(data))
    content = data.ljust(length, b"\xcc")
    nominal = [0, *bits_of(can_id, 11), 0, 0, 1, 0, 1]  # RRS, IDE, FDF, res, BRS
    code = length if length <= 8 else 9 + (12, 16, 20, 24, 32, 48, 64).index(length)
    fast = [0, *bits_of(code, 4), *(bit for byte in content for bit in bits_of(byte, 8))]  # ESI, DLC, data
    follows = stuffed(nominal + fast)
    check = 4 + (17 if length <= 16 else 21)  # stuff count and CRC
    fixed = -(-check // 4)
    slow_bits = len(nominal) + sum(follows[: len(nominal)]) + AFTER_CRC - 1
    fast_bits = len(fast) + sum(follows[len(nominal) :]) + check + fixed + 1
    return slow_bits * CLASSIC_BIT_S + fast_bits * DATA_BIT_S


def classic_seconds(frames: list[Sent]) -> float:
    """How long these frames keep a bus of 1 Mbit/s busy."""
    return sum(classic_bits(*frame) for frame in frames) * CLASSIC_BIT_S


# ---------------------------------------------------------------- bytes and bus time


@cache
def upload() -> tuple[list[Sent], int, int]:
    """Every frame of both sides while the example's path is sent block by block; its bytes, and its poses."""
    path = prepared("second")[0].path
    sides = {side: Endpoint(side, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=1.0) for side in Side}
    for endpoint in sides.values():
        endpoint.use_session(1)
    frames: list[Sent] = []
    for block in split(path.body()):
        sides[Side.RUNTIME].send_record(block, 0.0)
        stored = False
        while moved := [(side, frame) for side in Side for frame in sides[side].outgoing()]:
            for side, frame in moved:
                frames.append(frame)
                items = sides[side.peer].receive(*frame, now_s=0.0)
                if any(isinstance(item, RecordReceived) for item in items) and not stored:
                    stored = True
                    sides[Side.CONTROLLER].send_record(records.BlockStored(block.index), 0.0)
    return frames, len(path.body()), len(path)


def pose_and_upload() -> Rows:
    """The hip stem's path as it is uploaded, flow control and answers included, on a bus that does nothing else.

    FD is computed: the same records in frames of 64 bytes, 1 Mbit/s and 5 Mbit/s, one flow control a block. The limit
    is the payload's bits at the data rate. Flow control waits for the other side's loop, which adds a turn of each side
    a block of 32 frames.
    """
    frames, size, poses = upload()
    took, bits = classic_seconds(frames), sum(classic_bits(*frame) for frame in frames)
    fast, fast_frames, fast_bytes = _fd_upload()
    yield ("2000 poses", "classic, 1 Mbit/s", "FD, 1 and 5 Mbit/s, computed")
    yield ("frames", str(len(frames)), str(fast_frames))
    yield ("bytes of the path", str(size), str(size))
    yield ("bytes of data on the bus", str(sum(len(data) for _, data in frames)), str(fast_bytes))
    yield (
        "bytes a pose, of data on the bus",
        f"{sum(len(d) for _, d in frames) / poses:.2f}",
        f"{fast_bytes / poses:.2f}",
    )
    yield ("bits a pose", f"{bits / poses:.1f}", "")
    yield ("bus time a pose", f"{took / poses * 1e6:.1f} us", f"{fast / poses * 1e6:.1f} us")
    yield ("upload", f"{took:.3f} s", f"{fast:.3f} s")
    limit, fast_limit = size * 8 * CLASSIC_BIT_S, size * 8 * DATA_BIT_S
    yield ("limit of the bit rate", f"{limit:.3f} s", f"{fast_limit:.3f} s")
    yield ("upload / limit", f"{took / limit:.2f}", f"{fast / fast_limit:.2f}")


def _fd_upload() -> tuple[float, int, int]:
    took, frames, size = 0.0, 0, 0
    runtime, controller = (TRANSFER_IDS[side][records.Channel.BULK] for side in Side)
    for number, block in enumerate(split(prepared("second")[0].path.body()), 1):
        payload = records.pack(block, 1, number)
        parts = [payload[:62], *(payload[at : at + 63] for at in range(62, len(payload), 63))]
        answer = records.pack(records.BlockStored(block.index), 1, number)
        sent = [(runtime, bytes(2 if not at else 1) + part) for at, part in enumerate(parts)]
        back = [(controller, bytes(8)), (controller, bytes(2) + answer)]
        took += sum(fd_seconds(*frame) for frame in sent + back)
        frames += len(sent + back)
        size += sum(len(data) for _, data in sent + back)
    return took, frames, size


@dataclass
class Recorded:
    """A whole session, frame by frame."""

    frames: list[tuple[float, int, bytes]]
    cutting: tuple[float, float]
    names: dict[int, str] = field(default_factory=dict)


@cache
def session() -> Recorded:
    """Both loops on a bus in memory, in virtual time, from the announcement to the end of the cut."""
    with tempfile.TemporaryDirectory() as directory:
        files = read_files(
            EXAMPLES / "hip-stem.plan.json",
            EXAMPLES / "robot.toml",
            EXAMPLES / "registration-second.json",
            None,
            None,
        )
        with pair_of(Path(directory), files, make_job(files, now=datetime.now(UTC))) as pair:
            return _recorded(pair)


def _recorded(pair: Pair) -> Recorded:
    pair.power_up(time_scale=100.0)
    pair.to(Phase.CUTTING, limit_s=60.0)
    began = pair.clock()
    pair.end(600.0)
    ended = pair.clock()
    if pair.phase is not Phase.DONE:
        raise ValueError(f"the session ended {pair.phase}: {pair.state.reason}")
    seen = [(seen.at_s, seen.can_id, seen.data) for seen in pair.wire.seen]
    names = {can_id: kind.__name__ for kind, can_id in IDS.items()}
    names |= {
        i: f"{c.name.lower()} records of the {s.name.lower()}"
        for s in Side
        for c, i in TRANSFER_IDS[s].items()
    }
    return Recorded(seen, (began, ended), names)


def session_bytes() -> Rows:
    """A session that cuts the hip stem, heartbeats every 20 ms, the arm at 100 times its speed; exact stuff bits."""
    run = session()
    yield ("frames of", "frames", "bytes", "bits", "bus time", "bits a frame, mean")
    by_id = Counter(can_id for _, can_id, _ in run.frames)
    for can_id in sorted(by_id):
        data = [content for _, found, content in run.frames if found == can_id]
        yield _share(run.names[can_id], [(can_id, content) for content in data])
    yield _share("all", [(can_id, content) for _, can_id, content in run.frames])


def _share(name: str, frames: list[Sent]) -> tuple[str, ...]:
    bits = sum(classic_bits(*frame) for frame in frames)
    size = sum(len(data) for _, data in frames)
    return (
        name,
        str(len(frames)),
        str(size),
        str(bits),
        f"{bits * 1e-3:.2f} ms",
        f"{bits / len(frames):.1f}",
    )


def cyclic_load() -> Rows:
    """What both sides send while the arm cuts, heartbeats every 20 ms, of the bits that 1 Mbit/s carries.

    The worst case has a stuff bit after every four bits: 135 bits a frame with the intermission.
    """
    run = session()
    began, ended = run.cutting
    frames = [(can_id, data) for at, can_id, data in run.frames if began + 0.1 < at <= ended - 0.1]
    span = ended - began - 0.2
    worst = len(frames) * 135 * CLASSIC_BIT_S
    yield ("window", "frames/s", "load", "worst case of these frames")
    yield (
        f"{span:.2f} s",
        f"{len(frames) / span:.0f}",
        f"{classic_seconds(frames) / span:.2%}",
        f"{worst / span:.2%}",
    )


# ---------------------------------------------------------------- reaction


class Peer:
    """A runtime's side of the bus without a runtime: opens a session, keeps it alive, and then does something wrong."""

    def __init__(self, bus: can.BusABC) -> None:
        self.bus = bus
        self.heard: deque[Any] = deque()
        self._new()
        announced = self._wait(lambda item: _record(item, records.Announce))
        self.boot_nonce = announced.record.boot_nonce

    def _new(self) -> None:
        self.endpoint = Endpoint(
            Side.RUNTIME, heartbeat_s=HEARTBEAT_S, timeout_s=TIMEOUT_S, transfer_timeout_s=1.0
        )
        self.port = Port(self.bus, self.endpoint)

    def _wait(self, wanted: Callable[[Any], bool], limit_s: float = 2.0, beats: bool = False) -> Any:
        until_s, beat_s = time.monotonic() + limit_s, 0.0
        while time.monotonic() < until_s:
            now_s = time.monotonic()
            if beats and now_s >= beat_s:
                beat_s = now_s + HEARTBEAT_S
                self.endpoint.send_frame(RuntimeHeartbeat(RuntimeCode.INHIBIT, 0), now_s)
            self.port.flush()
            message = self.bus.recv(timeout=0.002)
            if message is None:
                continue
            for item in self.endpoint.receive(
                message.arbitration_id, bytes(message.data), now_s=time.monotonic()
            ):
                if wanted(item):
                    return item
        raise TimeoutError("the controller did not answer")

    def open(self) -> None:
        """A session, with a heartbeat accepted; the one before it is ended in order."""
        if self.endpoint.link.is_open:
            end = RuntimeStop(StopCode.END, StopCause.SESSION_ENDED)
            self.put(*self.endpoint.link.encode(end, time.monotonic()))
        while (
            self.bus.recv(timeout=0.01) is not None
        ):  # an OPEN in the END's turn is aborted with all transfers
            pass
        self._new()
        nonce = os.urandom(16)
        timing = records.Timing(20, 100, 120, 2000, 500, 200, 10_000, 25)
        self.endpoint.send_record(
            records.Open(2, self.boot_nonce, nonce, bytes(32), timing), time.monotonic(), session=0
        )
        self.port.flush()
        tag = records.session_tag(self.boot_nonce, nonce)
        self.endpoint.use_session(tag)
        self._wait(lambda item: _record(item, records.Opened))
        self.endpoint.link.open(tag, time.monotonic())
        self._wait(lambda item: isinstance(item, Accepted) and item.fresh and _beat(item.frame), beats=True)

    def provoke(self, wrong: Callable[["Peer"], None], cause: StopCause) -> float | None:
        """Seconds from the wrong to the controller's fault frame, by this side's clock; None if it had another cause."""
        wrong(self)
        began = time.perf_counter()
        while True:
            message = self.bus.recv(timeout=1.0)
            if message is None:
                raise TimeoutError("the controller did not stop")
            if message.arbitration_id == IDS[ControllerFault]:
                took = time.perf_counter() - began
                fault = decode_frame(message.arbitration_id, bytes(message.data))
                return took if isinstance(fault, ControllerFault) and fault.cause is cause else None

    def put(self, can_id: int, data: bytes) -> None:
        """One frame, as it stands."""
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


def _record(item: object, kind: type[records.Record]) -> bool:
    return isinstance(item, RecordReceived) and isinstance(item.record, kind)


def _beat(frame: Frame) -> bool:
    return type(frame).__name__ == "ControllerHeartbeat"


def _stop(peer: Peer) -> None:
    peer.put(
        *peer.endpoint.link.encode(RuntimeStop(StopCode.STOP, StopCause.OPERATOR_STOP), time.monotonic())
    )


def _corrupt(peer: Peer) -> None:
    for _ in range(3):
        peer.put(IDS[RuntimeHeartbeat], bytes(8))


def _gap(peer: Peer) -> None:
    can_id, data = peer.endpoint.link.encode(RuntimeHeartbeat(RuntimeCode.INHIBIT, 0), time.monotonic())
    peer.put(can_id, protect(data[3:], (data[2] + 100) % 256, DATA_IDS[can_id], peer.endpoint.link.tag))


def _unlisted(peer: Peer) -> None:
    can_id, data = peer.endpoint.link.encode(RuntimeHeartbeat(RuntimeCode.INHIBIT, 0), time.monotonic())
    peer.put(can_id, protect(bytes(5), data[2], DATA_IDS[can_id], peer.endpoint.link.tag))


def _silence(peer: Peer) -> None:
    """A last heartbeat, and nothing more: the clock runs from here."""
    peer.put(*peer.endpoint.link.encode(RuntimeHeartbeat(RuntimeCode.INHIBIT, 0), time.monotonic()))


FAULTS: dict[str, tuple[Callable[[Peer], None], StopCause, int, str]] = {
    "stop frame": (_stop, StopCause.OPERATOR_STOP, TRIALS, "100 ms"),
    "third corrupt frame": (_corrupt, StopCause.CORRUPTION, TRIALS, "100 ms"),
    "counter gap": (_gap, StopCause.SEQUENCE_ERROR, TRIALS, "100 ms"),
    "code that is not listed": (_unlisted, StopCause.PROTOCOL_VIOLATION, TRIALS, "100 ms"),
    "silence, from the last heartbeat": (
        _silence,
        StopCause.HEARTBEAT_LOST,
        TRIALS // 4,
        "100 ms time-out, 20 ms turn",
    ),
}


def reaction() -> Rows:
    """From the frame to the controller's fault frame: hub, simulated controller and this script as processes.

    The bound of a fault that a frame brings is the heartbeat time-out, within which the gate closes even if the frame is
    lost. No cut was running: the same table decides in every state. The runtime's own reaction is not measured.
    """
    yield ("fault", "trials", "median", "99 %", "max", "bound")
    with controller() as bus:
        peer = Peer(bus)
        for name, (wrong, cause, trials, bound) in FAULTS.items():
            took: list[float] = []
            while (
                len(took) < trials
            ):  # a machine that stood still has stopped the session before the fault did
                with suppress(TimeoutError):
                    peer.open()
                    found = peer.provoke(wrong, cause)
                    took += [] if found is None else [found]
            late = quantiles(took, n=100, method="inclusive")[98]
            yield (
                name,
                str(trials),
                *(f"{value * 1e3:.2f} ms" for value in (median(took), late, max(took))),
                bound,
            )


@contextmanager
def controller() -> Iterator[can.BusABC]:
    """A bus with a simulated controller, each in a process of its own."""
    with tempfile.TemporaryDirectory(prefix="cutgate-") as name:
        directory = Path(name)
        socket, key = directory / "bus.sock", directory / "bench.key"
        new_key_file(key, os.urandom(KEY_BYTES))
        command = [
            sys.executable,
            "-m",
            "firmware_sim",
            "--robot",
            str(EXAMPLES / "robot.toml"),
            "--key",
            str(key),
        ]
        command += ["--interface", "cutgate", "--channel", str(socket)]
        with (
            hub_process(socket),
            can.Bus(interface="cutgate", channel=str(socket)) as bus,
            subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as process,
        ):
            try:
                yield bus
            finally:
                process.terminate()


# ---------------------------------------------------------------- codec and checks


def codec() -> Rows:
    """Of one core, Python. A frame's check is identifier, CRC with tag and data ID, counter, content, age."""
    yield ("work", "time", "of a 20 ms period")
    for name, (work, count) in WORKS.items():
        took = seconds(work)[0] / count
        yield (name, f"{took * 1e6:.1f} us", f"{took / HEARTBEAT_S:.3%}")


BEATS = 1000
PERMIT = wire_permit()
KEY = bytes(range(32))
SIGNED = sign(KEY, PERMIT)
PACKED = records.pack(SIGNED, 1, 1)
BEAT = RuntimeHeartbeat(RuntimeCode.CUT, 1)


def _link(side: Side) -> Link:
    link = Link(side, timeout_s=TIMEOUT_S, heartbeat_s=HEARTBEAT_S)
    link.open(1, 0.0)
    return link


def _encode() -> None:
    link = _link(Side.RUNTIME)
    for _ in range(BEATS):
        link.encode(BEAT, 0.0)


@cache
def _beats() -> list[Sent]:
    link = _link(Side.RUNTIME)
    return [link.encode(BEAT, 0.0) for _ in range(BEATS)]


def _receive() -> None:
    link = _link(Side.CONTROLLER)
    for can_id, data in _beats():
        if not isinstance(link.receive(can_id, data, now_s=0.0), Accepted):
            raise TypeError("a sound heartbeat was refused")


def _decode() -> None:
    for can_id, data in _beats():
        decode_frame(can_id, data)


WORKS: dict[str, tuple[Callable[[], object], int]] = {
    "encode a heartbeat": (_encode, BEATS),
    "decode a heartbeat": (_decode, BEATS),
    "decode and check a heartbeat": (_receive, BEATS),
    "a sample of joints to frames": (
        lambda: [joint_frames((0.1, 0.2, 300.0, 0.4, 0.5)) for _ in range(100)],
        100,
    ),
    "permit to bytes": (lambda: [records.pack(SIGNED, 1, 1) for _ in range(100)], 100),
    "bytes to permit": (lambda: [records.unpack(PACKED) for _ in range(100)], 100),
    "sign a permit": (lambda: [sign(KEY, PERMIT) for _ in range(100)], 100),
    "verify a permit": (lambda: [verify(KEY, SIGNED) for _ in range(100)], 100),
    "read a path of 2000 poses": (lambda: records.Path.parse(prepared_bytes()), 1),
}


@cache
def prepared_bytes() -> bytes:
    """The example's path."""
    return prepared("second")[0].path.body()


SECTIONS: dict[str, Callable[[], Rows]] = {
    "A pose and an upload": pose_and_upload,
    "A session": session_bytes,
    "Cyclic load": cyclic_load,
    "Reaction to a fault": reaction,
    "Codec and checks": codec,
}


def main() -> None:
    """Print the page as it comes, and write it where asked."""
    about = f"By `make bench` on {machine()}. Bits are counted on the frames themselves; times are medians of {RUNS} runs where nothing else is said."
    show(document("Benchmarks of the wire", about, SECTIONS), __doc__.splitlines()[0] if __doc__ else None)


if __name__ == "__main__":
    main()
