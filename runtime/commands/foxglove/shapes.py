"""Numbers of ours, in mm, deg and rad, as parts of messages: metres, quaternions, colours, lines. Pure."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.runtime.audit.records import ZERO, Time
from cutgate.runtime.commands.foxglove.schemas import (
    FoxgloveColor,
    FoxgloveCylinder,
    FoxgloveKeyValuePair,
    FoxgloveLine,
    FoxgloveLineType,
    FoxglovePoint3,
    FoxglovePose,
    FoxgloveQuaternion,
    FoxgloveSceneEntity,
    FoxgloveSphere,
    FoxgloveText,
    FoxgloveVector3,
)

MM_PER_M: Final = 1000.0
_MICROMETRE: Final = 6
"""Decimals of a metre."""
_UNIT: Final = 9
"""Decimals of a part of a unit quaternion."""


def metres(point_mm: Floats) -> list[float]:
    """A point, shape (3,), in m."""
    return [round(value / MM_PER_M, _MICROMETRE) + 0.0 for value in point_mm.tolist()]


def vector(point_mm: Floats) -> FoxgloveVector3:
    """A place or direction, mm, shape (3,)."""
    x, y, z = metres(point_mm)
    return FoxgloveVector3(x=x, y=y, z=z)


def points(line_mm: Floats) -> tuple[FoxglovePoint3, ...]:
    """Places, mm, shape (n, 3)."""
    return tuple(FoxglovePoint3(x=x, y=y, z=z) for x, y, z in map(metres, line_mm))


def quaternion(x: float, y: float, z: float, w: float) -> FoxgloveQuaternion:
    """A unit quaternion, rounded."""
    x, y, z, w = (round(value, _UNIT) + 0.0 for value in (x, y, z, w))
    return FoxgloveQuaternion(x=x, y=y, z=z, w=w)


UNTURNED: Final = quaternion(0.0, 0.0, 0.0, 1.0)


def about_z(angle_rad: float) -> FoxgloveQuaternion:
    """The rotation about z."""
    return quaternion(0.0, 0.0, math.sin(angle_rad / 2.0), math.cos(angle_rad / 2.0))


def about_z_then_y(z_rad: float, y_rad: float) -> FoxgloveQuaternion:
    """The rotation about z, and behind it about the y that has turned with it."""
    sz, cz, sy, cy = (
        math.sin(z_rad / 2.0),
        math.cos(z_rad / 2.0),
        math.sin(y_rad / 2.0),
        math.cos(y_rad / 2.0),
    )
    return quaternion(-sz * sy, cz * sy, sz * cy, cz * cy)


def with_z_along(axis: Floats) -> FoxgloveQuaternion:
    """A rotation that brings z to a unit axis, shape (3,)."""
    x, y, z = axis.tolist()
    return about_z_then_y(math.atan2(y, x), math.atan2(math.hypot(x, y), z))


def of_matrix(rotation: Floats) -> FoxgloveQuaternion:
    """A rotation, shape (3, 3), proper; by the greatest of the four parts, so that no small number is divided by."""
    m, trace = rotation, float(np.trace(rotation))
    squares = np.array([m[0, 0], m[1, 1], m[2, 2], trace]) * 2.0 - trace + 1.0
    k = int(np.argmax(squares))
    parts = np.empty(4)
    parts[k] = squares[k]
    if k == 3:
        parts[:3] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    else:
        i, j = (k + 1) % 3, (k + 2) % 3
        parts[i], parts[j], parts[3] = m[i, k] + m[k, i], m[j, k] + m[k, j], m[j, i] - m[i, j]
    x, y, z, w = (parts / np.linalg.norm(parts)).tolist()
    return quaternion(x, y, z, w)


def pose(position_mm: Floats, orientation: FoxgloveQuaternion = UNTURNED) -> FoxglovePose:
    """A pose, its place in mm."""
    return FoxglovePose(position=vector(position_mm), orientation=orientation)


ORIGIN: Final = pose(np.zeros(3))


def colour(code: str, opacity: float = 1.0) -> FoxgloveColor:
    """A colour from its code, ``#rrggbb``."""
    r, g, b = (round(int(code[k : k + 2], 16) / 255.0, 4) for k in (1, 3, 5))
    return FoxgloveColor(r=r, g=g, b=b, a=opacity)


def line(
    points_mm: Floats,
    of: FoxgloveColor,
    pixels: float,
    indices: Ints | None = None,
    kind: FoxgloveLineType = FoxgloveLineType.LINE_STRIP,
) -> FoxgloveLine:
    """Lines of a width on the screen that does not depend on how near they are.

    Args:
        points_mm: shape (n, 3).
        of: their colour.
        pixels: their width.
        indices: of the points, where not each in its order.
        kind: how points become lines.
    """
    return FoxgloveLine(
        type=kind,
        pose=ORIGIN,
        thickness=pixels,
        scale_invariant=True,
        points=points(points_mm),
        color=of,
        colors=(),
        indices=() if indices is None else tuple(indices.tolist()),
    )


def cylinder(begin_mm: Floats, end_mm: Floats, wide_mm: float, of: FoxgloveColor) -> FoxgloveCylinder:
    """From one point to another; of no length where they are one."""
    along = end_mm - begin_mm
    length = float(np.linalg.norm(along))
    axis = along / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    return FoxgloveCylinder(
        pose=pose((begin_mm + end_mm) / 2.0, with_z_along(axis)),
        size=vector(np.array([wide_mm, wide_mm, length])),
        bottom_scale=1.0,
        top_scale=1.0,
        color=of,
    )


def sphere(centre_mm: Floats, wide_mm: float, of: FoxgloveColor) -> FoxgloveSphere:
    """A ball."""
    return FoxgloveSphere(pose=pose(centre_mm), size=vector(np.full(3, wide_mm)), color=of)


def label(place_mm: Floats, text: str, of: FoxgloveColor) -> FoxgloveText:
    """Words at a place, as large as the screen's."""
    return FoxgloveText(
        pose=pose(place_mm), billboard=True, font_size=14.0, scale_invariant=True, color=of, text=text
    )


def entity(
    identifier: str,
    frame: str,
    at: Time,
    *,
    told: Sequence[tuple[str, str]] = (),
    lines: Sequence[FoxgloveLine] = (),
    cylinders: Sequence[FoxgloveCylinder] = (),
    spheres: Sequence[FoxgloveSphere] = (),
    texts: Sequence[FoxgloveText] = (),
) -> FoxgloveSceneEntity:
    """A thing that stays, and moves with its frame."""
    return FoxgloveSceneEntity(
        timestamp=at,
        frame_id=frame,
        id=identifier,
        lifetime=ZERO,
        frame_locked=True,
        metadata=tuple(FoxgloveKeyValuePair(key=key, value=value) for key, value in told),
        lines=tuple(lines),
        cylinders=tuple(cylinders),
        spheres=tuple(spheres),
        texts=tuple(texts),
    )
