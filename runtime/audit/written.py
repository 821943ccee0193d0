"""A file that this process alone writes: what was written must be found again under its name, as it was written.

A descriptor goes on taking bytes after its file was deleted, renamed, cut or overwritten; a synced byte that nobody
finds again proves nothing. So the file is looked at by its name before and after every commit: that it is this one,
and as long as it was written. Its content is read back where that may be needed: when its times show that somebody
else has written to it, and, while it is not large, with every record that lets something be enabled. What is read
back is what the system gives, be it from its memory; that the disk keeps it is what the sync is for.
"""

import os
from hashlib import sha256
from pathlib import Path
from typing import Final

from cutgate.runtime.audit.disk import Disk, Reservation, write_all

READ_BACK_MAX: Final = 32 << 20
"""Bytes of the largest file that is read back with every enabling record; of a larger one its times are believed."""
PIECE: Final = 1 << 20


class LostError(Exception):
    """What was written is not found again; the text names the file and what was found instead."""


class Written:
    """One such file. Each of its calls may take as long as the disk does.

    Args:
        disk: the disk operations.
        descriptor: of the new and empty file.
        path: its name.
    """

    def __init__(self, disk: Disk, descriptor: int, path: Path) -> None:
        self._disk = disk
        self.descriptor = descriptor
        self.path = path
        self.size = 0
        self._digest = sha256()
        self._remember(os.fstat(descriptor))

    @property
    def sha256(self) -> bytes:
        """Of all bytes that were written, 32 bytes."""
        return self._digest.digest()

    def append(self, data: bytes) -> None:
        """Write all bytes.

        Raises:
            OSError: an error of the disk.
        """
        write_all(self._disk, self.descriptor, data)
        self._digest.update(data)
        self.size += len(data)
        self._remember(os.fstat(self.descriptor))

    def sync(self) -> None:
        """Return when all bytes are durable.

        Raises:
            OSError: an error of the disk.
        """
        self._disk.sync(self.descriptor)

    def reserve(self, size: int) -> Reservation:
        """Reserve space for so many more bytes.

        Raises:
            OSError: an error of the disk; there is no space.
        """
        found = self._disk.reserve(self.descriptor, self.path, self.size + size)
        self._remember(os.fstat(self.descriptor))
        return found

    def trim(self) -> None:
        """Give back what is reserved beyond the end.

        Raises:
            OSError: an error of the disk.
        """
        self._disk.trim(self.descriptor)
        self._remember(os.fstat(self.descriptor))

    def check(self, *, enabling: bool = False) -> None:
        """That everything written is found under the name.

        Args:
            enabling: something will be let go that enables: read the content back.

        Raises:
            LostError: it is not.
            OSError: an error of the disk.
        """
        found = identify(self.descriptor, self.path)
        told = f"{found.st_size} bytes, {self.size} were written"
        if found.st_size < self.size:
            raise LostError(f"{self.path} was cut to {told}")
        if found.st_size > self.size:
            raise LostError(f"{self.path} has grown to {told}")
        changed = (found.st_mtime_ns, found.st_ctime_ns) != self._times
        if changed or (enabling and self.size <= READ_BACK_MAX):
            self._read_back()
            self._remember(found)  # as it was before it was read: what changes meanwhile shows the next time

    def _remember(self, status: os.stat_result) -> None:
        self._times = (status.st_mtime_ns, status.st_ctime_ns)

    def _read_back(self) -> None:
        digest = sha256()
        try:
            reading = os.open(self.path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
        except FileNotFoundError:
            raise LostError(f"{self.path} {_gone(self.descriptor)}") from None
        try:
            while data := os.read(reading, PIECE):
                digest.update(data)
        finally:
            os.close(reading)
        if digest.digest() != self._digest.digest():
            raise LostError(f"{self.path} was overwritten: what is read back is not what was written")


def identify(descriptor: int, path: Path) -> os.stat_result:
    """What stands under a name, if it is this open file.

    Raises:
        LostError: nothing does, or another file.
        OSError: an error of the disk.
    """
    try:
        found = os.stat(path, follow_symlinks=False)  # noqa: PTH116 - as fstat beside it
    except (FileNotFoundError, NotADirectoryError):
        raise LostError(f"{path} {_gone(descriptor)}") from None
    ours = os.fstat(descriptor)
    if (found.st_dev, found.st_ino) != (ours.st_dev, ours.st_ino):
        what = "was deleted" if ours.st_nlink == 0 else "was renamed"
        raise LostError(f"{path} {what}, and another file was put in its place")
    return found


def _gone(descriptor: int) -> str:
    """What became of an open file that is not found under its name: asked only now, it may go at any moment."""
    deleted = os.fstat(descriptor).st_nlink == 0
    return "was deleted" if deleted else "was renamed or moved, or a folder above it was"
