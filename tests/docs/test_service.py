"""The example unit of systemd: what it names exists, and stops in order have the time they may take."""

import os
import shlex
import shutil
import signal
import subprocess
from configparser import ConfigParser
from pathlib import Path

import pytest
from typer.main import get_command

from cutgate.config.constants import CONSTANTS
from cutgate.config.load import EXAMPLES
from cutgate.config.screen import FLUSH_S
from cutgate.config.signals import ENDING
from cutgate.runtime.commands.app import app
from cutgate.runtime.session.loop import GUIDANCE_S
from cutgate.runtime.session.withdrawal import WITHDRAW_S
from cutgate.runtime.session.worker import JOIN_S, KILLED_S, give_priority_back

UNIT = EXAMPLES / "cutgate-run.service"
PAGE = Path(__file__).parents[2] / "docs" / "timing.md"


@pytest.fixture(scope="module")
def service():
    """Its section of the service, by the names as they are written."""
    unit = ConfigParser(interpolation=None, delimiters=("=",))
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read_string(UNIT.read_text(encoding="utf-8"))
    return unit["Service"]


def test_the_command_its_options_and_its_inputs_exist(service):
    program, verb, *words = shlex.split(service["ExecStart"])
    assert (Path(program).name, Path(program).is_absolute()) == ("cutgate", True)
    named = get_command(app).commands[verb].make_context(verb, words).params
    for option in ("path", "robot", "registration", "site"):
        assert (EXAMPLES / named[option]).is_file(), option
    assert named["key"]
    assert named["log_dir"]
    assert not named["allow_simulated"], "where a unit runs there is a robot"
    assert all(not Path(word).is_absolute() for word in words)
    assert Path(service["WorkingDirectory"]) == Path("/var/lib") / service["StateDirectory"]


def test_nothing_is_begun_anew_and_nobody_but_the_runtime_is_told_to_stop(service):
    assert service["Restart"] == "no"
    assert service["KillMode"] == "mixed"
    assert signal.Signals[service["KillSignal"]] in ENDING


def test_a_stop_in_order_has_the_time_that_it_may_take(service):
    bounds = (CONSTANTS["stop_confirm_ms"].high / 1000, CONSTANTS["checkpoint_deadline_ms"].high / 1000)
    most_s = sum((*bounds, GUIDANCE_S, WITHDRAW_S, JOIN_S, KILLED_S, FLUSH_S))
    assert float(service["TimeoutStopSec"].removesuffix("s")) > most_s


def test_words_come_from_where_what_is_asked_for_is_shown(service):
    assert {service[f"Standard{stream}"] for stream in ("Input", "Output", "Error")} == {"tty"}
    assert service["TTYPath"].startswith("/dev/tty")


def test_key_and_logs_are_nobody_elses(service):
    assert service["User"] != "root"
    assert int(service["UMask"], 8) & 0o077 == 0o077
    assert int(service["StateDirectoryMode"], 8) & 0o077 == 0


def test_the_loop_has_a_priority_that_there_is_and_the_verification_gives_it_back(service, monkeypatch):
    policy = getattr(os, f"SCHED_{service['CPUSchedulingPolicy'].upper()}")
    least, most = os.sched_get_priority_min(policy), os.sched_get_priority_max(policy)
    assert least < int(service["CPUSchedulingPriority"]) < most // 2
    assert "CPUSchedulingResetOnFork" not in service, "the threads of the loop's own process keep it"
    for held, given_back in (
        (policy, True),
        (policy | os.SCHED_RESET_ON_FORK, True),
        (os.SCHED_BATCH, False),
    ):
        told = []
        monkeypatch.setattr(os, "sched_getscheduler", lambda _pid, held=held: held)
        monkeypatch.setattr(os, "sched_setscheduler", lambda *words, told=told: told.append(words))
        give_priority_back(7)
        assert [(pid, policy) for pid, policy, _ in told] == [(7, os.SCHED_OTHER)] * given_back


def test_a_verification_process_that_has_ended_keeps_nobody_from_going_on(monkeypatch):
    def gone(_pid):
        raise ProcessLookupError

    monkeypatch.setattr(os, "sched_getscheduler", gone)
    give_priority_back(7)


def test_the_page_says_why_each_line_that_matters_is_as_it_is(service):
    page = PAGE.read_text(encoding="utf-8")
    left_to_systemds_own = {
        "Type",
        "ExecStart",
        "WorkingDirectory",
        "StateDirectoryMode",
        "TTYReset",
        "SendSIGHUP",
        "StandardError",
    }
    assert [name for name in service if name not in left_to_systemds_own and f"`{name}" not in page] == []


@pytest.mark.processes
@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="this machine has no systemd-analyze")
def test_systemd_finds_nothing_wrong_with_it(tmp_path):
    program = tmp_path / "cutgate"
    program.write_text("#!/bin/sh\n", encoding="utf-8")
    program.chmod(0o700)
    here = tmp_path / UNIT.name
    here.write_text(
        UNIT.read_text(encoding="utf-8").replace("/opt/cutgate/bin/cutgate", str(program)), encoding="utf-8"
    )
    done = subprocess.run(
        ["systemd-analyze", "verify", here], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr.strip()) == (0, "")
