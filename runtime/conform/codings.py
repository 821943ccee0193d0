"""Blocks of a path that no sound runtime sends: their place and their poses are right, their coding is not."""

import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from cutgate.protocol.coding import encode, fewest, written
from cutgate.protocol.path import HEADER_BYTES
from cutgate.protocol.records import Path, PathBlock, split
from cutgate.runtime.conform.failures import InconclusiveError

Coder = Callable[[Path], bytes]
"""The poses of a path that has one block, coded in some way."""
STILL: Final = (0, 0)
"""Order - 1 and parameter of a component that does not change: its differences of the second order are as short."""
ENDLESS: Final = 33
"""The least parameter with prefixes."""


def block(path: Path, coder: Coder) -> PathBlock:
    """The only block of a short path, its poses coded so."""
    (sound,) = split(path.body())
    return replace(sound, data=sound.data[:HEADER_BYTES] + coder(path))


def corrupted(path: Path) -> PathBlock:
    """A right coding, of other poses than the CRC-32 is of."""
    (sound,) = split(path.body())
    return replace(sound, block_crc32=zlib.crc32(b"other poses"))


def cut_short(path: Path) -> bytes:
    """A byte less."""
    return encode(path.poses)[:-1]


def a_byte_behind(path: Path) -> bytes:
    """A byte of zeros more, as if it were filled up further."""
    return encode(path.poses) + b"\0"


def a_pose_more(path: Path) -> bytes:
    """The last pose twice, where the path has it once."""
    poses = path.poses
    return encode(poses[[*range(len(poses)), -1]])


def a_pose_less(path: Path) -> bytes:
    """Without the last pose."""
    return encode(path.poses[:-1])


def in_32_bits(path: Path) -> bytes:
    """Every difference in 32 bits: the right poses, and bytes that another sender of the same path would not send."""
    return written(path.poses, [(0, 32)] * path.poses.shape[1])


def of_a_higher_order(path: Path) -> bytes:
    """What does not change as second differences of 0 bits. Raises InconclusiveError where everything changes."""
    choice = fewest(path.poses)
    if STILL not in choice:
        raise InconclusiveError("every component of the sample path changes")
    return written(path.poses, [(1, 0) if one == STILL else one for one in choice])


def endless_prefix(path: Path) -> bytes:
    """The last component's first prefix has no end: zeros up to the last byte."""
    *others, _ = [STILL] * path.poses.shape[1]
    return written(path.poses[:1], [*others, (0, ENDLESS)]) + bytes(100)
