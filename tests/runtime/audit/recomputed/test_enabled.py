"""The ledger of what left: each rule, broken alone and kept, without a log around it."""

from dataclasses import replace
from hashlib import sha256

import pytest

from cutgate.protocol import records as wire
from cutgate.runtime.audit import records
from cutgate.runtime.audit.recomputed.enabled import DIGESTS, Ledger, decision_differences

VERIFIER = "cutgate test"
CONFIGURATION = sha256(b"configuration").digest()
STANDS = (-40_000_000, 95_000_000, 265_000_000, -50_000_000, 32_000_000)
ENTRY, EXIT = (1, 2, 3, 4, 5), (6, 7, 8, 9, 10)


def digest(name):
    return sha256(name.encode()).digest()


PERMIT = wire.Permit(
    nonce=bytes(16),
    announce_nonce=bytes(16),
    session_digest=bytes(32),
    serial="SIM-1",
    protocol_version=wire.PROTOCOL_VERSION,
    epoch=1,
    **{f"{name}_digest": digest(name) for name in DIGESTS},
    configuration_digest=CONFIGURATION,
    verifier_version=VERIFIER,
    start_joints_u=STANDS,
    branch=wire.Branch("right", 0, 0),
    approach=wire.Approach(10_000, 12_000, ENTRY, EXIT, 25),
    lifetime_s=120,
)
START = wire.Start(
    nonce=bytes(16),
    epoch=1,
    session_digest=bytes(32),
    permit_digest=PERMIT.digest,
    start_joints_u=STANDS,
)
ADMISSIBLE = {"verdict": "admissible"}


def verdict(word="admissible", **changes):
    values = {
        "document": "{}",
        "verdict": word,
        "method": "certified",
        "verifier": VERIFIER,
        "poses": 2,
        "evaluations_arm": 1,
        "evaluations_wrist": 1,
        **{f"{name}_sha256": digest(name).hex() for name in DIGESTS},
    }
    return records.AuditVerdict(**values | changes)


def approach(word="admissible", **changes):
    values = {
        "document": "{}",
        "verdict": word,
        "start_joints_u": STANDS,
        "entry_um": 10_000,
        "exit_um": 12_000,
        "entry_joints_u": ENTRY,
        "exit_joints_u": EXIT,
        "speed_percent": 25,
    }
    return records.AuditApproach(**values | changes)


def record(kind, stage, token=1, signed=None, **changes):
    """One record of a permit, start or reset."""
    signed = signed or {"permit": PERMIT, "start": START}.get(kind)
    values = {"kind": kind, "stage": stage, "token": token, "record": signed and signed.canonical().hex()}
    if stage == "sent":
        values |= {"log_size": 0, "log_root": bytes(32).hex()}
    if kind == "permit":
        values |= {f"{name}_sha256": digest(name).hex() for name in DIGESTS}
        values["configuration_sha256"] = CONFIGURATION.hex()
    return records.AuditPermit(**values | changes)


def ledger(recomputed=None, admitted="admissible", recorded=None, way=None):
    """One in which everything stands as it should for a permit."""
    made = Ledger(CONFIGURATION)
    made.verdict(recorded or verdict(), recomputed or ADMISSIBLE)
    made.approach(way or approach(), admitted)
    return made


def entered(found, *entries):
    """What is wrong with these records, in their order."""
    return [line for entry in entries for line in found.permit(entry)]


def permitted():
    """A ledger in which a permit has been acknowledged, under a number that nothing else has."""
    found = ledger()
    stages = ("authorised", "sent", "acknowledged")
    assert entered(found, *(record("permit", stage, token=8) for stage in stages)) == []
    return found


def left(kind, found, **changes):
    """What is wrong with a record that is authorised and leaves."""
    return entered(found, record(kind, "authorised"), record(kind, "sent", **changes))


def test_a_permit_and_a_start_that_keep_every_rule_are_in_order():
    assert left("start", permitted()) == []


@pytest.mark.parametrize("changes", [{"log_size": 1}, {"log_root": "ab" * 32}])
@pytest.mark.parametrize("kind", ["permit", "start"])
def test_the_tree_that_is_named_is_the_one_that_was_signed(kind, changes):
    found = permitted() if kind == "start" else ledger()
    assert left(kind, found, **changes) == [f"the {kind}'s log is not the one that was signed"]


def test_before_version_4_nothing_names_a_tree():
    older = PERMIT.canonical()[: -len(wire.NO_TREE_HEAD.body())].hex()
    assert left("permit", ledger(), record=older, log_size=None, log_root=None) == []
    told = ["the permit's log is not the one that was signed"]
    assert left("permit", ledger(), record=older, log_size=None, log_root="ab" * 32) == told


# ---------------------------------------------------------------- authorised


@pytest.mark.parametrize("kind", ["permit", "start", "reset"])
def test_nothing_leaves_that_was_not_authorised_under_its_kind_and_its_token(kind):
    told = f"a {kind} left without a record that authorised it"
    others = [other for other in ("permit", "start", "reset") if other != kind]
    for before in (
        [],
        [record(kind, "authorised", token=2)],
        [record(kind, "authorised", token=None)],
        [record(other, "authorised", token=1) for other in others],
        [record(kind, "withheld"), record(kind, "refused"), record(kind, "acknowledged")],
    ):
        assert told in entered(permitted(), *before, record(kind, "sent")), before
    for between in (
        [],
        [record(kind, "withheld")],
        [record(other, "authorised", token=2) for other in others],
    ):
        assert entered(permitted(), record(kind, "authorised"), *between, record(kind, "sent")) == []


@pytest.mark.parametrize("stage", ["authorised", "acknowledged", "refused", "withheld"])
def test_a_record_that_says_nothing_left_is_judged_by_no_rule(stage):
    nothing = Ledger(CONFIGURATION)
    assert (
        entered(nothing, *(record(kind, stage, record="xyz") for kind in ("permit", "start", "reset"))) == []
    )


def test_a_reset_needs_neither_verdict_nor_approach_nor_a_record_that_can_be_read():
    assert left("reset", Ledger(CONFIGURATION), record="xyz") == []


def test_what_enables_is_a_permit_or_a_start_that_was_authorised():
    for kind, enabling in (("permit", True), ("start", True), ("reset", False)):
        found = Ledger(CONFIGURATION)
        assert not found.enabling
        entered(found, record(kind, "sent"))
        assert not found.enabling
        entered(found, record("reset", "authorised"), record(kind, "authorised", token=2))
        assert found.enabling is enabling


# ---------------------------------------------------------------- verdict and approach


@pytest.mark.parametrize("kind", ["permit", "start"])
@pytest.mark.parametrize("recorded", ["admissible", "inadmissible"])
@pytest.mark.parametrize("again", ["admissible", "inadmissible"])
def test_what_enables_leaves_only_on_what_is_admissible_recorded_and_recomputed(kind, recorded, again):
    sound = recorded == again == "admissible"
    by_verdict, by_approach = permitted(), permitted()
    by_verdict.verdict(verdict(recorded), {"verdict": again})
    by_verdict.approach(approach(), "admissible")
    by_approach.approach(approach(recorded), again)
    told = f"is recorded as {recorded} and recomputed as {again}"
    assert left(kind, by_verdict) == ([] if sound else [f"a {kind} left; the verdict {told}"])
    assert left(kind, by_approach) == ([] if sound else [f"a {kind} left; the approach {told}"])


@pytest.mark.parametrize("kind", ["permit", "start"])
def test_nothing_leaves_without_verdict_or_approach(kind):
    nothing = left(kind, Ledger(CONFIGURATION))
    assert nothing[:2] == [f"a {kind} left without a verdict", f"a {kind} left without a verified approach"]
    found = permitted()
    found.verdict(verdict(), ADMISSIBLE)  # a later verdict needs an approach of its own
    assert left(kind, found) == [f"a {kind} left without a verified approach"]


def test_the_latest_verdict_counts():
    found = permitted()
    found.verdict(verdict(verifier="another"), ADMISSIBLE)
    found.approach(approach(), "admissible")
    assert left("permit", found) == [f"the permit names the verifier {VERIFIER}, its verdict another"]


@pytest.mark.parametrize("name", DIGESTS)
def test_the_permits_digests_are_those_of_its_verdict_and_of_what_was_signed(name):
    field = f"{name}_sha256"
    assert left("permit", ledger(recorded=verdict(**{field: "00"}))) == [
        f"the permit's {name} digest is not the verdict's"
    ]
    signed = replace(PERMIT, **{f"{name}_digest": bytes(32)})
    assert left("permit", ledger(), signed=signed) == [
        f"the permit's {name} digest is not the one that was signed"
    ]
    assert left("start", permitted(), **{field: "00"}) == []  # a start names its permit alone


def test_the_configuration_is_the_one_that_was_signed_and_that_of_the_files():
    assert left("permit", ledger(), configuration_sha256="00") == [
        "the permit's configuration digest is not the one that was signed"
    ]
    other = replace(PERMIT, configuration_digest=bytes(32))
    assert left("permit", ledger(), signed=other, configuration_sha256=bytes(32).hex()) == [
        "the permit's configuration is not that of robot.toml, site.toml and the options as they are attached"
    ]


@pytest.mark.parametrize(("kind", "signed"), [("permit", PERMIT), ("start", START)])
@pytest.mark.parametrize("other", [{"log_size": 7}, {"log_root": digest("another root").hex()}])
def test_the_tree_that_a_record_says_it_names_is_the_one_that_was_signed(kind, signed, other):
    before = {"permit": ledger, "start": permitted}[kind]
    told = [f"the {kind}'s log is not the one that was signed"]
    assert left(kind, before(), **other) == told
    named = replace(signed, log=wire.TreeHead(bytes(16), 7, digest("root")))
    assert told[0] in left(kind, before(), signed=named)
    assert left(kind, before(), signed=named, log_size=7, log_root=digest("root").hex()) == []


@pytest.mark.parametrize(("kind", "signed"), [("permit", PERMIT), ("start", START)])
def test_what_was_signed_before_there_was_a_tree_names_none(kind, signed):
    """Protocol version 3: the record has no tree, and neither had what was signed."""
    before = {"permit": ledger, "start": permitted}[kind]()
    old = signed.canonical()[: -len(wire.NO_TREE_HEAD.body())].hex()
    assert left(kind, before, record=old, log_size=None, log_root=None) == []


def test_the_approach_that_is_bound_is_the_one_that_was_verified():
    (line,) = left("permit", ledger(way=approach(entry_um=10_001)))
    assert line == (
        "the permit's entry are not the verified: 10.000 mm along the tool, at q0 0.000001 deg, q1 0.000002 deg, "
        "q2 0.000003 mm, q3 0.000004 deg, q4 0.000005 deg, verified 10.001 mm along the tool, at q0 0.000001 deg, "
        "q1 0.000002 deg, q2 0.000003 mm, q3 0.000004 deg, q4 0.000005 deg"
    )


# ---------------------------------------------------------------- warnings


def confirm(what="CUT_HIGH", command="confirm", accepted=True):
    return records.AuditOperator(word=command, what=what, accepted=accepted)


WARNED = ADMISSIBLE | {
    "warnings": [
        {"code": "CUT_HIGH", "confirm": True},
        {"code": "CUT_DEEP", "confirm": True},
        {"code": "CUT_FAR", "confirm": False},
    ]
}
DEEP, HIGH = (
    f"a permit left although the warning {code} was not confirmed" for code in ("CUT_DEEP", "CUT_HIGH")
)


@pytest.mark.parametrize(
    ("commands", "told"),
    [
        ([], [DEEP, HIGH]),
        ([confirm()], [DEEP]),
        ([confirm(), confirm("CUT_DEEP")], []),
        ([confirm(accepted=False), confirm("CUT_DEEP")], [HIGH]),
        ([confirm(command="start"), confirm("CUT_DEEP")], [HIGH]),
        ([confirm(None), confirm("CUT_DEEP")], [HIGH]),
    ],
)
def test_a_permit_waits_for_every_warning_that_the_operator_must_confirm(commands, told):
    found = ledger(WARNED)
    for command in commands:
        found.operator(command)
    assert left("permit", found) == told


def test_what_was_confirmed_before_a_verdict_confirms_nothing_of_it():
    found = ledger(WARNED)
    for code in ("CUT_HIGH", "CUT_DEEP"):
        found.operator(confirm(code))
    found.verdict(verdict(), WARNED)
    found.approach(approach(), "admissible")
    assert left("permit", found) == [DEEP, HIGH]
    found.verdict(verdict(), ADMISSIBLE)
    found.approach(approach(), "admissible")
    assert left("permit", found) == []


# ---------------------------------------------------------------- start


def test_no_start_leaves_without_a_permit_that_was_acknowledged():
    told = ["a start left without an acknowledged permit"]
    found = ledger()
    assert left("permit", found) == []
    assert left("start", found) == told
    entered(
        found, record("start", "acknowledged"), record("reset", "acknowledged"), record("permit", "refused")
    )
    assert left("start", found) == told
    entered(found, record("permit", "acknowledged"))
    assert left("start", found) == []
    entered(found, record("reset", "acknowledged"))  # takes nothing back
    assert left("start", found) == []


def test_a_start_is_of_the_permit_that_left_last():
    told = ["a start left for another permit than the one that had left"]
    found, second = permitted(), replace(PERMIT, lifetime_s=60)
    assert left("start", found, signed=replace(START, permit_digest=second.digest)) == told
    assert entered(found, record("permit", "authorised"), record("permit", "sent", signed=second)) == []
    assert left("start", found) == told
    assert left("start", found, signed=replace(START, permit_digest=second.digest)) == []


@pytest.mark.parametrize("kind", ["permit", "start"])
@pytest.mark.parametrize("signed", [None, "00", "xyz"])
def test_what_was_signed_can_be_read(kind, signed):
    (line,) = left(kind, permitted(), record=signed)
    assert line.startswith(f"the {kind}'s record cannot be read: ")


# ---------------------------------------------------------------- decisions


def rule(name, holds):
    return records.PermissiveValue(name=name, holds=holds, text="", bound="", remedy="")


def decided(**changes):
    values = {
        "sequence": 7,
        "event": "heartbeat",
        "from_state": "cutting",
        "to_state": "cutting",
        "disposition": "decided",
        "permissives": (rule("one", holds=False), rule("two", holds=True), rule("three", holds=False)),
    }
    return list(decision_differences(records.AuditDecision(**values | changes)))


SENT = [f"decision 7 sent although this did not hold: {name}" for name in ("one", "three")]
WENT_ON = [f"decision 7 let the arm go on although this did not hold: {name}" for name in ("one", "three")]


def test_a_decision_that_sent_or_let_the_arm_go_on_names_each_permissive_that_did_not_hold():
    assert decided() == WENT_ON
    assert decided(disposition="sent") == SENT + WENT_ON
    assert decided(disposition="sent", from_state="permitting") == SENT
    assert decided(disposition="sent", permissives=(rule("two", holds=True),)) == []


@pytest.mark.parametrize("disposition", ["decided", "authorised", "acknowledged", "withheld"])
def test_what_was_not_sent_may_have_failed(disposition):
    assert decided(disposition=disposition, from_state="permitting") == []


@pytest.mark.parametrize("event", ["joints measured", "progress reported", "heartbeat", "time passed"])
@pytest.mark.parametrize("moving", ["starting", "cutting", "finishing"])
def test_the_moving_arm_goes_on_only_while_the_tracking_monitor_holds(moving, event):
    for to_state in ("starting", "cutting", "finishing", "done"):
        assert decided(from_state=moving, event=event, to_state=to_state) == WENT_ON
    for to_state in ("stopping", "stopped"):
        assert decided(from_state=moving, event=event, to_state=to_state) == []
    assert decided(from_state=moving, event="said start") == []
    assert decided(from_state="permitted", event=event) == []
