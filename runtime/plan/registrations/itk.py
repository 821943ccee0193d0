"""Transforms of ITK as they are written, text or HDF5, to one 4x4 matrix.

x' = A (x - c) + c + t with the centre c in the fixed parameters; of a composite the last listed is applied first.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from cutgate.config.refusal import InputError
from cutgate.protocol.arrays import Floats
from cutgate.runtime.plan.registrations.rigid import check_rigid
from cutgate.runtime.plan.transform import TRANSLATION_MM

PARTS_MAX: Final = 100
"""Transforms of one composite."""
COMPOSITE: Final = "CompositeTransform"
_NAME: Final = re.compile(
    r"(?P<kind>[A-Za-z0-9]{1,60})_(?:double|float)_(?P<from>[0-9])_(?P<to>[0-9])(?:_[0-9])?"
)
_TEXT_MAX: Final = 100
_REGISTER: Final = "register again with a rigid transform (VersorRigid3DTransform, Euler3DTransform)"

Numbers = Sequence[float]


@dataclass(frozen=True, slots=True)
class Part:
    """One transform as it is written.

    Attributes:
        place: where it stands in the file, for messages.
        kind: its type, without precision and dimensions.
        parameters: as the type orders them.
        fixed: likewise.
    """

    place: str
    kind: str
    parameters: tuple[float, ...]
    fixed: tuple[float, ...]


class _Kind(NamedTuple):
    """How many numbers a type has, and what they make: linear part, shape (3, 3), and translation."""

    parameters: int
    fixed: tuple[int, ...]
    made: Callable[["_Place", Numbers, Numbers], tuple[Floats, Floats]]


class _Place(NamedTuple):
    file: object
    place: str

    def refused(self, found: str, bound: str, remedy: str) -> InputError:
        return InputError(self.file, self.place, found, bound, remedy)


def kind_of(file: object, place: str, text: str) -> str:
    """The type that a file names, without precision and dimensions.

    Raises:
        InputError: it is none that is read; says what it does to the bone where that is known.
    """
    read = ", ".join(KINDS)
    found = _NAME.fullmatch(text) if len(text) <= _TEXT_MAX else None
    if found is None:
        raise InputError(
            file, place, text, f"a type of ITK ({read}) as AffineTransform_double_3_3", "correct it"
        )
    if (found["from"], found["to"]) != ("3", "3"):
        raise InputError(file, place, text, "of three dimensions, ..._3_3", "register in three dimensions")
    kind = found["kind"]
    if kind in _DEFORMING:
        raise InputError(
            file, place, f"{_DEFORMING[kind]} ({kind})", f"rigid: {read} or {COMPOSITE}", _REGISTER
        )
    if kind not in KINDS and kind != COMPOSITE:
        raise InputError(file, place, text, f"one of {read} or {COMPOSITE}", _REGISTER)
    return kind


def matrix_of(file: object, parts: Sequence[Part]) -> Floats:
    """What the file's transforms do together, shape (4, 4).

    Raises:
        InputError: none, or several without a composite before them; one that is not rigid, or has not as many numbers
            as its type.
    """
    first = parts[0] if parts else None
    if first is None:
        raise InputError(file, "", None, "it holds no transform", "save the registration's transform")
    if first.kind != COMPOSITE:
        if len(parts) > 1:
            found, bound = f"a second transform ({parts[1].kind})", "one transform, or a composite of several"
            raise InputError(file, parts[1].place, found, bound, "save the transform that is meant alone")
        return _matrix(file, first)
    if first.parameters or first.fixed:
        bound = "a composite without numbers of its own"
        raise InputError(file, first.place, "a composite with parameters", bound, "save it anew")
    if len(parts) == 1:
        bound = "a composite of transforms"
        raise InputError(file, first.place, "an empty composite", bound, "save it with its transforms")
    whole = np.eye(4)
    for part in parts[1:]:
        whole = whole @ _matrix(file, part)
    return whole


def _matrix(file: object, part: Part) -> Floats:
    """One transform, shape (4, 4)."""
    place = _Place(file, part.place)
    if part.kind == COMPOSITE:
        raise place.refused("a composite within a composite", "composed of rigid ones", "flatten it")
    kind = KINDS[part.kind]
    if len(part.parameters) != kind.parameters:
        found = f"{len(part.parameters)} parameters"
        raise place.refused(found, f"{kind.parameters} parameters for {part.kind}", "save the transform anew")
    if len(part.fixed) not in kind.fixed:
        wanted = " or ".join(map(str, kind.fixed))
        found = f"{len(part.fixed)} fixed parameters"
        raise place.refused(found, f"{wanted} fixed parameters for {part.kind}", "save the transform anew")
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = kind.made(place, part.parameters, part.fixed)
    check_rigid(file, part.place, matrix)
    return matrix


def _about(place: _Place, linear: Floats, shift: Numbers, centre: Numbers) -> tuple[Floats, Floats]:
    """Rotated about a centre, then moved."""
    c, t = np.array(centre), np.array(shift)
    if not (float(np.abs((c, t)).max()) <= TRANSLATION_MM):
        found = f"centre {list(centre)}, translation {list(shift)}"
        raise place.refused(found, f"within {TRANSLATION_MM:g} mm", "lengths are mm")
    return linear, t if not c.any() else t + c - linear @ c


def _affine(place: _Place, p: Numbers, fixed: Numbers) -> tuple[Floats, Floats]:
    linear = np.array(p[:9]).reshape(3, 3)
    check_rigid(
        place.file, place.place, np.block([[linear, np.zeros((3, 1))], [np.zeros((1, 3)), np.eye(1)]])
    )
    return _about(place, linear, p[9:], fixed)


def _rotation_of_versor(place: _Place, v: Numbers) -> Floats:
    """The rotation of a unit quaternion's vector part."""
    length = math.hypot(*v)
    if not (length <= 1.0):
        found = f"a versor of length {length:g}"
        raise place.refused(
            found, "at most 1: the vector part of a unit quaternion", "save the transform anew"
        )
    x, y, z = v
    w = math.sqrt(max(0.0, 1.0 - length * length))
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _versor(place: _Place, p: Numbers, fixed: Numbers) -> tuple[Floats, Floats]:
    return _about(place, _rotation_of_versor(place, p[:3]), p[3:], fixed)


def _similarity(place: _Place, p: Numbers, fixed: Numbers) -> tuple[Floats, Floats]:
    scaled = np.eye(4)
    scaled[:3, :3] = p[6] * _rotation_of_versor(place, p[:3])
    check_rigid(place.file, place.place, scaled)
    return _about(place, scaled[:3, :3], p[3:6], fixed)


def _euler(place: _Place, p: Numbers, fixed: Numbers) -> tuple[Floats, Floats]:
    """Rz Rx Ry; where the fourth fixed parameter is 1, Rz Ry Rx."""
    if not all(abs(angle) <= 2.0 * math.pi for angle in p[:3]):
        found = f"angles {list(p[:3])}"
        raise place.refused(found, "radians, within a revolution (+-6.2832)", "convert them from degrees")
    order = fixed[3] if len(fixed) > 3 else 0.0
    if order not in (0.0, 1.0):
        raise place.refused(f"an order {order:g}", "0 (Rz Rx Ry) or 1 (Rz Ry Rx)", "save the transform anew")
    (cx, cy, cz), (sx, sy, sz) = (tuple(map(turned, p[:3])) for turned in (math.cos, math.sin))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    linear = about_z @ about_y @ about_x if order else about_z @ about_x @ about_y
    return _about(place, linear, p[3:], fixed[:3])


def _translation(place: _Place, p: Numbers, _fixed: Numbers) -> tuple[Floats, Floats]:
    return _about(place, np.eye(3), p, (0.0, 0.0, 0.0))


KINDS: Final = MappingProxyType(
    {
        "AffineTransform": _Kind(12, (3,), _affine),
        "MatrixOffsetTransformBase": _Kind(12, (3,), _affine),
        "VersorRigid3DTransform": _Kind(6, (3,), _versor),
        "Euler3DTransform": _Kind(6, (3, 4), _euler),
        "TranslationTransform": _Kind(3, (0,), _translation),
        "Similarity3DTransform": _Kind(7, (3,), _similarity),
    }
)
"""The types that are read; a similarity or an affine one only if it is rigid."""
_DEFORMING: Final = MappingProxyType(
    {
        "BSplineTransform": "a B-spline, which bends the bone",
        "BSplineDeformableTransform": "a B-spline, which bends the bone",
        "DisplacementFieldTransform": "a displacement field, which bends the bone",
        "GaussianExponentialDiffeomorphicTransform": "a displacement field, which bends the bone",
        "ThinPlateSplineKernelTransform": "a thin-plate spline, which bends the bone",
        "ScaleTransform": "a scale",
        "ScaleLogarithmicTransform": "a scale",
        "ScaleVersor3DTransform": "a scale along each axis",
        "ScaleSkewVersor3DTransform": "a scale and a shear",
    }
)
