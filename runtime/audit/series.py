"""A folder of logs is a chain too: whether its sessions follow on one another, and what is missing, doubled or foreign.

    found = examine(sessions, head, pinned=key)
    found.status, found.findings, found.joined

Each session names the one before it, its key is certified by that one's, its epoch is the next; ``HEAD`` names the last
one, and a controller those that have moved an arm. So each is named from two sides, and whoever takes one away, puts
another in its place or puts back an old state contradicts one of them. What each rule makes of the whole folder, and
what is to be done then, stands in ``RULES``. What a single log says of itself is judged elsewhere.

Nothing is read here, and time grows with the number of sessions.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from typing import Final, NamedTuple

from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.series_facts import Folder, FolderSession, HeadNamed, WitnessNamed
from cutgate.runtime.audit.series_rules import SeriesFinding, worst
from cutgate.runtime.audit.signing.log_key import FIRST_EPOCH

NAME_OF_HEAD: Final = "HEAD"
_NAMED_MAX: Final = 5
"""File names in one sentence."""


@dataclass(frozen=True, slots=True)
class Joined:
    """A session in its place, and in words how it follows on the one before; ``placed``: it has a place."""

    session: FolderSession
    how: str
    placed: bool = False


@dataclass(frozen=True, slots=True)
class SeriesFound:
    """What a folder is.

    Attributes:
        status: of all together: the worst of its sessions and findings.
        joined: the sessions in their order; behind them what has no place among them.
        findings: in the order of ``FINDERS``.
        key: which key vouches, in words.
        witness: what controllers saw, in words.
        anchor: what became of the anchors, in words.
    """

    status: Status
    joined: tuple[Joined, ...]
    findings: tuple[SeriesFinding, ...]
    key: str
    witness: str
    anchor: str


# ---------------------------------------------------------------- one session and the one before it


class _Link(NamedTuple):
    """What a session says of the one before it, against what that is."""

    what: str
    named: object
    found: object


def _links(before: FolderSession, one: FolderSession) -> Iterator[_Link]:
    """What can be compared; between two that are signed all of it must be there."""
    previous = one.previous
    links = (
        _Link("size", previous.size, before.size),
        _Link("root", previous.root, before.root),
        _Link("head", previous.head, before.head),
        _Link("epoch", previous.epoch, before.epoch),
    )
    for link in links:
        both = before.key is not None and one.key is not None
        if link.found is not None and (both or link.named is not None):
            yield link


def _pair(folder: Folder, before: FolderSession, one: FolderSession) -> Iterator[SeriesFinding]:
    """What is wrong between two sessions of which one has its place behind the other."""
    missing = _between(before, one)
    if missing:
        here = "" if one.previous.log != before.file else f"; it calls {before.file} the one before it"
        yield SeriesFinding(
            "epoch-missing", one.file, missing, "not in this folder", f"between {before.file} and this{here}"
        )
        return
    yield from _named(folder, before, one)
    yield from _certified(before, one)


def _between(before: FolderSession, one: FolderSession) -> str:
    """The epochs that are missing between them; empty if none are."""
    if one.epoch is None:
        return ""
    first, last = (before.epoch or FIRST_EPOCH - 1) + 1, one.epoch - 1
    if last < first:
        return ""
    return f"the session of epoch {first}" if first == last else f"the sessions of epochs {first} to {last}"


def _named(folder: Folder, before: FolderSession, one: FolderSession) -> Iterator[SeriesFinding]:
    """What it says of the one before."""
    if one.previous.note is not None:
        yield SeriesFinding("previous-noted", one.file, "the session before", "", one.previous.note)
    other = _other(folder, before, one)
    if other is not None:
        yield other
    if other is None or other.code == "renamed":
        yield from _compared(before, one)


def _other(folder: Folder, before: FolderSession, one: FolderSession) -> SeriesFinding | None:
    """Whether it names another file than that of the one before it."""
    name, what = one.previous.log, "the session before"
    if name == before.file:
        return None
    if name is None:
        return SeriesFinding("begins-anew", one.file, what, "none", before.file)
    if name in folder.blank:
        told = f"{name}, which has no record 0; so nothing says how {before.file} was then"
        return SeriesFinding("link-unknown", one.file, what, "", told)
    if name in folder.files:
        return SeriesFinding("link-differs", one.file, what, name, before.file)
    if one.previous.head == before.head:
        bound = f"{name}, as {one.file} calls it"
        return SeriesFinding("renamed", before.file, "its name", before.file, bound)
    return SeriesFinding("log-missing", one.file, what, f"{name}, which is not here", "in this folder")


def _compared(before: FolderSession, one: FolderSession) -> Iterator[SeriesFinding]:
    """What it says of the one before, part by part."""
    for link in _links(before, one):
        if link.named != link.found:
            what, bound = f"{link.what} of {before.file}", f"{link.found}, as that log has it"
            yield SeriesFinding("link-differs", one.file, what, _told(link.named), bound)
    if before.closed and one.previous.crashed:
        bound = f"closed, as {before.file} is"
        yield SeriesFinding("closed-called-crashed", one.file, "the session before", "called crashed", bound)
    if not before.closed and not one.previous.crashed:
        bound = f"closed, as {one.file} found it"
        yield SeriesFinding("cut-off", before.file, "its end", "without a close record", bound)


def _certified(before: FolderSession, one: FolderSession) -> Iterator[SeriesFinding]:
    """Whether its key is certified by the one before."""
    if before.key is None or one.key is None or one.key.certificate is None:
        return
    if not before.key.certifies(one.key):
        bound = f"by the key of epoch {before.key.epoch}, as {before.file} has it"
        yield SeriesFinding(
            "certificate-wrong", one.file, f"the certificate of epoch {one.epoch}", "not signed", bound
        )


def _told(value: object) -> str:
    return "not given" if value is None else str(value)


# ---------------------------------------------------------------- what is found in a folder


def _sound(folder: Folder) -> Iterator[SeriesFinding]:
    """Files that are no logs, and files that cannot be read."""
    if not (folder.logs or folder.blank or folder.head):
        yield SeriesFinding("no-logs", NAME_OF_HEAD, "the folder", "", "no log of a session is in it")
    lost = [name for name in folder.no_logs if name in folder.named]
    for name in lost:
        yield SeriesFinding(
            "named-unreadable", name, "the file", "no log of cutgate", "the log that others name"
        )
    others = sorted(folder.no_logs.keys() - set(lost))
    if others:
        yield SeriesFinding(
            "not-a-log", others[0], "foreign files", "", f"no logs of cutgate: {_list(others)}"
        )
    for one in folder.blank.values():
        if one.status is Status.INCOMPLETE and not (
            folder.running and folder.head and one.file == folder.head.log
        ):
            told = "cut before record 0 was whole: a crash at the very start of a session leaves that, or somebody cut it"
            yield SeriesFinding("before-record-0", one.file, "the file", "", told)
    for one in folder.copies:
        yield SeriesFinding("recovered-copy", one.file, "a recovered copy", "", f"of {one.recovered_from}")


def _list(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED_MAX} more" if len(names) > _NAMED_MAX else ""
    return ", ".join(names[:_NAMED_MAX]) + more


def _doubled(folder: Folder) -> Iterator[SeriesFinding]:
    """Logs that take the place of another, and those of another series."""
    for name in sorted(folder.doubles):
        one, first = folder.files[name], folder.doubles[name]
        if (one.log_id, one.head) == (first.log_id, first.head):
            yield SeriesFinding("copy", name, "the log", f"a copy of {first.file}", "in the folder once")
        else:
            place = f"epoch {one.epoch}" if one.epoch == first.epoch is not None else f"log {one.log_id}"
            bound = f"one log alone; {first.file} is another"
            yield SeriesFinding("doubled", name, f"what is of {place}", "here twice", bound)
    for other in folder.foreign:
        found = other.key.series.hex() if other.key else ""
        yield SeriesFinding("foreign", other.file, "its series", found, (folder.series or b"").hex())


def _joints(folder: Folder) -> Iterator[SeriesFinding]:
    """Each session against the one before it."""
    for one in folder.ordered[:1]:
        if one.previous.log is not None or (one.epoch or FIRST_EPOCH) > FIRST_EPOCH:
            earlier = one.previous.log or f"the one of epoch {(one.epoch or FIRST_EPOCH) - 1}"
            yield SeriesFinding(
                "begins-late", one.file, "the session before", "", f"not in this folder: {earlier}"
            )
    for before, one in pairwise(folder.ordered):
        yield from _pair(folder, before, one)


def _uncertified(folder: Folder) -> Iterator[SeriesFinding]:
    """Keys that nobody certified: enrolled, or with nothing that says why."""
    first = folder.ordered[0] if folder.ordered else None
    for one in folder.signed:
        if one.key is None or one.key.certificate is not None:
            continue
        if one.enrolled is None:
            bound = f"signed by the key of epoch {one.key.epoch - 1}, or enrolled"
            yield SeriesFinding("certificate-missing", one.file, "its key's certificate", "not given", bound)
        elif one is not first:
            told = f"enrolled, not certified ({one.enrolled}): {one.key.fingerprint}"
            yield SeriesFinding("enrolled", one.file, f"the key of epoch {one.epoch}", "", told)


def _clock(folder: Folder) -> Iterator[SeriesFinding]:
    """No session runs with a clock that is behind one that was closed before."""
    latest: FolderSession | None = None
    for one in folder.ordered:
        # Until 0.1.0 no clock was held against the session before; what is signed always is.
        if one.key is not None and latest is not None and one.opened_ns < latest.last_ns:
            bound = f"at least {utc(latest.last_ns)}, when {latest.file} was closed"
            yield SeriesFinding("clock-back", one.file, "its time", utc(one.opened_ns), bound)
        if one.closed and (latest is None or one.last_ns > latest.last_ns):
            latest = one


def utc(time_ns: int) -> str:
    """A time to the millisecond; the number itself where no clock has it."""
    try:
        moment = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC)
    except (ValueError, OverflowError, OSError):
        return f"{time_ns} ns"
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{time_ns // 1_000_000 % 1000:03d}Z"


def _older(folder: Folder) -> Iterator[SeriesFinding]:
    """Logs without signatures: before the first enrolment they are of their time, after it nobody writes them."""
    begun_ns = folder.signed[0].opened_ns if folder.signed else None
    late = {one.file: one for one in folder.old if begun_ns is not None and one.opened_ns >= begun_ns}
    for one in late.values():
        bound = f"signed, as all since {folder.signed[0].file} enrolled a key"
        yield SeriesFinding("old-form-late", one.file, "the log", "unsigned, of the older form", bound)
    count = len(folder.old) - len(late)
    if count:
        first = next(one for one in folder.old if one.file not in late)
        told = f"{count} unsigned, of the older form; they are joined by their heads alone"
        yield SeriesFinding("old-form", first.file, "logs", "", told)


def _pinned(folder: Folder) -> Iterator[SeriesFinding]:
    """Whether the pinned key vouches for the keys behind it."""
    pinned, own = folder.pinned, {one.epoch: one for one in folder.signed}
    if pinned is None:
        return
    at, behind = own.get(pinned.epoch), own.get(pinned.epoch + 1)
    epochs = [one.epoch or 0 for one in folder.signed]
    place = f"the pinned key, of epoch {pinned.epoch}"
    if not epochs:
        yield SeriesFinding("key-not-reached", NAME_OF_HEAD, place, "", "no log of its series is here")
    elif at is not None and at.key is not None and at.key.public != pinned.public:
        value = f"{pinned.fingerprint}"
        yield SeriesFinding("key-differs", at.file, place, value, f"{at.key.fingerprint}, as this log has it")
    elif at is None and behind is not None and behind.key is not None and not pinned.certifies(behind.key):
        yield SeriesFinding(
            "key-differs",
            behind.file,
            place,
            "not the one that certified",
            f"the key of epoch {behind.epoch}",
        )
    elif at is None and behind is None and not epochs[0] < pinned.epoch < epochs[-1]:
        told = f"the logs here are of epochs {epochs[0]} to {epochs[-1]}, and none is certified from it on"
        yield SeriesFinding("key-not-reached", folder.signed[0].file, place, "", told)
    for one in folder.signed:
        if one.key is not None and one.key.epoch > pinned.epoch and one.key.certificate is None:
            bound = f"certified from the pinned key of epoch {pinned.epoch} on"
            yield SeriesFinding(
                "key-not-certified", one.file, f"the key of epoch {one.epoch}", "enrolled", bound
            )


def _witnessed(folder: Folder) -> Iterator[SeriesFinding]:
    """What a controller saw must be here."""
    for one in folder.ordered:
        for seen in one.witnesses:
            log = folder.ids.get(seen.log_id)
            what = f"the log that the controller saw, {seen.log_id}"
            if log is None:
                code = "witness-missing" if seen.found else "witness-unknown"
                then = (
                    "here when this session opened"
                    if seen.found
                    else "not here when this session opened either"
                )
                yield SeriesFinding(code, one.file, what, f"in no log here, and was {then}", "in this folder")
            elif seen.size > log.size:
                bound = f"at most {log.size}, which {log.file} has"
                yield SeriesFinding("witness-differs", one.file, what, f"of {seen.size} records", bound)
            elif not (log.archived or _holds(log, seen)):
                bound = f"one that a start of {log.file} names"
                value = f"root {seen.root} at {seen.size} records"
                yield SeriesFinding("witness-differs", one.file, what, value, bound)


def _holds(log: FolderSession, seen: WitnessNamed) -> bool:
    tree = (seen.size, seen.root)
    return tree in log.trees or tree == (log.size, log.root)


def _headed(folder: Folder) -> Iterator[SeriesFinding]:
    """HEAD against the last session."""
    head, last = folder.head, folder.ordered[-1] if folder.ordered else None
    series = None if folder.series is None else folder.series.hex()
    if head is None:
        if last is not None:
            yield SeriesFinding("head-missing", NAME_OF_HEAD, "the file", "", "not in this folder")
    elif None not in (head.series, series) and head.series != series:
        bound = f"{series}, as the logs"
        yield SeriesFinding("head-foreign", NAME_OF_HEAD, "its series", _told(head.series), bound)
    else:
        other, log = _other_last(folder, head, last), folder.files.get(head.log, last)
        if other is not None:
            yield other
        if log is not None and (other is None or other.code == "renamed"):
            yield from _last(folder, head, log)


def _other_last(folder: Folder, head: HeadNamed, last: FolderSession | None) -> SeriesFinding | None:
    """Whether HEAD names another log than the last one."""
    log, what = folder.files.get(head.log), "the last log"
    if log is None and last is not None and head.closed and head.head == last.head:
        return SeriesFinding("renamed", last.file, "its name", last.file, f"{head.log}, as HEAD calls it")
    if log is None:
        value = f"{head.log}, which is not here"
        return SeriesFinding("head-log-missing", NAME_OF_HEAD, what, value, "in this folder")
    if log is not last and log.file not in folder.blank:
        newest = "none that has a place here" if last is None else f"{last.file}, the last one here"
        return SeriesFinding("head-old", NAME_OF_HEAD, what, head.log, newest)
    return None


def _last(folder: Folder, head: HeadNamed, log: FolderSession) -> Iterator[SeriesFinding]:
    """HEAD against the log that it names."""
    if not head.closed:
        code = "running" if folder.running else "crashed-last"
        told = "running: its log is not whole yet" if folder.running else "never closed: it has crashed"
        yield SeriesFinding(code, log.file, "the last session", "", told)
        return
    for link in _head_links(head, log):
        given = link.named is not None or log.key is not None  # of a signed log HEAD has all of them
        if link.found is not None and given and link.named != link.found:
            bound = f"{link.found}, as {log.file} has it"
            yield SeriesFinding("head-differs", NAME_OF_HEAD, f"its {link.what}", _told(link.named), bound)
    if not log.closed:
        yield SeriesFinding(
            "cut-off", log.file, "its end", "without a close record", "closed, as HEAD has it"
        )


def _head_links(head: HeadNamed, log: FolderSession) -> tuple[_Link, ...]:
    return (
        _Link("series", head.series, None if log.key is None else log.key.series.hex()),
        _Link("epoch", head.epoch, log.epoch),
        _Link("size", head.size, log.size),
        _Link("root", head.root, log.root),
        _Link("head", head.head, log.head),
    )


def _anchored(folder: Folder) -> Iterator[SeriesFinding]:
    """What somebody kept elsewhere must be here."""
    here = _hashes(folder)
    for anchor in folder.anchors:
        if anchor not in here:
            bound = "a head, or a root that a checkpoint signs, of a session here"
            yield SeriesFinding("anchor-missing", NAME_OF_HEAD, "the anchor", anchor, bound)


def _hashes(folder: Folder) -> dict[str, str]:
    """Every root and head that is known, and its log."""
    found = {}
    for one in folder.logs:
        for value in (one.root, one.head, *one.anchors, *(root for _, root in one.trees)):
            if value is not None:
                found[value] = one.file
    return found


FINDERS: Final = (
    _sound,
    _doubled,
    _joints,
    _uncertified,
    _clock,
    _older,
    _pinned,
    _witnessed,
    _headed,
    _anchored,
)
"""In the order in which they are asked, and their findings are told."""


# ---------------------------------------------------------------- all of it


def examine(folder: Folder, told: Sequence[SeriesFinding] = ()) -> SeriesFound:
    """What this folder is.

    Args:
        folder: what it says.
        told: what was found on reading it.
    """
    findings = (*told, *(finding for finder in FINDERS for finding in finder(folder)))
    named = folder.no_logs.keys() & folder.named
    statuses = [one.status for one in folder.sessions if one.file not in folder.no_logs or one.file in named]
    return SeriesFound(
        status=worst([*statuses, *(finding.status for finding in findings)]),
        joined=tuple(_all_joined(folder)),
        findings=findings,
        key=_key(folder, findings),
        witness=_seen(folder),
        anchor=_kept(folder),
    )


def _all_joined(folder: Folder) -> Iterator[Joined]:
    before: FolderSession | None = None
    for one in folder.ordered:
        yield Joined(one, _how(folder, before, one), placed=True)
        before = one
    for name, first in folder.doubles.items():
        yield Joined(folder.files[name], f"doubles {first.file}")
    for one in folder.foreign:
        yield Joined(one, "of another series")
    for one in folder.copies:
        yield Joined(one, f"recovered copy of {one.recovered_from}")
    for one in folder.blank.values():
        yield Joined(one, "without a record 0" if one.status is Status.TAMPERED else "cut before record 0")


def _how(folder: Folder, before: FolderSession | None, one: FolderSession) -> str:
    wrong = (
        []
        if before is None
        else [found for found in _pair(folder, before, one) if found.status is Status.TAMPERED]
    )
    if wrong:
        return f"NOT JOINED ({', '.join(dict.fromkeys(found.code for found in wrong))})"
    enrolled = ["enrolled here"] if one.enrolled is not None and one.key is not None else []
    if before is None:
        link = [] if enrolled else ["begins late" if one.previous.log is not None else "the first"]
    else:
        link = ["after a crash" if one.previous.crashed else "follows"]
    form = ["older form"] if one.key is None else []
    return ", ".join((*link, *enrolled, *form))


def _key(folder: Folder, findings: Iterable[SeriesFinding]) -> str:
    if not folder.signed:
        return "none (nothing here is signed)"
    first, last = folder.signed[0], folder.signed[-1]
    span = f"epochs {first.epoch} to {last.epoch}"
    if folder.pinned is not None:
        broken = any(found.code.startswith(("key-", "certificate-", "epoch-")) for found in findings)
        reach = "does not vouch for all of them" if broken else f"vouches for {_vouched(folder)}"
        return f"pinned ({folder.pinned.fingerprint}, epoch {folder.pinned.epoch}), {reach}; {span}"
    fingerprint = first.key.fingerprint if first.key else ""
    return f"from the logs themselves (epoch {first.epoch}: {fingerprint}), pinned by nobody; {span}"


def _vouched(folder: Folder) -> str:
    pinned = folder.pinned
    earlier = sum(1 for one in folder.ordered if pinned is not None and (one.epoch or 0) < pinned.epoch)
    later = len(folder.ordered) - earlier
    links = f", and by what they say for {earlier} before them" if earlier else ""
    return f"{later} by certificates{links}"


def _seen(folder: Folder) -> str:
    """What became of the logs that controllers told of."""
    seen = [(one, folder.ids.get(one.log_id)) for session in folder.ordered for one in session.witnesses]
    if not seen:
        return "no controller has told of a log"
    there = sum(1 for one, log in seen if log is not None and not log.archived and _holds(log, one))
    archived = sum(1 for _, log in seen if log is not None and log.archived)
    kept = f", {archived} archived (root not checked)" if archived else ""
    return f"of {len(seen)} logs that a controller told of {there} found{kept}"


def _kept(folder: Folder) -> str:
    if not folder.anchors:
        return "not given"
    here = _hashes(folder)
    return f"{sum(1 for one in folder.anchors if one in here)} of {len(folder.anchors)} found"
