"""All commands of ``cutgate``, and what an error looks like from outside; ``cutgate.runtime.cli`` is the way in.

A command's module, and all that it needs of libraries, is imported when the command is called and not before.
"""

from importlib import import_module
from typing import Annotated, Any, Final

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from cutgate import __version__
from cutgate.config.exits import INTERNAL, INTERRUPTED, NOT_WRITTEN, READER_GONE, REFUSED
from cutgate.config.refusal import InputError
from cutgate.config.screen import STDERR, printable, write_nowhere
from cutgate.runtime.commands.screen import delivered, echo, no_room

COMMANDS: Final = {
    "verify": (
        "verify",
        "Check off-line whether a whole cut path keeps its distance from every limit of the robot.",
    ),
    "register": (
        "register",
        "Register the bone: fit CT to robot coordinates by landmarks touched with the probe, and write the registration.",
    ),
    "recheck": (
        "recheck",
        "Check the proof that a whole cut path is admissible, interval by interval, without a search.",
    ),
    "reach": (
        "reach",
        "Map where the bone could stand so that the whole cut path keeps its distance from every limit.",
    ),
    "run": (
        "run",
        "Verify the path against the controller on the bus, permit it, start it, watch it to its end.",
    ),
    "sim": (
        "controller_side",
        "The simulated controller (cutgate sim --help). Exit code: 0, or 2 on bad input, key or bus.",
    ),
    "bus": (
        "controller_side",
        "The local virtual CAN bus: bus serve, bus stat (load, queues, errors), bus inject (errors on demand).",
    ),
    "conform": (
        "conform",
        "Show that a controller refuses what it must. Its plant must be disconnected; see docs/controllers.md.",
    ),
    "demo": (
        "demo",
        "Refuse a first registration, explain where to move the bone, admit a second one and cut to the end.",
    ),
    "example": (
        "example",
        "Write the example files into a folder, to start from: robot, site, plans, registrations, README.txt.",
    ),
    "key": ("key", "Pre-shared keys, those of one session, and keys that sign logs."),
    "doctor": (
        "doctor",
        "Look at installation, bus, clock, priority, key, log directory and disk: can a session run here?",
    ),
    "config": ("config", "Settings as they hold, and input files checked on their own."),
    "decode": (
        "decode",
        "Show what was said on the bus: a line for each message, with its fields in words and units.",
    ),
    "audit": ("audit", "Review session logs: what was decided, and whether it stands."),
}
"""Of each command the module that registers it, and its help's first paragraph, which a test compares with the module's."""


def load(name: str) -> Any:
    """The command of this name, with all that it needs imported."""
    module, _ = COMMANDS[name]
    own = typer.Typer(add_completion=False)
    own.callback()(lambda: None)  # a group, also where the module registers one command alone
    import_module(f"cutgate.runtime.commands.{module}").register(own)
    return typer.main.get_group(own).commands[name]


class Named(TyperCommand):
    """A command of which only name and help are known until it is called."""

    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **more: Any) -> Any:
        """What calling a command begins with: the real one goes on from here."""
        return load(str(self.name)).make_context(info_name, args, *rest, **more)


class Commands(TyperGroup):
    """All of them, in the order in which help lists them."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands = {name: Named(name, callback=None, help=text) for name, (_, text) in COMMANDS.items()}


app = typer.Typer(
    name="cutgate",
    cls=Commands,
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
        _shown(error)
        return REFUSED
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except SystemExit:  # what prints the help ends so where nobody reads it
        return READER_GONE
    except Exception as error:  # noqa: BLE001 - the last line of defence: one line and a code, never a traceback
        return _failed(error)
    return code if isinstance(code, int) else 0


def _shown(error: TyperException) -> None:
    """What is wrong with the arguments, whether or not anybody reads it; what was typed is data."""
    if isinstance(getattr(error, "message", None), str):
        error.message = printable(error.message)
    show = getattr(error, "show", None)
    if show is None:
        delivered(error.format_message(), err=True)
        return
    try:
        show()
    except OSError:
        write_nowhere(STDERR)


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
