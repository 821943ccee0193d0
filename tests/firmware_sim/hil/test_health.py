"""What the health check finds in a session, and what a marker lets it find."""

import pytest

from cutgate.firmware_sim.hil import health
from cutgate.firmware_sim.hil.health import FINDINGS, Expectation, HealthFinding, unexpected
from cutgate.protocol.states import StopCause


def names(findings):
    return [finding.name for finding in findings]


@pytest.mark.parametrize(
    ("document", "code", "found"),
    [
        ({"cause": "NONE"}, 0, []),
        ({"reason": "too far"}, 1, ["not-admitted"]),
        (None, 2, ["refused"]),
        ({"cause": "HEARTBEAT_LOST", "reason": "r"}, 3, ["HEARTBEAT_LOST"]),
        ({"cause": "of a later version", "reason": "r"}, 3, ["INTERNAL_ERROR"]),
        ({}, 70, ["INTERNAL_ERROR"]),
        (None, None, ["unfinished"]),
        ({"cause": "NONE"}, -9, ["unfinished"]),
    ],
)
def test_how_the_runtime_ended(document, code, found):
    assert names(health.of_outcome(document, code)) == found


def test_faults_are_found_by_their_cause():
    records = [
        {"source": "controller", "code": "STOPPED", "cause": "ESTOP_UNKNOWN"},
        {"source": "controller", "code": "STOPPED", "cause": "BONE_MOVED", "detail": "wired input"},
        {},
    ]
    assert list(map(str, health.of_faults(records))) == ["BONE_MOVED: fault of the controller: wired input"]


def test_error_frames_are_counted_and_dropped_frames_told_from_them():
    def frame(is_error, number, data):
        return {"is_error": is_error, "id": number, "data": data}

    records = [
        frame(False, 4, "0001"),
        frame(True, 4, "0001000000000005"),
        frame(True, 4, "0000"),
        frame(True, 4, "00"),
        frame(True, 8, "0001"),
        {},
    ]
    assert [(one.name, one.text[:1]) for one in health.of_frames(records)] == [
        ("overrun", "1"),
        ("error-frame", "3"),
    ]
    assert health.of_frames(records[:1]) == []


@pytest.mark.parametrize(
    ("gaps", "late"), [([10, 75.1], True), ([75.1, 10], True), ([75.0], False), ([], False)]
)
def test_a_loop_is_late_that_stood_still_for_three_quarters_of_the_time_out(gaps, late):
    records = [{"longest_gap_ms": gap, "timeout_ms": 100.0} for gap in gaps]
    assert names(health.of_timing(records)) == ["late-loop"] * late


LOST, LATE = HealthFinding("HEARTBEAT_LOST", "x"), HealthFinding("late-loop", "y")


@pytest.mark.parametrize(
    ("findings", "expected", "wrong"),
    [
        ([], [], []),
        ([LOST], [], ["HEARTBEAT_LOST: x"]),
        ([LOST], [Expectation(("HEARTBEAT_LOST",))], []),
        ([LOST], [Expectation(("CORRUPTION", "HEARTBEAT_LOST"))], []),
        ([LOST, LATE], [Expectation(("HEARTBEAT_LOST",))], ["late-loop: y"]),
        ([LOST, LATE], [Expectation(("HEARTBEAT_LOST",), ("late-loop",))], []),
        ([], [Expectation((), ("late-loop",))], []),
        (
            [],
            [Expectation(("CORRUPTION", "HEARTBEAT_LOST"))],
            ["expected and did not come: CORRUPTION or HEARTBEAT_LOST"],
        ),
        (
            [LOST],
            [Expectation(("HEARTBEAT_LOST",)), Expectation(("late-loop",))],
            ["expected and did not come: late-loop"],
        ),
    ],
)
def test_what_is_wrong_is_what_no_marker_allows_and_what_a_marker_waits_for_in_vain(
    findings, expected, wrong
):
    assert unexpected(findings, expected) == wrong


def test_a_marker_names_what_there_is():
    assert {cause.name for cause in StopCause} < set(FINDINGS)
    for wrong in ({"must": ("HEARTBEAT",)}, {"must": (), "may": ("late",)}):
        with pytest.raises(ValueError, match=r"is not known; use NONE, .*late-loop"):
            Expectation(**wrong)


def test_a_log_is_judged_by_its_records_whatever_else_is_in_it():
    fault = {"source": "controller", "code": "STOPPED", "cause": "BONE_MOVED"}
    late = {"longest_gap_ms": 90.0, "timeout_ms": 100.0}
    records = [
        ("/timing", late),
        ("/audit/fault", fault),
        ("/audit/open", fault),
        ("/can/frame", {"is_error": True}),
    ]
    assert names(health.of_log([], records)) == ["BONE_MOVED", "error-frame", "late-loop"]
    assert list(map(str, health.of_log(["a", "b"], iter(())))) == ["log: a; b"]


def test_the_stop_by_which_a_test_ends_is_no_second_finding():
    quit_, other = HealthFinding("OPERATOR_QUIT", "q"), HealthFinding("HEARTBEAT_LOST", "h")
    for unfinished, left in ((True, [other]), (False, [quit_, other])):
        assert health.but_the_tests_end([quit_, other], unfinished=unfinished) == left
