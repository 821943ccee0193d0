"""A registration of another program, with what is declared of it, to the bytes of ``registration.json``."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from cutgate.config.load import Loaded, decode
from cutgate.protocol.arrays import Floats
from cutgate.runtime.plan.registration import Registration
from cutgate.runtime.plan.registrations.declared import (
    Complete,
    CtFrame,
    Declared,
    TransformDirection,
    complete,
)
from cutgate.runtime.plan.registrations.itk import matrix_of
from cutgate.runtime.plan.registrations.itk_hdf5 import read_itk_hdf5
from cutgate.runtime.plan.registrations.itk_text import is_itk_text, read_itk_text
from cutgate.runtime.plan.registrations.matrix_text import read_matrix

REVERSED: Final = (-1.0, -1.0, 1.0, 1.0)
"""LPS from RAS and back: x and y point the other way."""
NAME_MAX: Final = 200


@dataclass(frozen=True, slots=True)
class Converted(Loaded[Registration]):
    """A registration of another program: ``data`` are the bytes of the ``registration.json`` that was made of it.

    Attributes:
        source: the bytes of the file itself.
        declared: what was declared of it.
    """

    source: bytes
    declared: Declared


def converted(path: Path, data: bytes, declared: Declared) -> bytes:
    """The ``registration.json`` of a file of another program; its numbers are the doubles of the file.

    Raises:
        InputError: something is not declared, or the file holds no rigid transform.
    """
    given = complete(path, declared)
    document = {
        "schema": "cutgate.registration/1",
        "id": path.stem[:NAME_MAX],
        "R_T_CT": placed(_READERS[path.suffix.lower()](path, data), given).tolist(),
        "residual_rms_mm": given.residual_mm,
        "created_utc": given.taken_at,
    }
    return f"{json.dumps(document)}\n".encode()


def placed(matrix: Floats, given: Complete) -> Floats:
    """``R_T_CT``, shape (4, 4), of the file's transform.

    The robot's side stays as it is, whatever the frame: nothing anatomical is about it. On the CT's side the file has LPS;
    where the plan's coordinates are RAS, x and y are reversed before the transform is applied to them.
    """
    to_robot = matrix if given.direction is TransformDirection.CT_TO_ROBOT else _inverse(matrix)
    return to_robot * REVERSED if given.frame is CtFrame.RAS else to_robot


def _inverse(matrix: Floats) -> Floats:
    """Of a rigid transform, shape (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = matrix[:3, :3].T
    inverse[:3, 3] = -(matrix[:3, :3].T @ matrix[:3, 3])
    return inverse


def _itk_text(path: Path, data: bytes) -> Floats:
    return matrix_of(path, read_itk_text(path, decode(path, data)))


def _itk_or_matrix(path: Path, data: bytes) -> Floats:
    text = decode(path, data)
    return matrix_of(path, read_itk_text(path, text)) if is_itk_text(text) else read_matrix(path, text)


def _matrix(path: Path, data: bytes) -> Floats:
    return read_matrix(path, decode(path, data))


def _itk_hdf5(path: Path, data: bytes) -> Floats:
    return matrix_of(path, read_itk_hdf5(path, data))


_READERS: Final = MappingProxyType[str, Callable[[Path, bytes], Floats]](
    {".tfm": _itk_text, ".txt": _itk_or_matrix, ".mat": _matrix, ".h5": _itk_hdf5}
)
FOREIGN_EXTENSIONS: Final = tuple(_READERS)
