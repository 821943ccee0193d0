"""What only a holder of the pre-shared key can say: authentication codes of records, heartbeats and joint samples.

Both sides hold the same 32 random bytes. HKDF-SHA256 (RFC 5869) derives from them, per direction and purpose, the
16-byte keys of AES-CMAC (RFC 4493): the key of OPEN for good, all others for one session, with its digest as salt. So
nothing that was said in one session means anything in another.

    key of OPEN   = HKDF(pre-shared key, no salt, "cutgate/open/1")
    session key   = HKDF(pre-shared key, salt = session digest, "<from> to <to>: <purpose>")
    code          = AES-CMAC(key, domain | 0x00 | session digest | sequence, u32 | body without its code)
    heartbeat tag = first 16 bits of AES-CMAC(key, counter, u32 | echo, u32 | last two bytes)
    sample tag    = first 20 bits of AES-CMAC(key, counter, u32 | five joints in counts, i32)

OPEN has no session yet: its code leaves out digest and sequence. All integers are little endian, "first bits" those of
least weight. A keyless guess of a heartbeat's tag succeeds once in 65 536 and then buys one time-out of motion at most;
each one that misses stops.

    >>> from cutgate.protocol.conversation import Acknowledge
    >>> from cutgate.protocol.states import StopCause
    >>> ours = theirs = PresharedKey(bytes(range(32))).session(bytes(32))
    >>> signed = ours.sign(Acknowledge(epoch=3, cause=StopCause.OPERATOR_STOP), sequence=7)
    >>> theirs.authentic(signed, sequence=7), theirs.authentic(signed, sequence=8)
    (True, False)
"""

import hmac
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, TypeVar

from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from cutgate.protocol.conversation import Open, SignedRecord, session_tag
from cutgate.protocol.wire import Side

KEY_BYTES = 32
CODE_KEY_BYTES: Final = 16
OPENING: Final = b"cutgate/open/1"
FINGERPRINT = b"cutgate key fingerprint"
FINGERPRINT_BYTES = 4

NO_ECHO: Final = 0xFFFF_FFFF
"""Echo of a side that has not yet accepted a heartbeat of its peer, as the tag covers it."""
COUNTER_MAX: Final = NO_ECHO - 1
SAMPLE_TAG_BITS: Final = 20

_HEARTBEAT: Final = struct.Struct("<II2s")
_SAMPLE: Final = struct.Struct("<I5i")
_DIRECTION: Final = {Side.RUNTIME: "runtime to controller", Side.CONTROLLER: "controller to runtime"}


def _named(sender: Side, purpose: str) -> str:
    """What a session's key is derived for, and its name wherever it is kept."""
    return f"{_DIRECTION[sender]}: {purpose}"


RECORDS: Final = {side: _named(side, "record") for side in Side}
HEARTBEATS: Final = {side: _named(side, "heartbeat") for side in Side}
SAMPLES: Final = _named(Side.CONTROLLER, "sample")
KEY_NAMES: Final = (*RECORDS.values(), *HEARTBEATS.values(), SAMPLES)
"""The keys of a session."""

Signed = TypeVar("Signed", bound=SignedRecord)


class Code:
    """AES-CMAC with one key, prepared once: a copy costs a tenth of a new one."""

    def __init__(self, key: bytes) -> None:
        self._prepared = CMAC(AES(key))

    def of(self, data: bytes) -> bytes:
        """The code of these bytes, 16 bytes."""
        code = self._prepared.copy()
        code.update(data)
        return code.finalize()


class PresharedKey:
    """The 32 bytes that both sides hold. Raises ValueError for another length."""

    def __init__(self, key: bytes) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"key is {len(key)} bytes, must be {KEY_BYTES}")
        self._key = key
        self._opening = Code(_derived(key, None, OPENING))

    def sign_open(self, record: Open) -> Open:
        """OPEN with its code."""
        return record.with_mac(self._opening.of(record.canonical()))

    def open_authentic(self, record: Open) -> bool:
        """Whether a holder of the key made exactly this OPEN; in constant time."""
        return hmac.compare_digest(self._opening.of(record.canonical()), record.code)

    def session(self, session_digest: bytes) -> "SessionCodes":
        """The codes of the session with this digest, 32 bytes."""
        return SessionCodes(self.code_keys(session_digest))

    def code_keys(self, session_digest: bytes) -> "CodeKeys":
        """The keys of the session with this digest, 32 bytes: nothing else is known by them."""
        derived = {name: _derived(self._key, session_digest, name.encode("ascii")) for name in KEY_NAMES}
        return CodeKeys(session_digest, derived)

    @cached_property
    def fingerprint(self) -> str:
        """Eight hexadecimal digits by which people compare two keys: enough for that, and nothing to find a key by.

        The first bytes of HMAC-SHA256 under the key over a fixed text.
        """
        return hmac.digest(self._key, FINGERPRINT, "sha256")[:FINGERPRINT_BYTES].hex()


@dataclass(frozen=True)
class CodeKeys:
    """The keys of one session, from which neither the pre-shared key nor those of another session follow.

    Attributes:
        digest: names the session, 32 bytes.
        keys: 16 bytes each, by ``KEY_NAMES``. Raises ValueError if one is missing, or of another length.
    """

    digest: bytes
    keys: Mapping[str, bytes] = field(repr=False)

    def __post_init__(self) -> None:
        if set(self.keys) != set(KEY_NAMES) or {len(key) for key in self.keys.values()} != {CODE_KEY_BYTES}:
            raise ValueError(f"keys must be {CODE_KEY_BYTES} bytes each: {', '.join(KEY_NAMES)}")


class SessionCodes:
    """The codes of one session, both directions.

    Attributes:
        digest: names the session, 32 bytes (``conversation.session_digest``).
        tag: its first four bytes: virtual bytes of every single frame.
    """

    def __init__(self, keys: CodeKeys) -> None:
        self.digest = keys.digest
        self.tag = session_tag(keys.digest)
        self._records = {side: Code(keys.keys[RECORDS[side]]) for side in Side}
        self._heartbeats = {side: Code(keys.keys[HEARTBEATS[side]]) for side in Side}
        self._samples = Code(keys.keys[SAMPLES])

    def sign(self, record: Signed, sequence: int) -> Signed:
        """The record with its code, for the sequence it goes out with."""
        return record.with_mac(self._code(record, sequence))

    def authentic(self, record: SignedRecord, sequence: int) -> bool:
        """Whether a holder of the key made exactly this record, for this sequence; in constant time."""
        return hmac.compare_digest(self._code(record, sequence), record.code)

    def _code(self, record: SignedRecord, sequence: int) -> bytes:
        return self._records[record.SENDER].of(record.canonical(self.digest, sequence))

    def heartbeat_tag(self, sender: Side, counter: int, echo: int, covered: bytes) -> int:
        """16 bits over a heartbeat's counter and echo, both extended to 32 bits, and its last two bytes."""
        code = self._heartbeats[sender].of(_HEARTBEAT.pack(counter, echo, covered))
        return int.from_bytes(code[:2], "little")

    def sample_tag(self, counter: int, joints: Sequence[int]) -> int:
        """20 bits over a sample's counter, extended to 32 bits, and its five joints in counts of their frames."""
        code = self._samples.of(_SAMPLE.pack(counter, *joints))
        return int.from_bytes(code, "little") % (1 << SAMPLE_TAG_BITS)


def _derived(key: bytes, salt: bytes | None, info: bytes) -> bytes:
    return HKDF(algorithm=SHA256(), length=CODE_KEY_BYTES, salt=salt, info=info).derive(key)


def fingerprint(key: bytes) -> str:
    """The fingerprint of a key (``PresharedKey.fingerprint``). Raises ValueError unless the key is 32 bytes."""
    return PresharedKey(key).fingerprint
