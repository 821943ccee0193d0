"""``cutgate key``: pre-shared keys, how people compare them, keys that sign logs, and those of one session for who reviews it."""

import re
import secrets
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Final

import typer

from cutgate.config.key import load_key, new_key_file
from cutgate.config.load import InputError
from cutgate.config.screen import printable
from cutgate.config.session_keys import new_session_key_file
from cutgate.protocol.codes import KEY_BYTES, fingerprint
from cutgate.runtime.audit.directory import in_use
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.audit.log_keys import new_log_key, public_path, to_continue
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.audit.recomputed.opening import Opening, opening_of, session_keys
from cutgate.runtime.commands.screen import echo, messages, working

LOG_ID: Final = re.compile("[0-9a-f]{32}")
_RESTORE: Final = "restore the log: cutgate audit verify tells more"

keys = typer.Typer(
    no_args_is_help=True, help="Pre-shared keys, those of one session, and keys that sign logs."
)


@keys.callback()
def _group() -> None:
    """Pre-shared keys of runtime and controller, those of one session, and keys that sign logs."""


@keys.command("new")
def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Must not exist yet.")],
    *,
    log: Annotated[bool, typer.Option("--log", help="A key that signs the logs of a log directory.")] = False,
    continues: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="With --log: for this log directory, whose key is lost or too old."),
    ] = None,
) -> None:
    """Write a new random key, readable by its owner only (mode 0600). Never overwrites.

    Without --log it is the pre-shared key of runtime and controller. With --log its public half is written beside it, as
    FILE.pub: keep a copy elsewhere, by which logs are verified.
    """
    if log:
        _new_log_key(file, continues)
        return
    if continues is not None:
        raise InputError("--continues", "", None, "is for keys that sign logs", "add --log")
    key = secrets.token_bytes(KEY_BYTES)
    new_key_file(file, key)
    text = f"New key in {file}, fingerprint {fingerprint(key)}. Give the controller the same file; keep it secret."
    messages().print(printable(text), soft_wrap=True)


def _new_log_key(file: Path, continues: Path | None) -> None:
    if continues is None:
        made = new_log_key(file)
        told = "for a log directory in which no session was signed yet"
    else:
        series, epoch = to_continue(continues)
        made = new_log_key(file, series=series, epoch=epoch)
        told = (
            f"for the session of epoch {epoch} in {continues}, enrolled anew: no key before it certifies it"
        )
    text = (
        f"New log key in {file}, fingerprint {made.public.fingerprint}, {told}. Its public half is in "
        f"{public_path(file)}: keep a copy elsewhere. Name the key with: cutgate run --log-key"
    )
    messages().print(printable(text), soft_wrap=True)


@keys.command("fingerprint")
def show(file: Annotated[Path, typer.Argument(metavar="FILE", help="A key file of this side.")]) -> None:
    """Print eight digits to compare with those of the other side: keys that differ have other ones.

    Nobody finds the key by them.
    """
    echo(fingerprint(load_key(file)))


@keys.command("session")
def session(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A session's log (.mcap).")],
    key: Annotated[Path, typer.Option(help="The pre-shared key of that session.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="The session's keys; must not exist yet.")
    ],
) -> None:
    """Write the keys of a log's session alone, to check its codes with: cutgate audit verify LOG --key FILE.

    Who holds them can move no arm. Mode 0600, never overwrites. Exit code: 0, or 2 where the key is not that session's.
    """
    secret = load_key(key)
    with ExitStack() as files:
        with working(f"reading {log}"):
            read = files.enter_context(reading(log))
        if not read.scan.finished and in_use(log.parent):
            remedy = "wait until it has ended: while it runs its keys move the arm"
            raise InputError(log, "", None, "a session is running in its folder", remedy)
        log_id, opening = read.report.log_id, _opening(log, read)
    found = session_keys(log_id, opening, secret)
    if found is None:
        named = f"{opening.fingerprint}, that of " if opening.fingerprint else ""
        remedy = "name the file of that key"
        bound = f"{named}the key that the session of {log} was opened with"
        raise InputError(key, "fingerprint", fingerprint(secret), bound, remedy)
    new_session_key_file(out, found)
    text = f"Keys of session {found.codes.digest.hex()[:8]} of log {found.log_id} in {out}."
    messages().print(printable(text), soft_wrap=True)


def _opening(path: Path, log: Log) -> Opening:
    """How the log's session was opened."""
    try:
        opening = opening_of(log)
    except ValueError as error:
        raise InputError(path, "", None, str(error), _RESTORE) from None
    if opening is None:
        bound = "holds no OPEN and OPENED: no session was opened, or it is of before 0.2"
        raise InputError(
            path, "", None, bound, "name the log of another session; this one's codes cannot be checked"
        )
    return opening


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.add_typer(keys, name="key")
