"""A whole session, from announcement to the closed log."""

import json
import re
from pathlib import Path

import pytest
from mcap.reader import make_reader

from cutgate.config.session_keys import load_review_key
from cutgate.protocol import records
from cutgate.protocol.frames import CONTROL_IDS, Joints01, RuntimeStop
from cutgate.protocol.states import StopCode
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.audit.recomputed.authenticated import CodesFound, check_codes
from cutgate.runtime.audit.replay import ReplayOutcome, replay
from cutgate.runtime.commands.app import execute
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified
from tests.system.harness import FAST, POSES, ROBOT, is_kind, judged, registration
from tests.tool_paths import tool_path

pytestmark = pytest.mark.processes


def reviewed(path: Path) -> tuple[Status, ReplayOutcome]:
    """What ``audit verify`` and ``audit replay`` say of a log."""
    log = judged(path)
    return log.report.status, replay(log, certified.verify, verifier=VERIFIER).outcome


def codes_of(path: Path, key: Path) -> CodesFound:
    """What becomes of a session's codes under the key of a file."""
    with reading(path) as log, path.with_suffix(".candump.log").open("rb") as frames:
        return check_codes(log, frames, load_review_key(key))


def test_a_session_cuts_every_segment_and_leaves_a_sound_log(rig, capsys):
    run, sim = rig.run(json=True, fresh=True), rig.sim(scale=FAST, fresh=True)
    run.line("permitted:")
    rig.begin(sim, run)
    assert run.exit() == 0
    assert f"DONE: {POSES - 1} segments executed" in sim.line("state DONE")
    assert rig.at_rest(sim) == "INHIBITED"

    document = json.loads(run.document)
    log = Path(document["log"]["mcap"])
    assert document["schema"] == "cutgate.run/1"
    assert (document["outcome"], document["cause"], document["log"]["closed"]) == ("completed", "NONE", True)
    assert document["verdict"]["verdict"] == "admissible"
    assert [log] == rig.logs()

    assert execute(["audit", "verify", str(log)]) == 0
    assert capsys.readouterr().out.startswith("OK (signed, key ")
    assert execute(["audit", "replay", str(log)]) == 0
    assert "IDENTICAL" in capsys.readouterr().out
    keys = rig.folder / "session.json"
    assert execute(["key", "session", str(log), "--key", str(rig.folder / "site.key"), "-o", str(keys)]) == 0
    assert codes_of(log, keys).answer == codes_of(log, rig.folder / "site.key").answer == "yes"
    assert codes_of(log, keys).notes == ()

    with log.open("rb") as file:  # the stock reader, as anyone would use it
        reader = make_reader(file, validate_crcs=True)
        decisions = [json.loads(m.data) for _, _, m in reader.iter_messages(topics=["/audit/decision"])]
        attached = {attachment.name for attachment in reader.iter_attachments()}
    assert decisions[-1]["to_state"] == "done"
    assert {"robot.toml", "site.toml", "registration.json", "path.bin", "cutgate.dbc"} <= attached


@pytest.mark.parametrize("joints", [None, "40,30,400,-120,80"])
def test_the_arm_comes_from_wherever_it_stands_and_goes_back_there(rig, joints):
    sim, run = rig.sim(scale=4 * FAST, joints=joints), rig.run(json=True)
    run.line("permitted:")
    rig.begin(sim, run)
    assert run.exit() == 0
    assert f"DONE: {POSES - 1} segments executed" in sim.line("state DONE")
    first, last = ([bytes(m.data[3:]) for m in rig.bus.frames if is_kind(m, Joints01)][i] for i in (0, -1))
    assert first == last
    assert json.loads(run.document)["approach"]["verdict"] == "admissible"
    assert reviewed(rig.logs()[-1]) == (Status.OK, ReplayOutcome.IDENTICAL)


def test_an_approach_that_violates_a_deadband_is_not_admitted(rig):
    run, sim = rig.run(), rig.sim(joints="0,70,52,0,55")
    assert run.exit() == 1
    assert "approach and retract INADMISSIBLE" in run.document
    assert "move q2 by +3.51 mm, to 55.51 mm" in run.document.partition("NOT ADMITTED")[2]
    assert rig.at_rest(sim) == "INHIBITED"
    assert reviewed(rig.logs()[-1]) == (Status.OK, ReplayOutcome.IDENTICAL)
    assert "state PERMITTED" not in sim.told


def test_a_roll_without_limits_runs_a_whole_session_in_the_turns_that_were_asked_for(rig):
    """What must fit a joints frame is where the arm goes, not what its limits allow."""
    robot = rig.folder / "unlimited.toml"
    text = re.sub(r"q3_deg = .*", "q3_deg = [-36000, 36000]", ROBOT.read_text(encoding="utf-8"))
    robot.write_text(text, encoding="utf-8")
    run, sim = rig.run(robot=robot, more=["--roll-turns", "2"]), rig.sim(robot=robot, scale=8 * FAST)
    run.line("permitted:")
    assert re.search(r"the approach moves q0 .*, q3 \+7\d\d\.\d deg \(2\.0 turns\)", run.told)
    assert "WARNING q3 turns 2.0 times on the approach" in run.told
    assert "--roll-turns 0 is nearest to where the arm stands (the path fits in -6 to 6)" in run.told
    rig.begin(sim, run)
    assert run.exit() == 0
    assert f"DONE: {POSES - 1} segments executed" in sim.line("state DONE")
    (verdict,), (opened,) = (list(rig.log().of(topic)) for topic in ("/audit/verdict", "/audit/open"))
    assert (verdict["q0_turns"], verdict["roll_turns"]) == (0, 2)
    assert {"name": "joint branch", "value": "asked for: --roll-turns 2"} in opened["simulation"]
    assert reviewed(rig.logs()[-1]) == (Status.OK, ReplayOutcome.IDENTICAL)


def test_the_unlimited_arm_of_the_paper_runs_a_whole_session(rig):
    run, sim = rig.run(robot=Path("figure2")), rig.sim(robot=Path("figure2"), scale=8 * FAST)
    run.line("permitted:")
    rig.begin(sim, run)
    assert run.exit() == 0
    assert f"DONE: {POSES - 1} segments executed" in sim.line("state DONE")


def test_the_bus_saw_one_permit_one_start_and_an_orderly_end(rig):
    sim, run = rig.cutting(scale=FAST)
    assert run.exit() == 0
    rig.at_rest(sim)
    kinds = [type(envelope.record) for envelope in rig.bus.records(CONTROL_IDS[0])]
    assert kinds == [
        records.Open,
        records.Collect,
        records.NonceRequest,
        records.Permit,
        records.NonceRequest,
        records.Start,
    ]
    assert [stop.code for _, stop in rig.bus.all(RuntimeStop)] == [StopCode.END]


@pytest.mark.parametrize(("name", "poses"), [("blade-channel.csv", 561), ("impeller-blade.csv", 484)])
def test_a_five_axis_path_is_cut_to_its_end(rig, name, poses):
    placed = registration("placed", (600, 0, 200))
    (rig.folder / "placed.json").write_text(json.dumps(placed), encoding="utf-8")
    sim, run = rig.cutting(scale=100, plan=tool_path(name), registration="placed.json")
    assert run.exit() == 0
    assert f"DONE: {poses - 1} segments executed" in sim.line("state DONE")
    assert reviewed(rig.logs()[-1]) == (Status.OK, ReplayOutcome.IDENTICAL)


@pytest.mark.parametrize("name", ["whole-wheel.csv", "impeller-op1.csv"])
def test_a_path_that_goes_round_is_not_admitted(rig, name):
    placed = registration("placed", (600, 0, 200))
    (rig.folder / "placed.json").write_text(json.dumps(placed), encoding="utf-8")
    run, sim = rig.run(plan=tool_path(name), registration="placed.json"), rig.sim()
    assert run.exit() == 1
    assert "INADMISSIBLE" in run.document
    assert "roll_m" in run.document.partition("NOT ADMITTED")[2]
    assert rig.at_rest(sim) == "INHIBITED"
    assert reviewed(rig.logs()[-1]) == (Status.OK, ReplayOutcome.IDENTICAL)
    assert "state PERMITTED" not in sim.told
