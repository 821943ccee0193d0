"""What only a holder of the pre-shared key can say: permit, start, reset. AES-CMAC-128 over canonical bytes.

The key file holds 32 random bytes in hexadecimal, mode 0600. The key that signs is derived from it per direction.
"""

import hmac
import os
import stat
from pathlib import Path
from typing import TypeVar

from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from cutgate.protocol.conversation import SignedRecord

KEY_BYTES = 32
MODE = 0o600
FILE_BYTES_MAX = 2 * KEY_BYTES + 2
"""The digits and one line end."""
RUNTIME_TO_CONTROLLER = b"runtime to controller"

Signed = TypeVar("Signed", bound=SignedRecord)


class KeyFileError(ValueError):
    """A key file that must not be used; the message names the file, what is wrong, and what to do."""


def _direction_key(key: bytes) -> bytes:
    """The 16-byte key of this direction."""
    if len(key) != KEY_BYTES:
        raise ValueError(f"key is {len(key)} bytes, must be {KEY_BYTES}")
    return HKDF(algorithm=SHA256(), length=16, salt=None, info=RUNTIME_TO_CONTROLLER).derive(key)


def _mac(key: bytes, record: SignedRecord) -> bytes:
    code = CMAC(AES(_direction_key(key)))
    code.update(record.canonical())
    return code.finalize()


def sign(key: bytes, record: Signed) -> Signed:
    """The record with its code. Raises ValueError unless the key is 32 bytes."""
    return record.with_mac(_mac(key, record))


def verify(key: bytes, record: SignedRecord) -> bool:
    """Whether a holder of the key made exactly this record; in constant time."""
    return hmac.compare_digest(_mac(key, record), record.code)


def new_key_file(path: Path, key: bytes) -> None:
    """Write a new key file, mode 0600, and make it durable. Never overwrites.

    Raises:
        KeyFileError: the key is not 32 bytes, or the file exists or cannot be written.
    """
    if len(key) != KEY_BYTES:
        raise KeyFileError(f"{path}: the key is {len(key)} bytes, must be {KEY_BYTES}")
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, MODE)
    except FileExistsError:
        raise KeyFileError(
            f"{path}: exists and is never overwritten; name another file or remove it"
        ) from None
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be written: {error.strerror}") from None
    with os.fdopen(descriptor, "wb") as file:
        os.fchmod(descriptor, MODE)
        file.write(key.hex().encode("ascii") + b"\n")
        file.flush()
        os.fsync(descriptor)


def load_key(path: Path) -> bytes:
    """The 32 bytes of a key file that only its owner can read.

    Raises:
        KeyFileError: missing, not a plain file, open to others, or not 64 hexadecimal digits.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        raise KeyFileError(
            f"{path}: there is no such key file; make one with: cutgate key new {path}"
        ) from None
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise KeyFileError(f"{path}: is not a plain file; name a file made with: cutgate key new")
        if stat.S_IMODE(status.st_mode) != MODE:
            mode = stat.S_IMODE(status.st_mode)
            raise KeyFileError(f"{path}: mode is {mode:04o}, must be {MODE:04o}; run: chmod 600 {path}")
        if not status.st_size <= FILE_BYTES_MAX:
            raise KeyFileError(f"{path}: is {status.st_size} bytes, must be at most {FILE_BYTES_MAX}")
        text = os.read(descriptor, FILE_BYTES_MAX).strip()
    finally:
        os.close(descriptor)
    try:
        key = bytes.fromhex(text.decode("ascii"))
    except ValueError:
        raise KeyFileError(f"{path}: is not hexadecimal; make a new one with: cutgate key new") from None
    if len(key) != KEY_BYTES:
        raise KeyFileError(
            f"{path}: holds {len(key)} bytes, must hold {KEY_BYTES}; make a new one: cutgate key new"
        )
    return key
