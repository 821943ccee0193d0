"""What is looked at after a session on real SocketCAN, whatever became of it."""

from collections.abc import Collection

from cutgate.protocol.frames import ControllerFault
from cutgate.protocol.states import LATCHING, StopCause
from cutgate.runtime.commands.app import execute
from tests.system.harness import POSES, SITE, decoded, moved_after, state_of


def assert_sound(log, capsys) -> None:
    """What a reviewer does with a log: verify it, and decide again."""
    capsys.readouterr()
    assert execute(["audit", "verify", str(log)]) == 0
    assert execute(["audit", "replay", str(log)]) == 0
    said = capsys.readouterr().out
    assert said.startswith("OK (signed, key ")
    assert "IDENTICAL" in said


def assert_cut(rig, sim, run, capsys) -> None:
    """Every segment is cut, and the log is sound."""
    assert run.exit() == 0, run.told
    assert f"DONE: {POSES - 1} segments executed" in sim.line("state DONE")
    sim.line("state INHIBITED$")
    assert_sound(rig.logs()[-1], capsys)


def assert_stopped(rig, sim, run, causes: Collection[StopCause], capsys) -> None:
    """A cut that was disturbed has stopped for one of these causes on both sides; nothing moved again; the log is sound.

    The rig's bus is where the controller's own frames leave.
    """
    assert run.exit() == 3, run.told
    fault = rig.bus.single(ControllerFault)
    sim.line("state (INHIBITED|FAULT)")
    log = rig.log()
    found = StopCause[log.of("/audit/decision")[-1]["first_out"]]
    assert {found, decoded(fault).cause} <= set(causes), run.told
    assert_sound(rig.logs()[-1], capsys)
    ends = {f"{'FAULT' if cause in LATCHING else 'INHIBITED'} ({cause.name})" for cause in causes}
    assert state_of(sim) in ends
    assert not moved_after(rig, fault.timestamp)
    assert "state DONE" not in sim.told


def assert_not_permitted(rig, sim, run, capsys) -> None:
    """No session came as far as a permit; what was logged of it is sound."""
    assert run.exit() in {1, 3}, run.told
    assert "permitted:" not in run.told
    for log in rig.logs():
        assert_sound(log, capsys)
    sim.listen()
    assert "state PERMITTED" not in sim.told
    assert not moved_after(rig, 0.0)


def hurried(rig) -> None:
    """What never comes is waited for a second, not for half a minute."""
    text = SITE.replace("[timing]\n", "[timing]\nannounce_wait_s = 1\ntransfer_timeout_s = 1\n")
    (rig.folder / "site.toml").write_text(text, encoding="utf-8")
