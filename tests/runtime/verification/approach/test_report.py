"""What becomes of the answer."""

import json

import numpy as np
import pytest

from cutgate.firmware_sim.kinematics import as_joints
from cutgate.protocol import records
from cutgate.runtime.verification.approach import report
from cutgate.runtime.verification.approach.decision import verify
from cutgate.runtime.verification.approach.model import Start
from tests.runtime.verification.approach.cuts import MIDDLE, cut
from tests.runtime.verification.cases import DEG


def test_the_document_is_finite_and_says_what_was_verified():
    for start in (MIDDLE, np.array([2.0, *MIDDLE[1:]])):
        given_start = Start(start, 10_000, 0.5, 0.2 * DEG)
        verdict = verify(cut(), given_start)
        text = json.dumps(report.document(verdict, given_start), allow_nan=False)
        document = json.loads(text)
        assert document["verdict"] == ("admissible" if verdict.admissible else "inadmissible")
        assert document["start_joints"] == pytest.approx([*np.degrees(start[:2]), 250.0, 0.0, 55.0])
        assert set(document["legs"]) == {"approach", "entry", "exit", "retract"}
        assert document["reasons"] == list(verdict.reasons)


def test_what_is_bound_is_what_was_verified():
    verdict = verify(cut(), Start(MIDDLE, 10_000))
    bound = report.bound(verdict, 40)
    assert isinstance(bound, records.Approach)
    assert as_joints(records.joints_to_memory(bound.entry_joints_u)) == as_joints(verdict.entry)
    assert as_joints(records.joints_to_memory(bound.exit_joints_u)) == as_joints(verdict.exit)
    assert (bound.entry_um, bound.exit_um, bound.speed_percent) == (verdict.entry_um, verdict.exit_um, 40)
