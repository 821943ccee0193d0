"""The recorded steps of a session: the way of a cut is accepted, and whatever leads astray is named with its decision."""

from dataclasses import replace

import pytest

from cutgate.protocol import records as wire
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.audit import records
from cutgate.runtime.audit.recomputed.steps import Steps
from cutgate.runtime.audit.recomputed.transitions import transitions
from tests.runtime.interlock import builders

TABLE = transitions()
EPOCH = builders.EPOCH


def listed(phase, *failing):
    return tuple(
        records.PermissiveValue(name=name, holds=name not in failing, bound="", remedy="")
        for name in TABLE.permissives.get(phase, ())
    )


def decision(sequence, way, event, *effects, first_out=None, permissives=None):
    before, after = way
    shown = listed(before) if permissives is None else permissives
    return records.AuditDecision(
        sequence=sequence,
        event=event,
        from_state=before,
        to_state=after,
        disposition="decided",
        effects=effects,
        permissives=shown,
        first_out=first_out,
    )


def view(state, cause="NONE", *, epoch=EPOCH, pressed=True, clear=True):
    return records.AuditController(
        state=state,
        cause=cause,
        epoch=epoch,
        device_pressed=pressed,
        emergency_stop_clear=clear,
        cutting_mode=state in ("PERMITTED", "CUTTING"),
        fresh=True,
    )


def sent(kind):
    return records.AuditPermit(kind=kind, stage="sent")


def opened(**changes):
    answer = replace(builders.OPENED, **changes)
    digest = wire.session_digest(builders.OPEN)
    return records.AuditSession(
        session=digest.hex(),
        open=wire.pack(builders.OPEN, 0, 1).hex(),
        opened=wire.pack(answer, wire.session_tag(digest), 1).hex(),
    )


CUT = (
    decision(1, ("waiting", "opening"), "controller announced", "UseSession", "send Open"),
    opened(),
    decision(2, ("opening", "collecting"), "session opened", "OpenLink", "SeekWitness", "send Collect"),
    view("OPEN"),
    decision(3, ("collecting", "collecting"), "limits received", permissives=()),
    decision(4, ("collecting", "collecting"), "calibration received", permissives=()),
    decision(5, ("collecting", "uploading"), "tool received", "send path block 0"),
    decision(6, ("uploading", "verifying"), "path stored", "Verify"),
    view("LOADED"),
    decision(7, ("verifying", "nonce_permit"), "verdict admissible", "send NonceRequest"),
    decision(8, ("nonce_permit", "authorising_permit"), "nonce for permit", "commit permit as record 2"),
    sent("permit"),
    decision(9, ("authorising_permit", "permitting"), "record durable", "send Permit"),
    view("PERMITTED", pressed=False),
    decision(10, ("permitting", "permitted"), "heartbeat"),
    view("PERMITTED"),
    decision(11, ("permitted", "nonce_start"), "said start", "send NonceRequest"),
    decision(12, ("nonce_start", "authorising_start"), "nonce for start", "commit start as record 3"),
    sent("start"),
    decision(13, ("authorising_start", "starting"), "record durable", "send Start"),
    view("CUTTING"),
    decision(14, ("starting", "cutting"), "heartbeat"),
    view("DONE"),
    decision(15, ("cutting", "finishing"), "heartbeat"),
    decision(16, ("finishing", "done"), "joints measured", "send END SESSION_ENDED"),
)
"""A cut from its beginning to its end, as its log tells it."""


def close(final_state):
    return records.AuditClose(
        final_state=final_state,
        clean=True,
        message_count=1,
        candump_sha256="",
        candump_bytes=0,
    )


def wrong(*log):
    """What is wrong with these records."""
    steps = Steps(TABLE)
    heard = {
        records.AuditSession: lambda record: steps.opened(record.encode()),
        records.AuditController: steps.controller,
        records.AuditFault: steps.fault,
        records.AuditPermit: steps.permit,
        records.AuditOperator: steps.operator,
        records.AuditDecision: steps.decision,
        records.AuditClose: steps.closed,
    }
    return [line for record in log for line in heard[type(record)](record)]


def until(sequence):
    """The cut up to this decision."""
    last = next(
        at
        for at, one in enumerate(CUT)
        if isinstance(one, records.AuditDecision) and one.sequence == sequence
    )
    return CUT[: last + 1]


def test_a_cut_is_accepted_whole_and_cut_off_anywhere():
    assert wrong(*CUT, close("done")) == []
    for length in range(len(CUT)):
        assert wrong(*CUT[:length]) == []


@pytest.mark.parametrize("sequence", range(1, 17))
def test_a_decision_that_is_missing_is_missed(sequence):
    left_out = [
        one for one in CUT if not (isinstance(one, records.AuditDecision) and one.sequence == sequence)
    ]
    found = wrong(*left_out, close("done"))
    told = f"behind decision {sequence - 1}" if sequence < 16 else "decision 15 has led to finishing"
    assert any(told in line for line in found), found


def test_a_decision_names_its_number_phase_and_event():
    found = wrong(*until(9), decision(10, ("permitting", "permitted"), "reply ACCEPTED to permit"))
    assert found == [
        (
            "decision 10, permitting on reply ACCEPTED to permit: to permitted, nothing leaves, first cause kept, "
            "permissives none; the table has to permitting, nothing leaves, first cause kept, permissives none"
        )
    ]


def test_permissives_that_fail_are_told_where_the_table_needs_them():
    way = ("permitted", "nonce_start")
    failing = listed("permitted", "controller's joint limits equal the approved")
    start = decision(11, way, "said start", "send NonceRequest", permissives=failing)
    assert wrong(*until(10), view("PERMITTED"), start)


def test_permissives_that_are_not_listed_are_told_by_name():
    fewer = listed("permitted")[1:]
    start = decision(11, ("permitted", "nonce_start"), "said start", "send NonceRequest", permissives=fewer)
    found = wrong(*until(10), view("PERMITTED"), start)
    assert found == [
        "decision 11, permitted on said start: it lists other permissives than the table: protocol version"
    ]


@pytest.mark.parametrize(
    ("shown", "odd"),
    [
        (listed("permitted")[::-1], "in another order"),
        ((*listed("permitted"), records.PermissiveValue(name="new", holds=True, bound="", remedy="")), "new"),
    ],
)
def test_so_are_those_of_another_order_and_those_that_are_too_many(shown, odd):
    start = decision(11, ("permitted", "nonce_start"), "said start", "send NonceRequest", permissives=shown)
    assert wrong(*until(10), view("PERMITTED"), start) == [
        f"decision 11, permitted on said start: it lists other permissives than the table: {odd}"
    ]


@pytest.mark.parametrize(("event", "to"), [("failed", "stopping"), ("gave up", "stopped")])
def test_an_event_of_this_side_names_its_cause(event, to):
    def stop(cause):
        way = ("cutting", to)
        told = f"{event} LOOP_STALLED"
        return decision(15, way, told, "send STOP LOOP_STALLED", first_out=cause, permissives=())

    assert wrong(*until(14), stop("LOOP_STALLED")) == []
    assert wrong(*until(14), stop("INTERNAL_ERROR"))


def test_a_heartbeat_without_its_decision_is_told_once():
    released = view("CUTTING", pressed=False)
    refused = decision(15, ("cutting", "cutting"), "said start", "Refused", permissives=())
    found = wrong(*until(14), released, refused, close("cutting"))
    assert found[1:] == [
        (
            "the controller shows CUTTING, cause none, epoch the session's, enabling device released, emergency stop clear in "
            "cutting, behind decision 14, and no decision follows: the table takes a step there"
        )
    ]


def test_a_heartbeat_that_has_a_wrong_decision_is_not_told_as_one_that_has_none():
    goes_on = decision(15, ("cutting", "cutting"), "heartbeat", permissives=())
    found = wrong(*until(14), view("CUTTING", pressed=False), goes_on, close("cutting"))
    assert len(found) == 2
    assert found[1].startswith("decision 15, cutting on heartbeat (CUTTING, cause none, ")


def test_a_heartbeat_that_must_stop_has_its_decision():
    released = view("CUTTING", pressed=False)
    found = wrong(*until(14), released, close("cutting"))
    assert any("no decision follows" in line for line in found)
    assert any("its table never lets be seen" in line for line in found)


def test_a_stop_names_the_controllers_cause_and_keeps_it():
    stops = view("INHIBITED", "EMERGENCY_STOP", epoch=EPOCH + 1, clear=False)

    def stop(cause):
        return decision(
            15, ("cutting", "stopping"), "heartbeat", "send STOP X", first_out=cause, permissives=()
        )

    def end(cause):
        return decision(16, ("stopping", "stopped"), "heartbeat", first_out=cause)

    assert wrong(*until(14), stops, stop("EMERGENCY_STOP"), end("EMERGENCY_STOP"), close("stopped")) == []
    assert wrong(*until(14), stops, stop("EMERGENCY_STOP"), close("stopping")) == []
    assert wrong(*until(14), stops, stop("HEARTBEAT_LOST"))
    assert wrong(*until(14), stops, stop("EMERGENCY_STOP"), end("HEARTBEAT_LOST"))


def test_the_controllers_fault_names_the_cause_that_it_claims():
    fault = records.AuditFault(source="controller", code="STOPPED", cause="CORRUPTION")

    def stop(cause):
        way = ("cutting", "stopping")
        return decision(15, way, "controller's fault", "send STOP X", first_out=cause, permissives=())

    assert wrong(*until(14), fault, stop("CORRUPTION")) == []
    assert wrong(*until(14), fault, stop("EMERGENCY_STOP"))


@pytest.mark.parametrize(
    ("shown", "said"),
    [
        (
            view("INHIBITED", "OPERATOR_STOP"),
            (
                "INHIBITED, cause OPERATOR_STOP, epoch 3, device held, emergency stop clear, cutting mode off behind decision 14, "
                "after CUTTING: its table goes from there to CUTTING, DONE"
            ),
        ),
        (
            view("OPEN", pressed=False, clear=False),
            (
                "OPEN, cause NONE, epoch 3, device released, emergency stop pressed, cutting mode off behind decision 14, after "
                "CUTTING: its table goes from there to CUTTING, DONE"
            ),
        ),
        (
            view("OPEN", epoch=EPOCH + 1),
            (
                "OPEN, cause NONE, epoch 4, device held, emergency stop clear, cutting mode off behind decision 14, after CUTTING "
                "and a stop: its table goes from there to FAULT, INHIBITED"
            ),
        ),
        (view("FAULT", "OPERATOR_STOP", epoch=EPOCH + 1), None),
    ],
)
def test_the_controller_goes_on_as_its_table_does(shown, said):
    found = wrong(*until(14), shown)
    assert found == ([] if said is None else [f"the controller shows {said}"])


def test_its_first_heartbeat_follows_from_how_it_opened_the_session():
    found = wrong(*until(2), view("PERMITTED"))
    assert found == [
        (
            "the controller shows PERMITTED, cause NONE, epoch 3, device held, emergency stop clear, cutting mode on "
            "behind decision 2, and no permit had left"
        )
    ]
    held = opened(state=ControllerState.FAULT, cause=StopCause.SECOND_NODE)
    assert any("after FAULT: its table goes" in line for line in wrong(CUT[0], held, view("CUTTING")))


def test_behind_a_stop_the_controller_does_not_come_back_to_the_session():
    stopped = view("INHIBITED", "OPERATOR_STOP", epoch=EPOCH + 1)
    assert wrong(*until(14), stopped, view("CUTTING"))[1:] == [
        (
            "the controller shows CUTTING, cause NONE, epoch 3, device held, emergency stop clear, cutting mode on "
            "behind decision 14, after a stop has ended that epoch"
        )
    ]


@pytest.mark.parametrize(("kind", "sequence"), [("permit", 9), ("start", 13)])
def test_the_controller_goes_on_only_with_what_was_sent(kind, sequence):
    without = [one for one in CUT if not (isinstance(one, records.AuditPermit) and one.kind == kind)]
    assert any(f"no {kind} had left" in line for line in wrong(*without))


def test_a_latch_is_left_by_a_reset_and_a_cause_by_an_acknowledgement():
    held = (
        CUT[0],
        opened(state=ControllerState.FAULT, cause=StopCause.SECOND_NODE),
        decision(2, ("opening", "held"), "session opened", "OpenLink", "SeekWitness"),
        view("FAULT", "SECOND_NODE"),
    )
    acknowledge = records.AuditOperator(word="acknowledge", accepted=True)
    said = decision(3, ("held", "held"), "said acknowledge", "send Acknowledge")
    assert wrong(*held, acknowledge, said, view("FAULT")) == []
    assert any("nobody had said acknowledge" in line for line in wrong(*held, view("FAULT")))
    found = wrong(*held, acknowledge, said, view("FAULT"), view("OPEN"))
    assert any("no reset had left" in line for line in found)


def test_a_controller_that_is_held_lets_nothing_be_collected():
    found = wrong(CUT[0], opened(cause=StopCause.BONE_MOVED), *CUT[2:3])
    assert found == [
        (
            "decision 2, opening on session opened: to collecting, OpenLink, SeekWitness, send Collect leaves, first cause "
            "kept, permissives none; the table has to held, OpenLink, SeekWitness leaves, first cause kept, permissives none"
        )
    ]


def test_what_cannot_be_read_of_the_opening_is_told():
    steps = Steps(TABLE)
    (line,) = steps.opened(b"{}")
    assert line.startswith("/audit/session cannot be read: ")
    assert steps == Steps(TABLE)


def test_the_first_heartbeat_of_a_session_that_is_not_open_follows_from_nothing():
    assert wrong(view("INHIBITED", "OPERATOR_STOP", epoch=7)) == []


def test_only_a_fault_of_the_controller_names_the_cause_that_it_claims():
    faults = [
        records.AuditFault(source=source, code="STOPPED", cause=cause)
        for source, cause in (("controller", "CORRUPTION"), ("runtime", "EMERGENCY_STOP"))
    ]
    way = ("cutting", "stopping")

    def stop(cause):
        return decision(15, way, "controller's fault", "send STOP X", first_out=cause, permissives=())

    assert wrong(*until(14), *faults, stop("CORRUPTION")) == []
    assert wrong(*until(14), *faults, stop("EMERGENCY_STOP"))
    assert wrong(*until(14), faults[1], stop("EMERGENCY_STOP"))


@pytest.mark.parametrize("stage", ["authorised", "acknowledged", "refused", "withheld"])
def test_a_permit_that_was_made_and_not_sent_has_not_left(stage):
    log = [
        records.AuditPermit(kind="permit", stage=stage)
        if isinstance(one, records.AuditPermit) and one.kind == "permit"
        else one
        for one in CUT
    ]
    assert any("no permit had left" in line for line in wrong(*log))


@pytest.mark.parametrize(("word", "accepted"), [("acknowledge", False), ("start", True)])
def test_an_acknowledgement_that_was_not_taken_is_none_and_no_other_word_is_one(word, accepted):
    held = (
        CUT[0],
        opened(state=ControllerState.FAULT, cause=StopCause.SECOND_NODE),
        decision(2, ("opening", "held"), "session opened", "OpenLink", "SeekWitness"),
        view("FAULT", "SECOND_NODE"),
        records.AuditOperator(word=word, accepted=accepted),
        view("FAULT"),
    )
    assert any("nobody had said acknowledge" in line for line in wrong(*held))


def test_a_program_whose_table_has_failed_may_end_without_it():
    told = decision(12, ("permitted", "stopped"), "gave up INTERNAL_ERROR", first_out="INTERNAL_ERROR")
    last = told.model_copy(update={"reason": "without the table: internal error", "permissives": ()})
    assert wrong(*until(10), last, close("stopped")) == []
    assert wrong(*until(10), told)


def test_the_log_closes_where_the_last_decision_has_led():
    assert wrong(*CUT, close("stopped")) == ["the log closes in stopped; decision 16 has led to done"]
