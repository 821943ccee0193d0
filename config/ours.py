"""Files that decide: keys, memories, lists, heads. One way to make, to believe and to replace them.

Such a file is believed only if it is ours: a regular file, reached through no link of its own name, that belongs to
the user of this process (root, too, believes only root's) and that nobody else may write. It is made only where
nothing stands, and written anew as a whole under a fresh name that takes the old one's place when it is durable: never
through what stands there, for who may write in the folder could have put a link to another file under any name that
can be guessed.
"""

import contextlib
import os
import pwd
import stat
from pathlib import Path
from typing import Final

from cutgate.config.load import InputError, unreadable

MODE: Final = 0o600
"""Of every file made here: only its owner reads and writes it."""
FRESH: Final = ".{name}.{number}.new"
"""What is to take a file's place, until it does."""
_MAKE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_BELIEVE: Final = (
    os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
)  # a pipe without a writer is refused, not waited for


def create_ours(path: str | os.PathLike[str]) -> int:
    """A descriptor, to write, of a new and empty file that only its owner may read.

    Raises:
        FileExistsError: anything stands there, be it a link that leads nowhere.
        OSError: it cannot be made.
    """
    return os.open(path, _MAKE, MODE)


def open_ours(path: str | os.PathLike[str], flags: int = os.O_RDONLY, *, secret: bool = False) -> int:
    """A descriptor of a file that is ours.

    Args:
        path: the file; no symbolic link.
        flags: of ``os.open``; with ``os.O_CREAT`` it is made where it is missing.
        secret: nobody else may read it either.

    Raises:
        FileNotFoundError: there is none.
        InputError: it is not ours, or cannot be opened; names owner or mode and what to do.
    """
    try:
        descriptor = os.open(path, flags | _BELIEVE, MODE)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        if os.path.islink(path):  # noqa: PTH114 - a path of any kind
            remedy = "put the file itself there, if you know who made the link"
            raise InputError(path, "", None, "is a symbolic link", remedy) from None
        raise unreadable(path, error) from None
    try:
        _believe(path, os.fstat(descriptor), secret=secret)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def read_ours(path: str | os.PathLike[str], limit: int, *, secret: bool = False) -> bytes:
    """The whole of a file that is ours.

    Args:
        path: the file; no symbolic link.
        limit: largest accepted size, bytes.
        secret: nobody else may read it either.

    Raises:
        FileNotFoundError: there is none.
        InputError: it is not ours, larger, or cannot be read.
    """
    descriptor = open_ours(path, secret=secret)
    try:
        size = os.fstat(descriptor).st_size
        if not (size <= limit):
            remedy = "it holds something else; restore the file"
            raise InputError(path, "size", f"{size} bytes", f"<= {limit} bytes", remedy)
        data = b""
        while part := os.read(descriptor, limit + 1 - len(data)):
            data += part
            if len(data) > limit:
                raise OSError(f"grew over {limit} bytes while it was read")  # noqa: TRY301
    except OSError as error:
        raise unreadable(path, error) from None
    finally:
        os.close(descriptor)
    return data


class Replacement:
    """What is to take a file's place: made under a fresh name, written, and put in place as a whole.

    Made early where space must be reserved for it; ``descriptor`` serves for that.

    Raises:
        OSError: it cannot be made.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        file = Path(path)
        self._name = file.name
        self._fresh = FRESH.format(name=file.name, number=os.urandom(8).hex())
        self._folder = os.open(file.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
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
            rest = memoryview(data)
            while rest:
                rest = rest[os.write(self.descriptor, rest) :]
            os.fsync(self.descriptor)
            os.rename(self._fresh, self._name, src_dir_fd=self._folder, dst_dir_fd=self._folder)
            os.fsync(self._folder)
        except OSError:
            self.discard()
            raise
        self._close()

    def discard(self) -> None:
        """Give it up, if it has not been put in place."""
        if self.descriptor < 0:
            return
        with contextlib.suppress(OSError):  # whoever gives it up knows why, and a later one has another name
            os.unlink(self._fresh, dir_fd=self._folder)
        self._close()

    def _close(self) -> None:
        os.close(self.descriptor)
        os.close(self._folder)
        self.descriptor = self._folder = -1


def replace_durably(path: str | os.PathLike[str], data: bytes) -> None:
    """Replace a small file as a whole, or make it: whatever happens, afterwards it is the old one or the new.

    The new one is on the disk, folder entry included, when this returns.

    Raises:
        OSError: it could not be written; the file is the old one, or this.
    """
    Replacement(path).put(data)


def user(uid: int) -> str:
    """A user for a message: name and number."""
    try:
        return f"{pwd.getpwuid(uid).pw_name} (uid {uid})"
    except KeyError:
        return f"unknown (uid {uid})"


def _believe(path: str | os.PathLike[str], status: os.stat_result, *, secret: bool) -> None:
    """Raises InputError unless the file is ours."""
    if not stat.S_ISREG(status.st_mode):
        raise InputError(path, "", None, "not a regular file", "put the file itself there")
    if status.st_uid != os.geteuid():
        remedy = f"if nobody else can have changed it: chown it to {os.geteuid()}"
        raise InputError(path, "owner", user(status.st_uid), user(os.geteuid()), remedy)
    mode = stat.S_IMODE(status.st_mode)
    if mode & (0o077 if secret else 0o022):
        bound = f"without access by others ({MODE:04o})" if secret else f"not writable by others ({MODE:04o})"
        done = "read or changed" if secret else "changed"
        remedy = f"if nobody else can have {done} it: chmod {MODE:o}"
        raise InputError(path, "mode", f"{mode:04o}", bound, remedy)
