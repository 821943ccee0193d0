"""Landmarks to a registration: the fit, or why there is none that could be believed."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cutgate.config.constants import CHECK_POINTS_MAX
from cutgate.config.refusal import InputError
from cutgate.protocol.arrays import Floats
from cutgate.runtime.kinematics.landmarks import residuals_mm
from cutgate.runtime.plan.registrations.declared import RESIDUAL_MAX_MM
from cutgate.runtime.plan.registrations.fit import (
    POINTS_MIN,
    SCALE_MAX,
    SCALE_MIN,
    SPREAD_MIN_MM,
    RigidFit,
    rigid_fit,
    spread_mm,
)
from cutgate.runtime.plan.registrations.landmarks_csv import Landmark


@dataclass(frozen=True)
class Registered:
    """What the landmarks give.

    Attributes:
        landmarks: as they were read.
        residuals_mm: of each of them, held out or not, shape (n,).
        fit: of those that were not held out.
    """

    landmarks: tuple[Landmark, ...]
    residuals_mm: Floats
    fit: RigidFit


def registered(file: object, landmarks: Sequence[Landmark]) -> Registered:
    """The fit to the landmarks that are not held out.

    Args:
        file: for messages.
        landmarks: of both uses.

    Raises:
        InputError: too few, all but on a line, mirrored, in different units, or not the same points.
    """
    used = [one for one in landmarks if not one.held_out]
    if not (len(used) >= POINTS_MIN):
        bound, remedy = f">= {POINTS_MIN} landmarks to fit", "touch more landmarks, or hold fewer of them out"
        raise InputError(file, "use", f"{len(used)} landmarks to fit", bound, remedy)
    if not (len(landmarks) - len(used) <= CHECK_POINTS_MAX):
        found, bound = f"{len(landmarks) - len(used)} landmarks to check", f"<= {CHECK_POINTS_MAX}"
        raise InputError(file, "use", found, bound, "hold fewer of them out")
    ct_mm, robot_mm = (_points(used, name) for name in ("ct_mm", "robot_mm"))
    for name, points_mm in (("ct", ct_mm), ("robot", robot_mm)):
        _check_spread(file, name, spread_mm(points_mm))
    fit = rigid_fit(ct_mm, robot_mm)
    _check_fit(file, fit)
    off_mm = residuals_mm(fit.transform, _points(landmarks, "ct_mm"), _points(landmarks, "robot_mm"))
    return Registered(tuple(landmarks), off_mm, fit)


def registration_of(found: Registered, name: str, ct_id: str | None, created_utc: str) -> bytes:
    """The ``registration.json``, with the landmarks that were held out as its check points."""
    document = {
        "schema": "cutgate.registration/1",
        "id": name,
        "residual_rms_mm": found.fit.rms_mm,
        "created_utc": created_utc,
        **({} if ct_id is None else {"ct_id": ct_id}),
        "R_T_CT": found.fit.transform.tolist(),
        "check_points": [
            {"id": one.id, "ct_mm": one.ct_mm, "robot_mm": one.robot_mm}
            for one in found.landmarks
            if one.held_out
        ],
    }
    return f"{json.dumps(document, indent=1)}\n".encode()


def _points(landmarks: Sequence[Landmark], name: str) -> Floats:
    return np.array([getattr(one, name) for one in landmarks], dtype=np.float64)


def _check_spread(file: object, frame: str, spread: float) -> None:
    if not (spread >= SPREAD_MIN_MM):
        raise InputError(
            file,
            f"least singular value of {frame}_x, {frame}_y, {frame}_z of the landmarks to fit",
            f"{spread:.3f} mm rms off a line",
            f">= {SPREAD_MIN_MM:g} mm: else nothing keeps the bone from turning about it",
            "touch a landmark to the side of the others, and check that lengths are mm",
        )


def _check_fit(file: object, fit: RigidFit) -> None:
    if fit.mirrored:
        raise InputError(
            file,
            "",
            f"{fit.rms_mm:.3f} mm rms off, {fit.mirrored_rms_mm:.3f} mm as a mirror image",
            "landmarks of which one set is moved onto the other, not mirrored",
            "one axis of one set is reversed (from LPS to RAS x and y both are), or a line is not the same landmark in both",
        )
    if not (SCALE_MIN <= fit.scale <= SCALE_MAX):
        raise InputError(
            file,
            "",
            f"robot coordinates that are {fit.scale:.4g} times those of the CT in size",
            f"of the same size, {SCALE_MIN:g} to {SCALE_MAX:g} times",
            "write both in mm, and check that each line is the same landmark in both frames",
        )
    if not (fit.rms_mm <= RESIDUAL_MAX_MM):
        remedy = "check that each line is the same landmark in both frames"
        raise InputError(file, "", f"a fit {fit.rms_mm:.4g} mm rms off", f"<= {RESIDUAL_MAX_MM:g} mm", remedy)
