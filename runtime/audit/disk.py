"""What the log asks of a disk, and the disk there is. Tests put another in its place."""

import ctypes
import errno
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from cutgate.config.durable import Replacement, create_ours, sync_folder

KEEP_SIZE: Final = 1
"""FALLOC_FL_KEEP_SIZE of Linux: blocks are reserved beyond the end, the file's length stays."""


@dataclass(frozen=True, slots=True)
class Reservation:
    """Space for the log: ``size`` bytes that are there, ``reserved`` or only seen free, and how that is known."""

    size: int
    reserved: bool
    how: str


class Disk(Protocol):
    """The disk operations of a log. Each raises OSError, and each may never return."""

    def create(self, path: Path) -> int:
        """A descriptor of a new, empty, unbuffered file; refused if it exists."""
        ...

    def write(self, descriptor: int, data: memoryview) -> int:
        """Write some of the bytes; how many."""
        ...

    def sync(self, descriptor: int) -> None:
        """Return when all bytes written so far are durable."""
        ...

    def reserve(self, descriptor: int, path: Path, size: int) -> Reservation:
        """Reserve ``size`` bytes from the file's start without changing its length."""
        ...

    def trim(self, descriptor: int) -> None:
        """Give back what is reserved beyond the file's end."""
        ...

    def close(self, descriptor: int) -> None:
        """Close the descriptor."""
        ...

    def sync_directory(self, directory: Path) -> None:
        """Make the directory's entries durable."""
        ...

    def prepare(self, path: Path) -> Replacement:
        """What is to take a small file's place, under a fresh name."""
        ...

    def replace(self, prepared: Replacement, data: bytes) -> None:
        """Write it and put it in place, durably: afterwards the file is the old or the new."""
        ...


class SystemDisk:
    """The operating system's files."""

    def create(self, path: Path) -> int:
        """As ``Disk``; readable by the owner only."""
        return create_ours(path)

    def write(self, descriptor: int, data: memoryview) -> int:
        """As ``Disk``."""
        return os.write(descriptor, data)

    def sync(self, descriptor: int) -> None:
        """As ``Disk``."""
        os.fdatasync(descriptor)

    def reserve(self, descriptor: int, path: Path, size: int) -> Reservation:
        """As ``Disk``; where the file system cannot reserve, the free space is looked at instead, and said so."""
        try:
            _fallocate(descriptor, size)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.ENOSYS):
                raise
        else:
            return Reservation(size, reserved=True, how="reserved")
        free = os.statvfs(path.parent)
        return Reservation(
            free.f_bavail * free.f_frsize,
            reserved=False,
            how="seen free: this file system cannot reserve",
        )

    def trim(self, descriptor: int) -> None:
        """As ``Disk``."""
        os.ftruncate(descriptor, os.fstat(descriptor).st_size)

    def close(self, descriptor: int) -> None:
        """As ``Disk``."""
        os.close(descriptor)

    def sync_directory(self, directory: Path) -> None:
        """As ``Disk``."""
        sync_folder(directory)

    def prepare(self, path: Path) -> Replacement:
        """As ``Disk``."""
        return Replacement(path)

    def replace(self, prepared: Replacement, data: bytes) -> None:
        """As ``Disk``."""
        prepared.put(data)


def write_all(disk: Disk, descriptor: int, data: bytes) -> None:
    """Write all bytes, however few the system takes at a time.

    Raises:
        OSError: an error of the disk; a write that takes nothing is one too.
    """
    rest = memoryview(data)
    while rest:
        taken = disk.write(descriptor, rest)
        if not (taken > 0):
            raise OSError(errno.EIO, "the disk takes no bytes")
        rest = rest[taken:]


_LIBC: Final = ctypes.CDLL(None, use_errno=True)


def _fallocate(descriptor: int, size: int) -> None:
    """``fallocate(2)`` with KEEP_SIZE; ``os.posix_fallocate`` would change the file's length.

    Raises:
        OSError: as the system call, or ENOSYS where the C library has none.
    """
    function = getattr(_LIBC, "fallocate", None)
    if function is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    function.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64)
    while function(descriptor, KEEP_SIZE, 0, size) != 0:
        code = ctypes.get_errno()
        if code != errno.EINTR:
            raise OSError(code, os.strerror(code))
