"""``cutgate key``: pre-shared keys, and how people compare them."""

import secrets
from pathlib import Path
from typing import Annotated

import typer

from cutgate.config.key import load_key, new_key_file
from cutgate.config.screen import printable
from cutgate.protocol.codes import KEY_BYTES, fingerprint
from cutgate.runtime.commands.screen import echo, messages

keys = typer.Typer(no_args_is_help=True, help="Pre-shared keys.")


@keys.callback()
def _group() -> None:
    """Pre-shared keys of runtime and controller."""


@keys.command("new")
def new(file: Annotated[Path, typer.Argument(metavar="FILE", help="Must not exist yet.")]) -> None:
    """Write a new random key, readable by its owner only (mode 0600). Never overwrites."""
    key = secrets.token_bytes(KEY_BYTES)
    new_key_file(file, key)
    text = f"New key in {file}, fingerprint {fingerprint(key)}. Give the controller the same file; keep it secret."
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
