"""``cutgate sim`` and ``cutgate bus``: the simulated controller and the virtual bus as programs of their own.

They are started as separate programs, never imported: the controller's side must stay independent of this one.
"""

import os
import sys
from typing import Final

import typer

from cutgate.config.interpreter import program

PASS_ON: Final = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}


def _become(name: str, arguments: list[str]) -> None:
    sys.stdout.flush()
    os.execv(sys.executable, program("cutgate.firmware_sim", name, *arguments))  # noqa: S606


def sim(context: typer.Context) -> None:
    """The simulated controller (cutgate sim --help). Exit code: 0, or 2 on bad input, key or bus."""
    _become("sim", context.args)


def bus(context: typer.Context) -> None:
    """The local virtual CAN bus: bus serve, bus stat (load, queues, errors), bus inject (errors on demand)."""
    _become("bus", context.args)


def register(app: typer.Typer) -> None:
    """Adds both commands."""
    app.command("sim", context_settings=PASS_ON, add_help_option=False)(sim)
    app.command("bus", context_settings=PASS_ON, add_help_option=False)(bus)
