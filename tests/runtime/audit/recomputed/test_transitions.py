"""The frozen tables: each part of a step that is another one is told."""

from dataclasses import FrozenInstanceError, replace
from hashlib import sha256
from itertools import product

import pytest

from cutgate.runtime.audit.recomputed.transitions import (
    HEARTBEAT,
    HOLD,
    KEPT,
    NAMED,
    NO_EPOCH,
    NOT_SHOWN,
    SHOWN,
    VIEW_PARTS,
    HeartbeatView,
    StepTaken,
    TransitionRow,
    condition_of,
    data,
    first_out_of,
    leaves_of,
    opened_as,
    shown_cause,
    transitions,
    transitions_sha256,
)

TABLE = transitions()
PERMITTED = HeartbeatView("PERMITTED", "none", "the session's", "held", "clear")


def test_a_log_names_the_file_by_its_digest():
    assert transitions_sha256() == sha256(data()).hexdigest()


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


def test_a_heartbeat_is_shown_by_what_the_rows_tell_apart():
    view = HeartbeatView.of("CUTTING", "BONE_MOVED", 3, 4, device_pressed=False, emergency_stop_clear=False)
    assert view == ("CUTTING", "withdrawing", "another", "released", "pressed")
    assert str(view) == (
        "CUTTING, cause withdrawing, epoch another, enabling device released, emergency stop pressed"
    )
    view = HeartbeatView.of("OPEN", "NONE", 4, 4, device_pressed=True, emergency_stop_clear=True)
    assert view == ("OPEN", "none", "the session's", "held", "clear")


def test_what_the_table_has_instead_leaves_out_what_needs_no_record_unless_there_is_nothing_else():
    odd = StepTaken("done", (), KEPT, SHOWN)
    stopped = HeartbeatView("INHIBITED", "none", "the session's", "held", "clear")
    assert TABLE.step("stopping", HEARTBEAT, stopped, odd) == (
        "to stopping, send Withdraw leaves, first cause kept, permissives none; or to stopped, nothing leaves, first cause "
        "kept, permissives none"
    )
    sound = HeartbeatView("CUTTING", "none", "the session's", "held", "clear")
    assert (
        TABLE.step("cutting", HEARTBEAT, sound, odd)
        == "to cutting, nothing leaves, first cause kept, permissives silent"
    )


EVERY = tuple(map(frozenset, VIEW_PARTS))


@pytest.mark.parametrize(
    ("views", "view", "fits"),
    [
        (None, None, True),
        (None, PERMITTED, False),
        (EVERY, None, False),
        (EVERY, PERMITTED, True),
        *(((*EVERY[:at], frozenset({"another one"}), *EVERY[at + 1 :]), PERMITTED, False) for at in range(5)),
    ],
)
def test_a_row_is_about_a_heartbeat_that_shows_all_it_needs_or_about_any_other_event(views, view, fits):
    assert TransitionRow(views, SENT).fits(view) == fits


def test_a_file_that_lacks_a_part_of_a_view_lets_nothing_pass():
    with pytest.raises(ValueError, match="shorter"):
        TransitionRow(EVERY[:-1], SENT).fits(PERMITTED)
    lacking = replace(TABLE, views=tuple(view[:-1] for view in TABLE.views))
    with pytest.raises(ValueError, match="shorter"):
        lacking.shows("CUTTING", "NONE", device=True, clear=True, cutting_mode=True)


def test_the_tables_are_not_altered_once_they_are_read():
    with pytest.raises(FrozenInstanceError):
        TABLE.rows = {}
    assert NO_EPOCH == 0
