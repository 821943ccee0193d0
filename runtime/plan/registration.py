"""Where the bone stands: what a registration says, and what it is known by.

A pose in implant coordinates reaches the robot frame as ``R_p = R_T_CT * CT_T_I * I_p``.
"""

import hashlib
import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import AfterValidator, Field, Strict

from cutgate.config.constants import CHECK_POINTS_MAX
from cutgate.config.model import Real, Site, Strictly, Text, broken
from cutgate.protocol.arrays import Floats
from cutgate.protocol.times import since_1970_us
from cutgate.runtime.kinematics.landmarks import CheckPoints, PointResidual, residuals_mm
from cutgate.runtime.plan.transform import TRANSLATION_MM, Transform


def utc_time(text: str) -> str:
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


def finer_than_a_microsecond(created_utc: str) -> bool:
    """Whether a time would not be told apart from another one: it is known, and compared, to the microsecond."""
    return re.search(r"[.,]\d{7}", created_utc) is not None


POINT_NAME_MAX: Final = 64
PointName = Annotated[str, Strict(), Field(min_length=1, max_length=POINT_NAME_MAX)]
Coordinate = Annotated[Real, Field(ge=-TRANSLATION_MM, le=TRANSLATION_MM)]
Point = tuple[Coordinate, Coordinate, Coordinate]


class CheckPoint(Strictly):
    """A landmark that was touched with the probe and not used for the fit: where it is in CT and robot coordinates."""

    id: PointName
    ct_mm: Point
    robot_mm: Point


def _told_apart(points: tuple[CheckPoint, ...]) -> tuple[CheckPoint, ...]:
    """Refuses two points of one name: nobody could tell which of them is off."""
    names = [point.id for point in points]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise broken(
                f"another name than check_points.{names.index(name)} has",
                "give each point a name of its own",
                key=f"check_points.{index}.id",
                found=name,
            )
    return points


class Registration(Strictly):
    """``registration.json``: where the CT, and with it the bone, stands in the robot frame."""

    schema_: Annotated[Literal["cutgate.registration/1"], Field(alias="schema")]
    id: Text
    R_T_CT: Transform
    residual_rms_mm: Annotated[Real, Field(ge=0, le=100)]
    created_utc: Annotated[str, Strict(), AfterValidator(utc_time)]
    ct_id: Text | None = None
    check_points: Annotated[
        tuple[CheckPoint, ...], Field(max_length=CHECK_POINTS_MAX), AfterValidator(_told_apart)
    ] = ()

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
        Only where there are check points: | their number, u16 | of each id, CT and robot coordinates, as above.
        """
        numbers = np.append(self.matrix[:3].ravel(), self.residual_rms_mm) + 0.0
        created_us = since_1970_us(self.created)
        texts = [text.encode() for text in (self.id, self.ct_id or "")]
        content = b"".join(
            (
                b"cutgate/registration/1",
                numbers.astype("<f8").tobytes(),
                created_us.to_bytes(8, "little", signed=True),
                *(_behind_its_length(text) for text in texts),
                *self._of_check_points(),
            )
        )
        return hashlib.sha256(content).digest()

    def _of_check_points(self) -> Iterator[bytes]:
        """What the digest covers of the check points; nothing where there are none, as before there were any."""
        if self.check_points:
            yield len(self.check_points).to_bytes(2, "little")
        for point in self.check_points:
            yield _behind_its_length(point.id.encode())
            yield (np.array((*point.ct_mm, *point.robot_mm)) + 0.0).astype("<f8").tobytes()

    @property
    def created(self) -> datetime:
        """When the registration was made."""
        return datetime.fromisoformat(self.created_utc).astimezone(UTC)


def checked(registration: Registration | None, site: Site) -> CheckPoints:
    """The residual of each check point, and what the site asks of them; without a registration there is none."""
    if registration is None or not registration.check_points:
        return CheckPoints((), site.check_point_tolerance_mm, site.check_points_min)
    points = registration.check_points
    ct_mm, robot_mm = (np.array([getattr(one, name) for one in points]) for name in ("ct_mm", "robot_mm"))
    residuals = residuals_mm(registration.matrix, ct_mm, robot_mm).tolist()
    return CheckPoints(
        tuple(PointResidual(one.id, residual) for one, residual in zip(points, residuals, strict=True)),
        site.check_point_tolerance_mm,
        site.check_points_min,
    )


def _behind_its_length(text: bytes) -> bytes:
    return len(text).to_bytes(2, "little") + text
