"""Rigid transforms as SimpleITK makes, writes and applies them: the oracle that shares nothing with the readers."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import SimpleITK as sitk  # noqa: N813 - as its manual does

from cutgate.runtime.plan.registrations.declared import CtFrame, Declared, TransformDirection

TAKEN_AT = "2026-03-01T08:30:00.25Z"
CT_TO_ROBOT, ROBOT_TO_CT = TransformDirection.CT_TO_ROBOT, TransformDirection.ROBOT_TO_CT
LPS, RAS = CtFrame.LPS, CtFrame.RAS
ALL = Declared(LPS, CT_TO_ROBOT, TAKEN_AT, 0.31)
CENTRE = (12.5, -31.0, 40.25)
SHIFT = (480.125, 30.5, 210.0625)


def rotation(x: float, y: float, z: float) -> np.ndarray:
    """A rotation by its vector, by Rodrigues: another way than any of the readers goes."""
    angle = math.sqrt(x * x + y * y + z * z)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / (angle or 1.0)
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


def affine() -> sitk.Transform:
    made = sitk.AffineTransform(3)
    made.SetMatrix(rotation(0.3, -0.7, 1.1).ravel().tolist())
    made.SetCenter(CENTRE)
    made.SetTranslation(SHIFT)
    return made


def versor() -> sitk.Transform:
    made = sitk.VersorRigid3DTransform()
    made.SetRotation((0.6, -0.48, 0.64), 2.9)
    made.SetCenter(CENTRE)
    made.SetTranslation(SHIFT)
    return made


def euler(*, zyx: bool = False) -> sitk.Transform:
    made = sitk.Euler3DTransform()
    made.SetRotation(0.4, -1.2, 2.6)
    made.SetComputeZYX(zyx)
    made.SetCenter(CENTRE)
    made.SetTranslation(SHIFT)
    return made


def similarity(scale: float = 1.0) -> sitk.Transform:
    made = sitk.Similarity3DTransform()
    made.SetRotation((0.0, 0.6, 0.8), 0.5)
    made.SetCenter(CENTRE)
    made.SetTranslation(SHIFT)
    made.SetScale(scale)
    return made


MADE: dict[str, Callable[[], sitk.Transform]] = {
    "affine": affine,
    "versor": versor,
    "Euler": euler,
    "Euler ZYX": lambda: euler(zyx=True),
    "translation": lambda: sitk.TranslationTransform(3, SHIFT),
    "similarity of scale 1": similarity,
    "composite": lambda: sitk.CompositeTransform([affine(), euler(), sitk.TranslationTransform(3, SHIFT)]),
    "composite of one": lambda: sitk.CompositeTransform([versor()]),
}


def written(folder: Path, transform: sitk.Transform, extension: str) -> Path:
    """The file that SimpleITK makes of it."""
    path = folder / f"from-itk{extension}"
    sitk.WriteTransform(transform, str(path))
    return path
