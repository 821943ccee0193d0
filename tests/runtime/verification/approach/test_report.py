"""What becomes of the answer."""

import json
import math

import numpy as np
import pytest

from cutgate.firmware_sim.kinematics import as_joints
from cutgate.protocol import records
from cutgate.runtime.verification.approach import report
from cutgate.runtime.verification.approach.decision import verify
from cutgate.runtime.verification.approach.model import ApproachVerdict, LegVerdict, StartJoints
from cutgate.runtime.verification.verdict import Boundary
from tests.runtime.verification.approach.cuts import MIDDLE, cut
from tests.runtime.verification.cases import DEG


def test_the_document_is_finite_and_says_what_was_verified():
    for start in (MIDDLE, np.array([2.0, *MIDDLE[1:]])):
        given_start = StartJoints(start, 10_000, 0.5, 0.2 * DEG)
        verdict = verify(cut(), given_start)
        text = json.dumps(report.document(verdict, given_start), allow_nan=False)
        document = json.loads(text)
        assert document["verdict"] == ("admissible" if verdict.admissible else "inadmissible")
        assert document["start_joints"] == pytest.approx([*np.degrees(start[:2]), 250.0, 0.0, 55.0])
        assert set(document["legs"]) == {"approach", "entry", "exit", "retract"}
        assert document["reasons"] == list(verdict.reasons)


def test_what_is_bound_is_what_was_verified():
    verdict = verify(cut(), StartJoints(MIDDLE, 10_000))
    bound = report.bound(verdict, 40)
    assert isinstance(bound, records.Approach)
    assert as_joints(records.joints_to_memory(bound.entry_joints_u)) == as_joints(verdict.entry)
    assert as_joints(records.joints_to_memory(bound.exit_joints_u)) == as_joints(verdict.exit)
    assert (bound.entry_um, bound.exit_um, bound.speed_percent) == (verdict.entry_um, verdict.exit_um, 40)


def test_the_tightest_boundary_and_its_leg_are_named():
    verdict = verify(cut(), StartJoints(MIDDLE, 10_000))
    leg, tightest = report.worst(verdict)
    margins = {
        (one.name, b.name): b.certified / b.deadband for one in verdict.legs for b in one.boundaries.values()
    }
    assert margins[leg, tightest.name] == min(margins.values())
    assert report.summary(verdict) == (
        f"every leg keeps every deadband; tightest is {tightest.name} on the {leg}, "
        f"{tightest.certified:.3f} {tightest.unit} with {tightest.deadband:g} {tightest.unit} required"
    )


def test_an_undefined_boundary_is_the_worst_and_reasons_are_the_summary():
    verdict = verify(cut(), StartJoints(np.array([2.0, *MIDDLE[1:]]), 10_000))
    assert report.worst(verdict)[1].certified is None
    assert report.summary(verdict) == "; ".join(verdict.reasons)
    assert report.bound(verdict, 25) is None


def test_an_answer_without_legs_has_no_worst():
    none = ApproachVerdict(True, 0, 0, None, None, (), ())
    assert report.worst(none) is None
    assert report.summary(none) == "every leg keeps every deadband"
    assert report.bound(none, 25) is None


def test_joints_are_shown_in_deg_and_mm_and_not_at_all_where_they_are_not_finite():
    assert report.shown(np.array([math.pi, 0.0, 12.5, math.nan, -math.inf])) == [180.0, 0.0, 12.5, None, None]
    assert (
        report.document(ApproachVerdict(False, 0, 0, None, None, (), ("so",)), StartJoints(MIDDLE, 0))[
            "entry_joints"
        ]
        is None
    )


def by_hand():
    """Two legs: the second's boundary keeps more mm and fewer deadbands."""
    inner = Boundary("inner", "mm", 3.25, 3.0, None, 0.5, None, 2.0, violated=False)
    pitch = Boundary("pitch_min", "deg", 6.5, 6.0, None, 0.25, None, 5.0, violated=False)
    legs = (LegVerdict("approach", {"inner": inner}, ()), LegVerdict("exit", {"pitch_min": pitch}, ("so",)))
    return ApproachVerdict(
        True, 10_500, 20_000, np.radians([1.0, 2.0, 0.0, 4.0, 5.0]), None, legs, ("so", "and so")
    )


def test_the_least_margin_is_per_deadband():
    leg, boundary = report.worst(by_hand())
    assert (leg, boundary.name) == ("exit", "pitch_min")


def test_the_document_has_all_of_the_answer():
    start = StartJoints(np.array([0.0, 0.0, 250.0, math.pi, 0.0]), 10_000, 0.5, math.pi / 2)
    document = report.document(by_hand(), start)
    assert document.pop("entry_joints") == pytest.approx([1.0, 2.0, 0.0, 4.0, 5.0])
    assert document == {
        "schema": "cutgate.approach/1",
        "verdict": "admissible",
        "clearance_um": 10_000,
        "start_tolerance_mm": 0.5,
        "start_tolerance_deg": 90.0,
        "start_joints": [0.0, 0.0, 250.0, 180.0, 0.0],
        "entry_um": 10_500,
        "exit_um": 20_000,
        "exit_joints": None,
        "legs": {
            "approach": {
                "inner": {
                    "unit": "mm",
                    "clearance": 3.25,
                    "certified": 3.0,
                    "deadband": 2.0,
                    "fraction": 0.5,
                    "violated": False,
                }
            },
            "exit": {
                "pitch_min": {
                    "unit": "deg",
                    "clearance": 6.5,
                    "certified": 6.0,
                    "deadband": 5.0,
                    "fraction": 0.25,
                    "violated": False,
                }
            },
        },
        "reasons": ["so", "and so"],
    }
