"""The quantised path: the canonical bytes that the controller executes, and their blocks on the wire.

Header of 40 bytes, then 20 bytes a pose: tip x, y, z as int32 in um, tool axis as octahedral map u, v as int32
in units of 2**-30. Only + - * / and sqrt decode it, so decoding is the same to the last bit on every machine.
A block of 4000 of these bytes holds whole poses because the header is as long as two. It is sent coded (``coding``),
each block on its own, and stored as the bytes themselves.
"""

import functools
import math
import zlib
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cutgate.protocol.arrays import Bools, Floats
from cutgate.protocol.coding import COMPONENTS, coded_bytes_max, decode, encode
from cutgate.protocol.parameters import UNIT, counts_nearest
from cutgate.protocol.wire import (
    I16,
    I64,
    U8,
    U16,
    U32,
    Blob,
    Block,
    Channel,
    Choice,
    Record,
    RecordError,
    Rest,
    Side,
    digest,
)

Elbow = Literal["right", "left"]
ElbowCode = Annotated[Elbow, Choice(("right", "left"))]

MAGIC = b"cutgate.path"
FORMAT = 1
LINE_AND_GREAT_CIRCLE = 1
"""Interpolation: the tip on a straight line, the axis on a great circle, both linear in one parameter."""
MICROMETRE_AND_OCTAHEDRAL = 1
"""Units: tip in um, axis as octahedral map scaled by 2**30."""
SCALE = 1 << 30
POSE_BYTES = 20
HEADER_BYTES = 40
POSES_MAX = 1 << 20
PATH_BYTES_MAX = HEADER_BYTES + POSE_BYTES * POSES_MAX
BLOCK_BYTES = 4000
BLOCK_DATA_MAX = coded_bytes_max(BLOCK_BYTES // POSE_BYTES)
"""Of the first block too: its header takes no more than two poses at their worst."""
TURNS_MAX = 100
TURN_MAX_DEG = 179.0
_HALF_SUM_MIN = math.cos(math.radians(TURN_MAX_DEG / 2.0))


def encode_axes(axes: Floats) -> NDArray[np.int32]:
    """Octahedral map of directions (n, 3), any length, as int32 (n, 2). +z is (0, 0), -z is (2**30, 2**30)."""
    plane = axes / np.sum(np.abs(axes), axis=1, keepdims=True)
    flat = plane[:, :2]
    folded = (1.0 - np.abs(flat[:, ::-1])) * np.where(flat < 0.0, -1.0, 1.0)
    codes: NDArray[np.int32] = np.rint(np.where(plane[:, 2:] < 0.0, folded, flat) * SCALE).astype(np.int32)
    return codes


def decode_axes(mapped: NDArray[np.int32]) -> Floats:
    """Unit vectors (n, 3) of octahedral pairs (n, 2); the fold is undone in integers."""
    flat = mapped.astype(np.int64)
    height = SCALE - np.abs(flat[:, 0]) - np.abs(flat[:, 1])
    folded = (SCALE - np.abs(flat[:, ::-1])) * np.where(flat < 0, -1, 1)
    plane = np.where(height[:, np.newaxis] < 0, folded, flat)
    vector = np.column_stack((plane, height)).astype(np.float64)
    x, y, z = vector[:, 0], vector[:, 1], vector[:, 2]
    length = np.sqrt((x * x + y * y) + z * z)
    # + 0.0 turns -0.0 into 0.0
    return vector / length[:, np.newaxis] + 0.0


@dataclass(frozen=True)
class PathHeader(Block):
    """The first 40 bytes: everything about a path but its poses, read without looking at these."""

    magic: Annotated[bytes, Blob(12)]
    version: U8
    interpolation: U8
    units: U8
    elbow: ElbowCode
    q0_turns: I16
    roll_turns: I16
    feed_u: I64
    tool_length_u: I64
    count: U32

    def check(self) -> None:
        """Refuse what this version cannot execute."""
        wanted = (MAGIC, FORMAT, LINE_AND_GREAT_CIRCLE, MICROMETRE_AND_OCTAHEDRAL)
        found = (self.magic, self.version, self.interpolation, self.units)
        if found != wanted:
            raise RecordError(f"path format, interpolation and units are {found}, must be {wanted}")
        for name, turns in (("q0_turns", self.q0_turns), ("roll_turns", self.roll_turns)):
            if not abs(turns) <= TURNS_MAX:
                raise RecordError(f"path {name} is {turns}, must be within +-{TURNS_MAX}")
        if not self.feed_u > 0:
            raise RecordError(f"path feed is {self.feed_u / UNIT} mm/s, must be > 0")
        if not self.tool_length_u >= 0:
            raise RecordError(f"path tool length is {self.tool_length_u / UNIT} mm, must be >= 0")
        if not 2 <= self.count <= POSES_MAX:
            raise RecordError(f"path has {self.count} poses, must have 2..{POSES_MAX}")

    @classmethod
    def of(cls, body: bytes) -> Self:
        """The header of a path's canonical bytes, whose poses were judged when they came. Raises RecordError."""
        header = cls.parse(body[:HEADER_BYTES])
        if len(body) != HEADER_BYTES + POSE_BYTES * header.count:
            raise RecordError(f"path of {header.count} poses is {len(body)} bytes long")
        return header

    @property
    def feed_mm_s(self) -> float:
        """Programmed feed, mm/s."""
        return self.feed_u / UNIT

    @property
    def tool_length_mm(self) -> float:
        """Wrist centre to tip, mm."""
        return self.tool_length_u / UNIT


@dataclass(frozen=True)
class PathCodes:
    """A path whose header has been judged and whose poses have not: taking it over costs nothing, however long it is.

    Attributes:
        elbow: the arm's elbow on the whole path.
        q0_turns: full turns of q0 at the first pose.
        roll_turns: full turns of q3 at the first pose.
        feed_u: feed, 1e-6 mm/s.
        tool_length_u: tool the path was made for, 1e-6 mm.
        pose_bytes: 20 bytes a pose.
    """

    elbow: Elbow
    q0_turns: int
    roll_turns: int
    feed_u: int
    tool_length_u: int
    pose_bytes: bytes

    def __post_init__(self) -> None:
        if len(self.pose_bytes) % POSE_BYTES:
            raise RecordError(
                f"path poses are {len(self.pose_bytes)} bytes, must be a multiple of {POSE_BYTES}"
            )
        self._header()

    def _header(self) -> PathHeader:
        return PathHeader(
            magic=MAGIC,
            version=FORMAT,
            interpolation=LINE_AND_GREAT_CIRCLE,
            units=MICROMETRE_AND_OCTAHEDRAL,
            elbow=self.elbow,
            q0_turns=self.q0_turns,
            roll_turns=self.roll_turns,
            feed_u=self.feed_u,
            tool_length_u=self.tool_length_u,
            count=len(self.pose_bytes) // POSE_BYTES,
        )

    def body(self) -> bytes:
        """The canonical bytes."""
        return self._header().body() + self.pose_bytes

    @classmethod
    def parse(cls, body: bytes) -> Self:
        """The path of canonical bytes; raises RecordError for anything wrong with what is judged."""
        header = PathHeader.of(body)
        return cls(
            elbow=header.elbow,
            q0_turns=header.q0_turns,
            roll_turns=header.roll_turns,
            feed_u=header.feed_u,
            tool_length_u=header.tool_length_u,
            pose_bytes=bytes(body[HEADER_BYTES:]),
        )

    @property
    def digest(self) -> bytes:
        """SHA-256 of the canonical bytes."""
        return digest(self.body())

    def __len__(self) -> int:
        return len(self.pose_bytes) // POSE_BYTES

    @property
    def poses(self) -> NDArray[np.int32]:
        """The codes, (n, 5), read-only."""
        return np.frombuffer(self.pose_bytes, dtype="<i4").reshape(-1, 5)

    def judge(self, begin: int, end: int) -> None:
        """Look at these poses, and at how each follows the one before it. Raises RecordError for the first wrong one."""
        before = max(begin - 1, 0)
        _judge(self.poses[before:end], self.decoded(before, end)[1], before)

    def decoded(self, begin: int, end: int) -> tuple[Floats, Floats]:
        """Tips, mm, and unit axes of these poses, (k, 3) each."""
        codes = self.poses[begin:end]
        return codes[:, :3] / 1000.0, decode_axes(codes[:, 3:])

    @functools.cached_property
    def tips_mm(self) -> Floats:
        """Cutter tips, mm, (n, 3), read-only."""
        tips = self.poses[:, :3] / 1000.0
        tips.setflags(write=False)
        return tips

    @property
    def feed_mm_s(self) -> float:
        """Programmed feed, mm/s."""
        return self.feed_u / UNIT

    @property
    def tool_length_mm(self) -> float:
        """Wrist centre to tip, mm."""
        return self.tool_length_u / UNIT


@dataclass(frozen=True)
class Path(PathCodes):
    """A path in controller coordinates, as verified, stored and executed: every pose of it has been judged."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _judge(self.poses, self.axes, 0)

    @classmethod
    def quantised(
        cls,
        tips_mm: ArrayLike,
        axes: ArrayLike,
        *,
        feed_mm_s: float,
        tool_length_mm: float,
        elbow: Elbow,
        q0_turns: int = 0,
        roll_turns: int = 0,
    ) -> Self:
        """The path to the nearest code: tip coordinates within 0.5 um, axes within 1e-6 rad.

        Args:
            tips_mm: (n, 3), mm.
            axes: (n, 3), from the tip toward the holder, unit within 1e-3.
            feed_mm_s: programmed feed, mm/s.
            tool_length_mm: wrist centre to tip, mm.
            elbow: the arm's elbow.
            q0_turns: full turns of q0 at the first pose.
            roll_turns: full turns of q3 at the first pose.

        Raises:
            RecordError: not finite, beyond the codes, fewer than two poses, or neighbouring axes too far apart.
        """
        tips, directions = np.asarray(tips_mm, dtype=np.float64), np.asarray(axes, dtype=np.float64)
        if tips.ndim != 2 or tips.shape[1] != 3 or tips.shape != directions.shape:
            raise RecordError(f"path tips are {tips.shape} and axes {directions.shape}, both must be (n, 3)")
        _refuse_first(~np.all(np.isfinite(tips) & np.isfinite(directions), axis=1), "is not finite")
        micrometres = np.rint(tips * 1000.0)
        _refuse_first(~np.all(np.abs(micrometres) < 2.0**31, axis=1), "tip is beyond +-2147483.647 mm")
        lengths = np.linalg.norm(directions, axis=1)
        _refuse_first(~(np.abs(lengths - 1.0) <= 1e-3), "axis length is not within 0.001 of 1")
        poses = np.column_stack((micrometres.astype(np.int64), encode_axes(directions))).astype("<i4")
        return cls(
            elbow=elbow,
            q0_turns=q0_turns,
            roll_turns=roll_turns,
            feed_u=counts_nearest(feed_mm_s, "feed"),
            tool_length_u=counts_nearest(tool_length_mm, "tool length"),
            pose_bytes=poses.tobytes(),
        )

    @functools.cached_property
    def axes(self) -> Floats:
        """Unit tool axes, (n, 3), read-only."""
        axes = decode_axes(self.poses[:, 3:])
        axes.setflags(write=False)
        return axes


def _judge(codes: NDArray[np.int32], axes: Floats, first: int) -> None:
    """Refuse axis codes beyond their scale, and neighbouring axes too far apart; ``first`` is the first pose's number."""
    mapped = np.abs(codes[:, 3:].astype(np.int64))
    _refuse_first(~np.all(mapped <= SCALE, axis=1), "axis code is beyond 2**30", first)
    half_sum = np.sqrt(np.sum((0.5 * (axes[1:] + axes[:-1])) ** 2, axis=1))
    wrong = ~(half_sum >= _HALF_SUM_MIN)
    _refuse_first(wrong, f"axis is more than {TURN_MAX_DEG} deg from the next pose's", first)


def _refuse_first(wrong: Bools, why: str, first: int = 0) -> None:
    """Raise for the first pose at which something is wrong."""
    if np.any(wrong):
        raise RecordError(f"path pose {first + int(np.argmax(wrong))}: {why}")


@dataclass(frozen=True)
class PathBlock(Record):
    """Part `index` of `count` of a path's bytes, its poses coded.

    Which bytes it stands for follows from its index and from `total`, and so how many poses it holds.
    """

    TYPE: ClassVar[int] = 0x20
    SENDER: ClassVar[Side] = Side.RUNTIME
    CHANNEL: ClassVar[Channel] = Channel.BULK

    index: U16
    count: U16
    offset: U32
    total: U32
    block_crc32: U32
    """Over the path's bytes, not their coding: it is kept with them, and what a decoder makes is held against it."""
    data: Annotated[bytes, Rest(BLOCK_DATA_MAX)]

    def check(self) -> None:
        """Refuse a block that does not lie where its index says. What it holds is looked at when it is decoded."""
        least = HEADER_BYTES + 2 * POSE_BYTES
        if not least <= self.total <= PATH_BYTES_MAX or self.total % POSE_BYTES:  # a header is as long as two
            raise RecordError(
                f"PathBlock.total is {self.total}, must be {HEADER_BYTES} and {POSE_BYTES} for each of 2..{POSES_MAX} poses"
            )
        if self.count != -(-self.total // BLOCK_BYTES) or not self.index < self.count:
            raise RecordError(f"PathBlock {self.index} of {self.count} does not fit {self.total} bytes")
        if self.offset != self.index * BLOCK_BYTES:
            raise RecordError(f"PathBlock {self.index}: offset must be {self.index * BLOCK_BYTES}")

    def decoded(self) -> bytes:
        """The path's bytes, at most BLOCK_BYTES.

        Raises:
            RecordError: `data` is not the coding of that many poses, or not of those with this CRC-32.
        """
        header, coded = self.data[: self._header_bytes], self.data[self._header_bytes :]
        size = min(BLOCK_BYTES, self.total - self.offset) - self._header_bytes
        try:
            poses = decode(coded, size // POSE_BYTES)
        except RecordError as error:
            raise RecordError(f"PathBlock {self.index}: {error}") from None
        found = header + poses.astype("<i4").tobytes()
        if self.block_crc32 != zlib.crc32(found):
            raise RecordError(f"PathBlock {self.index}: CRC-32 does not match its poses")
        return found

    @property
    def _header_bytes(self) -> int:
        return HEADER_BYTES if self.index == 0 else 0


def path_block(path_bytes: bytes, index: int) -> PathBlock:
    """One block of a path's canonical bytes, coded."""
    total, offset = len(path_bytes), index * BLOCK_BYTES
    part = path_bytes[offset : offset + BLOCK_BYTES]
    header = HEADER_BYTES if index == 0 else 0
    poses = np.frombuffer(part[header:], dtype="<i4")
    data = part[:header] + encode(poses.reshape(len(poses) // COMPONENTS, COMPONENTS))
    return PathBlock(index, -(-total // BLOCK_BYTES), offset, total, zlib.crc32(part), data)


def split(path_bytes: bytes) -> list[PathBlock]:
    """The blocks of a path's canonical bytes, in the order in which they are sent."""
    return [path_block(path_bytes, index) for index in range(-(-len(path_bytes) // BLOCK_BYTES))]


@dataclass(frozen=True)
class Assembly:
    """The path's bytes received so far, block by block, in order; a value, never changed."""

    blocks: tuple[bytes, ...] = ()
    crc32s: tuple[int, ...] = ()
    total: int = 0

    def add(self, block: PathBlock) -> "Assembly":
        """This assembly and one block more, decoded.

        Raises:
            RecordError: it is not the next one of the same path, or not what a sound path is coded as.
        """
        if block.index != len(self.blocks):
            raise RecordError(f"PathBlock {block.index} came where {len(self.blocks)} was due")
        if self.blocks and block.total != self.total:
            raise RecordError(f"PathBlock {block.index} is of {block.total} bytes, the path of {self.total}")
        return Assembly((*self.blocks, block.decoded()), (*self.crc32s, block.block_crc32), block.total)

    @property
    def complete(self) -> bool:
        """Whether every byte is here."""
        return bool(self.blocks) and len(self.blocks) == -(-self.total // BLOCK_BYTES)

    @property
    def data(self) -> bytes:
        """The path's bytes. Raises RecordError while blocks are missing."""
        if not self.complete:
            raise RecordError(f"path is not complete: {len(self.blocks)} blocks of {self.total} bytes")
        return b"".join(self.blocks)


def block_of_pose(pose: int) -> int:
    """The index of the block that holds a pose's bytes: a pose never lies across two."""
    return (HEADER_BYTES + POSE_BYTES * pose) // BLOCK_BYTES
