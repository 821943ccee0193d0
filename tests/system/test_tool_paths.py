"""A session whose cut comes from a tool path file: how it was read stands in the log, and a replay reads it in the same way."""

import json

import pytest

from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.names import READING
from cutgate.runtime.audit.recomputed.inputs import inputs_of, typed
from cutgate.runtime.audit.records import AuditOpen
from cutgate.runtime.audit.replay import ReplayOutcome, replay
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified
from tests.system.harness import FAST, judged, register

pytestmark = pytest.mark.processes

PROGRAM = """PARTNO/1
UNITS/MM
LOADTL/1
FEDRAT/1200.,MMPM
RAPID
GOTO/0.,0.,20.,0.5,0.,0.8660254
GOTO/0.,0.,0.,0.5,0.,0.8660254
CUTCOM/LEFT
CIRCLE/5.,0.,0.,0.,0.,1.
GOTO/10.,0.,0.,0.5,0.,0.8660254
CUTCOM/OFF
GOTO/10.,0.,20.,0.5,0.,0.8660254
FINI
"""


def test_a_cutter_location_file_is_cut_and_replayed(rig):
    path = rig.folder / "part.apt"
    path.write_text(PROGRAM)
    declared = ["--cutcom-is-tool-centre", "--arc-tolerance-mm", "0.05"]
    where = register(rig.folder, "placed", (620, 0, 200))
    run, sim = rig.run(plan=path, registration=where, json=True, more=declared), rig.sim(scale=FAST)
    run.line("permitted:")
    rig.begin(sim, run)
    assert run.exit() == 0
    assert json.loads(run.document)["verdict"]["deadband"]["arm_mm"] > 0.05

    log = judged(rig.logs()[-1])
    assert log.report.status is Status.OK
    assert log.scan.attachment("plan.apt") is not None
    kept = {option.name: option.value for option in typed(log, AuditOpen)[0].simulation}
    assert kept[READING] == "cutcom_is_tool_centre=true arc_tolerance_mm=0.05"
    found = inputs_of(log)
    wider = found.widened.deadband.path_tolerance_mm - found.robot.deadband.path_tolerance_mm
    assert 0.05 <= wider <= 0.0501
    assert replay(log, certified.verify, verifier=VERIFIER).outcome is ReplayOutcome.IDENTICAL


def test_a_file_of_two_tools_is_refused_before_anything_is_begun(rig):
    path = rig.folder / "two.apt"
    path.write_text(
        PROGRAM.replace(
            "FINI", "LOADTL/2\nGOTO/0.,0.,0.,0.5,0.,0.8660254\nGOTO/1.,0.,0.,0.5,0.,0.8660254\nFINI"
        )
    )
    run = rig.run(plan=path, more=["--cutcom-is-tool-centre"])
    assert run.exit() == 2
    assert "tool 1 from line 6, tool 2 from line 14" in run.told
    assert not rig.logs()
