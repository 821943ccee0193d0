"""A disk that never answers again: nothing that enables leaves, what stops leaves at once."""

import os
import shutil
import subprocess
from contextlib import suppress

import pytest

from cutgate.protocol import records
from cutgate.protocol.frames import ControllerHeartbeat, RuntimeHeartbeat, RuntimeStop
from cutgate.protocol.states import RuntimeCode, StopCause
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.interlock.state import Phase
from tests.system.children import Script
from tests.system.harness import FAST, HEARTBEAT_S, Rig, begins

pytestmark = pytest.mark.processes

AT_ONCE = 2
"""Heartbeats: one that was on its way, and one that was due with the word."""
LOST = round(2.0 / HEARTBEAT_S)
"""Heartbeats: with the next chunk, a second later at most, and its way to the disk."""


def test_no_permit_leaves_and_the_session_fails(rig):
    run, sim = rig.run(script=Script(disk_stops_at=Phase.VERIFYING)), rig.sim()
    run.line("permit authorised, its record is being made durable")
    run.line("STOP sent: the permit's record did not reach the disk")
    sim.line(r"state FAULT \(AUDIT_FAILED\)")
    assert not any(begins(message, records.Permit) for message in rig.bus.frames)
    assert {beat.code for _, beat in rig.bus.all(RuntimeHeartbeat)} == {RuntimeCode.INHIBIT}
    assert not any(beat.cutting_mode for _, beat in rig.bus.all(ControllerHeartbeat))


@pytest.mark.parametrize("phase", [Phase.AUTHORISING_PERMIT, Phase.AUTHORISING_START, Phase.CUTTING])
def test_the_stop_leaves_within_a_heartbeat_of_the_word(rig, phase):
    stuck = Phase.PERMITTED if phase is Phase.AUTHORISING_START else phase
    script = Script(disk_stops_at=Phase.VERIFYING if phase is Phase.AUTHORISING_PERMIT else stuck)
    run, sim = rig.run(script=script), rig.sim()
    if phase is not Phase.AUTHORISING_PERMIT:
        run.line("permitted:")
        sim.say("hold")
        run.line("say start$")
        run.say("start")
    run.line(
        {Phase.AUTHORISING_PERMIT: "permit auth", Phase.AUTHORISING_START: "start auth"}.get(
            phase, "cutting$"
        )
    )
    said = len(rig.bus.frames)
    run.say("stop")
    left = rig.bus.single(RuntimeStop)
    assert rig.bus.beats(RuntimeHeartbeat, after=said, before=left) <= AT_ONCE
    sim.line(r"state INHIBITED \(OPERATOR_STOP\)")
    assert not any(begins(m, records.Start) for m in rig.bus.frames) or phase is Phase.CUTTING
    assert rig.bus.all(RuntimeStop)[0][1].cause is StopCause.OPERATOR_STOP


# ---------------------------------------------------------------- a log that is lost


def live(rig):
    """The log that is being written."""
    return rig.logs()[-1]


def overwrite(log):
    with log.open("r+b") as file:
        file.seek(100)
        file.write(b"something else")


def rm_r(folder):
    """As the command does: what the session itself removes meanwhile is none of its business."""
    shutil.rmtree(folder, ignore_errors=True)
    assert not folder.exists()


ACTS = {
    "rm -r": (lambda log: rm_r(log.parent), "was deleted"),
    "mv the folder": (lambda log: log.parent.rename(log.parent.with_name("moved")), "was renamed or moved"),
    "rm": (lambda log: log.unlink(), "mcap was deleted"),
    "mv": (lambda log: log.rename(log.with_name("moved")), "mcap was renamed or moved"),
    "truncate": (lambda log: os.truncate(log, 0), "mcap was cut to 0 bytes"),
    "cp and mv": (lambda log: shutil.copy(log, log.with_name("x")).rename(log), "another file was put in its place"),
    "dd conv=notrunc": (overwrite, "mcap was overwritten"),
    "rm the raw frames": (lambda log: log.with_suffix(".candump.log").unlink(), "candump.log was deleted"),
}  # fmt: skip


@pytest.mark.parametrize("act", ACTS)
def test_no_start_leaves_once_the_log_is_lost(rig, act):
    lose, told = ACTS[act]
    sim, run = rig.permitted()
    lose(live(rig))
    sim.say("hold")
    run.line("enabling device is held|STOP sent")  # said before, start would be refused for the device
    run.say("start")
    assert run.exit() == 3
    assert told in run.told
    assert "AUDIT_FAILED" in sim.line(r"state FAULT")
    assert not any(begins(message, records.Start) for message in rig.bus.frames)
    assert "NOT CLOSED" in run.told


@pytest.mark.parametrize("act", ACTS)
def test_a_cut_whose_log_is_lost_is_stopped(rig, act):
    lose, told = ACTS[act]
    sim, run = rig.cutting()
    log = live(rig)
    rig.until(lambda: log.with_suffix(".candump.log").stat().st_size)
    lost = len(rig.bus.frames)
    lose(log)
    stopped = rig.bus.single(RuntimeStop)
    assert rig.bus.beats(RuntimeHeartbeat, after=lost, before=stopped) <= LOST
    assert run.exit() == 3
    assert told in run.told
    assert rig.at_rest(sim) == "FAULT (AUDIT_FAILED)"


def test_a_log_that_is_lost_after_the_cut_makes_it_no_success(rig):
    """The retract has ended, the log is not closed yet: the last turn waits for a disk that is slow."""
    run, sim = rig.run(script=Script(sync_s=0.3)), rig.sim(scale=FAST)
    run.line("permitted:")
    sim.say("hold")
    run.line("enabling device is held")
    run.say("start")
    sim.line("state DONE")
    rm_r(live(rig).parent)
    assert run.exit() == 3
    assert "was deleted" in run.told


# ---------------------------------------------------------------- a disk that another program fills


@pytest.fixture
def small_disk(tmp_path):
    """A file system of its own for the logs."""
    folder = tmp_path / "logs"
    folder.mkdir()
    mounted = ["mount", "-t", "tmpfs", "-o", "size=64m", "none", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mounted, check=False, capture_output=True).returncode:
        pytest.skip("only root mounts a file system, and not everywhere")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(folder):
    """Take every byte that is free."""
    with (folder / "another program's").open("wb", buffering=0) as file, suppress(OSError):
        while file.write(bytes(1 << 16)):
            pass
    assert os.statvfs(folder).f_bavail == 0


def test_a_cut_that_was_permitted_ends_though_another_program_fills_the_disk(small_disk, tmp_path):
    with Rig(tmp_path) as rig:
        sim, run = rig.cutting(scale=4)
        fill(small_disk)
        assert run.exit() == 0
        assert rig.at_rest(sim) == "INHIBITED"
        assert rig.log().report.status is Status.OK


@pytest.mark.parametrize("left", [0, 1 << 20])
def test_a_disk_that_another_program_has_filled_lets_no_permit_leave(small_disk, tmp_path, left):
    with Rig(tmp_path) as rig:
        fill(small_disk)
        os.truncate(
            small_disk / "another program's", (small_disk / "another program's").stat().st_size - left
        )
        rig.sim()
        run = rig.run()
        assert run.exit() in ((1, 3) if left else (2,))
        assert "free" in run.told
        assert not any(begins(message, records.Permit) for message in rig.bus.frames)
