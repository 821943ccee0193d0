"""The shipped plans: what their scripts write, how long they are, and that the example robot can cut them."""

import math
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from cutgate.config.load import EXAMPLES, InputError, load_robot
from cutgate.config.model import Site
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.examples import make_femoral
from cutgate.firmware_sim.arm import middle_of
from cutgate.runtime.plan.load import load_plan, load_registration
from cutgate.runtime.plan.prepare import prepare
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.approach import decision
from cutgate.runtime.verification.approach.model import StartJoints
from cutgate.runtime.verification.recorded import problem_from_records

SCRIPTS = {
    "make_hip_stem.py": {"hip-stem.plan.json", "registration-first.json", "registration-second.json"},
    "make_femoral.py": {"femoral.plan.json", "registration-femoral.json"},
    "make_tibial.py": {"tibial.plan.json", "registration-tibial.json"},
}
LENGTHS_MM = {"hip-stem": 5000.0, "femoral": 7000.0, "tibial": 3000.0}
"""Table 2 of the paper."""
REGISTRATIONS = {
    "hip-stem": "registration-second",
    "femoral": "registration-femoral",
    "tibial": "registration-tibial",
}
ROBOT = load_robot("example").value


def placed(name, shift_mm=(0.0, 0.0, 0.0)):
    """The problem of a shipped plan under its registration, the bone moved by ``shift_mm``."""
    registration = load_registration(REGISTRATIONS[name])
    moved = np.array(registration.value.R_T_CT) + np.pad(np.reshape(shift_mm, (3, 1)), ((0, 1), (3, 0)))
    rows = tuple(tuple(row) for row in moved.tolist())
    registration = replace(registration, value=registration.value.model_copy(update={"R_T_CT": rows}))
    ready = prepare(load_plan(name), registration, ROBOT, now=datetime.now(UTC), clock_skew_s=0.0)
    assert ready.ct_link == "linked"
    bodies = (limits_record(ROBOT).body(), calibration_record(ROBOT).body(), tool_record(ROBOT).body())
    return problem_from_records(ready.path.body(), *bodies, ROBOT, any_branch=True)


def test_every_shipped_plan_and_registration_has_a_script():
    assert set().union(*SCRIPTS.values()) == {path.name for path in EXAMPLES.glob("*.json")}


@pytest.mark.processes
@pytest.mark.parametrize(("script", "names"), SCRIPTS.items(), ids=SCRIPTS)
def test_the_files_come_out_of_their_script_byte_by_byte(script, names, tmp_path):
    subprocess.run([sys.executable, EXAMPLES / script, tmp_path], check=True, timeout=60)
    assert {path.name for path in tmp_path.iterdir()} == names
    for name in names:
        assert (tmp_path / name).read_bytes() == (EXAMPLES / name).read_bytes()
        assert len((tmp_path / name).read_bytes()) < 250_000


@pytest.mark.parametrize(("name", "length_mm"), LENGTHS_MM.items())
def test_paths_are_as_long_as_those_of_the_paper(name, length_mm):
    steps = np.linalg.norm(np.diff(load_plan(name).value.tips_mm, axis=0), axis=1)
    assert steps.sum() == pytest.approx(length_mm, rel=0.01)
    assert 0.0 < steps.min() <= steps.max() < 7.0
    assert steps.mean() == pytest.approx(2.5, abs=0.1)


@pytest.mark.parametrize("name", LENGTHS_MM)
def test_a_plan_is_admissible_with_room_to_spare(name):
    verdict = certified.verify(placed(name))
    assert verdict.admissible, verdict.reasons
    for boundary in verdict.boundaries.values():
        assert boundary.certified >= (20.0 if boundary.unit == "mm" else 10.0), boundary.name
    assert max(line.peak / line.limit for line in verdict.speed) <= 0.5


@pytest.mark.parametrize("name", LENGTHS_MM)
def test_the_simulated_arm_reaches_it_and_comes_back_from_where_it_stands_at_power_up(name):
    problem, site = placed(name), Site()
    branch = certified.verify(problem).branch
    start = StartJoints(
        np.array(middle_of(limits_record(ROBOT))),
        round(1000 * site.approach.approach_clearance_mm),
        site.start.start_tolerance_mm,
        math.radians(site.start.start_tolerance_deg),
    )
    found = decision.verify(replace(problem, branch=(branch.q0_turns, branch.roll_turns)), start)
    assert found.admissible, found.reasons


@pytest.mark.parametrize(
    ("name", "shift_mm", "boundary"),
    [
        ("femoral", (0.0, 0.0, 55.0), "top"),
        ("femoral", (0.0, 0.0, -110.0), "bottom"),
        ("femoral", (150.0, 200.0, 0.0), "outer"),
        ("tibial", (0.0, 0.0, 140.0), "top"),
        ("tibial", (200.0, 150.0, 0.0), "outer"),
        ("tibial", (-440.0, -120.0, 0.0), "inner"),
    ],
)
def test_the_bone_elsewhere_makes_it_inadmissible(name, shift_mm, boundary):
    verdict = certified.verify(placed(name, shift_mm))
    assert not verdict.admissible
    assert verdict.boundaries[boundary].violated


def test_femur_and_tibia_of_the_knee_are_not_mistaken_for_each_other():
    with pytest.raises(InputError, match=r"example-knee-tibia-ct.*example-knee-femur-ct"):
        prepare(
            load_plan("femoral"),
            load_registration("registration-tibial"),
            ROBOT,
            now=datetime.now(UTC),
            clock_skew_s=0.0,
        )


def outside_femur(places):
    """Distance of places (n, 3) from the finished femur, mm, seen from the side; it is convex."""
    names = ("ANTERIOR", "FRONT_CHAMFER", "DISTAL", "BACK_CHAMFER", "POSTERIOR")
    cuts = [getattr(make_femoral, name) for name in names]
    normals = [(math.sin(a), math.cos(a)) for a in (math.radians(cut.normal_deg) for cut in cuts)]
    out = [(places[:, 1:] - cut.first) @ normal for cut, normal in zip(cuts, normals, strict=True)]
    return np.max(out, axis=0)


def test_neither_cutter_nor_shank_enters_the_femur_that_stays():
    plan = load_plan("femoral").value
    holes = np.hypot(np.abs(plan.tips_mm[:, 0]) - make_femoral.PEG_X, plan.tips_mm[:, 1]) < 1.001
    cuts = ~(holes & (plan.axes[:, 2] == 1.0))
    for along_mm in np.linspace(0.0, 150.0, 31):
        places = (plan.tips_mm + along_mm * plan.axes)[cuts]
        assert outside_femur(places).min() >= make_femoral.CUTTER_RADIUS - 1e-3


def test_the_knees_paths_begin_and_end_far_outside_the_bone():
    assert outside_femur(load_plan("femoral").value.tips_mm[[0, -1]]).min() >= 30.0
    assert load_plan("tibial").value.tips_mm[[0, -1], 2].min() >= 30.0


@pytest.mark.processes
def test_the_tool_paths_of_the_tests_come_out_of_their_script_byte_by_byte(tmp_path):
    data = Path(__file__).parents[1] / "data"
    subprocess.run([sys.executable, data / "make_tool_paths.py", tmp_path], check=True, timeout=60)
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in data.glob("*.csv")}
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (data / path.name).read_bytes()
