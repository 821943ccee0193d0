"""The keys that sign logs: one for each session of a log directory, each certified by the one before it.

    certified = "cutgate/log-key/1" | series | epoch | public key
    certificate = Ed25519 signature over ``certified``, by the key of the epoch before

The series names the sessions of one log directory, in their order; the epoch numbers them from 1. The key of an epoch
that nobody certified begins anew: it was enrolled. Series have 16 bytes, epochs 32 bit (little endian), keys 32 bytes.
"""

import json
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any, Final

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

SERIES_BYTES: Final = 16
KEY_BYTES: Final = 32
CERTIFICATE_BYTES: Final = 64
EPOCH_MAX: Final = (1 << 32) - 1
FIRST_EPOCH: Final = 1
FILE_MAX: Final = 1024
"""Bytes of the largest key file."""
_SHOWN: Final = 40
"""Characters of a key of the JSON that is none of ours."""
_DOMAIN: Final = b"cutgate/log-key/1"
_KEY_PAIR: Final = "cutgate.log-key/1"
_PUBLIC_HALF: Final = "cutgate.log-public-key/1"


@dataclass(frozen=True, slots=True)
class PublicLogKey:
    """The public half of one epoch's key; ``certificate`` is the signature of the key before it, None if enrolled."""

    series: bytes
    epoch: int
    public: bytes
    certificate: bytes | None = None

    @property
    def fingerprint(self) -> str:
        """Sixteen hexadecimal digits, for people."""
        return fingerprint_of(self.public)

    @property
    def certified(self) -> bytes:
        """What its certificate signs."""
        return _DOMAIN + self.series + struct.pack("<I", self.epoch) + self.public

    def certifies(self, other: "PublicLogKey") -> bool:
        """Whether the other key is of the next epoch and carries this key's signature."""
        if (other.series, other.epoch) != (self.series, self.epoch + 1) or other.certificate is None:
            return False
        try:
            Ed25519PublicKey.from_public_bytes(self.public).verify(other.certificate, other.certified)
        except InvalidSignature:
            return False
        return True

    def encode(self) -> bytes:
        """Its file: what a reviewer pins."""
        return _file(_PUBLIC_HALF, self, public_key=self.public, certificate=self.certificate)

    @classmethod
    def parse(cls, data: bytes) -> "PublicLogKey":
        """Raises ValueError for anything else."""
        return cls(*_parsed(_PUBLIC_HALF, "public_key", data))


@dataclass(frozen=True)
class LogKey:
    """The key of one epoch, with its secret.

    Attributes:
        series: of the log directory, 16 bytes.
        epoch: from 1 on.
        secret: 32 bytes.
        certificate: by the key before it; None where it was enrolled.
    """

    series: bytes
    epoch: int
    secret: bytes
    certificate: bytes | None = None

    @cached_property
    def private(self) -> Ed25519PrivateKey:
        """What signs."""
        return Ed25519PrivateKey.from_private_bytes(self.secret)

    @cached_property
    def public(self) -> PublicLogKey:
        """The public half."""
        public = self.private.public_key().public_bytes_raw()
        return PublicLogKey(self.series, self.epoch, public, self.certificate)

    def following(self, secret: bytes) -> "LogKey":
        """The next epoch's key, certified by this one.

        Args:
            secret: 32 random bytes.

        Raises:
            ValueError: there is no further epoch.
        """
        if not self.epoch < EPOCH_MAX:
            raise ValueError(f"epoch {self.epoch} is the last one")
        drawn = LogKey(self.series, self.epoch + 1, secret)
        return LogKey(self.series, drawn.epoch, secret, self.private.sign(drawn.public.certified))

    def encode(self) -> bytes:
        """Its file, for its owner alone."""
        return _file(_KEY_PAIR, self, secret=self.secret, certificate=self.certificate)

    @classmethod
    def parse(cls, data: bytes) -> "LogKey":
        """Raises ValueError for anything else."""
        return cls(*_parsed(_KEY_PAIR, "secret", data))


def fingerprint_of(public: bytes) -> str:
    """Of a public key, for people: sixteen hexadecimal digits of its SHA-256."""
    digits = sha256(public).hexdigest()
    return " ".join(digits[at : at + 4] for at in range(0, 16, 4))


def chained(pinned: PublicLogKey, keys: Iterable[PublicLogKey]) -> PublicLogKey | None:
    """The last of these keys, if each is certified by the one before it and the first by the pinned one.

    Args:
        pinned: the key that is trusted.
        keys: of the epochs behind it, in their order.

    Returns:
        None where a certificate is missing or not the one before's; the pinned key where no keys are given.
    """
    last = pinned
    for key in keys:
        if not last.certifies(key):
            return None
        last = key
    return last


def _file(schema: str, key: Any, **parts: bytes | None) -> bytes:
    hexed = {name: part.hex() for name, part in parts.items() if part is not None}
    content = {"schema": schema, "series": key.series.hex(), "epoch": key.epoch, **hexed}
    return json.dumps(content).encode() + b"\n"


def _parsed(schema: str, half: str, data: bytes) -> tuple[bytes, int, bytes, bytes | None]:
    """Series, epoch, the half of the key that the file holds under this name, and certificate.

    Raises:
        ValueError: it is another file, or holds more or less than these.
    """
    content = _read(schema, data)
    others = content.keys() - {"schema", "series", "epoch", half, "certificate"}
    if others:
        raise ValueError(f"its key {min(others)[:_SHOWN]!r} is none that such a file has")
    certificate = content.get("certificate")
    return (
        _bytes(content, "series", SERIES_BYTES),
        _epoch(content),
        _bytes(content, half, KEY_BYTES),
        None if certificate is None else _bytes(content, "certificate", CERTIFICATE_BYTES),
    )


def _read(schema: str, data: bytes) -> dict[str, Any]:
    try:
        content = json.loads(data, object_pairs_hook=_once)
    except _TwiceError:
        raise
    except (ValueError, RecursionError):
        raise ValueError("it is not JSON") from None
    found = content.get("schema") if isinstance(content, dict) else None
    if found != schema:
        raise ValueError(f"its schema is {found!r}, must be {schema!r}")
    return dict(content)


class _TwiceError(ValueError):
    """A key of the JSON is given twice: another program may read the other one."""


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for name, value in pairs:
        if name in content:
            raise _TwiceError(f"its key {name[:_SHOWN]!r} is given twice")
        content[name] = value
    return content


def _bytes(content: dict[str, Any], name: str, size: int) -> bytes:
    text = content.get(name)
    digits = text if isinstance(text, str) else ""
    if len(digits) != 2 * size or set(digits) - set("0123456789abcdef"):
        raise ValueError(f"its {name} must be {2 * size} hexadecimal digits")
    return bytes.fromhex(digits)


def _epoch(content: dict[str, Any]) -> int:
    epoch = content.get("epoch")
    if not (isinstance(epoch, int) and not isinstance(epoch, bool) and FIRST_EPOCH <= epoch <= EPOCH_MAX):
        raise ValueError(f"its epoch must be {FIRST_EPOCH} to {EPOCH_MAX}")
    return epoch
