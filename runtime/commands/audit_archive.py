"""``cutgate audit archive``: old sessions are moved to another folder, and the folder still verifies."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from cutgate.config.load import InputError
from cutgate.config.ours import read_ours
from cutgate.config.screen import printable
from cutgate.runtime.audit.archive import (
    ArchivePlan,
    archive,
    files_of_session,
    plan,
    read_stub,
    removed,
    withdrawn_by,
)
from cutgate.runtime.audit.directory import LIST_MAX, WITHDRAWN, lock
from cutgate.runtime.audit.folder import STUB_SUFFIX, files_of
from cutgate.runtime.commands.audit_folder import read_folder
from cutgate.runtime.commands.screen import echo, working

_NO_ROOM = (
    "free the disk of the other folder and ask again: what was moved is moved, the rest is where it was"
)


def archive_sessions(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The log directory.")],
    *,
    to: Annotated[Path, typer.Option("--to", metavar="DIR2", help="Where they go; made if it is missing.")],
    before: Annotated[
        str | None,
        typer.Option(
            "--before",
            metavar="DATE",
            help="Sessions opened before this, UTC: 2026-11-01 or 2026-11-01T12:00.",
        ),
    ] = None,
    keep: Annotated[
        int | None, typer.Option("--keep", metavar="N", min=1, help="All but the newest N.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be moved, and move nothing.")
    ] = False,
) -> None:
    """Move old sessions to another folder: log, raw frames and signature.

    A small file `<name>.archived` is left of each, by which `audit verify DIR` still verifies the folder. The newest
    session stays, one that runs, and all from the last start on, which the controller may still name. What does not
    verify as OK or INCOMPLETE stays too. Interrupted, it goes on where it stopped when it is called again.

    Exit code: 0; 2 where something that was asked for is not sound and stays, or on bad input.
    """
    if (before is None) is (keep is None):
        raise InputError(
            "audit archive", "", None, "takes either --before DATE or --keep N", "give one of them"
        )
    before_ns = None if before is None else _time_ns(before)
    with _locked(folder):
        _check_apart(folder, to)
        for path in files_of(folder):
            if path.name.endswith(STUB_SUFFIX):
                _finish(folder, path, to, dry_run=dry_run)
        read = read_folder(folder, running=False)
        chosen = plan(read.found, keep=keep, before_ns=before_ns, named=_named(folder))
        if not dry_run and chosen.moved:
            _made(to)
        for session in chosen.moved:
            names = ", ".join(path.name for path in files_of_session(folder / session.file))
            if dry_run:
                echo(printable(f"would move {names}"))
                continue
            with _disk(to), working(f"moving {session.file}"):
                archive(folder, session, to)
            echo(printable(f"moved {names} to {to}"))
        raise typer.Exit(_told(chosen, dry_run=dry_run))


def _told(chosen: ArchivePlan, *, dry_run: bool) -> int:
    """What stays, and how many were moved; the exit code."""
    for kept in chosen.kept:
        echo(printable(f"{kept.session.file} stays: {kept.why}"), err=kept.wrong)
    count = len(chosen.moved)
    echo(f"{count} session{'' if count == 1 else 's'} {'to be moved' if dry_run else 'moved'}")
    return 2 if any(kept.wrong for kept in chosen.kept) else 0


def _finish(folder: Path, path: Path, to: Path, *, dry_run: bool) -> None:
    """What an earlier call has copied and not removed yet."""
    stub = read_stub(path)
    left = [entry.name for entry in stub.moved if os.path.lexists(folder / entry.name)]
    if not left:
        return
    if dry_run:
        echo(printable(f"would remove {', '.join(left)}: copied by an earlier call"))
        return
    with _disk(to):
        names = removed(folder, stub, to)
    echo(printable(f"removed {', '.join(names)}: copied by an earlier call"))


def _time_ns(text: str) -> int:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(
            "--before", "", text[:80], "a date, as 2026-11-01", "write year, month and day"
        ) from None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return int(moment.timestamp()) * 1_000_000_000


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """The folder, which is there and in which no session runs meanwhile."""
    if not folder.is_dir():
        raise InputError(folder, "", None, "no such folder", "name a log directory")
    descriptor = lock(folder)
    try:
        yield
    finally:
        os.close(descriptor)


def _check_apart(folder: Path, to: Path) -> None:
    """Raises InputError where both are one, or the other one is no folder."""
    if os.path.lexists(to) and not to.is_dir():
        raise InputError(to, "", None, "not a folder", "name another one with --to")
    if to.is_dir() and to.samefile(folder):
        raise InputError(to, "--to", None, "the log directory itself", "name another folder")


def _made(to: Path) -> None:
    try:
        to.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(to, "", None, f"cannot be made ({error.strerror})", "name another folder") from None


@contextmanager
def _disk(to: Path) -> Iterator[None]:
    """Errors of the disk as refusals."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(error.filename or to, "", None, f"not moved ({reason})", _NO_ROOM) from None


def _named(folder: Path) -> frozenset[str]:
    """Logs that the next session looks into."""
    with suppress(FileNotFoundError):
        lines = read_ours(folder / WITHDRAWN, LIST_MAX).decode("ascii", "replace").split("\n")
        return withdrawn_by(lines)
    return frozenset()
