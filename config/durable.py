"""Writing a small file so that it survives a loss of power: a new one, or one in the place of what stood there.

A file is made only where nothing stands, and replaced as a whole, under a fresh name that takes the old one's place
when it is durable: never through what stands there, for who may write in the folder could have put a link to another
file under any name that can be guessed.

The order is what counts: the bytes are on the disk before the name, and the name before the call returns.
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

MODE: Final = 0o600
"""Of a file of ours: only its owner reads and writes it."""
SHARED_MODE: Final = 0o666
"""Of a file for others, less what the umask takes away."""
_MAKE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_CLOSED: Final = -1
"""No descriptor has this number."""
_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_FRESH: Final = ".{name}.{number}.new"
"""What is to take a file's place, until it does."""


def create_ours(path: str | os.PathLike[str]) -> int:
    """A descriptor, to write, of a new and empty file that only its owner may read.

    Raises:
        FileExistsError: anything stands there, be it a link that leads nowhere.
        OSError: it cannot be made.
    """
    return os.open(path, _MAKE, MODE)


def create_durably(path: str | os.PathLike[str], data: bytes, *, ours: bool = True) -> None:
    """A new file that is on the disk, folder entry included, when this returns; where that fails none is left there.

    Args:
        path: where nothing stands.
        data: all of its bytes.
        ours: only its owner may read it, whatever the umask; else who the umask lets.

    Raises:
        FileExistsError: anything stands there.
        OSError: it cannot be made or written.
    """
    with creating(path, ours=ours) as descriptor:
        write_all(descriptor, data)


@contextlib.contextmanager
def creating(path: str | os.PathLike[str], *, ours: bool = True) -> Iterator[int]:
    """As ``create_durably``, for what is made piece by piece: a descriptor to write to, as long as the block runs.

    When the block has ended the file is on the disk; where it is left by any exception none is left there.

    Args:
        path: where nothing stands.
        ours: only its owner may read it, whatever the umask; else who the umask lets.

    Raises:
        FileExistsError: anything stands there.
        OSError: it cannot be made, or not be synced.
    """
    descriptor = create_ours(path) if ours else os.open(path, _MAKE, SHARED_MODE)
    try:
        if ours:
            os.fchmod(descriptor, MODE)
        yield descriptor
        os.fsync(descriptor)
        sync_folder(Path(path).parent)
    except BaseException:
        os.unlink(path)  # noqa: PTH108 - a path of any kind
        raise
    finally:
        os.close(descriptor)


class Replacement:
    """What is to take a file's place: made under a fresh name, written, and put in place as a whole.

    Made early where space must be reserved for it; ``descriptor`` serves for that.

    Raises:
        OSError: it cannot be made.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        file = Path(path)
        self._name = file.name
        self._fresh = _FRESH.format(name=file.name, number=os.urandom(8).hex())
        self._folder = os.open(file.parent, _FOLDER)
        try:
            self.descriptor = os.open(self._fresh, _MAKE, MODE, dir_fd=self._folder)
        except OSError:
            os.close(self._folder)
            raise

    def put(self, data: bytes) -> None:
        """Write it and put it in place; it is on the disk, folder entry included, when this returns. Once.

        Raises:
            OSError: it could not be written; the file is the old one, or this.
        """
        try:
            write_all(self.descriptor, data)
            os.fsync(self.descriptor)
            os.rename(self._fresh, self._name, src_dir_fd=self._folder, dst_dir_fd=self._folder)
            os.fsync(self._folder)
        except OSError:
            self.discard()
            raise
        self._close()

    def discard(self) -> None:
        """Give it up, if it has not been put in place."""
        if self.descriptor == _CLOSED:
            return
        with contextlib.suppress(OSError):  # whoever gives it up knows why, and a later one has another name
            os.unlink(self._fresh, dir_fd=self._folder)
        self._close()

    def _close(self) -> None:
        os.close(self.descriptor)
        os.close(self._folder)
        self.descriptor = self._folder = _CLOSED


def replace_durably(path: str | os.PathLike[str], data: bytes) -> None:
    """Replace a small file as a whole, or make it: whatever happens, afterwards it is the old one or the new.

    The new one is on the disk, folder entry included, when this returns.

    Raises:
        OSError: it could not be written; the file is the old one, or this.
    """
    Replacement(path).put(data)


def left_over(path: Path) -> Iterator[Path]:
    """What was to take a file's place and never did: its process was cut short."""
    return path.parent.glob(_FRESH.format(name=path.name, number="*"))


def sync_folder(folder: str | os.PathLike[str]) -> None:
    """Make the names in a folder durable.

    Raises:
        OSError: an error of the disk.
    """
    descriptor = os.open(folder, _FOLDER)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_all(descriptor: int, data: bytes) -> None:
    """However few bytes the system takes at a time."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(descriptor, rest) :]
