"""Where things are: the arm's points by another kinematics, the path and its worst places by the verdict."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.firmware_sim.kinematics import as_joints, calibrated_arm, forward
from cutgate.protocol import records as wire
from cutgate.runtime.audit import names
from cutgate.runtime.audit.reading import reading
from cutgate.runtime.audit.records import AuditVerdict, boundaries_of
from cutgate.runtime.commands.foxglove.known import known_of
from cutgate.runtime.commands.report.place import along_the_path, arm_points, place_document


@pytest.fixture(scope="module", params=["cut", "refused"])
def found(request, logs):
    """What is known of a session, its verdict's document, and the controller's records."""
    with reading(logs[request.param]) as log:
        known, _, missing = known_of(log, "x.mcap")
        assert not missing
        verdict = json.loads(log.of(AuditVerdict.TOPIC)[-1]["document"])
        attached = {
            name: log.scan.attachment(name).data for name in (names.CALIBRATION, names.TOOL, names.PATH)
        }
    return known, verdict, attached


@given(st.tuples(*[st.floats(-2.0, 2.0)] * 5))
def test_the_arms_points_are_those_of_the_simulated_arm(found, joints):
    known, _, attached = found
    tool = wire.Tool.parse(attached[names.TOOL])
    arm = calibrated_arm(
        wire.Calibration.parse(attached[names.CALIBRATION]), tool_mm=tool.length_mm, elbow="right"
    )
    joints = np.array(joints) * [1.0, 1.0, 200.0, 1.0, 1.0]
    pose = forward(arm, as_joints(joints))
    slide, elbow, wrist, tip = arm_points(known.arm, joints)
    assert math.dist(tip, pose.tip) < 1e-9
    axis = (wrist - tip) / tool.length_mm
    assert math.dist(axis, pose.axis) < 1e-9
    assert math.isclose(math.dist(slide, elbow), known.arm.upper_mm)
    assert math.isclose(math.dist(elbow, wrist), known.arm.forearm_mm)


def test_the_path_is_the_uploaded_one_and_its_length_the_verdicts(found):
    known, verdict, attached = found
    document = place_document(known.decision, known.arm)
    tips = np.array(document["tip"]).reshape(-1, 3)
    uploaded = wire.Path.parse(attached[names.PATH]).tips_mm
    assert np.allclose(tips[[0, -1]], uploaded[[0, -1]], atol=0.011)
    assert math.isclose(document["length"][-1], verdict["path"]["tip_length_mm"], abs_tol=0.2)
    assert len(document["wrist"]) == len(document["tip"]) == 3 * len(document["pose"])
    assert (
        len(document["shade"])
        == len(document["ratio"])
        == len(document["limiting"])
        == len(document["pose"]) - 1
    )


def test_a_clearance_is_never_shown_as_more_than_the_path_has(found):
    """Points of the path may have more than the bound that is proved of all of it, the least of them hardly more."""
    known, verdict, _ = found
    document = place_document(known.decision, known.arm)
    proved = [one.certified / one.deadband for one in boundaries_of(verdict) if one.certified is not None]
    shown = [ratio for ratio in document["ratio"] if ratio is not None]
    assert -0.001 <= min(shown) - min(proved) < 0.3


def test_what_violates_is_marked_and_nothing_else(found):
    known, verdict, _ = found
    document = place_document(known.decision, known.arm)
    violated = {name for name, entry in verdict["boundaries"].items() if entry["violated"]}
    told = " ".join(one["text"] for one in document["worst"] if one["violated"])
    placed = {name for name in violated if verdict["boundaries"][name]["segment"] is not None}
    assert all(name in told for name in placed)
    assert any(one["violated"] for one in document["worst"]) is bool(placed)
    assert (min(document["shade"]) < 0) is (verdict["verdict"] == "inadmissible")


def test_along_the_path_every_boundary_has_its_curve_and_the_deadband_is_one(found):
    plot = along_the_path(found[0].decision)
    assert [series["name"] for series in plot["series"]] == list(found[0].decision.scene.names)
    assert plot["lines"] == [{"name": "deadband", "value": 1.0}]
    assert plot["x"] == sorted(plot["x"])
