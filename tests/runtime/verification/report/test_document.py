"""The verdict's JSON document."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from cutgate.runtime.verification.advice import Guidance, Move
from cutgate.runtime.verification.report.document import Digests, document_text, verdict_document
from cutgate.runtime.verification.verdict import Boundary, Evaluations, JointBranch, SpeedLine, Verdict
from tests.runtime.commands.contract import VerdictDocument

GOOD = Boundary("outer", "mm", 7.25, 7.2493, 3, 0.5, 12.5, 5.0, violated=False)
UNDEFINED = Boundary("roll_min", "deg", None, None, None, None, None, 2.0, violated=True)
VERDICT = Verdict(
    method="certified",
    admissible=False,
    tip_length_mm=100.0,
    wrist_length_mm=120.0,
    axis_angle_rad=math.pi,
    deadband_arm_mm=5.0,
    deadband_wrist_rad=math.radians(2.0),
    branch=JointBranch("right", 0, -1),
    evaluations=Evaluations(10, 12, 501),
    boundaries={"outer": GOOD, "roll_min": UNDEFINED},
    speed=(SpeedLine(0, 1.0, 0.25, 4, ok=True), SpeedLine(3, 2.0, math.inf, 7, ok=False)),
    reasons=("roll_min is undefined",),
)
MOVES = (
    Move("outer", "move", (-1.0, 0.0, 0.0), distance_mm=3.5),
    Move("roll_min", "turn", (0, 0, 1), angle_deg=2.5),
)
GUIDANCE = Guidance((-3.5, 0.25, 0.0), 0.0, (1.0, 2.0, 3.0), MOVES, 6.5, verified=True, text="inward")
DIGESTS = Digests(b"\x01" * 32, b"\x02" * 32, b"\x03" * 32, b"\xff" * 32)


def document(verdict=VERDICT, guidance=GUIDANCE, elapsed_ms=1.5):
    return verdict_document(verdict, poses=7, guidance=guidance, digests=DIGESTS, elapsed_ms=elapsed_ms)


def test_the_document_is_the_contracts():
    assert VerdictDocument.model_validate_json(document_text(document()))


def test_every_value_stands_where_the_contract_says():
    found = document()
    assert (found["verdict"], found["method"], found["schema"]) == (
        "inadmissible",
        "certified",
        "cutgate.verdict/1",
    )
    assert found["path"] == {
        "poses": 7,
        "tip_length_mm": 100.0,
        "wrist_length_mm": 120.0,
        "axis_angle_deg": 180.0,
    }
    assert found["deadband"] == {"arm_mm": 5.0, "wrist_deg": 2.0}
    assert found["branch"] == {"elbow": "right", "q0_turns": 0, "roll_turns": -1}
    assert found["evaluations"] == {"arm": 10, "wrist": 12, "worst_case": 501, "best_case": None}
    assert found["boundaries"]["outer"] == {
        "unit": "mm",
        "clearance": 7.25,
        "certified": 7.2493,
        "segment": 3,
        "fraction": 0.5,
        "tip_length_mm": 12.5,
        "violated": False,
    }
    assert found["speed"][0] == {"joint": 0, "limit": 1.0, "peak": 0.25, "segment": 4, "ok": True}
    assert found["guidance"]["moves"] == [
        {"boundary": "outer", "kind": "move", "direction": [-1, 0, 0], "distance_mm": 3.5},
        {"boundary": "roll_min", "kind": "turn", "direction": [0, 0, 1], "angle_deg": 2.5},
    ]
    assert found["digests"] == {
        "path": "01" * 32,
        "limits": "02" * 32,
        "calibration": "03" * 32,
        "registration": "ff" * 32,
    }


def test_a_joint_that_accelerates_too_much_is_not_ok_in_its_speed_line():
    """The contract's verdict follows from the boundaries and the speed lines alone."""
    speed = (SpeedLine(0, 1.0, 0.25, 4, ok=True), SpeedLine(1, 1.0, 0.25, 4, ok=True))
    hasty = (
        SpeedLine(0, 5.0, 6.0, 2, ok=False, quantity="acceleration"),
        SpeedLine(1, 5.0, 4.0, 2, ok=True, quantity="acceleration"),
    )
    found = document(replace(VERDICT, speed=speed, acceleration=hasty))
    assert [line["ok"] for line in found["speed"]] == [False, True]
    assert found["acceleration"][0] == {"joint": 0, "limit": 5.0, "peak": 6.0, "segment": 2, "ok": False}


def test_undefined_values_are_null():
    found = document(replace(VERDICT, branch=None), guidance=None)
    assert found["boundaries"]["roll_min"]["certified"] is None
    assert found["boundaries"]["roll_min"]["violated"] is True
    assert found["branch"] is found["guidance"] is None
    assert found["speed"][1]["peak"] is None
    assert document(guidance=replace(GUIDANCE, translation_mm=None))["guidance"]["translation_mm"] is None


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_nan_and_infinity_never_appear(value):
    boundary = replace(GOOD, clearance=value, certified=value, fraction=value, tip_length_mm=value)
    verdict = replace(VERDICT, boundaries={"outer": boundary}, wrist_length_mm=value, axis_angle_rad=value)
    text = document_text(document(verdict, elapsed_ms=value))
    assert "NaN" not in text
    assert "Infinity" not in text
    with pytest.raises(ValueError, match="JSON"):
        document_text({"x": value})


def test_numpy_numbers_become_plain_ones():
    boundary = replace(GOOD, clearance=np.float64(1.5), segment=np.int64(3), violated=np.bool_(False))
    text = document_text(document(replace(VERDICT, boundaries={"outer": boundary})))
    assert json.loads(text)["boundaries"]["outer"]["segment"] == 3
