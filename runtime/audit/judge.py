"""The rules over the records of a log, one record after the other, and over what they say of the file.

    judge = Judge()
    for message in walk(file, found):
        judge.take(message)
    problems = [*judge.problems, *judge.content(found)]

Record 0 opens the log and nothing follows its one close record, which counts all of them. Each record is a JSON object
whose sequence is its number, and each ``/audit/`` record carries the chain's head before it. Every record of an
attachment has its attachment, and in a closed file the other way round as well. The metadata name the log of record 0,
and of a recovered copy what it was made of (``recovered.py``). A permit or start that names a log and its tree names this
one, and the tree as it was (``roots.py``). Of a log that names a key, every chunk is signed (``signing/signatures.py``).
"""

import json
import re
from collections.abc import Iterable, Iterator
from typing import Any, Final

from cutgate.runtime.audit.chain import GENESIS, LINKED, follow
from cutgate.runtime.audit.container.stored import Scan, Stored
from cutgate.runtime.audit.records import STREAMED, AuditAttachment, AuditClose, AuditOpen
from cutgate.runtime.audit.recovered import RECOVERED, is_copy, told_by
from cutgate.runtime.audit.roots import Roots
from cutgate.runtime.audit.signing.signatures import Signatures
from cutgate.runtime.audit.writer import ENCODING, METADATA

KEPT_MAX: Final = 1_000_000
"""Records whose place is kept, of topics that are not streamed; a session has thousands."""


class Judge:
    """The rules over the records, one record after the other.

    Attributes:
        head: the chain's head over all records so far.
        count: records so far.
        first: parsed record 0; None where it is no JSON object, or none.
        places: topic, offset and size of each record whose topic is not streamed.
        streamed: topics that are, of which there are records.
        problems: the first record whose place in the chain is wrong.
        anchors: those of the ``anchors`` asked for that were found, with the number of the last record they cover.
        signatures: the rule on what is signed.
        roots: the tree of all records so far, and the first record that names another.
    """

    def __init__(self, anchors: Iterable[bytes] = ()) -> None:
        self.anchors: dict[bytes, int] = {}
        self._sought = frozenset(anchors)
        self.unlinked = False
        """What is wrong first is a link of the chain."""
        self.signatures = Signatures()
        self.head = GENESIS
        self.count = 0
        self.first: dict[str, Any] | None = None
        self._last = b""
        self.last_topic = ""
        self.places: list[tuple[str, int, int]] = []
        self.streamed: set[str] = set()
        self.problems: list[str] = []
        self.roots = Roots()
        self._first_topic: str | None = None
        self._opens = 0
        self._closes = 0
        self._counted: list[Any] = []
        """What the first close record counts, if there is one."""
        self._after_close: tuple[int, str] | None = None
        self._attached: list[tuple[Any, ...]] = []
        self._too_many = False

    def take(self, message: Stored) -> None:
        """The next record."""
        number, topic, data = self.count, message.topic, message.data
        # Of what is streamed behind record 0 nothing is asked but that it is an object, and nearly all records are.
        plain = number and topic in STREAMED and _PLAIN.fullmatch(data)
        record = {} if plain else parse_object(data)
        if not self.problems:
            self._follows(number, message, record)
        if number == 0:
            self.first, self._first_topic = record, topic
            self.roots.log_id = (record or {}).get("log_id")
        self.signatures.take(number, topic, record or {}, self.roots.tree)
        covered = message.covered
        self.head = follow(self.head, covered)
        self.roots.take(topic, covered, data)
        if self._sought:
            found = self._sought & {self.head, self.roots.tree.root}
            self.anchors |= dict.fromkeys(found - self.anchors.keys(), number)
        self.count += 1
        self._last, self.last_topic = data, topic
        if self._closes == 1 and self._after_close is None:
            self._after_close = (number, topic)
        if topic in STREAMED:
            self.streamed.add(topic)
        else:
            self._keep(message, record)

    @property
    def last(self) -> dict[str, Any] | None:
        """The last record so far; None where it is no JSON object, or there is none."""
        return parse_object(self._last)

    def _follows(self, number: int, message: Stored, record: dict[str, Any] | None) -> None:
        if record is None:
            told = "it is not a JSON object"
        elif message.sequence != number:
            told = f"its sequence is {message.sequence}"
        elif message.channel.encoding != ENCODING:
            told = f"its encoding is not {ENCODING}"
        elif message.topic.startswith(LINKED) and record.get("prev") != self.head.hex():
            self.unlinked = True
            told = "it does not follow from the records before it"
        else:
            return
        self.problems.append(f"record {number} ({message.topic}): {told}")

    def _keep(self, message: Stored, record: dict[str, Any] | None) -> None:
        topic = message.topic
        if not len(self.places) < KEPT_MAX:
            self._too_many = True
            return
        self.places.append((topic, message.offset, len(message.data)))
        if topic == AuditOpen.TOPIC:
            self._opens += 1
        elif topic == AuditClose.TOPIC:
            self._closes += 1
            if self._closes == 1:
                self._counted.append((record or {}).get("message_count"))
        elif topic == AuditAttachment.TOPIC:
            self._attached.append(
                tuple((record or {}).get(key) for key in ("name", "media_type", "sha256", "size"))
            )

    def content(self, found: Scan) -> Iterator[str]:
        """What the records say of the file and what the file holds, side by side."""
        if self._first_topic not in (None, AuditOpen.TOPIC):
            yield f"record 0 is {self._first_topic}, must be {AuditOpen.TOPIC}"
        for topic, times in ((AuditOpen.TOPIC, self._opens), (AuditClose.TOPIC, self._closes)):
            if times > 1:
                yield f"{topic} is there {times} times"
        for count in self._counted:
            if self._after_close is not None:
                number, topic = self._after_close
                yield f"record {number} ({topic}) stands after the close record"
            elif count != self.count:
                yield f"the close record counts {count} messages, the file holds {self.count}"
        if self._too_many:
            yield f"it holds over {KEPT_MAX} records that are not streamed; no session writes so many"
        yield from self._attachments(found)
        if self.count:
            yield from self._metadata(found)

    def _metadata(self, found: Scan) -> Iterator[str]:
        """Those of the log of record 0; and, of a recovered copy, what it says of itself."""
        names = [entry.name for entry in found.metadata]
        if names not in ([METADATA], [METADATA, RECOVERED]) or found.metadata[0].metadata.get("log_id") != (
            self.first or {}
        ).get("log_id"):
            yield "the file's metadata are not those of record 0"
        try:
            told = told_by(found.metadata)
        except ValueError as error:
            yield f"the metadata {RECOVERED} are none that a recovery writes: {error}"
            return
        if told is not None and found.finished and told.records != self.count:
            yield f"its recovery has kept {told.records} records, the file holds {self.count}"

    def _attachments(self, found: Scan) -> Iterator[str]:
        """Every record of an attachment has its attachment; in a closed file the other way round as well.

        What a crash has left may end between the two: the attachment is written first.
        """
        recorded = self._attached
        stored = [(entry.name, entry.media_type, entry.sha256, entry.size) for entry in found.attachments]
        for number, entry in enumerate(stored[: len(recorded)]):
            if recorded[number] != entry:
                yield f"attachment {number} ({entry[0]}) is not what its record says"
        if len(recorded) > len(stored):
            yield f"attachment {recorded[len(stored)][0]} has a record but is not there"
        if found.finished and not is_copy(found.metadata) and len(stored) > len(recorded):
            yield f"attachment {stored[len(recorded)][0]} has no record"


def missing(found: Scan, judge: Judge) -> list[str]:
    """What a log lacks at its end, after a crash or a loss of power; of a recovered copy, that it is one."""
    lacks = _copied(found)
    if not found.finished:
        lacks.append(
            f"the file ends early: record {judge.count - 1} is the last whole one"
            if judge.count
            else "the file ends before its first record"
        )
    if found.zeros:
        lacks.append("it ends in zeros, as a file system leaves it after a loss of power")
    if judge.last_topic != AuditClose.TOPIC:
        lacks.append("there is no close record: the session did not end in order")
    return lacks


def _copied(found: Scan) -> list[str]:
    """That it is a recovered copy, if it is: what it was made of had been cut, whatever the copy holds."""
    try:
        told = told_by(found.metadata)
    except ValueError:
        return ["it is a recovered copy that does not say of what"]
    return [] if told is None else [str(told)]


def _refuse(text: str) -> Any:
    raise ValueError(text)


_JSON: Final = json.JSONDecoder(parse_constant=_refuse)
"""NaN and infinity are not JSON."""


_TEXT: Final = rb'"[ !#-\[\]-~]*+"'
"""Printable ASCII without an escape."""
_SCALAR: Final = rb"[1-9][0-9]{0,17}+|0|true|false|" + _TEXT
_FLAT: Final = rb"\{%b:(?:%b)(?:,%b:(?:%b))*+\}" % (_TEXT, _SCALAR, _TEXT, _SCALAR)
_VALUE: Final = _SCALAR + b"|" + _FLAT
_PLAIN: Final = re.compile(rb"\{%b:(?:%b)(?:,%b:(?:%b))*+\}" % (_TEXT, _VALUE, _TEXT, _VALUE))
"""Some of the JSON objects, those of frames among them: what fits is one, in a third of the time of parsing it.

What does not fit is parsed. Nothing is tried twice, so the time grows with the length alone.
"""


def parse_object(data: bytes) -> dict[str, Any] | None:
    """The JSON object, or None."""
    try:
        content = _JSON.decode(data.decode("utf-8", "surrogatepass"))
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None
