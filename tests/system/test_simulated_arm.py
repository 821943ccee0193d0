"""The simulated arm as a process: with mass, another one than it reports, and without power for a while."""

import pytest

from tests.system.harness import FAST, POSES, ROBOT

pytestmark = pytest.mark.processes


def test_an_arm_with_mass_that_is_another_one_than_it_reports_cuts_and_says_how_near_it_came(rig):
    true = rig.folder / "true.toml"
    text = ROBOT.read_text(encoding="utf-8")
    assert "upper_link_mm = 450.0" in text
    true.write_text(text.replace("upper_link_mm = 450.0", "upper_link_mm = 449.0"), encoding="utf-8")
    run = rig.run()
    sim = rig.sim(scale=10, more=["--dynamics", "--true-calibration", str(true)])
    run.line("permitted:")
    rig.begin(sim, run)
    assert run.exit() == 0
    sim.line("least distances of the true arm in the cut: inner ")
    assert "was up to 1.000 mm from" in sim.line("the true wrist centre")
    assert f"DONE: {POSES - 1} segments executed" in sim.line("state DONE")


def test_after_a_loss_of_power_the_next_session_cuts(rig):
    run, sim = rig.run(), rig.sim("power-loss@permitted", scale=FAST)
    assert run.exit() == 3
    assert "HEARTBEAT_LOST" in run.told
    sim.line("power is back")
    again = rig.run()
    again.line("permitted:")
    rig.begin(sim, again)
    assert again.exit() == 0
