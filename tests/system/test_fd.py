"""CAN FD between real processes: bulk records in FD frames, and a side that is not set to it."""

import pytest

from cutgate.protocol.frames import BULK_IDS
from cutgate.runtime.audit.inspect import Status
from tests.system.harness import POSES, SITE

pytestmark = pytest.mark.processes


def test_a_session_over_fd_cuts_every_segment_with_bulk_frames_alone_as_fd(rig):
    (rig.folder / "site.toml").write_text(f"{SITE}[bus]\nfd = true\n", encoding="utf-8")
    run, sim = rig.run(), rig.sim(scale=30, fd=True)
    run.line("permitted:")
    rig.begin(sim, run)
    assert run.exit() == 0
    assert f"DONE: {POSES - 1} segments executed" in sim.line("state DONE")
    assert rig.log().report.status is Status.OK
    seen = rig.bus.frames
    assert all(m.is_fd is m.bitrate_switch is (m.arbitration_id in BULK_IDS) for m in seen)
    assert max(m.dlc for m in seen) == 64
    assert max(m.dlc for m in seen if not m.is_fd) == 8


@pytest.mark.parametrize(("runtime", "controller"), [(True, False), (False, True)])
def test_fd_on_one_side_alone_ends_in_words_before_anything_is_uploaded(rig, runtime, controller):
    sim, run = rig.sim(fd=controller), rig.run(fd=runtime)
    assert run.exit() == 3
    assert "TRANSFER_FAILED" in run.document
    assert "limits, calibration and tool did not arrive" in run.document
    assert rig.at_rest(sim) == "INHIBITED (TRANSFER_FAILED)"
    assert rig.log().report.status is Status.OK
