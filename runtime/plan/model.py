"""What plan and registration files hold, and the frames they speak of.

A pose in implant coordinates reaches the robot frame as ``R_p = R_T_CT * CT_T_I * I_p``.
"""

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import chain
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, Strict

from cutgate.config.constants import CONSTANTS
from cutgate.config.model import Real, Strictly, Text, broken
from cutgate.config.refusal import InputError, shown
from cutgate.protocol.arrays import Floats
from cutgate.protocol.times import since_1970_us

COORDINATE_MM: Final = 10_000.0
TRANSLATION_MM: Final = 100_000.0
RIGID: Final = 1e-6
DECIMALS: Final = 7
"""So many are enough for a rotation to be rigid, whatever it is."""
UNIT_AXIS: Final = 1e-3
AXIS_DECIMALS: Final = 4
"""So many are enough for an axis to be of length 1."""
NUMBERS: Final = frozenset({int, float})
LAST_ROW: Final = (0.0, 0.0, 0.0, 1.0)


def _rigid(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    """Refuses what is not a rigid transform: orthonormal to 1e-6, determinant +1, last row 0 0 0 1."""
    matrix = np.array(rows, dtype=np.float64)
    if rows[3] != LAST_ROW:
        raise broken("0 0 0 1 in the last row", "write the 4x4 matrix row by row", found=list(rows[3]))
    if not (float(np.abs(matrix[:3, 3]).max()) <= TRANSLATION_MM):
        raise broken(
            f"translated by at most {TRANSLATION_MM:g} mm", "lengths are mm", found=matrix[:3, 3].tolist()
        )
    if not (float(np.abs(matrix[:3, :3]).max()) <= 2.0):
        raise broken(
            "a rotation: no entry beyond 1", "no scaling, no shear", found=float(np.abs(matrix[:3, :3]).max())
        )
    error = float(np.abs(matrix[:3, :3].T @ matrix[:3, :3] - np.eye(3)).max())
    if not (error <= RIGID):
        remedy = _too_few_decimals(matrix[:3, :3], error) or "no scaling, no shear"
        raise broken(f"orthonormal to {RIGID:g}", remedy, found=f"off by {error:.3g}")
    determinant = float(np.linalg.det(matrix[:3, :3]))
    if not (determinant > 0):
        raise broken("of determinant +1", "no mirroring", found=f"determinant {determinant:.6f}")
    return rows


def _too_few_decimals(rotation: Floats, error: float) -> str:
    """What to do about a rotation that was rounded too far; empty where its decimals do not explain the error.

    Entries that are off by half a unit of the last decimal each make products of columns that are off by at most
    sqrt(3) of these units, and a little more: of seven decimals, no more than is allowed.
    """
    decimals = next((n for n in range(DECIMALS) if np.array_equal(rotation, rotation.round(n))), DECIMALS)
    unit = 10.0**-decimals
    if not (decimals < DECIMALS and error <= math.sqrt(3.0) * unit + 0.75 * unit**2):
        return ""
    return f"its rotation has {decimals} decimals, which is too few: write {DECIMALS} or more"


def _list_to_tuple(value: object) -> object:
    """JSON has lists only; anything else is left for the next validator to refuse."""
    return tuple(value) if isinstance(value, list) else value


Row = Annotated[tuple[Real, Real, Real, Real], BeforeValidator(_list_to_tuple)]
Transform = Annotated[tuple[Row, Row, Row, Row], BeforeValidator(_list_to_tuple), AfterValidator(_rigid)]


def _utc(text: str) -> str:
    """Refuses what is not an ISO-8601 time in UTC."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise broken("an ISO-8601 time in UTC", "write for example 2026-03-01T08:30:00Z") from None
    offset = moment.utcoffset()
    if offset is None:
        remedy = (
            "it names no zone: convert it from local time to UTC, unless it is UTC already, and end it with Z"
        )
        raise broken("an ISO-8601 time in UTC", remedy)
    if offset != timedelta(0):
        raise broken("an ISO-8601 time in UTC", f"convert it, do not relabel it{_in_utc(moment)}")
    return text


def _in_utc(moment: datetime) -> str:
    """What to write for a time of another zone; nothing where the calendar ends before it is converted."""
    try:
        return f": write {moment.astimezone(UTC).isoformat().replace('+00:00', 'Z')}"
    except OverflowError:
        return ""


class PlanDocument(Strictly):
    """``plan.json`` but for its poses, which ``poses_of`` checks faster than a model could."""

    schema_: Annotated[Literal["cutgate.plan/1"], Field(alias="schema")]
    id: Text
    implant: Text
    side: Literal["left", "right"]
    units: Literal["mm"]
    tool_length_mm: Annotated[Real, Field(ge=0, le=2000)] | None = None
    feed_mm_s: Annotated[Real, Field(ge=0.001, le=10_000)]
    ct_T_implant: Transform  # noqa: N815 - the contract's name: frame CT from frame implant
    ct_id: Text | None = None
    poses: Annotated[list[Any], Strict()]


class Registration(Strictly):
    """``registration.json``: where the CT, and with it the bone, stands in the robot frame."""

    schema_: Annotated[Literal["cutgate.registration/1"], Field(alias="schema")]
    id: Text
    R_T_CT: Transform
    residual_rms_mm: Annotated[Real, Field(ge=0, le=100)]
    created_utc: Annotated[str, Strict(), AfterValidator(_utc)]
    ct_id: Text | None = None

    @property
    def matrix(self) -> Floats:
        """``R_T_CT``, shape (4, 4), mm."""
        return np.array(self.R_T_CT, dtype=np.float64)

    @property
    def place(self) -> bytes:
        """What the place is known by, whatever else is written around it: SHA-256 over rows 0 to 2 of ``R_T_CT``, 32 bytes."""
        rows = self.matrix[:3] + 0.0  # -0 is 0
        return hashlib.sha256(b"cutgate/place/1" + rows.astype("<f8").tobytes()).digest()

    @property
    def digest(self) -> bytes:
        """What the registration is known by, however its file is written: SHA-256 over its content, 32 bytes.

        "cutgate/registration/1" | rows 0 to 2 of ``R_T_CT`` | residual | created, us since 1970, i64 | id | ct_id; numbers
        binary64 with -0 as 0, each text UTF-8 behind its length, u16; no ct_id is one of length 0. Little endian.
        """
        numbers = np.append(self.matrix[:3].ravel(), self.residual_rms_mm) + 0.0
        created_us = since_1970_us(self.created)
        texts = [text.encode() for text in (self.id, self.ct_id or "")]
        content = b"".join(
            (
                b"cutgate/registration/1",
                numbers.astype("<f8").tobytes(),
                created_us.to_bytes(8, "little", signed=True),
                *(len(text).to_bytes(2, "little") + text for text in texts),
            )
        )
        return hashlib.sha256(content).digest()

    @property
    def created(self) -> datetime:
        """When the registration was made."""
        return datetime.fromisoformat(self.created_utc).astimezone(UTC)


@dataclass(frozen=True, slots=True)
class Plan:
    """Poses to cut, in implant coordinates, with what the file says about them.

    Attributes:
        id: the plan's name; for a bare tool path the file's.
        implant, side: what is planned; None for a bare tool path.
        tool_length_mm: the tool the plan was made for, or None.
        feed_mm_s: planned feed at the tip, or None where the file has none.
        ct_T_implant: (4, 4), mm.
        ct_id: which CT, or None.
        tips_mm: (n, 3).
        axes: (n, 3), unit, from the tip toward the holder.
    """

    id: str
    implant: str | None
    side: Literal["left", "right"] | None
    tool_length_mm: float | None
    feed_mm_s: float | None
    ct_T_implant: Floats  # noqa: N815 - as above
    ct_id: str | None
    tips_mm: Floats
    axes: Floats


def shorter(pose_limit: int) -> str:
    """What to do about a path of more poses than the limit: no site can raise it beyond what the wire carries."""
    part = "part the path"
    return part if pose_limit >= CONSTANTS["pose_limit"].high else f"raise pose_limit in site.toml, or {part}"


def table_of(file: object, rows: Sequence[Any], place: Callable[[int], str]) -> Floats:
    """Rows of six numbers, as JSON has them, as one array of shape (n, 6).

    Raises:
        InputError: names the first row that is not six numbers (true, false and text are none).
    """
    bound = "six numbers x, y, z, i, j, k"
    for index, row in enumerate(rows):
        if not (type(row) is list and len(row) == 6 and NUMBERS.issuperset(map(type, row))):
            quotes = type(row) is list and str in set(map(type, row))
            remedy = "write its numbers without quotes" if quotes else "correct this pose"
            raise InputError(file, place(index), row, bound, remedy)
    try:
        return np.fromiter(chain.from_iterable(rows), np.float64, 6 * len(rows)).reshape(-1, 6)
    except OverflowError:
        found = "an integer no double can hold"
        raise InputError(file, "poses", found, f"within +-{COORDINATE_MM:g}", "lengths are mm") from None


def poses_of(file: object, table: Floats, place: Callable[[int], str]) -> tuple[Floats, Floats]:
    """Tips (n, 3) mm and unit axes (n, 3) of rows ``x, y, z, i, j, k``.

    Args:
        file: for messages.
        table: shape (n, 6).
        place: where row ``n`` stands in the file, for messages.

    Raises:
        InputError: fewer than two rows, not finite, too far out, or an axis that is not of length 1 within 1e-3.
    """
    if not (len(table) >= 2):
        raise InputError(file, "poses", f"{len(table)} poses", ">= 2 poses", "a path needs two poses or more")
    inside = np.isfinite(table) & (np.abs(table) <= COORDINATE_MM)
    bad = np.flatnonzero(~inside.all(axis=1))
    if bad.size:
        bound = f"six finite numbers within +-{COORDINATE_MM:g}"
        found = _and_more(table[bad[0]].tolist(), bad)
        raise InputError(file, place(int(bad[0])), found, bound, "lengths are mm")
    lengths = np.linalg.norm(table[:, 3:], axis=1)
    bad = np.flatnonzero(~(np.abs(lengths - 1.0) <= UNIT_AXIS))
    if bad.size:
        found = _and_more(f"of length {lengths[bad[0]]:.6g}", bad)
        bound = f"a tool axis i, j, k of length 1 within {UNIT_AXIS:g}"
        raise InputError(
            file,
            place(int(bad[0])),
            found,
            bound,
            f"normalise the tool axis, with {AXIS_DECIMALS} decimals or more",
        )
    return table[:, :3].copy(), table[:, 3:] / lengths[:, None]


def _and_more(found: object, bad: NDArray[np.intp]) -> str:
    """The first bad row's value, and how many rows more are bad."""
    return shown(found) + (f" ({bad.size - 1} more like it)" if bad.size > 1 else "")
