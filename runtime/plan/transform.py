"""Rigid transforms as files have them: 4x4, row by row, lengths in mm."""

import math
from typing import Annotated, Final

import numpy as np
from pydantic import AfterValidator, BeforeValidator

from cutgate.config.model import Real, broken
from cutgate.protocol.arrays import Floats

TRANSLATION_MM: Final = 100_000.0
RIGID: Final = 1e-6
DECIMALS: Final = 7
"""So many are enough for a rotation to be rigid, whatever it is."""
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
        remedy = too_few_decimals(matrix[:3, :3], error) or "no scaling, no shear"
        raise broken(f"orthonormal to {RIGID:g}", remedy, found=f"off by {error:.3g}")
    determinant = float(np.linalg.det(matrix[:3, :3]))
    if not (determinant > 0):
        raise broken("of determinant +1", "no mirroring", found=f"determinant {determinant:.6f}")
    return rows


def too_few_decimals(rotation: Floats, error: float) -> str:
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
