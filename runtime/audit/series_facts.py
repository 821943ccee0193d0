"""What the logs of a folder say of themselves and of each other, and the order in which that puts them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.signing.log_key import PublicLogKey

SESSIONS_MAX: Final = 10_000
"""Logs and stubs of one folder: years of an operating room. More are refused before one is read."""


@dataclass(frozen=True, slots=True)
class PreviousNamed:
    """What record 0 says of the session before; ``head`` and ``root`` in hex, None where it does not say."""

    log: str | None = None
    head: str | None = None
    size: int | None = None
    root: str | None = None
    epoch: int | None = None
    crashed: bool = False
    note: str | None = None


@dataclass(frozen=True, slots=True)
class WitnessNamed:
    """The tree that a controller saw last, as it told a session; ``found``: that session found it in its directory."""

    log_id: str
    size: int
    root: str
    found: bool


@dataclass(frozen=True, slots=True)
class FolderSession:
    """What a log, or the stub of one that was archived, says of itself.

    Attributes:
        file: its name.
        log_id: hex; empty where the file ends before record 0.
        status: what the log is judged to be, by itself.
        closed: it was closed in order.
        size, root, head: of everything in it; ``root`` None where it is not known.
        opened_ns, last_ns: UTC of the first and the last record.
        key: of its record 0; None in a log of the older form, which is not signed.
        enrolled: why its key has no certificate; None where it has one.
        previous: the session before.
        trees: size and root of the trees that its starts name, and of its last checkpoint.
        starts: a start was authorised in it.
        witnesses: what a controller told.
        anchors: roots and heads, in hex, that somebody asked for and that stand in it.
        archived: it is a stub.
        signed: records that are signed; not known of a stub.
        recovered_from: the crashed log that it is a copy of, as far as that was whole.
    """

    file: str
    log_id: str
    status: Status
    closed: bool
    size: int
    root: str | None
    head: str
    opened_ns: int
    last_ns: int
    key: PublicLogKey | None = None
    enrolled: str | None = None
    previous: PreviousNamed = PreviousNamed()
    trees: frozenset[tuple[int, str]] = frozenset()
    starts: bool = False
    witnesses: tuple[WitnessNamed, ...] = ()
    anchors: frozenset[str] = frozenset()
    archived: bool = False
    recovered_from: str | None = None
    signed: int = 0

    @property
    def epoch(self) -> int | None:
        """Of its key; None in a log of the older form."""
        return None if self.key is None else self.key.epoch


@dataclass(frozen=True, slots=True)
class HeadNamed:
    """What HEAD says of the last session; ``size``, ``root`` and ``head`` count where that was closed."""

    log: str
    closed: bool
    head: str | None = None
    series: str | None = None
    epoch: int | None = None
    size: int | None = None
    root: str | None = None


@dataclass(frozen=True)
class Folder:
    """All that a folder says, and its sessions in their order.

    Attributes:
        sessions: logs and stubs, in any order.
        head: None where there is none.
        pinned: the key that is trusted; None for the logs' own.
        running: a session holds the lock.
        anchors: roots and heads, in hex, that somebody kept elsewhere.
    """

    sessions: Sequence[FolderSession]
    head: HeadNamed | None
    pinned: PublicLogKey | None = None
    running: bool = False
    anchors: Sequence[str] = ()

    @cached_property
    def files(self) -> dict[str, FolderSession]:
        """By file name."""
        return {one.file: one for one in self.sessions}

    @cached_property
    def named(self) -> set[str]:
        """Files that a session or HEAD names as the last one before it."""
        names = {one.previous.log for one in self.sessions if one.previous.log is not None}
        return names | ({self.head.log} if self.head else set())

    @cached_property
    def logs(self) -> tuple[FolderSession, ...]:
        """Those that begin as a log does, recovered copies beside their originals apart."""
        return tuple(
            one
            for one in self.sessions
            if one.log_id and one.status is not Status.UNREADABLE and not self._copies(one)
        )

    @cached_property
    def blank(self) -> dict[str, FolderSession]:
        """Sessions that were cut before record 0: they have no place in the order."""
        return {
            one.file: one for one in self.sessions if not one.log_id and one.status is not Status.UNREADABLE
        }

    @cached_property
    def no_logs(self) -> dict[str, FolderSession]:
        """Files that are no logs of ours, whatever their names."""
        return {one.file: one for one in self.sessions if one.status is Status.UNREADABLE}

    def _copies(self, one: FolderSession) -> bool:
        """Whether it is the recovered copy of a log that is here too, and as that was recorded."""
        original = None if one.recovered_from is None else self.files.get(one.recovered_from)
        return (
            original is not None
            and original.recovered_from is None
            and (original.log_id, original.head) == (one.log_id, one.head)
        )

    @cached_property
    def copies(self) -> tuple[FolderSession, ...]:
        """Recovered copies, whose originals count."""
        return tuple(one for one in self.sessions if self._copies(one))

    @cached_property
    def series(self) -> bytes | None:
        """Of the sessions that belong here: the pinned key's, else that of most logs, of equally many the oldest's."""
        if self.pinned is not None:
            return self.pinned.series
        counts: dict[bytes, tuple[int, int]] = {}
        for one in self.logs:
            if one.key is not None:
                count, oldest_ns = counts.get(one.key.series, (0, one.opened_ns))
                counts[one.key.series] = count + 1, min(oldest_ns, one.opened_ns)
        return max(counts, key=lambda series: (counts[series][0], -counts[series][1]), default=None)

    @cached_property
    def foreign(self) -> tuple[FolderSession, ...]:
        """Those of another series."""
        return tuple(one for one in self.logs if one.key is not None and one.key.series != self.series)

    @cached_property
    def doubles(self) -> dict[str, FolderSession]:
        """By file name: whose place this one takes a second time."""
        found: dict[str, FolderSession] = {}
        places: dict[object, FolderSession] = {}
        for one in sorted(self._own, key=lambda one: (one.file not in self.named, one.file)):
            for place in (one.log_id, *([one.epoch] if one.epoch is not None else [])):
                first = places.setdefault(place, one)
                if first is not one:
                    found[one.file] = first
        return found

    @cached_property
    def _own(self) -> tuple[FolderSession, ...]:
        return tuple(one for one in self.logs if one.key is None or one.key.series == self.series)

    @cached_property
    def signed(self) -> tuple[FolderSession, ...]:
        """Those of the series, by their epochs, each epoch once."""
        own = (one for one in self._own if one.key is not None and one.file not in self.doubles)
        return tuple(sorted(own, key=lambda one: (one.epoch or 0, one.opened_ns)))

    @cached_property
    def old(self) -> tuple[FolderSession, ...]:
        """Those of the older form: as each names the one before it, the last one being named by what followed."""
        left = {one.file: one for one in self._own if one.key is None and one.file not in self.doubles}
        last = self.signed[0].previous.log if self.signed else self.head.log if self.head else None
        by_time = sorted(left.values(), key=lambda one: (one.opened_ns, one.file))
        runs = []
        for start in [*([left[last]] if last in left else []), *reversed(by_time)]:
            run, at = [], left.pop(start.file, None)
            while at is not None:
                run.append(at)
                at = left.pop(at.previous.log, None) if at.previous.log is not None else None
            runs.append(run[::-1])
        return tuple(one for run in reversed(runs) for one in run)

    @cached_property
    def ordered(self) -> tuple[FolderSession, ...]:
        """All that have a place: the older form first, then by epochs."""
        return self.old + self.signed

    @cached_property
    def ids(self) -> dict[str, FolderSession]:
        """By log id; of two the one that has the place."""
        return {one.log_id: one for one in (*self.logs, *self.ordered)}
