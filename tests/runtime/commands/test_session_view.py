"""What a person is told while a session goes on."""

import numpy as np

from cutgate.runtime.commands.session_view import SessionView, approach_line
from cutgate.runtime.interlock.state import Phase, VerdictReady
from cutgate.runtime.verification.approach import Start, verify
from tests.runtime.interlock.builders import NOW, START_JOINTS, VERDICT, in_phase
from tests.runtime.verification.test_approach import MIDDLE, cut


def test_what_an_admitted_session_waits_for_is_named(capsys):
    moved = (*START_JOINTS[:2], START_JOINTS[2] + 3_000_000, *START_JOINTS[3:])
    before, after = in_phase(Phase.VERIFYING), in_phase(Phase.ADMITTED, joints_u=moved)
    SessionView(quiet_output=True).step(before, VerdictReady(VERDICT), after, (), NOW)
    told = capsys.readouterr().err
    assert "waiting for the permissives" in told
    assert "measured wrist centre to the verified start: 3 (required: <= 0.5 mm)" in told
    assert "move the arm back" in told


def test_an_approach_is_told_in_a_line_with_what_decided_it():
    good = approach_line(verify(cut(), Start(MIDDLE, 10_000))).plain
    assert good.startswith("approach and retract ADMISSIBLE, entry ")
    assert "tightest is " in good
    low = np.array([*MIDDLE[:2], 53.0, *MIDDLE[3:]])
    bad = approach_line(verify(cut(), Start(low, 10_000))).plain
    assert "INADMISSIBLE" in bad
    assert (
        "bottom: clearance 3.000000 mm, needs 5 mm at fraction 0.000000 of the line; let the arm start" in bad
    )
