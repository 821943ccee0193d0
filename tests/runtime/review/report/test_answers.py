"""The first screen: three answers in sentences, right for every way in which a session can end."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol.states import StopCause
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.audit.records import AuditOpen, TrackingSample
from cutgate.runtime.interlock.permissives import FOLLOWS
from cutgate.runtime.review.report.answers import DECIDED_OTHERWISE, NOT_BELIEVED, Fact, answers
from cutgate.runtime.review.report.measured import Measured, measured_of
from cutgate.runtime.review.stopped import WORDS
from cutgate.runtime.review.story import story
from tests.runtime.audit.build import forge, session_log
from tests.runtime.audit.test_replay import changed
from tests.runtime.interlock.builders import NOW, in_phase
from tests.runtime.review.report.test_cards import ANYTHING, FIELDS, LISTS, decided

SAME = Fact("Replay", "the same", True)


def of(told, status=Status.OK, replayed=SAME, measured=None):
    return answers(told, status, replayed, measured)


def sentences(found):
    return {key: " ".join(getattr(found, key)) for key in ("allowed", "stopped", "close")}


def holding(found, **expected):
    """Every one of these is said in its answer."""
    said = sentences(found)
    for key, texts in expected.items():
        for text in texts:
            assert text in said[key], (key, text, said[key])


def fact(found, name):
    return next(one for one in found.facts if one.name == name)


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("refused"), 850.0).log.read_bytes()


# ---------------------------------------------------------------- every way in which a session can end


def test_a_session_that_was_cut_to_its_end(told):
    found = of(told["finished"])
    assert found.outcome == "The path was allowed and cut to its end; nothing stopped it."
    assert found.good
    permit, start = (len(one["permissives"]) for one in told["finished"]["allowed"])
    holding(
        found,
        allowed=[
            f"The permit left at {told['finished']['allowed'][0]['offset_s']:.3f} s: {permit} of {permit} permissives held",
            f"The start left at {told['finished']['allowed'][1]['offset_s']:.3f} s: {start} of {start} permissives held",
            "Verdict: the whole path keeps every deadband",
        ],
        stopped=["Nothing: it came to its end."],
        close=[
            "As proved for the whole path before the cut, nearest was pitch_min: 40.000 deg (required: 2 deg)"
        ],
    )


def test_a_session_refused_by_the_verdict_says_where_the_bone_was_to_be_moved(told):
    found = of(told["refused"])
    guidance = told["refused"]["verdicts"][0]["guidance"]
    x, y, z = guidance["translation_mm"]
    assert found.outcome == "REFUSED: cutting was not allowed, and nothing moved."
    assert not found.good
    holding(
        found,
        allowed=[
            "No: no permit left, so that nothing could move.",
            "Verdict: outer short by 106.066 mm",
            f"move the bone by x {x:+g}, y {y:+g}, z {z:+g} mm (verified), then register it again.",
            "controller's own check of the path: POSE_OUTSIDE_LIMITS at pose 0 (required: accepted). Move the bone",
        ],
        stopped=["Nothing moved, so that nothing was to be stopped."],
        close=["Too close, by the proved bounds of the whole path: outer: -110.7", "The arm did not move."],
    )


def test_a_session_refused_by_permissives_says_which_their_value_bound_and_remedy(told):
    entry = {
        "name": "age of the registration", "holds": False, "value": 90.0, "bound": "<= 60 min", "remedy": "register anew",
    }  # fmt: skip
    steps = [decided(from_state="admitted", to_state="refused", permissives=[entry])]
    story = told["finished"] | {"decisions": steps, "allowed": []}
    found = of(story | {"closed": told["refused"]["closed"]})
    assert found.outcome.startswith("REFUSED")
    holding(
        found,
        allowed=["Did not hold: age of the registration: 90 min (required: <= 60 min). Register anew."],
        close=["The arm did not move."],
    )


def test_what_only_follows_from_another_permissive_is_not_told_beside_it():
    state = in_phase("admitted")
    names = {permissive(state, NOW).name for permissive in FOLLOWS}
    from cutgate.runtime.interlock.permissives import FOLLOWING  # noqa: PLC0415 - beside what it must be equal to

    assert names == FOLLOWING


def test_what_was_asked_before_the_permit_is_not_why_it_did_not_start(told):
    entry = {"name": "bone", "holds": False, "text": "moved", "bound": "still", "remedy": "fix it"}
    early = decided(permissives=[entry], offset_s=0.0)
    permit = told["finished"]["allowed"][0]
    found = of(told["refused"] | {"decisions": [early], "allowed": [permit]})
    assert "Did not hold" not in sentences(found)["allowed"]
    late = early | {"offset_s": permit["offset_s"] + 1.0}
    found = of(told["refused"] | {"decisions": [early, late], "allowed": [permit]})
    holding(
        found,
        allowed=["No: cutting was never started.", "Did not hold: bone: moved (required: still). Fix it."],
    )


def test_a_session_stopped_while_cutting_says_by_what_where_and_what_was_done(told):
    stop = told["stopped"]["stop"]
    found = of(told["stopped"])
    assert found.outcome == "STOPPED while cutting: The operator said stop."
    assert not found.good
    whole = stop["where"]["to_go_mm"] / (1.0 - stop["where"]["percent"] / 100.0)
    holding(
        found,
        stopped=[
            "The operator said stop. (OPERATOR_STOP, while cutting)",
            f"Where: segment {stop['where']['segment']} of {stop['where']['segments']}: 50.3 % of the path is cut",
            f"Cut: {whole - stop['where']['to_go_mm']:.1f} mm of {whole:.1f} mm.",
            "below the entry plane",
            "At rest: yes: the controller's last heartbeat says that it inhibits motion.",
            "Then: the runtime stopped at 2.619 s; the controller said INHIBITED at 2.717 s.",
            *stop["next"],
        ],
    )


def test_a_stop_that_nobody_confirmed_says_so_and_what_was_to_be_done(told):
    stop = told["stopped"]["stop"] | {"confirmed": False, "next": ["Press the emergency stop."]}
    holding(
        of(told["stopped"] | {"stop": stop}),
        stopped=[
            "At rest: NO: nobody has confirmed that the arm stands.",
            "as last heard",
            "Press the emergency stop.",
        ],
    )


def test_what_was_found_is_said_where_it_says_more_than_the_cause(told):
    stop = told["stopped"]["stop"]
    found = of(told["stopped"] | {"stop": stop | {"reason": "q1 was 3 deg off"}})
    holding(found, stopped=["What was found: q1 was 3 deg off."])
    assert "What was found" not in sentences(of(told["stopped"]))["stopped"]


def test_a_log_that_ends_while_the_arm_moved_says_that_it_was_broken_off(told):
    found = of(told["crashed"], Status.INCOMPLETE)
    assert found.outcome.startswith("BROKEN OFF while cutting: the log ends here: the runtime was killed")
    assert not found.good
    holding(
        found,
        stopped=[
            "The log ends here",
            "as last heard",
            "At rest: NO: nobody has confirmed",
            "Press the emergency stop",
        ],
    )
    assert "Nobody named a cause" not in found.outcome + sentences(found)["stopped"]


def test_a_log_that_ends_before_anything_moved_says_so(told):
    found = of(told["refused"] | {"closed": None}, Status.INCOMPLETE)
    assert found.outcome == "The log has no end: the session was broken off before anything moved."


@pytest.mark.parametrize("name", ["withdrawn", "latched"])
def test_other_stops_name_their_cause_phase_and_next_step(told, name):
    stop = told[name]["stop"]
    found = of(told[name])
    while_ = "while cutting" if stop["moving"] else "before anything moved"
    assert found.outcome == f"STOPPED {while_}: {stop['text']}"
    holding(found, stopped=[f"({stop['cause']}, while {stop['while']})", *stop["next"]])


@pytest.mark.parametrize(
    "cause", [StopCause.OPERATOR_QUIT, StopCause.PERMIT_EXPIRED], ids=lambda one: one.name
)
def test_a_session_given_up_before_the_start_names_who_and_says_that_nothing_moved(told, cause):
    stop = told["latched"]["stop"] | {
        "cause": cause.name,
        "text": WORDS[cause],
        "reason": "",
        "while": "permitted",
    }
    found = of(told["latched"] | {"stop": stop})
    assert found.outcome == f"STOPPED before anything moved: {WORDS[cause]}"
    holding(
        found,
        allowed=["No: cutting was never started."],
        stopped=[f"{WORDS[cause]} ({cause.name}, while permitted)", "Where: the arm had not been started."],
        close=["The arm did not move."],
    )


# ---------------------------------------------------------------- whether it is to be believed


@pytest.mark.parametrize("status", Status)
def test_a_log_that_is_not_to_be_believed_says_so_and_nothing_of_it_is_good(told, status):
    found = of(told["finished"], status)
    assert found.warning == NOT_BELIEVED.get(status, "")
    assert found.good == (status in (Status.OK, Status.INCOMPLETE))
    assert fact(found, "Log").good == (status is Status.OK)


def test_a_tampered_log_says_tampered(told):
    assert "TAMPERED" in of(told["finished"], Status.TAMPERED).warning


@pytest.mark.parametrize(("good", "warning"), [(True, ""), (None, ""), (False, DECIDED_OTHERWISE)])
def test_what_cannot_be_decided_again_is_not_good(told, good, warning):
    found = of(told["finished"], replayed=Fact("Replay", "x", good))
    assert found.warning == warning
    assert found.good == (warning == "")


# ---------------------------------------------------------------- facts


def test_who_and_where_and_when(admitted):
    def told(**changes):
        log = read_log(forge(admitted, changed(AuditOpen, **changes)))
        return of(story(log, Path("x.mcap"), None))

    assert fact(told(), "Who").text == "not recorded"
    who = fact(told(operator="Ann", account="or1 (uid 7)", host="theatre"), "Who")
    assert who.text == "operator Ann, account or1 (uid 7), on theatre"
    assert fact(told(), "Opened").text.startswith("2026-")


@pytest.mark.parametrize(
    ("options", "simulation"),
    [
        ([{"name": "bus", "value": "socketcan/can0"}], "no simulated controller was allowed"),
        (
            [
                {"name": "bus", "value": "x"},
                {"name": "simulated controller", "value": "allowed by site.toml"},
            ],
            "YES: simulated controller, allowed by site.toml",
        ),
        ("strange", "no simulated controller was allowed"),
    ],
)
def test_a_simulation_is_called_one_and_a_bus_is_not(told, options, simulation):
    opened = told["finished"]["opened"] | {"simulation": options}
    assert fact(of(told["finished"] | {"opened": opened}), "Simulation").text == simulation


def test_the_tightest_clearance_is_rounded_down_and_an_undefined_one_is_not_the_tightest(told):
    verdict = dict(told["finished"]["verdicts"][0])
    verdict["boundaries"] = [
        {"name": "roll_min", "unit": "deg", "deadband": 2.0, "violated": True},
        {
            "name": "inner",
            "unit": "mm",
            "certified": 5.1999,
            "deadband": 5.0,
            "segment": 3,
            "tip_length_mm": 12.34,
        },
        {"name": "outer", "unit": "mm", "certified": 90.0, "deadband": 5.0},
    ]
    found = of(told["finished"] | {"verdicts": [verdict]})
    assert (
        fact(found, "Nearest limit").text
        == "inner: 5.199 mm (required: 5 mm), at segment 3, 12.3 mm along the path"
    )
    holding(found, close=["roll_min: undefined (required: 2 deg)"])


# ---------------------------------------------------------------- what was measured


def sample(**changes):
    joints = {f"q{k}_deviation_{'mm' if k == 2 else 'deg'}": 0.0 for k in range(5)}
    values = {"leg": "cut", "reference_s": 1.0, "tip_distance_mm": 0.1, "wrist_deviation_mm": 0.2}
    bounds = {"wrist_tolerance_mm": 2.0, "joint_tolerance_deg": 1.0}
    return TrackingSample(**(joints | values | bounds | changes)).encode()


class Samples:
    def __init__(self, *samples):
        self.samples = samples

    def each(self, topic):
        assert topic == TrackingSample.TOPIC
        return ((topic, data) for data in self.samples)


def test_the_worst_sample_is_told_with_its_tolerance_and_rounded_up():
    worst = sample(wrist_deviation_mm=1.23401, wrist_tolerance_mm=1.5, segment=7, fraction=0.5)
    found = measured_of(Samples(sample(tip_distance_mm=0.70001), worst, sample(leg="retract"), b"{", b"[]"))
    assert found == Measured(3, 1.23401, 1.5, 0.70001, 7)
    assert "3 samples" in found.words
    assert (
        "at most 1.235 mm from the verified way (at segment 7; allowed: 1.5 mm), the tip at most 0.701 mm"
        in found.words
    )


def test_beside_the_cut_there_is_no_segment():
    assert "(beside the cut; allowed: 2 mm)" in measured_of(Samples(sample(leg="approach"))).words


def test_a_log_without_samples_says_that_it_has_none(told):
    assert measured_of(Samples()) is None
    assert measured_of(Samples(b"{}")) is None
    holding(of(told["finished"]), close=["How far the moving arm was from the path is not in this log."])


def test_what_was_measured_stands_in_the_third_answer(told):
    measured = Measured(3, 1.0, 2.0, 0.5, 7)
    holding(of(told["stopped"], measured=measured), close=[measured.words])


# ---------------------------------------------------------------- whatever a log holds


@given(
    st.sampled_from(("finished", "refused", "stopped", "crashed")),
    st.lists(st.tuples(st.sampled_from(LISTS), st.sampled_from(FIELDS), ANYTHING), min_size=1, max_size=6),
    st.dictionaries(
        st.sampled_from(("name", "holds", "value", "text", "bound", "remedy")), ANYTHING, max_size=4
    ),
    st.dictionaries(
        st.sampled_from(("name", "unit", "certified", "deadband", "segment", "tip_length_mm", "violated")),
        ANYTHING,
    ),
    st.dictionaries(
        st.sampled_from(("simulation", "operator", "account", "host", "utc_ns", "final_state")), ANYTHING
    ),
    st.dictionaries(st.sampled_from(("translation_mm", "yaw_deg", "verified")), ANYTHING) | st.none(),
    st.dictionaries(st.sampled_from(("worst_certified", "worst_leg", "worst_boundary")), ANYTHING),
)
def test_three_answers_are_given_whatever_a_log_says(
    told, name, changes, permissive, boundary, opened, guidance, approach
):
    strange = dict(told[name])
    for place, field, value in changes:
        strange[place] = [entry | {field: value} for entry in strange[place]]
    strange["decisions"] = [
        *strange["decisions"],
        decided(permissives=[permissive, {"holds": False, **permissive}]),
    ]
    strange["verdicts"] = [
        verdict | {"boundaries": [*verdict["boundaries"], boundary], "guidance": guidance}
        for verdict in strange["verdicts"]
    ]
    strange["approaches"] = [*strange["approaches"], approach]
    strange["opened"] = strange["opened"] | opened
    strange["closed"] = strange["closed"] and strange["closed"] | opened
    found = of(strange)
    assert found.outcome
    assert all(sentences(found).values())
    assert math.isfinite(len(found.facts))
