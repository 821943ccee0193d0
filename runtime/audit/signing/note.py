"""Signed notes, https://c2sp.org/signed-note: text, an empty line, and a line for each signature.

    key ID = the first 4 bytes of SHA-256(key name | newline | type | public key)
    signature line = em dash, space, key name, space, base64(key ID | signature), newline

Of the types two are known: Ed25519 (0x01), which signs the text, and the cosignature of a witness (0x04,
https://c2sp.org/tlog-cosignature), which signs the time and the text. Signatures of other keys are passed over.
"""

import re
from base64 import b64decode, b64encode
from dataclasses import dataclass
from enum import IntEnum
from hashlib import sha256
from typing import Final

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

PUBLIC_BYTES: Final = 32
NOTE_MAX: Final = 1 << 16
"""Characters of the longest note that is read; ours have 186."""
SIGNATURES_MAX: Final = 64
_ID_BYTES: Final = 4
_TIME_BYTES: Final = 8
_DASH: Final = "\u2014 "
_NAME: Final = re.compile(r"[^\s+]+")
_CONTROL: Final = re.compile(r"[\x00-\x09\x0b-\x1f]")


class NoteError(ValueError):
    """It is no note, or not signed by the key that must have signed it; the text says what."""


class SignatureType(IntEnum):
    """What a key's signatures sign."""

    ED25519 = 0x01
    COSIGNATURE = 0x04


@dataclass(frozen=True, slots=True)
class VerifierKey:
    """A public key under its name.

    Attributes:
        name: no spaces, no plus.
        public: 32 bytes.
        type: of its signatures.
    """

    name: str
    public: bytes
    type: SignatureType = SignatureType.ED25519

    @property
    def id(self) -> bytes:
        """4 bytes, by which its signatures are found in a note."""
        return sha256(self.name.encode() + b"\n" + bytes((self.type,)) + self.public).digest()[:_ID_BYTES]

    def __str__(self) -> str:
        """As other programs take it: name, plus, key ID, plus, base64 of type and key."""
        return f"{self.name}+{self.id.hex()}+{b64encode(bytes((self.type,)) + self.public).decode()}"

    @classmethod
    def parse(cls, text: str) -> "VerifierKey":
        """From what ``str`` gives.

        Raises:
            NoteError: it is no such key, or its ID is another's.
        """
        try:
            name, key_id, encoded = text.split("+", 2)
            data = b64decode(encoded, validate=True)
            key = cls(name, data[1:], SignatureType(data[0]))
            own_id = key.id.hex()
        except (ValueError, IndexError):  # a name that is no UTF-8 has no ID
            raise NoteError("a key is NAME+ID+BASE64, of type 1 or 4") from None
        if not _NAME.fullmatch(name) or len(key.public) != PUBLIC_BYTES:
            raise NoteError(f"a key has a name without spaces, and {PUBLIC_BYTES} bytes")
        if own_id != key_id:
            raise NoteError(f"its key ID is {key_id}, the key's is {own_id}")
        return key


@dataclass(frozen=True, slots=True)
class Note:
    """A note whose signatures are not verified yet.

    Attributes:
        text: with its last newline.
        signatures: of each line the key's name, its ID, and what it says.
    """

    text: str
    signatures: tuple[tuple[str, bytes, bytes], ...]


def sign(text: str, name: str, secret: Ed25519PrivateKey) -> str:
    """The note of this text with one signature. A text ends with a newline."""
    key = VerifierKey(name, secret.public_key().public_bytes_raw())
    return _note(text, key, secret.sign(text.encode()))


def parse(note: str) -> Note:
    """Text and signature lines, none of them verified.

    Raises:
        NoteError: it is no note.
    """
    if not len(note) <= NOTE_MAX:
        raise NoteError(f"a note has at most {NOTE_MAX} characters, this one {len(note)}")
    text, empty, lines = note.rpartition("\n\n")
    if not _encodable(note):
        raise NoteError("a note is UTF-8")
    if _CONTROL.search(note) or not (text and empty and lines.endswith("\n")):
        raise NoteError("a note is text, an empty line and signature lines, without control characters")
    signatures = tuple(map(_signature, lines[:-1].split("\n")))
    if not len(signatures) <= SIGNATURES_MAX:
        raise NoteError(f"a note has at most {SIGNATURES_MAX} signatures, this one {len(signatures)}")
    return Note(text + "\n", signatures)


def verify(note: str, key: VerifierKey) -> str:
    """The text of a note that this key has signed.

    Raises:
        NoteError: it is no note, it is not signed by this key, or a signature that claims to be the key's is not.
    """
    if not _encodable(key.name):  # a log's id, as its record 0 has it: any text
        raise NoteError("the name of its key is not UTF-8")
    found = parse(note)
    claimed = [data for name, key_id, data in found.signatures if (name, key_id) == (key.name, key.id)]
    if not claimed:
        raise NoteError(f"it has no signature of the key {key.name}+{key.id.hex()}")
    public = Ed25519PublicKey.from_public_bytes(key.public)
    for data in claimed:
        try:
            public.verify(*_signed(found.text, key.type, data))
        except InvalidSignature:
            raise NoteError(f"its signature is not of the key {key.name}+{key.id.hex()}") from None
    return found.text


def alone(note: str, key: VerifierKey) -> str:
    """A note that this key has signed, without what others have signed of it. Raises as ``verify``."""
    text = verify(note, key)
    claimed = (data for name, key_id, data in parse(note).signatures if (name, key_id) == (key.name, key.id))
    return _note(text, key, next(claimed))


def _note(text: str, key: VerifierKey, data: bytes) -> str:
    return f"{text}\n{_DASH}{key.name} {b64encode(key.id + data).decode()}\n"


def _encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _signature(line: str) -> tuple[str, bytes, bytes]:
    name, _, encoded = line.removeprefix(_DASH).partition(" ")
    try:
        data = b64decode(encoded)
    except ValueError:
        data = b""
    # One form: else there were other notes, with other bytes, that are signed as well.
    whole = len(data) > _ID_BYTES and b64encode(data).decode() == encoded
    if not (line.startswith(_DASH) and _NAME.fullmatch(name) and whole):
        raise NoteError("a signature line is an em dash, a name, and base64 of key ID and signature")
    return name, data[:_ID_BYTES], data[_ID_BYTES:]


def _signed(text: str, kind: SignatureType, data: bytes) -> tuple[bytes, bytes]:
    """Signature and what it must sign."""
    if kind is SignatureType.ED25519:
        return data, text.encode()
    time_s = int.from_bytes(data[:_TIME_BYTES], "big")
    return data[_TIME_BYTES:], f"cosignature/v1\ntime {time_s}\n{text}".encode()
