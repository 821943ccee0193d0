"""What only a holder of the pre-shared key can say: permit, start, reset. AES-CMAC-128 over canonical bytes.

Both sides hold the same 32 random bytes. The key that signs is derived from them per direction.
"""

import hmac
from typing import TypeVar

from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from cutgate.protocol.conversation import SignedRecord

KEY_BYTES = 32
RUNTIME_TO_CONTROLLER = b"runtime to controller"
FINGERPRINT = b"cutgate key fingerprint"
FINGERPRINT_BYTES = 4

Signed = TypeVar("Signed", bound=SignedRecord)


def _direction_key(key: bytes) -> bytes:
    """The 16-byte key of this direction."""
    if len(key) != KEY_BYTES:
        raise ValueError(f"key is {len(key)} bytes, must be {KEY_BYTES}")
    return HKDF(algorithm=SHA256(), length=16, salt=None, info=RUNTIME_TO_CONTROLLER).derive(key)


def fingerprint(key: bytes) -> str:
    """Eight hexadecimal digits by which people compare two keys: enough for that, and nothing to find a key by.

    The first bytes of HMAC-SHA256 under the key over a fixed text. Raises ValueError unless the key is 32 bytes.
    """
    if len(key) != KEY_BYTES:
        raise ValueError(f"key is {len(key)} bytes, must be {KEY_BYTES}")
    return hmac.digest(key, FINGERPRINT, "sha256")[:FINGERPRINT_BYTES].hex()


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
