"""What the wire costs and how soon a fault stops it: ``python benchmarks/wire.py [--write FILE]``.

Markdown tables on stdout; with ``--write`` in a file as well.
"""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
from bits import CLASSIC_BIT_S, DATA_BIT_S, FULL_S, WORST_BITS, Sent
from measure import RUNS, machine, seconds
from numpy.typing import NDArray
from pages import Rows, document, show
from paths import EXAMPLES, prepared
from reaction import controller_cutting, controller_idle, runtime_cutting
from turns import longest_turns

from cutgate.protocol import records
from cutgate.protocol.coding import decode, encode
from cutgate.protocol.endpoint import Endpoint, RecordReceived
from cutgate.protocol.frames import IDS, TRANSFER_IDS, RuntimeHeartbeat, decode_frame, joint_frames
from cutgate.protocol.link import Accepted, Link
from cutgate.protocol.path import PathHeader, split
from cutgate.protocol.records import Side
from cutgate.protocol.states import RuntimeCode

sys.path.insert(0, str(Path(__file__).parents[2]))
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session.job import make_job, read_files
from tests.protocol.sessions import CODES, DIGEST, KEY
from tests.runtime.audit.build import wire_permit
from tests.runtime.session.pair import Pair, pair_of

HEARTBEAT_S, TIMEOUT_S = 0.02, 0.1


# ---------------------------------------------------------------- bytes and bus time


@dataclass
class Uploaded:
    """A path as it crosses the bus: every frame of both sides, the bytes that are stored, and those that say them."""

    frames: list[Sent]
    poses: int
    stored: int
    coded: int
    blocks: int

    @property
    def seconds(self) -> float:
        """On a bus that does nothing else."""
        return sum(frame.seconds for frame in self.frames)


@cache
def upload(registration: str = "second", name: str = "hip-stem", *, fd: bool) -> Uploaded:
    """A shipped path, sent block by block."""
    path = prepared(registration, name)[0].path
    blocks = split(path.body())
    sides = {
        side: Endpoint(side, KEY, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=1.0, fd=fd)
        for side in Side
    }
    for endpoint in sides.values():
        endpoint.use_session(DIGEST)
    frames: list[Sent] = []
    for block in blocks:
        sides[Side.RUNTIME].send_record(block, 0.0)
        stored = False
        while moved := [(side, frame) for side in Side for frame in sides[side].outgoing()]:
            for side, (can_id, data) in moved:
                is_fd = sides[side].is_fd(can_id)
                frames.append(Sent(can_id, data, is_fd))
                items = sides[side.peer].receive(can_id, data, is_fd=is_fd, now_s=0.0)
                if any(isinstance(item, RecordReceived) for item in items) and not stored:
                    stored = True
                    sides[Side.CONTROLLER].send_record(records.BlockStored(block.index), 0.0)
    coded = sum(len(block.data) for block in blocks)
    return Uploaded(frames, len(path), len(path.body()), coded, len(blocks))


def pose_and_upload() -> Rows:
    """The hip stem's path as it is uploaded, flow control and answers included, on a bus that does nothing else.

    A limit of the bit rate is bytes alone at the data rate: no identifier, check or stuff bit; once of the path as it is
    stored, 20 bytes a pose, once as it is coded. ISO-TP cannot come nearer to the latter than with full frames alone, 7 or
    63 bytes of a record in each, without stuff bits (last row).
    """
    columns = [_upload_column(fd=fd) for fd in (False, True)]
    yield ("2000 poses", "classic, 1 Mbit/s", "FD, 1 and 5 Mbit/s")
    yield from zip(UPLOAD, *columns, strict=True)


UPLOAD = (
    "frames",
    "of them flow control",
    "bytes of the path",
    "bytes of it, coded",
    "bytes a pose, coded",
    "bytes of data on the bus",
    "bytes a pose, of data on the bus",
    "bits a pose",
    "bus time a pose",
    "upload",
    "limit of the path",
    "upload / limit of the path",
    "limit of the coded path",
    "upload / limit of the coded path",
    "full frames without stuff bits / limit of the coded path",
)


def _upload_column(*, fd: bool) -> tuple[str, ...]:
    sent = upload(fd=fd)
    frames, took, poses = sent.frames, sent.seconds, sent.poses
    carried = sum(len(frame.data) for frame in frames)
    limit, coded_limit = (
        size * 8 * (DATA_BIT_S if fd else CLASSIC_BIT_S) for size in (sent.stored, sent.coded)
    )
    lowest = sent.coded / (63 if fd else 7) * FULL_S[fd]
    return (
        str(len(frames)),
        str(sum(frame.data[0] >> 4 == 3 for frame in frames)),
        str(sent.stored),
        str(sent.coded),
        f"{sent.coded / poses:.2f}",
        str(carried),
        f"{carried / poses:.2f}",
        f"{sum(frame.bits for frame in frames) / poses:.1f}",
        f"{took / poses * 1e6:.1f} us",
        f"{took:.3f} s",
        f"{limit:.3f} s",
        f"{took / limit:.2f}",
        f"{coded_limit:.3f} s",
        f"{took / coded_limit:.2f}",
        f"{lowest / coded_limit:.2f}",
    )


def coded_paths() -> Rows:
    """Each shipped path: what is stored, how it is coded, and what its upload takes of a bus that does nothing else.

    To the limit: upload, of the path as it is stored, 20 bytes a pose, at the data rate.
    """
    yield (
        "path",
        "poses",
        "blocks",
        "bytes a pose, coded",
        "classic",
        "to the limit",
        "FD",
        "to the limit, FD",
    )
    for registration, name in (("second", "hip-stem"), ("femoral", "femoral"), ("tibial", "tibial")):
        sent = upload(registration, name, fd=False)
        yield (
            name,
            str(sent.poses),
            str(sent.blocks),
            f"{sent.coded / sent.poses:.2f}",
            *_took(sent, CLASSIC_BIT_S),
            *_took(upload(registration, name, fd=True), DATA_BIT_S),
        )


def _took(sent: Uploaded, bit_s: float) -> tuple[str, str]:
    return (f"{sent.seconds:.3f} s", f"{sent.seconds / (sent.stored * 8 * bit_s):.2f}")


@dataclass
class Recorded:
    """A whole session, frame by frame: when, and what."""

    frames: list[tuple[float, Sent]]
    cutting: tuple[float, float]
    poses: int


@cache
def session(*, fd: bool) -> Recorded:
    """Both loops on a bus in memory, in virtual time, from the announcement to the end of the cut."""
    with tempfile.TemporaryDirectory() as directory:
        files = read_files(
            EXAMPLES / "hip-stem.plan.json",
            EXAMPLES / "robot.toml",
            EXAMPLES / "registration-second.json",
            None,
            None,
            allow_simulated=True,  # its plant runs faster than the clock
        )
        job = make_job(files, now=datetime.now(UTC))
        with pair_of(Path(directory), files, job, fd=tuple(Side) if fd else ()) as pair:
            return _recorded(pair)


def _recorded(pair: Pair) -> Recorded:
    pair.power_up(time_scale=100.0)
    pair.to(Phase.CUTTING, limit_s=60.0)
    began = pair.clock()
    pair.end(600.0)
    ended = pair.clock()
    if pair.phase is not Phase.DONE:
        raise ValueError(f"the session ended {pair.phase}: {pair.state.reason}")
    frames = [(seen.at_s, Sent(seen.can_id, seen.data, seen.is_fd)) for seen in pair.wire.seen]
    return Recorded(frames, (began, ended), PathHeader.of(pair.job.path).count)


NAMES = {can_id: kind.__name__ for kind, can_id in IDS.items()} | {
    can_id: f"{channel.name.lower()} records of the {side.name.lower()}"
    for side in Side
    for channel, can_id in TRANSFER_IDS[side].items()
}


def session_bytes() -> Rows:
    """A session that cuts the hip stem, heartbeats every 20 ms, the arm at 100 times its speed; exact stuff bits.

    The limit is the data of these frames alone, at 1 Mbit/s, those of FD frames at 5 Mbit/s.
    """
    runs = [session(fd=fd) for fd in (False, True)]
    yield ("frames of", *(f"{what}, {mode}" for mode in ("classic", "FD") for what in SESSION))
    for can_id in sorted({frame.can_id for run in runs for _, frame in run.frames}):
        yield _share(NAMES[can_id], [[f for _, f in run.frames if f.can_id == can_id] for run in runs])
    whole = [[frame for _, frame in run.frames] for run in runs]
    yield _share("all", whole)
    poses = runs[0].poses
    yield ("all, a pose", *(cell for frames in whole for cell in _per_pose(frames, poses)))
    yield (
        "all / limit of the bit rate",
        *(cell for frames in whole for cell in ("", "", "", _to_limit(frames))),
    )


SESSION = ("frames", "bytes", "bits", "bus time")


def _share(name: str, frames: list[list[Sent]]) -> tuple[str, ...]:
    return (name, *(cell for sent in frames for cell in _sums(sent)))


def _sums(frames: list[Sent]) -> tuple[str, ...]:
    size, bits = sum(len(frame.data) for frame in frames), sum(frame.bits for frame in frames)
    return (str(len(frames)), str(size), str(bits), f"{sum(f.seconds for f in frames) * 1e3:.2f} ms")


def _per_pose(frames: list[Sent], poses: int) -> tuple[str, ...]:
    counts = (len(frames), sum(len(f.data) for f in frames), sum(f.bits for f in frames))
    return (
        *(f"{count / poses:.2f}" for count in counts),
        f"{sum(f.seconds for f in frames) / poses * 1e6:.1f} us",
    )


def _to_limit(frames: list[Sent]) -> str:
    limit = sum(8 * len(f.data) * (DATA_BIT_S if f.is_fd else CLASSIC_BIT_S) for f in frames)
    return f"{sum(f.seconds for f in frames) / limit:.2f}"


def cyclic_load() -> Rows:
    """What both sides send while the arm cuts, heartbeats every 20 ms, of the bits that 1 Mbit/s carries.

    The worst case has a stuff bit after every four bits: 135 bits a frame with the intermission.
    """
    run = session(fd=False)
    began, ended = run.cutting
    frames = [frame for at, frame in run.frames if began + 0.1 < at <= ended - 0.1]
    span = ended - began - 0.2
    worst = len(frames) * WORST_BITS * CLASSIC_BIT_S
    yield ("window", "frames/s", "load", "worst case of these frames")
    yield (
        f"{span:.2f} s",
        f"{len(frames) / span:.0f}",
        f"{sum(frame.seconds for frame in frames) / span:.2%}",
        f"{worst / span:.2%}",
    )


# ---------------------------------------------------------------- codec and checks


def codec() -> Rows:
    """Of one core, Python. A frame's check is identifier, CRC with tag and data ID, counter, content, age."""
    yield ("work", "time", "of a 20 ms period")
    for name, (work, count) in WORKS.items():
        took = seconds(work)[0] / count
        yield (name, f"{took * 1e6:.1f} us", f"{took / HEARTBEAT_S:.3%}")


BEATS = 1000
BEAT = RuntimeHeartbeat(RuntimeCode.CUT, 1)


@cache
def _permit() -> records.Permit:
    return wire_permit()


@cache
def _signed() -> records.Permit:
    return CODES.sign(_permit(), 1)


@cache
def _packed() -> bytes:
    return records.pack(_signed(), 1, 1)


def _link(side: Side) -> Link:
    link = Link(side, timeout_s=TIMEOUT_S, heartbeat_s=HEARTBEAT_S)
    link.open(CODES, 0.0)
    return link


def _encode() -> None:
    link = _link(Side.RUNTIME)
    for _ in range(BEATS):
        link.encode(BEAT, 0.0)


@cache
def _beats() -> list[tuple[int, bytes]]:
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
    "permit to bytes": (lambda: [records.pack(_signed(), 1, 1) for _ in range(100)], 100),
    "bytes to permit": (lambda: [records.unpack(_packed()) for _ in range(100)], 100),
    "sign a permit": (lambda: [CODES.sign(_permit(), 1) for _ in range(100)], 100),
    "verify a permit": (lambda: [CODES.authentic(_signed(), 1) for _ in range(100)], 100),
    "read a path of 2000 poses": (lambda: records.Path.parse(prepared_bytes()), 1),
    "code a block of 200 poses": (lambda: [encode(_poses()) for _ in range(100)], 100),
    "decode and check a block of 200 poses": (lambda: [decode(encode_once(), 200) for _ in range(100)], 100),
}


@cache
def _poses() -> NDArray[np.int32]:
    return prepared("second")[0].path.poses[198:398]


@cache
def encode_once() -> bytes:
    """Of these poses, the second block of the example's path."""
    return encode(_poses())


@cache
def prepared_bytes() -> bytes:
    """The example's path."""
    return prepared("second")[0].path.body()


SECTIONS: dict[str, Callable[[], Rows]] = {
    "A pose and an upload": pose_and_upload,
    "Coded paths": coded_paths,
    "A session": session_bytes,
    "Cyclic load": cyclic_load,
    "The controller's reaction, no cut running": controller_idle,
    "The controller's reaction while it cuts": controller_cutting,
    "The runtime's reaction while the arm cuts": runtime_cutting,
    "The longest turn": longest_turns,
    "Codec and checks": codec,
}


def main() -> None:
    """Print the page as it comes, and write it where asked."""
    about = f"By `make bench` on {machine()}. Bits are counted on the frames themselves; times are medians of {RUNS} runs where nothing else is said."
    show(document("Benchmarks of the wire", about, SECTIONS), __doc__.splitlines()[0] if __doc__ else None)


if __name__ == "__main__":
    main()
