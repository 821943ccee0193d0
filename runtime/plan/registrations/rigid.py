"""Whether a transform that another program wrote is rigid, and if it is not, what it is instead."""

from typing import Final

import numpy as np

from cutgate.config.refusal import InputError
from cutgate.protocol.arrays import Floats
from cutgate.runtime.plan.transform import RIGID, TRANSLATION_MM, too_few_decimals

ENTRY_MAX: Final = 1e6
"""Of a rotation that is written in other units or scaled; beyond, it is nothing that could be named."""
_BOUND: Final = f"rigid: orthonormal to {RIGID:g}, determinant +1"
_METRES: Final = "units must be mm on both sides: write both in mm and register again"


def check_rigid(file: object, place: str, matrix: Floats) -> None:
    """Refuses what is not rigid, with the kind and the amount.

    Args:
        file: for messages.
        place: where it stands in it, for messages.
        matrix: shape (4, 4), mm.

    Raises:
        InputError: scale, shear or mirror image, or moved by more than 100 000 mm.
    """
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    largest = float(np.abs(linear).max())
    if not (largest <= ENTRY_MAX):
        raise InputError(file, place, f"an entry of {largest:g}", _BOUND, "check what the file holds")
    if not (float(np.abs(shift).max()) <= TRANSLATION_MM):
        found = f"translated by {shift.tolist()}"
        raise InputError(file, place, found, f"at most {TRANSLATION_MM:g} mm", "lengths are mm")
    error = float(np.abs(linear.T @ linear - np.eye(3)).max())
    if not (error <= RIGID):
        found, remedy = _instead(linear)
        raise InputError(file, place, found, _BOUND, too_few_decimals(linear, error) or remedy)
    determinant = float(np.linalg.det(linear))
    if not (determinant > 0.0):
        raise InputError(file, place, _mirrored(determinant), _BOUND, _UNMIRROR)


_UNMIRROR: Final = (
    "no axis may be reversed alone: correct the landmarks or axes it was made from, and register again"
)


def _mirrored(determinant: float) -> str:
    return f"a mirror image (determinant {determinant:.6g})"


def _instead(linear: Floats) -> tuple[str, str]:
    """What a linear part that is not orthonormal does, and what to do about it."""
    determinant = float(np.linalg.det(linear))
    if determinant < 0.0:
        return _mirrored(determinant), _UNMIRROR
    largest, _, least = (float(value) for value in np.linalg.svd(linear, compute_uv=False))
    if largest - least <= RIGID * largest:
        factor = f"a scale of {largest:.9g}"
        metres = any(abs(largest / one - 1.0) < 0.1 for one in (1000.0, 0.001))
        return factor, _METRES if metres else "register again with a rigid transform, without scale"
    along = np.linalg.norm(linear, axis=0)
    products = linear.T @ linear - np.diag(along**2)
    if float(np.abs(products).max()) <= RIGID * largest**2:
        x, y, z = (f"{float(value):.9g}" for value in along)
        return (
            f"scales of {x}, {y}, {z} along x, y, z",
            "register again with a rigid transform, without scale",
        )
    found = f"a shear that stretches by {least:.9g} to {largest:.9g}"
    return found, "register again with a rigid transform, without shear"
