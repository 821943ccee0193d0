"""The files of ``cutgate example``, used as their README.txt says."""

import pytest

from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.commands.app import execute
from tests.runtime.commands.test_example import commands
from tests.system.harness import judged

pytestmark = pytest.mark.processes


def test_a_session_as_the_readme_says_cuts_to_its_end(rig, tmp_path, monkeypatch):
    assert execute(["example", str(tmp_path / "start")]) == 0
    monkeypatch.chdir(tmp_path / "start")
    (key,), (sim,), (run,) = (commands(verb) for verb in ("key", "sim", "run"))
    assert execute(key) == 0
    controller = rig._start("controller", "cutgate.firmware_sim", [*sim, *rig._where])
    controller.line("enabling device released")
    runtime = rig._start("runtime", "cutgate.runtime.cli", [*run, *rig._where], apart=True)
    runtime.line("permitted:")
    rig.begin(controller, runtime)
    assert runtime.exit() == 0
    (log,) = (tmp_path / "start" / "logs").glob("*.mcap")
    assert judged(log).report.status is Status.OK
