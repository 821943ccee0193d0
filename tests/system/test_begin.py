"""Ctrl-C while the program is still being loaded."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.processes

HOOK = """
import os, signal, sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["INTERRUPTED_BY"]:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
"""
"""The process sends itself the signal when it comes to import a certain module."""

SCRIPT = Path(sys.executable).with_name("cutgate")


@pytest.mark.parametrize("module", ["typer", "numpy", "cutgate.runtime.commands.{}"])
@pytest.mark.parametrize(("command", "code"), [("run", 3), ("verify", 130)])
@pytest.mark.parametrize(
    "program", [[sys.executable, "-m", "cutgate.runtime.cli"], [str(SCRIPT)]], ids=["module", "script"]
)
def test_ctrl_c_while_the_program_is_loaded_is_one_line_and_a_code(tmp_path, program, command, code, module):
    if not Path(program[0]).exists():
        pytest.skip("the cutgate script is not installed")
    (tmp_path / "sitecustomize.py").write_text(HOOK, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "INTERRUPTED_BY": module.format(command)}
    done = subprocess.run([*program, command], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr == "cutgate: interrupted before it began\n"
