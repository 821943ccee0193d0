"""All commands of ``cutgate``, and what an error looks like from outside; ``cutgate.runtime.cli`` is the way in."""

from typing import Annotated

import typer
from typer.exceptions import TyperException

from cutgate import __version__
from cutgate.config.load import InputError
from cutgate.config.screen import printable
from cutgate.runtime.commands import (
    audit,
    conform,
    controller_side,
    demo,
    example,
    key,
    reach,
    recheck,
    run,
    verify,
)
from cutgate.runtime.commands.screen import delivered, echo, no_room
from cutgate.runtime.exits import INTERNAL, INTERRUPTED, NOT_WRITTEN, READER_GONE, REFUSED

app = typer.Typer(
    name="cutgate",
    help="Decides whether a bone-milling robot may start to cut.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(asked: bool) -> None:
    if asked:
        echo(f"cutgate {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    _version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Decides whether a bone-milling robot may start to cut."""


for command in (verify, recheck, reach, run, controller_side, conform, key, audit, demo, example):
    command.register(app)


def execute(arguments: list[str] | None = None) -> int:
    """Runs one command and returns its exit code; no exception leaves.

    Args:
        arguments: without the program's name; None for the process's own.
    """
    try:
        code = app(arguments, prog_name="cutgate", standalone_mode=False)
    except InputError as error:
        delivered(str(error), err=True)
        return REFUSED
    except TyperException as error:
        show = getattr(error, "show", None)
        show() if show else echo(error.format_message(), err=True)
        return REFUSED
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except SystemExit:  # what prints the help ends so where nobody reads it
        return READER_GONE
    except Exception as error:  # noqa: BLE001 - the last line of defence: one line and a code, never a traceback
        return _failed(error)
    return code if isinstance(code, int) else 0


def _failed(error: Exception) -> int:
    """No room for what is written, or a fault of the program: in one line, with its place."""
    if no_room(error):
        delivered(f"cutgate: what was to be written is not whole: {error.args[1]}", err=True)
        return NOT_WRITTEN
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    where = f"{place.tb_frame.f_code.co_filename}:{place.tb_lineno}" if place else "unknown place"
    text = str(error).replace("\n", " ")
    delivered(printable(f"cutgate: internal error: {type(error).__name__}: {text} ({where})"), err=True)
    return INTERNAL
