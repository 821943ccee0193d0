"""``cutgate config``: the site's settings as they hold, and input files validated without anything else."""

import json as json_format
import textwrap
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.text import Text

from cutgate.config.exits import OK, REFUSED
from cutgate.config.load import InputError, load_site
from cutgate.config.model import Site
from cutgate.config.screen import printable
from cutgate.config.settings import Setting, Source, settings
from cutgate.runtime.commands.screen import echo, output, working
from cutgate.runtime.plan.kinds import described

configuration = typer.Typer(
    no_args_is_help=True, help="Settings as they hold, and input files checked on their own."
)
SCHEMA: Final = "cutgate.settings/1"
INDENT: Final = 4
COLUMN_MAX: Final = 42
"""A value that is longer pushes what follows to the right, and no other row with it."""


@configuration.callback()
def _group() -> None:
    """Settings as they hold, and input files checked on their own."""


@configuration.command("show")
def show(
    site: Annotated[
        Path | None, typer.Option(metavar="FILE", help="site.toml; without it the defaults.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Show every setting of site.toml: value, where it comes from, bounds, unit, effect.

    Exit code: 0, or 2 for a file that is refused.
    """
    found = settings(Site() if site is None else load_site(site).value)
    if json:
        echo(json_format.dumps(_document(site, found), allow_nan=False, indent=2))
        return
    console = output()
    console.print(f"Settings of {printable(str(site))}" if site else "Settings without a site.toml: defaults")
    width = min(COLUMN_MAX, max(len(_assigned(one)) for one in found))
    for table, members in groupby(found, key=lambda one: one.table):
        console.print("")
        if table:
            console.print(Text(f"[{table}]", "bold"))
        for one in members:
            style = "bold" if one.source is Source.SITE else ""
            console.print(
                Text.assemble((_assigned(one).ljust(width), style), f"  {one.source:<9}  {_bounds(one)}")
            )
            wrapped = textwrap.fill(one.effect, max(console.width - INDENT, 2 * INDENT))
            console.print(Text(textwrap.indent(wrapped, " " * INDENT), "dim"))


@configuration.command("check")
def check(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="robot.toml, site.toml, registration.json, plans, tool paths."
        ),
    ],
    site: Annotated[
        Path | None, typer.Option(metavar="FILE", help="site.toml whose limits hold for plans.")
    ] = None,
) -> None:
    """Validate input files, each on its own: robot, site, registration, plan or tool path.

    Exit code: 0 all are accepted, 2 at least one is refused.
    """
    limits = (Site() if site is None else load_site(site).value).files
    code = OK
    for file in files:
        try:
            with working(f"reading {file}"):
                what = described(file, limits)
        except InputError as error:
            echo(str(error), err=True)
            code = REFUSED
        else:
            echo(printable(f"{file}: ok ({what})"))
    raise typer.Exit(code)


def _assigned(setting: Setting) -> str:
    """The setting and its value, with the unit."""
    if setting.value is None:
        return f"{setting.name}: not set"
    value = json_format.dumps(setting.value, ensure_ascii=False)
    return printable(f"{setting.name} = {value} {setting.unit}".rstrip())


def _bounds(setting: Setting) -> str:
    return f"{setting.bounds} {setting.unit}".rstrip()


def _document(site: Path | None, found: tuple[Setting, ...]) -> dict[str, Any]:
    members = ("key", "value", "source", "bounds", "unit", "effect")
    return {
        "schema": SCHEMA,
        "site": None if site is None else str(site),
        "settings": [{name: getattr(one, name) for name in members} for one in found],
    }


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.add_typer(configuration, name="config")
