"""``cutgate key``: pre-shared keys."""

import secrets
from pathlib import Path
from typing import Annotated

import typer

from cutgate.config.key import new_key_file
from cutgate.protocol.permit import KEY_BYTES
from cutgate.runtime.commands.screen import messages

keys = typer.Typer(no_args_is_help=True, help="Pre-shared keys.")


@keys.callback()
def _group() -> None:
    """Pre-shared keys of runtime and controller."""


@keys.command("new")
def new(file: Annotated[Path, typer.Argument(metavar="FILE", help="Must not exist yet.")]) -> None:
    """Write a new random key, readable by its owner only (mode 0600). Never overwrites."""
    new_key_file(file, secrets.token_bytes(KEY_BYTES))
    messages().print(f"New key in {file}. Give the controller the same file; keep it secret.")


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.add_typer(keys, name="key")
