"""The rule on the trees that permits and starts name.

    roots = Roots()
    roots.log_id = what record 0 names
    for record in the log, in its order:
        roots.take(topic, covered, data)
    roots.wrong  # empty where the rule is kept

What is sent names the log itself, and size and root of its tree as its authorising record became durable. So the size covers the record
that authorised it and none behind its own; the root is the one that the tree had at that size. A record is authorised
once, sent or withheld once, and one at a time; between the two the roots are remembered, ``ROOTS_MAX`` at most.
"""

from typing import Final, NamedTuple

from pydantic import ValidationError

from cutgate.protocol import records as wire
from cutgate.runtime.audit.records import AuditPermit
from cutgate.runtime.audit.signed import signed
from cutgate.runtime.audit.tree import Tree

_PERMIT: Final = AuditPermit.TOPIC
"""Looked up once: an attribute of a model's class takes its time, and this is asked of every record."""
ROOTS_MAX: Final = 1 << 16
"""Records from one that authorises to what is sent: over three seconds of the busiest bus, a commit has one second."""


class _Authorised(NamedTuple):
    """A record that authorises, and the trees since."""

    kind: str
    token: int | None
    number: int
    roots: list[bytes]
    """The first is that of the tree with this record as its last."""


class Roots:
    """The tree, one record after the other, and what permits, starts and resets say of it.

    Attributes:
        log_id: of the log, as its record 0 has it in hex; whatever stands there instead, or None, names none.
        tree: of all records so far.
        wrong: the first record that names another tree, and what it should have named; empty if none does.
    """

    def __init__(self) -> None:
        self.log_id: object = None
        self.tree = Tree()
        self.wrong = ""
        self._authorised: _Authorised | None = None
        """What has been neither sent nor withheld yet."""

    def take(self, topic: str, covered: bytes, data: bytes) -> None:
        """The next record: its topic, the bytes that the tree covers of it, and its JSON."""
        if topic == _PERMIT:
            told = self._permit(data)
            if told and not self.wrong:
                self.wrong = f"record {self.tree.size} ({topic}): {told}"
        self.tree.append(covered)
        if self._authorised is not None and len(self._authorised.roots) < ROOTS_MAX:
            self._authorised.roots.append(self.tree.root)

    def _permit(self, data: bytes) -> str:
        """What is wrong with this record; empty if nothing is."""
        try:
            record = AuditPermit.model_validate_json(data)
        except ValidationError as error:
            return f"it cannot be read: {error.errors()[0]['msg']}"
        told = ""
        if record.stage == "authorised":
            self._authorised = _Authorised(record.kind, record.token, self.tree.size, [])
        elif record.stage in ("sent", "withheld"):
            # Before version 4 of the protocol nothing names a tree.
            names = (record.log_size, record.log_root) != (None, None)
            told = (self._tree(record) or self._log(record)) if names and record.stage == "sent" else ""
            self._authorised = None
        return told

    def _tree(self, record: AuditPermit) -> str:
        """What is wrong with the tree that it names; empty if nothing is."""
        size, root, authorised = record.log_size, record.log_root, self._authorised
        if size is None or root is None:
            return "of the tree's size and root it names one alone"
        if authorised is None or (authorised.kind, authorised.token) != (record.kind, record.token):
            return f"it names a tree of size {size}, and no {record.kind} is authorised"
        first = authorised.number + 1
        if not first <= size <= self.tree.size:
            return (
                f"it names a tree of size {size}, must be {first} to {self.tree.size}: "
                f"with record {authorised.number}, which authorised it, and without its own"
            )
        if not size - first < len(authorised.roots):
            return (
                f"it names a tree of size {size}, over {ROOTS_MAX} records behind record {authorised.number}"
            )
        found = authorised.roots[size - first].hex()
        if found != root:
            return f"it names the root {root} at size {size}, the tree has {found} there"
        return ""

    def _log(self, record: AuditPermit) -> str:
        """What is wrong with the log that was signed; empty if it is this one."""
        try:
            read = signed(wire.Start, record) if record.kind == "start" else signed(wire.Permit, record)
        except ValueError as error:
            return f"what was signed cannot be read: {error}"
        named = read.log.log_id.hex()
        return "" if named == self.log_id else f"it names the log {named}, this one is {self.log_id}"
