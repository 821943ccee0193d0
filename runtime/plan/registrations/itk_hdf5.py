"""ITK transform files as HDF5 (``.h5``), as ITK and 3D Slicer write them.

Layout: ``/TransformGroup/0``, ``1``, ... each with ``TransformType`` and, but for a composite, ``TransformParameters`` and
``TransformFixedParameters`` (misspelled in earlier versions).
"""

import io
import math
from types import ModuleType
from typing import Any, Final

from cutgate.config.refusal import InputError, shown
from cutgate.runtime.plan.registrations.itk import COMPOSITE, PARTS_MAX, Part, kind_of

GROUP: Final = "TransformGroup"
TYPE: Final = "TransformType"
PARAMETERS: Final = ("TransformParameters", "TranformParameters")
FIXED: Final = ("TransformFixedParameters", "TranformFixedParameters")
NUMBERS_MAX: Final = 100
"""Of one data set; a rigid transform has 12 at most."""
BYTES_MAX: Final = 1 << 20
"""Of one value, or of one chunk, once it is in memory: the library reserves it whole, however few are asked for."""
STORED_MAX: Final = 4096
"""Bytes that a data set takes in the file: a deflate stream becomes up to a thousand times as long, whatever is declared."""
_ANEW: Final = "save the transform anew, or as text (.tfm)"


def read_itk_hdf5(file: object, data: bytes) -> tuple[Part, ...]:
    """The transforms in the order of their numbers.

    Raises:
        InputError: no HDF5, or not laid out as ITK does it; or h5py is not installed.
    """
    h5py = _h5py(file)
    try:
        with h5py.File(io.BytesIO(data), "r") as opened:
            return _Reader(file, h5py).parts(opened)
    except (
        OSError,
        RuntimeError,
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        OverflowError,
    ) as error:
        found = shown(str(error))
        raise InputError(file, "", None, f"not usable HDF5: {found}", _ANEW) from None


def _h5py(file: object) -> ModuleType:
    """The library, which only this format needs."""
    try:
        import h5py  # noqa: PLC0415 - an extra, and a tenth of a second
    except ImportError:
        remedy = "install it: pip install 'cutgate[h5]'; or save the transform as text (.tfm)"
        raise InputError(file, "", None, "HDF5 is read by h5py, which is not installed", remedy) from None
    module: ModuleType = h5py
    return module


class _Reader:
    """Reads what a file of transforms has, and nothing that lies outside of it.

    Args:
        file: for messages.
        h5py: the library.
    """

    def __init__(self, file: object, h5py: ModuleType) -> None:
        self._file, self._h5py = file, h5py

    def parts(self, opened: Any) -> tuple[Part, ...]:
        group = self._member(opened, GROUP, "", self._h5py.Group)
        count = len(group)
        if not (1 <= count <= PARTS_MAX + 1):
            bound = f"1 to {PARTS_MAX} transforms"
            raise InputError(self._file, GROUP, f"{count} members", bound, "save the transform that is meant")
        if {*group} != {str(number) for number in range(count)}:
            found = ", ".join(sorted(group)[:5])
            raise InputError(self._file, GROUP, shown(found), f"named 0 to {count - 1}", _ANEW)
        return tuple(self._part(group, str(number)) for number in range(count))

    def _part(self, group: Any, name: str) -> Part:
        place = f"{GROUP}/{name}"
        one = self._member(group, name, GROUP, self._h5py.Group)
        unknown = sorted({*one} - {TYPE, *PARAMETERS, *FIXED})
        if unknown:
            bound = (
                f"{TYPE}, {PARAMETERS[0]} and {FIXED[0]} alone: what else it says could change the transform"
            )
            raise InputError(self._file, place, shown(", ".join(unknown[:5])), bound, _ANEW)
        kind = kind_of(self._file, place, self._text(one, place))
        if kind == COMPOSITE and not {*one} & {*PARAMETERS, *FIXED}:
            return Part(place, kind, (), ())
        return Part(place, kind, *(self._numbers(one, names, place) for names in (PARAMETERS, FIXED)))

    def _member(self, parent: Any, name: str, place: str, kind: Any) -> Any:
        """One that lies in this file: no link to another one is followed."""
        inside = f"{place}/{name}".lstrip("/")
        link = parent.get(name, getlink=True)
        if not isinstance(link, self._h5py.HardLink):
            found = "missing" if link is None else "a link"
            raise InputError(self._file, inside, found, "there, in the file itself", _ANEW)
        member = parent[name]
        if not isinstance(member, kind):
            raise InputError(self._file, inside, shown(str(member)), f"a {kind.__name__.lower()}", _ANEW)
        return member

    def _dataset(self, parent: Any, name: str, place: str) -> Any:
        member = self._member(parent, name, place, self._h5py.Dataset)
        if member.external is not None or member.is_virtual:
            bound = "there, in the file itself"
            raise InputError(self._file, f"{place}/{name}", "data of another file", bound, _ANEW)
        if not (member.shape is not None and len(member.shape) <= 1 and member.size <= NUMBERS_MAX):
            bound = f"a list of at most {NUMBERS_MAX} values"
            raise InputError(self._file, f"{place}/{name}", f"of shape {member.shape}", bound, _ANEW)
        self._check_stored(member, f"{place}/{name}")
        return member

    def _check_stored(self, dataset: Any, place: str) -> None:
        """Refuses what would take far more memory to read than its few values need; nothing of it is read yet."""
        taken = dataset.dtype.itemsize * math.prod(dataset.chunks or ())
        stored = dataset.id.get_storage_size()
        layout = dataset.id.get_create_plist()
        filters = [layout.get_filter(number)[0] for number in range(layout.get_nfilters())]
        if not (taken <= BYTES_MAX):
            found, bound = f"values or chunks of {taken} bytes", f"<= {BYTES_MAX} bytes"
        elif not (stored <= STORED_MAX):
            found, bound = f"{stored} bytes in the file", f"<= {STORED_MAX} bytes"
        elif filters not in ([], [self._h5py.h5z.FILTER_DEFLATE]):
            found, bound = f"packed by filters {filters}", "plain, or deflated once as ITK does it"
        else:
            return
        raise InputError(self._file, place, found, bound, _ANEW)

    def _text(self, parent: Any, place: str) -> str:
        dataset = self._dataset(parent, TYPE, place)
        if self._h5py.check_string_dtype(dataset.dtype) is None or dataset.size != 1:
            found = f"{dataset.size} values of type {dataset.dtype}"
            raise InputError(self._file, f"{place}/{TYPE}", found, "one text", _ANEW)
        value = dataset[()]
        text = value if isinstance(value, bytes | str) else value[0]
        return text if isinstance(text, str) else bytes(text).decode("ascii", "backslashreplace")

    def _numbers(self, parent: Any, names: tuple[str, ...], place: str) -> tuple[float, ...]:
        present = [name for name in names if name in parent]
        if len(present) > 1:
            found = " and ".join(present)
            raise InputError(self._file, place, found, "one of the two spellings", _ANEW)
        name = present[0] if present else names[0]
        dataset = self._dataset(parent, name, place)
        if dataset.dtype.kind != "f" or dataset.dtype.itemsize not in (4, 8):
            found = f"of type {dataset.dtype}"
            raise InputError(self._file, f"{place}/{name}", found, "numbers of 4 or 8 bytes", _ANEW)
        values = tuple(float(value) for value in dataset[()].ravel())
        if not all(map(math.isfinite, values)):
            raise InputError(self._file, f"{place}/{name}", shown(values), "finite numbers", _ANEW)
        return values
