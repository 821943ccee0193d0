"""``cutgate audit verify`` of a folder of logs, and ``cutgate audit list``: all sessions, and how they are joined."""

import json as json_format
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import typer

from cutgate.config.load import InputError, read_bytes
from cutgate.config.screen import printable
from cutgate.runtime.audit.folder import STUB_SUFFIX, files_of, head_in, not_begun, session_of, unread
from cutgate.runtime.audit.inspect import OLD_FORM, Log, Status
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.audit.recomputed.authenticated import CodesFound
from cutgate.runtime.audit.replay import ReplayOutcome, replay
from cutgate.runtime.audit.series import Joined, SeriesFound, examine, utc
from cutgate.runtime.audit.series_facts import Folder, FolderSession
from cutgate.runtime.audit.series_rules import WORST, SeriesFinding, worst
from cutgate.runtime.audit.stub import STUB_MAX, Stub, stub_name
from cutgate.runtime.audit.trust import NOBODY, Trust
from cutgate.runtime.commands.screen import echo, output, working
from cutgate.runtime.commands.tables import Fitting
from cutgate.runtime.doctor.probes.files import session_in
from cutgate.runtime.review.sessions import NOT_CHECKED, SessionSummary, summary_of
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified

SHOWN: Final = 100
"""Findings that are printed; ``--json`` has all of them."""
REASON_MAX: Final = 500
"""Characters of why a log is not OK."""
_REPLAYED: Final = {
    ReplayOutcome.IDENTICAL: "identical",
    ReplayOutcome.DIFFERS: "differs",
    ReplayOutcome.BAD_INPUT: "not comparable",
}
_ID: Final = 8
"""Digits of a log's id at the end of its name."""

Add = Callable[[dict[str, Any]], None]
"""Takes a document for ``--json``."""
Visit = Callable[[Path, Log], Sequence[SeriesFinding]]
"""Told of each log while it is open; what it finds besides."""
Codes = Callable[[Path, Log], CodesFound]
"""Checks the codes of a session."""


@dataclass(frozen=True)
class FolderRead:
    """A folder that has been read.

    Attributes:
        path: of it.
        found: what it is.
        reasons: by file name: why a log is not OK, the first alone.
        replay: what deciding again came to.
        codes: what came of the codes; empty where none were to be checked.
    """

    path: Path
    found: SeriesFound
    reasons: dict[str, str]
    replay: str = NOT_CHECKED
    codes: str = ""

    @property
    def headline(self) -> str:
        """The verdict, with whose key, which witness and which anchor."""
        found, count = self.found, len(self.found.joined)
        sessions = f"{count} session{'' if count == 1 else 's'}"
        codes = f"; codes: {self.codes}" if self.codes else ""
        return (
            f"{found.status.name}: {self.path}: {sessions}; key {found.key}; witness: {found.witness}; "
            f"anchor: {found.anchor}; replay: {self.replay}{codes}"
        )

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "folder": str(self.path),
            "status": self.found.status.name,
            "headline": self.headline,
            "sessions": [self._session(joined) for joined in self.found.joined],
            "findings": [told(finding) for finding in self.found.findings],
            "key": self.found.key,
            "witness": self.found.witness,
            "anchor": self.found.anchor,
            "codes": self.codes or None,
        }

    def _session(self, joined: Joined) -> dict[str, Any]:
        one = joined.session
        return {
            "log": one.file,
            "log_id": one.log_id,
            "status": one.status.name,
            "reason": self.reasons.get(one.file),
            "joined": joined.how,
            "archived": one.archived,
            "epoch": one.epoch,
            "key": None if one.key is None else one.key.fingerprint,
            "opened_utc": utc(one.opened_ns),
            "messages": one.size,
            "root": one.root,
            "head": one.head,
        }


def told(finding: SeriesFinding) -> dict[str, Any]:
    """A finding for JSON."""
    return {
        **asdict(finding),
        "status": finding.status.name,
        "remedy": finding.remedy,
        "text": str(finding),
    }


def read_folder(
    path: Path,
    trust: Trust = NOBODY,
    visit: Visit = lambda _file, _log: (),
    *,
    running: bool | None = None,
) -> FolderRead:
    """Read a folder's logs, one after the other, and find what it is.

    A log is judged by itself, and each must be cosigned where that is asked; the pinned key and the anchors are the
    whole folder's.

    Args:
        path: of the folder.
        trust: the pinned key, the anchors and the cosigners.
        visit: told of each log while it is open.
        running: whether a session runs in it; None to look.

    Raises:
        InputError: the folder cannot be read, or holds too many logs.
    """
    sessions: list[FolderSession] = []
    reasons: dict[str, str] = {}
    anchors = tuple(anchor.hex() for anchor in trust.anchors)
    head, findings = head_in(path)
    files = files_of(path)
    if not files and head is None and not findings:
        remedy = "name a log, or the folder of logs"
        raise InputError(path, "", None, "a folder without logs (*.mcap)", remedy)
    cosigned = Trust(cosigners=trust.cosigners)
    for file in (one for one in files if not one.name.endswith(STUB_SUFFIX)):
        try:
            session, reason, more = _read(file, anchors, visit, cosigned)
            findings += more
        except InputError as error:
            session, reason = unread(file.name), error.problems[0].bound
            findings += (SeriesFinding("unreadable", file.name, "the file", "", reason),)
        sessions.append(session)
        if reason and reason != OLD_FORM:  # of those there is one finding
            reasons[file.name] = reason
    logs = {one.file: one for one in sessions}
    places: dict[str, list[str]] = {}
    for file in (one for one in files if one.name.endswith(STUB_SUFFIX)):
        left = _archived(file, logs)
        if isinstance(left, SeriesFinding):
            findings += (left,)
            continue
        sessions.append(left.session)
        places.setdefault(left.place, []).append(file.name)
        if left.reason and left.reason != OLD_FORM:
            reasons[left.session.file] = left.reason
    for place, names in places.items():
        told_of = f"{len(names)}, whose logs are not here; moved to {place}"
        findings += (SeriesFinding("archived", names[0], "archived sessions", "", told_of),)
        if trust.cosigners:
            told_of = f"of {len(names)} archived sessions whether they are cosigned; they are in {place}"
            findings += (SeriesFinding("cosigner-not-checked", names[0], "not checked", "", told_of),)
    running = session_in(path) is not None if running is None else running
    found = examine(Folder(sessions, head, trust.pinned, running, anchors), findings)
    return FolderRead(path, found, reasons)


def _read(
    file: Path, anchors: tuple[str, ...], visit: Visit, trust: Trust = NOBODY
) -> tuple[FolderSession, str, tuple[SeriesFinding, ...]]:
    """What a log says of itself, why it is not OK, and what was found in it besides."""
    with opened(file, trust) as log:
        found = tuple(visit(file, log))
        reason = "" if not_begun(log) else next(iter(log.report.reasons), "")[:REASON_MAX]
        return session_of(file.name, log, anchors), reason, found


class _Left(NamedTuple):
    """What is left of a session, why it is not OK, and where it was moved to."""

    session: FolderSession
    reason: str
    place: str


def _archived(file: Path, logs: Mapping[str, FolderSession]) -> _Left | SeriesFinding:
    """What a stub tells; or what is wrong with it, or not done yet."""
    try:
        stub = Stub.parse(read_bytes(file, STUB_MAX, "it is no stub of an archived log"))
        session, reason = stub.session()
    except (InputError, ValueError) as error:
        why = error.problems[0].bound if isinstance(error, InputError) else str(error)
        return SeriesFinding("stub-wrong", file.name, "the stub", "", why)
    if stub_name(stub.log) != file.name:
        return SeriesFinding("stub-wrong", file.name, "its log", stub.log, "the one that it is named after")
    log = logs.get(stub.log)
    if log is None:
        return _Left(session, reason, stub.place)
    here, left = ((one.log_id, one.size, one.root, one.head) for one in (log, session))
    if here != left:
        return SeriesFinding("stub-wrong", file.name, "the stub", "of another log", f"of {log.file}")
    return SeriesFinding("archive-unfinished", file.name, "its log", "", "still here, copied already")


@contextmanager
def opened(file: Path, trust: Trust = NOBODY) -> Iterator[Log]:
    """The log, read with a sign of life; errors as ``reading``."""
    with ExitStack() as files:
        with working(f"reading {file}"):
            log = files.enter_context(reading(file, trust))
        yield log


# ---------------------------------------------------------------- verify


@dataclass
class _Checked:
    """What came of the codes of all sessions."""

    check: Codes | None
    counts: Counter[str] = field(default_factory=Counter)
    fits: bool = False
    refused: SeriesFinding | None = None

    def visit(self, file: Path, log: Log) -> Sequence[SeriesFinding]:
        """The next log; the keys of one session alone tell nothing of another one."""
        if self.check is None or log.report.status is Status.UNREADABLE:
            return ()
        try:
            found = self.check(file, log)
        except InputError as error:
            self.counts[NOT_CHECKED] += 1
            self.refused = self.refused or SeriesFinding(
                "codes-not-checked", file.name, "codes", "", f"the key fits no session here: {error}"
            )
            return ()
        self.counts[found.answer] += 1
        self.fits = True
        wrong = SeriesFinding("codes-wrong", file.name, "its codes", "", found.line)
        return (wrong,) if found.answer == "no" else ()

    def held_to(self, read: FolderRead) -> FolderRead:
        """The folder with what came of the codes; a key that fits no session of it is none to be silent about."""
        found = read.found
        if self.refused and not self.fits:
            findings = (*found.findings, self.refused)
            found = replace(found, findings=findings, status=worst([found.status, self.refused.status]))
        return replace(read, found=found, codes=str(self))

    def __str__(self) -> str:
        """How many of each answer; empty where none were to be checked."""
        if self.check is None:
            return ""
        return ", ".join(f"{count} {answer}" for answer, count in sorted(self.counts.items())) or NOT_CHECKED


def verify_folder(path: Path, add: Add | None, trust: Trust = NOBODY, codes: Codes | None = None) -> Status:
    """Print what a folder of logs is, or hand over its document.

    Args:
        path: the folder.
        add: takes the document; None where lines are printed.
        trust: what the reviewer has from elsewhere.
        codes: checks those of a session; None where they are not to be.
    """
    checked = _Checked(codes)
    try:
        read = checked.held_to(read_folder(path, trust, checked.visit))
    except InputError as error:
        return refused(path, error, add)
    if add is not None:
        add(read.document())
        return read.found.status
    for joined in read.found.joined:
        one = joined.session
        epoch = "" if one.epoch is None else f", epoch {one.epoch}"
        stub = ", archived" if one.archived else ""
        echo(printable(f"{one.file}: {one.status.name}{epoch}{stub}, {joined.how}"))
        if one.file in read.reasons:
            echo(f"  {printable(read.reasons[one.file])}")
    print_findings(read.found.findings)
    echo(printable(read.headline))
    return read.found.status


def refused(path: Path, error: InputError, add: Add | None) -> Status:
    """What cannot be read at all."""
    echo(str(error), err=True)
    if add is not None:
        add({"folder": str(path), "status": Status.UNREADABLE.name, "headline": str(error)})
    return Status.UNREADABLE


def print_findings(findings: Sequence[SeriesFinding]) -> None:
    """A line each: what it makes of the folder, its code, and all that is to be known; the worst first."""
    weighed = sorted(findings, key=lambda finding: WORST.index(finding.status))
    for finding in weighed[:SHOWN]:
        weight = "told" if finding.status is Status.OK else finding.status.name
        echo(f"{weight} {finding.code}: {finding}")
    if len(findings) > SHOWN:
        echo(f"... and {len(findings) - SHOWN} more; --json has all of them")


# ---------------------------------------------------------------- list


@dataclass
class Rows:
    """A line for each log, in the order in which they were read, and how far they stand."""

    again: bool
    summaries: dict[str, SessionSummary] = field(default_factory=dict)

    def visit(self, file: Path, log: Log) -> Sequence[SeriesFinding]:
        """The next log."""
        result = None
        if self.again:
            with working(f"deciding {file.name} again"):
                result = replay(log, certified.verify, verifier=VERIFIER)
        self.summaries[file.name] = summary_of(log, _REPLAYED[result.outcome] if result else NOT_CHECKED)
        if result is None or result.outcome is not ReplayOutcome.DIFFERS:
            return ()
        why = next(iter(result.differences), "")[:REASON_MAX]
        return (SeriesFinding("replay-differs", file.name, "decided again", "", f"it differs: {why}"),)

    @property
    def replay(self) -> str:
        """What deciding again came to, of all."""
        if not self.again:
            return NOT_CHECKED
        counts = Counter(one.replay for one in self.summaries.values())
        return ", ".join(f"{count} {what}" for what, count in sorted(counts.items())) or NOT_CHECKED

    def table(self, sessions: Sequence[FolderSession]) -> Fitting:
        """Those sessions, in their order."""
        heads = ("time (UTC)", "log", "outcome", "verdict", "tightest clearance", "integrity", "replay")
        return Fitting(
            heads,
            [self._cells(one) for one in sessions],
            dispensable=("log",) if self.again else ("log", "replay"),
        )

    def _cells(self, one: FolderSession) -> tuple[str, ...]:
        summary = self.summaries.get(one.file, SessionSummary(one.opened_ns))
        clearance = "undefined" if summary.certified is None else f"{summary.certified:.3f} {summary.unit}"
        cells = (
            utc(one.opened_ns)[:16].replace("T", " "),
            short_name(one.file),
            "archived" if one.archived else summary.outcome or "not closed",
            summary.verdict or ("" if one.archived else "none"),
            f"{summary.boundary} {clearance}" if summary.boundary else "",
            one.status.name,
            summary.replay,
        )
        return tuple(printable(cell) for cell in cells)

    def documents(self, sessions: Sequence[FolderSession]) -> list[dict[str, Any]]:
        """For JSON."""
        found = []
        for one in sessions:
            summary = self.summaries.get(one.file, SessionSummary(one.opened_ns))
            more = {"log": one.file, "integrity": one.status.name, "archived": one.archived}
            found.append({**more, **asdict(summary), "opened_utc": utc(one.opened_ns)})
        return found


def short_name(file: str) -> str:
    """The digits of its id where a file is named as sessions name theirs, else all of its name."""
    stem = file.rpartition(".")[0]
    time, _, digits = stem.rpartition("-")
    return digits if len(digits) == _ID and time.endswith("Z") else file


def list_sessions(
    paths: Annotated[
        list[Path], typer.Argument(metavar="LOG|DIR...", help="Logs, and folders of logs, in any order.")
    ],
    *,
    again: Annotated[
        bool, typer.Option("--replay", help="Decide each session again from its log; takes its time.")
    ] = False,
    json: Annotated[
        bool, typer.Option("--json", help="One JSON document: a list, an entry for each argument.")
    ] = False,
) -> None:
    """List sessions: when, how they ended, the verdict, the tightest clearance, and whether the log stands.

    Of a folder also what is missing, doubled or foreign in it, as `audit verify DIR` finds it.

    Exit code: as `audit verify`: 0 OK, 1 INCOMPLETE, 2 TAMPERED (or a replay that differs), 3 UNREADABLE; the worst
    of all: 2, 3, 1, 0.
    """
    documents: list[dict[str, Any]] = []
    add = documents.append if json else None
    found = [_listed(path, add, again=again) for path in paths]
    if json:
        echo(json_format.dumps(documents, allow_nan=False, indent=2))
    raise typer.Exit(worst(found))


def _listed(path: Path, add: Add | None, *, again: bool) -> Status:
    """One argument's sessions."""
    rows = Rows(again)
    try:
        if path.is_dir():
            read = read_folder(path, visit=rows.visit)
        else:
            session, reason, more = _read(path, (), rows.visit)
            status = worst([session.status, *(finding.status for finding in more)])
            alone = SeriesFound(status, (Joined(session, "alone"),), more, "", "", "")
            read = FolderRead(path, alone, {path.name: reason} if reason else {})
    except InputError as error:
        return refused(path, error, add)
    status, read = read.found.status, replace(read, replay=rows.replay)
    sessions = [joined.session for joined in read.found.joined]
    if add is not None:
        findings = [told(finding) for finding in read.found.findings]
        add(
            {
                "path": str(path),
                "status": status.name,
                "headline": read.headline if path.is_dir() else status.name,
                "sessions": rows.documents(sessions),
                "findings": findings,
            }
        )
        return status
    output().print(rows.table(sessions))
    for name, reason in read.reasons.items():
        echo(f"{printable(name)}: {printable(reason)}")
    print_findings(read.found.findings)
    if path.is_dir():
        echo(printable(read.headline))
    return status
