"""OPEN and OPENED as a log holds them, and the session's keys: what every other code of the session is checked with."""

from typing import NamedTuple, TypeVar

from pydantic import ValidationError

from cutgate.config.load import InputError
from cutgate.config.session_keys import SessionKeys
from cutgate.protocol import records as wire
from cutgate.protocol.codes import FINGERPRINT_BYTES, PresharedKey, SessionCodes
from cutgate.protocol.wire import Channel, Side
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.records import AuditSession, LogRecord

NOT_OURS = "its code is none that a holder of the key made"
L = TypeVar("L", bound=LogRecord)


def as_record(kind: type[L], data: bytes) -> L:
    """A record of the log. Raises ValueError: it is none of this kind."""
    try:
        return kind.model_validate_json(data)
    except ValidationError as error:
        raise ValueError(error.errors(include_input=False, include_url=False)[0]["msg"]) from None


class Opening(NamedTuple):
    """How a session was opened.

    Attributes:
        named: the session's digest, as the log names it.
        request, answer: OPEN and OPENED.
        tag, sequence: of OPENED's envelope.
        request_sha256, answer_sha256: of both as they crossed the bus.
        fingerprint: of the pre-shared key, as the log names it.
    """

    named: bytes
    request: wire.Open
    answer: wire.Opened
    tag: int
    sequence: int
    request_sha256: bytes
    answer_sha256: bytes
    fingerprint: str | None

    @classmethod
    def parse(cls, data: bytes) -> "Opening":
        """The record of the log, JSON. Raises ValueError: it cannot be read."""
        record = as_record(AuditSession, data)
        sent, came = bytes.fromhex(record.open), bytes.fromhex(record.opened)
        request = wire.unpack(sent, sender=Side.RUNTIME, channel=Channel.CONTROL)
        answer = wire.unpack(came, sender=Side.CONTROLLER, channel=Channel.CONTROL)
        if not (isinstance(request.record, wire.Open) and isinstance(answer.record, wire.Opened)):
            raise ValueError("it holds other records than OPEN and OPENED")  # noqa: TRY004 - of data
        if record.key_fingerprint is not None and len(record.key_fingerprint) != 2 * FINGERPRINT_BYTES:
            raise ValueError(f"it names a fingerprint that has not {2 * FINGERPRINT_BYTES} digits")
        return cls(
            named=bytes.fromhex(record.session),
            request=request.record,
            answer=answer.record,
            tag=answer.session,
            sequence=answer.sequence,
            request_sha256=wire.digest(sent),
            answer_sha256=wire.digest(came),
            fingerprint=record.key_fingerprint,
        )


def opening_of(log: Log) -> Opening | None:
    """How a log's session was opened; None where it holds no OPEN and OPENED.

    Raises:
        ValueError: it holds several, or none that can be read.
    """
    found = [data for _, data in log.each(AuditSession.TOPIC)]
    if len(found) > 1:
        raise ValueError(f"{AuditSession.TOPIC} is there {len(found)} times, and a log has one session")
    try:
        return Opening.parse(found[0]) if found else None
    except ValueError as error:
        raise ValueError(f"{AuditSession.TOPIC} cannot be read: {error}") from None


def session_keys(log_id: str, opening: Opening, key: bytes) -> SessionKeys | None:
    """The keys of a log's session alone; None where it was not opened with this key.

    Args:
        log_id: of the log.
        opening: as it holds it.
        key: the pre-shared key, 32 bytes.
    """
    preshared = PresharedKey(key)
    if not preshared.open_authentic(opening.request):
        return None
    keys = preshared.code_keys(wire.session_digest(opening.request))
    return SessionKeys(log_id, opening.request.code, keys)


class Judged(NamedTuple):
    """What comes of OPEN and OPENED under a key.

    Attributes:
        codes: the session's; None where they cannot be known.
        opens, answers: whether the code of OPEN, and of OPENED, fits.
        wrong: what does not.
    """

    codes: SessionCodes | None
    opens: bool
    answers: bool
    wrong: tuple[str, ...]


def judge_opening(opening: Opening, key: bytes | SessionKeys) -> Judged:
    """Whether the session was opened by holders of this key on both sides.

    Args:
        opening: as the log holds it.
        key: the pre-shared key, or the keys that were made of this log.

    Raises:
        InputError: it is the key of another pair, by the fingerprint that the log names.
    """
    if isinstance(key, SessionKeys):
        codes, foreign = SessionCodes(key.codes), False
        same = wire.session_digest(opening.request) == codes.digest
        opens = same and opening.request.code == key.open_code
    else:
        preshared = PresharedKey(key)
        codes = preshared.session(wire.session_digest(opening.request))
        opens = preshared.open_authentic(opening.request)
        foreign = opening.fingerprint not in (None, preshared.fingerprint)
    answers = opening.tag == codes.tag and codes.authentic(opening.answer, opening.sequence)
    if foreign and not (opens or answers):
        remedy = "name that key's file, or the keys that were made of this log with it"
        raise InputError(
            "--key",
            "fingerprint",
            preshared.fingerprint,
            f"{opening.fingerprint}, as the log names it",
            remedy,
        )
    rules = (
        (opens, f"OPEN: {NOT_OURS}"),
        (answers, f"OPENED: {NOT_OURS}"),
        (opening.named == codes.digest, "it names another session than its OPEN opens"),
        (not foreign, "it names another key by its fingerprint"),
    )
    wrong = tuple(f"{AuditSession.TOPIC}: {what}" for holds, what in rules if not holds)
    known = opens or answers or isinstance(key, SessionKeys)
    return Judged(codes if known else None, opens, answers, wrong)
