"""A start and the checkpoint that it names, looked for in the chunks that a log's index says may hold them.

The record that authorises a start stands in one chunk with the checkpoint that signs the log's tree up to there: that
is the tree which the start names. So it is looked for where records of permits are, and nowhere else. What is found is
what the log's key has signed: that the records before it are those of that tree is for ``audit verify`` to say.
"""

from collections.abc import Callable, Iterator
from typing import BinaryIO, Final

from cutgate.runtime.audit.container.chunk import Chunk, Definitions
from cutgate.runtime.audit.container.places import ChunkPlace, by_hops, by_index, chunk_at, cut_in_zeros
from cutgate.runtime.audit.container.raw import BrokenError, Budget
from cutgate.runtime.audit.container.stored import Stored
from cutgate.runtime.audit.judge import parse_object
from cutgate.runtime.audit.records import AuditCheckpoint, AuditPermit
from cutgate.runtime.audit.signing import note
from cutgate.runtime.audit.signing.checkpoint import Checkpoint, origin_of
from cutgate.runtime.audit.signing.log_key import PublicLogKey
from cutgate.runtime.audit.signing.note import NoteError, VerifierKey

CUT_OFF: Final = "it ends with the record that authorised the start; that it was sent is not in it"
READ_MAX: Final = 256
"""Chunks of one log that are read; a session has a few decisions on permits, and some twenty topics."""


class SoughtStart:
    """The start with this tree, in the log of this id and key.

    Args:
        key: of the log, which is trusted.
        log_id: hex.
        size: records in the tree that the start names.
        root: of it, 32 bytes.
    """

    def __init__(self, key: PublicLogKey, log_id: str, size: int, root: bytes) -> None:
        self._origin = origin_of(log_id)
        self._key = VerifierKey(self._origin, key.public)
        self._size, self._root = size, root
        self._sent = {"kind": "start", "stage": "sent", "log_size": size, "log_root": root.hex()}
        self._signed = self._authorised = False
        self._wrong = ""

    def look(self, file: BinaryIO) -> str:
        """What this log lacks; empty if nothing, ``CUT_OFF`` where it ends before it says that the start left.

        Raises:
            OSError: it cannot be read.
        """
        for places in (by_index, by_hops):  # an index may be wrong, or gone with the end of the file
            self._signed = self._authorised = False
            self._wrong = ""
            try:
                if any(self._holds(chunk) for chunk in _of_permits(file, places)):
                    return ""
                whole = places is by_index or _has_index(file)
            except BrokenError as broken:
                self._wrong, whole = self._wrong or str(broken), True
        if self._signed and self._authorised and not whole:
            return CUT_OFF
        return self._wrong or (
            f"it holds no start that was sent with its tree of size {self._size}"
            if self._signed
            else f"no checkpoint of {self._size} records, which the controller saw, is in it"
        )

    def _holds(self, chunk: Chunk) -> bool:
        """Whether the start that was sent is in this chunk, and the chunk is signed."""
        found = False
        for message in chunk.messages:
            record = parse_object(message.data) or {}
            if message.topic == AuditCheckpoint.TOPIC and message.sequence == self._size:
                self._signed = self._is_signed(record)
            elif message.topic == AuditPermit.TOPIC:
                found = found or (self._signed and {key: record.get(key) for key in self._sent} == self._sent)
                stage = (record.get("kind"), record.get("stage"))
                self._authorised = message.sequence < self._size and stage == ("start", "authorised")
        return found and self._ends_signed(chunk.messages[-1])

    def _is_signed(self, record: dict[str, object]) -> bool:
        """Whether this checkpoint is the one that the start names."""
        try:
            named = self._named(record)
        except NoteError as error:
            self._wrong = f"its checkpoint of {self._size} records is not signed by its key: {error}"
            return False
        if (named.size, named.hash) != (self._size, self._root):
            self._wrong = (
                f"its tree has the root {named.hash.hex()} at size {named.size}, not {self._root.hex()}"
            )
            return False
        return True

    def _ends_signed(self, last: Stored) -> bool:
        """Whether a chunk ends in a checkpoint of all before it."""
        try:
            if (
                last.topic == AuditCheckpoint.TOPIC
                and self._named(parse_object(last.data) or {}).size == last.sequence
            ):
                return True
            told = "it ends in no checkpoint of all before it"
        except NoteError as error:
            told = str(error)
        self._wrong = f"the record that the start was sent is not signed: {told}"
        return False

    def _named(self, record: dict[str, object]) -> Checkpoint:
        text = record.get("note")
        signed = note.verify(text if isinstance(text, str) else "", self._key)
        return Checkpoint.parse(signed, self._origin)


def _of_permits(file: BinaryIO, places: Callable[[BinaryIO], Iterator[ChunkPlace]]) -> Iterator[Chunk]:
    """The chunks with records of permits, in file order; and those with a channel's first record, which defines it.

    Raises:
        BrokenError: a rule is broken, or there are more than any session writes.
    """
    definitions = Definitions(Budget())
    read = 0
    for place in places(file):
        known = definitions.channels
        wanted = place.channels is None or any(
            channel not in known or known[channel].topic == AuditPermit.TOPIC for channel in place.channels
        )
        if not wanted:
            continue
        read += 1
        if not read <= READ_MAX:
            raise BrokenError(f"over {READ_MAX} of its chunks hold permits; no session writes so many")
        try:
            chunk = chunk_at(file, place.offset, definitions)
        except BrokenError:
            if place.channels is None and cut_in_zeros(file, place.offset):
                return
            raise
        yield chunk


def _has_index(file: BinaryIO) -> bool:
    """Whether the file was finished."""
    try:
        next(by_index(file), None)
    except BrokenError:
        return False
    return True
