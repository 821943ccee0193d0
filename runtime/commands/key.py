"""``cutgate key``: pre-shared keys, keys that sign logs, and how people compare them."""

import secrets
from pathlib import Path
from typing import Annotated

import typer

from cutgate.config.key import load_key, new_key_file
from cutgate.config.load import InputError
from cutgate.config.screen import printable
from cutgate.protocol.codes import KEY_BYTES, fingerprint
from cutgate.runtime.audit.log_keys import new_log_key, public_path, to_continue
from cutgate.runtime.commands.screen import echo, messages

keys = typer.Typer(no_args_is_help=True, help="Pre-shared keys, and keys that sign logs.")


@keys.callback()
def _group() -> None:
    """Pre-shared keys of runtime and controller; keys that sign logs."""


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


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.add_typer(keys, name="key")
