"""The pre-shared key's file: 32 random bytes as hexadecimal digits, which only its owner may read."""

from pathlib import Path
from typing import Final

from cutgate.config.durable import create_durably
from cutgate.config.load import InputError
from cutgate.config.ours import read_ours
from cutgate.protocol.codes import KEY_BYTES

FILE_BYTES_MAX: Final = 2 * KEY_BYTES + 2
"""The digits and one line end."""


def new_key_file(path: Path, key: bytes) -> None:
    """Write a new key file, mode 0600 whatever the umask, and make it durable. Never overwrites.

    Raises:
        InputError: the key is not 32 bytes, or the file exists or cannot be written; then none is left there.
    """
    if len(key) != KEY_BYTES:
        raise InputError(path, "", f"a key of {len(key)} bytes", f"{KEY_BYTES} bytes")
    try:
        create_durably(path, key.hex().encode("ascii") + b"\n")
    except FileExistsError:
        remedy = "name another file or remove it"
        raise InputError(path, "", None, "exists and is never overwritten", remedy) from None
    except OSError as error:
        raise _unwritten(path, error) from None


def _unwritten(path: Path, error: OSError) -> InputError:
    remedy = "name a file in a folder that exists and has room"
    return InputError(path, "", None, f"cannot be written ({error.strerror})", remedy)


def load_key(path: Path) -> bytes:
    """The 32 bytes of a key file that is ours alone.

    Raises:
        InputError: missing, a link, another's, open to others, or not 64 hexadecimal digits.
    """
    try:
        data = read_ours(path, FILE_BYTES_MAX, secret=True)
    except FileNotFoundError:
        raise missing_key(path) from None
    return key_of(path, data)


def missing_key(path: Path) -> InputError:
    """The refusal of a key file that is not there."""
    remedy = f"copy the other side's there, or make one for both with: cutgate key new {path}"
    return InputError(path, "", None, "there is no such key file", remedy)


def key_of(path: Path, data: bytes) -> bytes:
    """The 32 bytes of a key file that was read.

    Raises:
        InputError: not 64 hexadecimal digits.
    """
    remedy = "copy it anew from the other side, or make another one for both with: cutgate key new"
    try:
        key = bytes.fromhex(data.decode("ascii").strip())
    except ValueError:
        raise InputError(path, "", None, "is not hexadecimal", remedy) from None
    if len(key) != KEY_BYTES:
        raise InputError(path, "", f"a key of {len(key)} bytes", f"{KEY_BYTES} bytes", remedy)
    return key
