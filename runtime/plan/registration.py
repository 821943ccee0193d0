"""Where the bone stands: what a registration says, and what it is known by.

A pose in implant coordinates reaches the robot frame as ``R_p = R_T_CT * CT_T_I * I_p``.
"""

import hashlib
from datetime import UTC, datetime, timedelta
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, Strict

from cutgate.config.model import Real, Strictly, Text, broken
from cutgate.protocol.arrays import Floats
from cutgate.protocol.times import since_1970_us
from cutgate.runtime.plan.transform import Transform


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
