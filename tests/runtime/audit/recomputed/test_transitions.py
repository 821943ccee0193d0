"""The frozen tables: they are the code's, and each part of a step that is another one is told."""

from dataclasses import replace
from itertools import product
from random import Random

import pytest

from cutgate.runtime.audit.recomputed.transitions import (
    HEARTBEAT,
    HOLD,
    KEPT,
    NAMED,
    NOT_SHOWN,
    SHOWN,
    SILENT,
    STAYS,
    VIEW_PARTS,
    HeartbeatView,
    StepTaken,
    condition_of,
    data,
    first_out_of,
    leaves_of,
    opened_as,
    shown_cause,
    transitions,
    transitions_sha256,
)
from cutgate.runtime.interlock.state import Phase
from docs.make_transitions import main
from docs.state_machines.transitions import boxes, events_of, row_of, states_of
from tests.runtime.interlock import builders

TABLE = transitions()
PERMITTED = HeartbeatView("PERMITTED", "none", "the session's", "held", "clear")


def test_the_file_is_what_the_code_does(tmp_path):
    """Whoever changes a table writes it anew, and reads what has changed: ``python -m docs.make_transitions``."""
    main(tmp_path / "new.json")
    assert (tmp_path / "new.json").read_bytes() == data(), "run: python -m docs.make_transitions, and read it"


def altered_in_two_ways(phase, number, draw):
    """States of this phase that differ from the sound one in what two of the file's states differ in."""
    sound = builders.in_phase(phase)
    changes = [
        {name: value for name, value in vars(state).items() if getattr(sound, name) != value}
        for state, _ in states_of(phase)
    ]
    for _ in range(number):
        first, second = draw.sample(changes, 2)
        yield replace(sound, **first, **{name: value for name, value in second.items() if name not in first})


@pytest.mark.slow
@pytest.mark.parametrize("phase", Phase)
def test_no_step_from_a_state_that_is_altered_in_two_ways_is_refused(phase):
    """The file's rows come from states that are altered in one; nothing new comes of two."""
    for state in altered_in_two_ways(phase, 10, Random(str(phase))):
        for event, after_s in events_of(state, every_view=True):
            (on, to, *rest), view = row_of(state, event, builders.NOW + after_s)
            taken = StepTaken(str(phase) if to == STAYS else to, *rest)
            if taken.permissives == SILENT:
                assert view is None or TABLE.silent(str(phase), view), (phase, on, view)
            else:
                assert TABLE.step(str(phase), on, view, taken) is None, (phase, on, view, taken)


def test_a_log_names_the_file_by_its_digest():
    assert len(bytes.fromhex(transitions_sha256())) == 32


SENT = StepTaken("permitting", ("send Permit",), KEPT, HOLD)


def test_a_permit_leaves_when_its_record_is_durable_and_every_permissive_holds():
    assert TABLE.step("authorising_permit", "record durable", None, SENT) is None


@pytest.mark.parametrize(
    "changed",
    [
        {"to": "permitted"},
        {"leaves": ()},
        {"leaves": ("send Permit", "send Permit")},
        {"first_out": NAMED},
        {"permissives": SHOWN},
        {"permissives": NOT_SHOWN},
    ],
)
def test_a_step_that_differs_in_any_part_is_none(changed):
    told = TABLE.step("authorising_permit", "record durable", None, SENT._replace(**changed))
    assert told is not None
    assert "to permitting, send Permit leaves" in told


def test_a_step_on_an_event_that_the_phase_does_not_know_is_none():
    assert TABLE.step("permitting", "no such event", None, SENT) == "nothing: it does not happen there"


def test_more_permissives_may_hold_than_the_table_asks_for():
    stays = StepTaken("permitted", ("Refused",), KEPT, SHOWN)
    for shown in (SHOWN, HOLD):
        assert TABLE.step("permitted", "said start", None, stays._replace(permissives=shown)) is None
    onward = StepTaken("nonce_start", ("send NonceRequest",), KEPT, HOLD)
    assert TABLE.step("permitted", "said start", None, onward) is None
    assert TABLE.step("permitted", "said start", None, onward._replace(permissives=SHOWN)) is not None


def test_a_permit_is_believed_by_a_heartbeat_that_says_so_and_by_nothing_else():
    believed = StepTaken("permitted", (), KEPT, NOT_SHOWN)
    assert TABLE.step("permitting", HEARTBEAT, PERMITTED, believed) is None
    for view in (
        PERMITTED._replace(state="LOADED"),
        PERMITTED._replace(cause="standing"),
        PERMITTED._replace(epoch="another"),
    ):
        assert TABLE.step("permitting", HEARTBEAT, view, believed) is not None
    assert TABLE.step("permitting", "reply accepted to permit", None, believed) is not None


def test_every_heartbeat_has_an_answer_in_every_phase():
    phases = {phase for phase, _ in TABLE.rows}
    assert len(phases) == 23
    for phase in phases:
        for parts in product(*VIEW_PARTS):
            assert any(row.fits(HeartbeatView(*parts)) for row in TABLE.rows[phase, HEARTBEAT]), (
                phase,
                parts,
            )


def test_no_heartbeat_passes_in_silence_on_which_a_moving_arm_must_stop():
    for phase in ("starting", "cutting"):
        waits = "PERMITTED" if phase == "starting" else "CUTTING"
        sound = HeartbeatView(waits, "none", "the session's", "held", "clear")
        assert TABLE.silent(phase, sound)
        for changed in (
            {"cause": "standing"},
            {"cause": "withdrawing"},
            {"epoch": "another"},
            {"device": "released"},
            {"emergency_stop": "pressed"},
            {"state": "INHIBITED"},
            {"state": "FAULT"},
            {"state": "OPEN"},
        ):
            assert not TABLE.silent(phase, sound._replace(**changed)), (phase, changed)


def test_the_controller_never_shows_a_moving_arm_with_the_device_released_or_a_latching_cause_that_has_not_latched():
    sound = {"device": True, "clear": True, "cutting_mode": True}
    assert TABLE.shows("CUTTING", "NONE", **sound)
    for part in sound:
        assert not TABLE.shows("CUTTING", "NONE", **{**sound, part: False})
    assert not TABLE.shows("CUTTING", "BONE_MOVED", **sound)
    off = {**sound, "cutting_mode": False}
    assert TABLE.shows("FAULT", "SECOND_NODE", **off)
    assert not TABLE.shows("INHIBITED", "SECOND_NODE", **off)


def test_behind_a_stop_no_heartbeat_of_the_session_shows_anything_but_the_stop():
    assert set().union(*TABLE.stopped.values()) == {"INHIBITED", "FAULT"}
    assert TABLE.live["CUTTING"] == {"CUTTING", "DONE"}
    assert TABLE.live["LOADED"] == {"LOADED", "OPEN", "PERMITTED"}


@pytest.mark.parametrize(
    ("event", "condition"),
    [
        ("failed LOOP_STALLED", "failed"),
        ("gave up BUS_FAILED", "gave up"),
        ("said confirm WITNESS", "said confirm"),
        ("said quit SIGTERM", "said quit"),
        ("controller of protocol version 3 announced", "controller of another protocol version announced"),
        ("reply ACCEPTED to permit", "reply accepted to permit"),
        ("reply NONCE_EXPIRED to start", "reply refused to start"),
        ("reply EPOCH to 0xee", "reply refused to something else"),
        ("nonce for reset", "nonce for reset"),
    ],
)
def test_events_lose_what_is_particular_to_one_session(event, condition):
    assert condition_of(event) == condition


def test_a_session_is_opened_in_several_ways():
    assert condition_of("session opened", opened_as(at_rest=False, withdrawal_due=True, witness=True)) == (
        "session opened, held, withdrawal due, witness"
    )


def test_effects_lose_index_token_and_cause():
    assert leaves_of(
        ("send path block 12", "commit start as record 7", "send STOP HEARTBEAT_LOST", "OpenLink")
    ) == (
        "send path block",
        "commit start",
        "send STOP",
        "OpenLink",
    )


def test_the_first_cause_is_kept_named_or_the_tables_own():
    assert first_out_of(None, None, "NONE") == KEPT
    assert first_out_of("EMERGENCY_STOP", "EMERGENCY_STOP", "BONE_MOVED") == KEPT
    assert first_out_of("BONE_MOVED", None, "BONE_MOVED") == NAMED
    assert first_out_of("HEARTBEAT_LOST", None, None) == "HEARTBEAT_LOST"


def test_causes_are_told_apart_by_what_follows_from_them():
    assert [shown_cause(name) for name in ("NONE", "OPERATOR_STOP", "BONE_MOVED", "AUDIT_FAILED")] == [
        "none",
        "standing",
        "withdrawing",
        "latching",
    ]


def test_views_fall_together_without_losing_or_adding_one():
    views = {
        HeartbeatView(*parts) for parts in product(*VIEW_PARTS) if parts[0] == "DONE" or parts[3] == "held"
    }
    found = boxes(views)
    covered = {HeartbeatView(*parts) for box in found if box for parts in product(*box)}
    assert covered == views
    assert len(found) < len(views) / 10
