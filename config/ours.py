"""Files that decide: keys, memories, lists, heads. One way to believe them; ``durable`` writes them.

Such a file is believed only if it is ours: a regular file, reached through no link of its own name, that belongs to
the user of this process (root, too, believes only root's) and that nobody else may write.
"""

import os
import pwd
import stat
from typing import Final

from cutgate.config.durable import MODE
from cutgate.config.load import InputError, unreadable

PART: Final = 1 << 16
"""So much is read at a time: memory goes by what a file holds, not by what it may."""
_BELIEVE: Final = (
    os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
)  # a pipe without a writer is refused, not waited for


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
        data = bytearray()
        while part := os.read(descriptor, PART):
            data += part
            if len(data) > limit:
                raise OSError(f"grew over {limit} bytes while it was read")  # noqa: TRY301
    except OSError as error:
        raise unreadable(path, error) from None
    finally:
        os.close(descriptor)
    return bytes(data)


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
