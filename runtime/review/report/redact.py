"""A page that can be shown to others: what names a person, a bone, a place or a session is left out.

What a log says of these is looked up once, and left out wherever it stands, in sentences too. Digests of files and
records are kept: nothing can be made of one, and whoever holds the file can show by it that it is the one. The digest
of a session is its name, and is left out; so are what was sent in its bytes, and what a process was called with.
"""

import html
import re
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import PurePath
from typing import Any, Final

from cutgate.config.load import DEFAULT_LIMIT
from cutgate.config.screen import printable
from cutgate.runtime.audit import names as attachments
from cutgate.runtime.audit.container.stored import StoredAttachment
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.records import (
    AuditDecision,
    AuditOpen,
    AuditOperator,
    AuditPermit,
    AuditProcess,
    AuditSession,
    AuditWitness,
)

LEFT_OUT: Final = "(left out)"
NAMES_MAX: Final = 300
"""Names that a log may have; a session has some thirty. Of a log with more every text is left out."""
NAME_MAX: Final = 4000
"""Characters of one name."""
_WHOLE: Final = 8
"""Characters from which a name is left out inside a longer word as well."""
_TAG: Final = 8
"""Digits of a session's or a log's name that file names and frames carry."""
_NAMED: Final[dict[str, tuple[str, ...]]] = {
    AuditOpen.TOPIC: (
        "log_id",
        "candump",
        "previous_log",
        "previous_note",
        "account",
        "host",
        "operator",
        "series",
    ),
    AuditSession.TOPIC: ("session", "open", "opened", "key_fingerprint"),
    AuditDecision.TOPIC: ("session",),
    AuditPermit.TOPIC: ("nonce", "record", "code"),
    AuditWitness.TOPIC: ("log_id", "log"),
    AuditOperator.TOPIC: ("reason",),
    AuditProcess.TOPIC: ("argv",),
}
"""Fields of records whose whole value is a name."""
_DROPPED: Final = frozenset({"candump", "argv", "nonce", "session", "document"})
"""Fields of a document that are left out by their names, whatever they hold. ``document``: what is shown of it is apart."""
_FILE_KEYS: Final = frozenset(
    {"id", "ct_id", "name", "operator", "patient", "comment", "description", "source"}
)
"""Keys of a plan or registration whose text names something."""
_FILES: Final = frozenset({attachments.PLAN, attachments.REGISTRATION, attachments.REGISTRATION_SOURCE})
_NUMBER: Final = re.compile(r"[-+.\d]*")
_COMMON: Final = frozenset(
    {
        attachments.ROBOT,
        attachments.SITE,
        "robot",
        "site",
        "plan",
        "registration",
        "cli",
        "cli.py",
        "run",
        "site.key",
        "key",
        "logs",
    }
)
"""Names of files, and parts of them, that name nobody."""
_FIELD: Final = re.compile(r"[a-z][a-z0-9_]{0,40}")
_TEXT: Final = re.compile(r"(?<=>)[^<>]+(?=<)")
"""Text between two elements: what is escaped holds neither of these signs."""
_ACCOUNT: Final = re.compile(r"(.*) \(uid \d+\)", re.DOTALL)
_DEPTH: Final = 40


class Redaction:
    """What of a log is left out.

    Args:
        names: what names somebody or something.
    """

    def __init__(self, names: frozenset[str]) -> None:
        self._names = names
        shown = {
            form
            for name in names
            for form in (name, printable(name), html.escape(printable(name)))
            if any(map(str.isalnum, form))
        }
        known = sorted(shown, key=lambda name: (-len(name), name))
        self._everything = len(names) > NAMES_MAX
        patterns = (
            re.escape(name) if len(name) >= _WHOLE else rf"(?<![0-9A-Za-z]){re.escape(name)}(?![0-9A-Za-z])"
            for name in known
        )
        self._pattern = re.compile("|".join(() if self._everything else patterns) or r"(?!)", re.IGNORECASE)

    @classmethod
    def of(cls, log: Log, *paths: str) -> "Redaction":
        """Everything in a log that is a name.

        Args:
            log: as read; its file is open.
            paths: of the log and what lies beside it.
        """
        found: set[str] = set()
        for name in chain(_recorded(log), _attached(log), chain.from_iterable(map(_file_names, paths))):
            if name not in _COMMON:
                found.add(name[:NAME_MAX])
            if len(found) > NAMES_MAX:  # of more, nothing is told apart
                break
        return cls(frozenset(found))

    def __or__(self, other: "Redaction") -> "Redaction":
        """What either leaves out."""
        return Redaction(self._names | other._names)

    def page(self, text: str) -> str:
        """HTML whose elements are as they were, and whose text is without the names.

        Args:
            text: HTML in which each text is escaped.
        """
        return _TEXT.sub(lambda found: self.text(found[0]) if found[0].strip() else found[0], text)

    def text(self, text: str) -> str:
        """A text without the names."""
        return LEFT_OUT if self._everything else self._pattern.sub(LEFT_OUT, text)

    def apply(self, document: Any) -> Any:
        """A document without the names, and without what is left out as a whole.

        Args:
            document: of dicts, lists, text and numbers; it is not changed.
        """
        return self._without(document, 0)

    def _without(self, value: Any, depth: int) -> Any:
        if isinstance(value, str):
            return self.text(value)
        if depth >= _DEPTH:
            return None
        if isinstance(value, Mapping):
            return {self._key(key): self._entry(key, inner, depth) for key, inner in value.items()}
        if isinstance(value, list | tuple):
            return [self._without(one, depth + 1) for one in value]
        return value

    def _key(self, key: object) -> object:
        """A field's name stays what it is, even if somebody is called so."""
        return key if not isinstance(key, str) or _FIELD.fullmatch(key) else self.text(key)

    def _entry(self, key: object, inner: Any, depth: int) -> Any:
        if key in _DROPPED and isinstance(inner, str | list | tuple):
            return LEFT_OUT if isinstance(inner, str) else []
        return self._without(inner, depth + 1)


def _recorded(log: Log) -> Iterator[str]:
    """The names in the records."""
    for topic, keys in _NAMED.items():
        for record in log.one_by_one(topic):
            for key in keys:
                yield from _names_of(record.get(key), key)
    for given in log.one_by_one(AuditOperator.TOPIC):
        if given.get("accepted") is not True:  # what was taken is a name of the program's
            yield from _names_of(given.get("what"), "what")
    for opened in log.one_by_one(AuditOpen.TOPIC):
        options = opened.get("simulation")
        for option in options if isinstance(options, list) else ():
            if isinstance(option, dict) and option.get("name") == "bus":
                yield from _names_of(option.get("value"), "bus")


def _names_of(value: object, key: str) -> Iterator[str]:
    if isinstance(value, list):
        for one in value:
            if isinstance(one, str) and ("/" in one or "." in one) and not _NUMBER.fullmatch(one):
                yield from _file_names(one.partition("=")[2] if one.startswith("-") else one)
        return
    if not isinstance(value, str) or not value:
        return
    yield value
    if key in ("session", "log_id"):
        yield value[:_TAG]
    if key == "account" and (found := _ACCOUNT.fullmatch(value)):
        yield found[1]
    if key in ("candump", "previous_log", "log", "bus"):
        yield from _file_names(value)


def _file_names(path: str) -> Iterator[str]:
    """A path, its folder, the file's name and what stands before its endings."""
    pure = PurePath(path)
    yield path
    yield pure.name
    yield pure.stem
    yield pure.name.split(".")[0]
    if len(pure.parts) > 1 and str(pure.parent) != "/":
        yield str(pure.parent)


def _attached(log: Log) -> Iterator[str]:
    """The names in plan and registration."""
    for entry in log.scan.attachments:
        if PurePath(entry.name).stem in _FILES:
            yield from _in_file(_document(entry), 0)


def _document(entry: StoredAttachment) -> Any:
    return parse_object(entry.data) if entry.size <= DEFAULT_LIMIT else None


def _in_file(value: Any, depth: int) -> Iterator[str]:
    if depth >= _DEPTH:
        return
    if isinstance(value, dict):
        for key, inner in value.items():
            if key in _FILE_KEYS and isinstance(inner, str):
                yield inner
            elif isinstance(inner, dict | list):
                yield from _in_file(inner, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            if isinstance(inner, dict):
                yield from _in_file(inner, depth + 1)
