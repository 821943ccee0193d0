"""The table of commands: a command is loaded when it is called, and no other with it."""

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from cutgate.runtime import commands
from cutgate.runtime.commands.app import COMMANDS, load

ROOT = Path(__file__).parents[3]
EXAMPLE = [str(ROOT / "examples" / "hip-stem.plan.json"), "--robot", str(ROOT / "examples" / "robot.toml")]
FOR_A_VERDICT = {"numpy", "pydantic"}
FOR_A_BUS = {"can", "cantools", "isotp", "asyncio", "ssl", "cryptography"}
FOR_OTHERS = {"mcap", "matplotlib", "multiprocessing", "concurrent.futures"}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_says_of_each_command_what_the_command_says_of_itself(name):
    own = re.sub(r"\s+", " ", load(name).help.split("\n\n")[0]).strip()
    assert COMMANDS[name][1] == own


def test_every_module_that_registers_a_command_is_in_the_table():
    names = {path.stem for path in Path(commands.__path__[0]).glob("*.py")} - {"app"}
    modules = {name: import_module(f"{commands.__name__}.{name}") for name in names}
    assert {name for name, module in modules.items() if hasattr(module, "register")} == {
        module for module, _ in COMMANDS.values()
    }


@pytest.mark.processes
@pytest.mark.parametrize(
    ("words", "unneeded", "code"),
    [
        (["--help"], FOR_A_VERDICT | FOR_A_BUS | FOR_OTHERS, 0),
        (["verify", *EXAMPLE], FOR_A_BUS | FOR_OTHERS, 1),
    ],
    ids=["help", "verify"],
)
def test_a_command_imports_no_library_that_it_does_not_need(words, unneeded, code):
    program = [sys.executable, "-X", "importtime", "-m", "cutgate.runtime.cli", *words]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    imported = set(re.findall(r"^import time:.*\| +(\S+)$", done.stderr, flags=re.MULTILINE))
    assert done.returncode == code
    assert "typer" in imported
    assert not imported & unneeded
