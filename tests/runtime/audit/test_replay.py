"""Replay: a log says the same when it is decided again, and every forgery with a sound chain is found."""

import json
from dataclasses import replace
from hashlib import sha256

import pytest

from cutgate.protocol import records as wire
from cutgate.protocol.records import Limits
from cutgate.runtime.audit import names, records
from cutgate.runtime.audit.inspect import Status, read_log, verify_log
from cutgate.runtime.audit.replay import ReplayOutcome, replay
from cutgate.runtime.plan.load import registration_from_bytes
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.certificate import Certificate
from tests.altering import altered
from tests.logs import signature_of
from tests.runtime.audit.build import (
    LOG_ID,
    STANDS,
    VERIFIER,
    forge,
    inputs,
    proof_of,
    session_log,
    small_log,
    wire_permit,
    wire_start,
)

ADMITTED, REFUSED = 500.0, 850.0
NO_FRAMES = b""
"""A session that was made up has passed no bus."""


@pytest.fixture(scope="module")
def admitted(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("admitted"), ADMITTED).log.read_bytes()


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("refused"), REFUSED).log.read_bytes()


def replayed(data, verify=certified.verify, verifier=VERIFIER):
    return replay(read_log(data, NO_FRAMES, signature_of(data)), verify, verifier=verifier)


def differs(data, word, status=Status.OK):
    """The forged log verifies, and only the replay finds it; what both find says ``status``."""
    assert verify_log(data, NO_FRAMES, signature_of(data)).status is status
    result = replayed(data)
    assert result.outcome is ReplayOutcome.DIFFERS
    assert any(word in line for line in result.differences), result.differences


NAMED = wire.TreeHead(bytes.fromhex(LOG_ID), 1, bytes(32))


def named_permit():
    """A permit that names the log that it is in."""
    return wire_permit(log=NAMED)


def bad(data, word):
    result = replayed(data)
    assert result.outcome is ReplayOutcome.BAD_INPUT
    assert word in result.differences[0]


TREE_HEAD_BYTES = len(wire.NO_TREE_HEAD.body())


def of_version_3():
    """Permits and starts as version 3 of the protocol had them: they name no tree."""
    permit = b""

    def edit(record):
        nonlocal permit
        if not isinstance(record, records.AuditPermit) or record.stage != "sent":
            return record
        kind = {"permit": wire.Permit, "start": wire.Start}[record.kind]
        signed = kind.parse(bytes.fromhex(record.record).removeprefix(kind.DOMAIN + b"\0") + wire.NO_MAC)
        if record.kind == "start":
            signed = replace(signed, permit_digest=permit)
        older = signed.canonical()[:-TREE_HEAD_BYTES]
        permit = sha256(older).digest()
        return record.model_copy(update={"record": older.hex(), "log_size": None, "log_root": None})

    return edit


@pytest.fixture(scope="module")
def older(admitted):
    """The admitted session as version 3 would have written it."""
    return forge(admitted, of_version_3())


def changed(kind, when=lambda _record: True, **changes):
    """An edit that changes fields of every record of one kind."""

    def edit(record):
        return record.model_copy(update=changes) if isinstance(record, kind) and when(record) else record

    return edit


def in_document(change):
    """An edit of the verdict's document, its flat fields and boundary records, as a careful forger would."""
    made = {}

    def edit(record):
        if isinstance(record, records.AuditVerdict):
            document = json.loads(record.document)
            change(document)
            made.update({entry.name: entry for entry in records.boundaries_of(document)})
            return records.AuditVerdict.of(
                document, verifier=record.verifier, tool_sha256=record.tool_sha256, reason=record.reason or ""
            )
        return made.get(record.name, record) if isinstance(record, records.AuditBoundary) else record

    return edit


# ---------------------------------------------------------------- identical


def test_an_admitted_session_replays(admitted):
    result = replayed(admitted)
    assert (result.outcome, result.differences, result.notes) == (
        ReplayOutcome.IDENTICAL,
        (),
        ("the steps were not held against the tables of transitions: record 0 names none",),
    )
    assert result.verdict["verdict"] == "admissible"


def test_a_refused_session_replays(refused):
    result = replayed(refused)
    assert (result.outcome, result.differences) == (ReplayOutcome.IDENTICAL, ())
    assert result.verdict["verdict"] == "inadmissible"
    assert "guidance was not computed again, nor the other elbow" in result.notes[0]


def test_a_rewritten_log_replays(admitted):
    assert replayed(forge(admitted)).outcome is ReplayOutcome.IDENTICAL


def test_a_session_without_a_verdict_has_nothing_to_compute(tmp_path):
    result = replayed(small_log(tmp_path, frames=False).log.read_bytes())
    assert result.outcome is ReplayOutcome.IDENTICAL
    assert "before a verdict" in result.notes[0]
    assert result.verdict is None


def test_a_log_that_ends_early_replays_as_far_as_it_goes(admitted):
    whole = admitted[: admitted.index(b'"final_state"') - 300]
    result = replayed(whole)
    assert result.outcome is ReplayOutcome.IDENTICAL
    assert "INCOMPLETE" in result.notes[0]


def test_another_verifier_is_stated(admitted):
    result = replayed(admitted, verifier="cutgate 9")
    assert result.outcome is ReplayOutcome.IDENTICAL
    assert "cutgate test recorded, cutgate 9 recomputes" in result.notes[0]


def test_on_another_cpu_the_counts_are_not_comparable(admitted):
    def other_counts(document):
        document["evaluations"]["arm"] += 1
        document["boundaries"]["top"]["segment"] = 1

    data = forge(admitted, changed(records.AuditOpen, cpu_dispatch=("Z80",)))
    data = forge(data, in_document(other_counts))
    result = replayed(data)
    assert result.outcome is ReplayOutcome.IDENTICAL
    assert "not comparable" in result.notes[0]


def test_on_another_cpu_clearances_are_compared(admitted):
    def other_clearance(document):
        document["boundaries"]["top"]["clearance"] += 1e-8

    data = forge(admitted, changed(records.AuditOpen, cpu_dispatch=("Z80",)))
    differs(forge(data, in_document(other_clearance)), "verdict boundaries.top.clearance")


def test_a_log_of_0_1_0_that_says_nothing_of_warnings_replays(admitted):
    def as_before(document):
        del document["extent"], document["warnings"]
        for boundary in document["boundaries"].values():
            del boundary["tip_mm"]

    earlier = "cutgate 0.1.0"
    data = forge(forge(admitted, in_document(as_before)), changed(records.AuditVerdict, verifier=earlier))
    data = forge(data, changed(records.AuditOpen, verifier=earlier))
    assert not [line for line in replayed(data).differences if "recomputed only" in line]
    differs(data, f"the permit names the verifier {VERIFIER}, its verdict {earlier}")
    differs(forge(admitted, in_document(as_before)), "extent")
    alone = forge(forge(admitted, in_document(as_before)), changed(records.AuditVerdict, verifier=earlier))
    differs(alone, "extent")


# ---------------------------------------------------------------- forged verdicts


def admit(document):
    document["verdict"] = "admissible"
    for entry in document["boundaries"].values():
        entry["violated"] = False
        entry["certified"] = entry["clearance"] = 50.0


@pytest.mark.parametrize(
    ("where", "key"), [("extent", "entry_tip_mm"), ("extent", "tilt_deg"), ("boundaries", "inner")]
)
def test_a_forged_place_of_the_cut_differs(admitted, where, key):
    def change(document):
        found = document[where][key]
        (found if isinstance(found, list) else found["tip_mm"])[0] += 0.001

    differs(forge(admitted, in_document(change)), f"verdict {where}.{key}")


def test_a_warning_that_was_left_out_or_made_up_differs(admitted):
    made_up = {"code": "CUT_HUGE", "text": "x", "value": 1.0, "bound": 2.0, "confirm": True}
    differs(
        forge(admitted, in_document(lambda document: document["warnings"].append(made_up))),
        "verdict warnings",
    )


def test_a_forged_verdict_with_a_sound_chain_differs(refused):
    differs(
        forge(refused, in_document(admit)), "verdict verdict: recorded admissible, recomputed inadmissible"
    )


@pytest.mark.parametrize("key", ["clearance", "certified"])
def test_a_clearance_off_by_more_than_a_billionth_differs(admitted, key):
    def widen(document):
        document["boundaries"]["inner"][key] += 2e-9

    differs(forge(admitted, in_document(widen)), f"verdict boundaries.inner.{key}")


def test_a_clearance_off_by_less_is_identical(admitted):
    def widen(document):
        document["boundaries"]["inner"]["clearance"] += 2e-10

    assert replayed(forge(admitted, in_document(widen))).outcome is ReplayOutcome.IDENTICAL


FORGERIES = {
    "evaluations.arm": lambda document: document["evaluations"].update(arm=1),
    "deadband.arm_mm": lambda document: document["deadband"].update(arm_mm=1.0),
    "branch.q0_turns": lambda document: document["branch"].update(q0_turns=1),
    "boundaries.top.violated": lambda document: document["boundaries"]["top"].update(violated=True),
    "boundaries.top.unit": lambda document: document["boundaries"]["top"].update(unit="deg"),
    "boundaries.outer.certified: recomputed only": lambda document: document["boundaries"].pop("outer"),
    "boundaries.extra.unit: recorded only": lambda document: document["boundaries"].update(
        extra=document["boundaries"]["top"]
    ),
    "speed.0.peak": lambda document: document["speed"][0].update(peak=0.0),
    "method": lambda document: document.update(method="stocco"),
    "path.poses": lambda document: document["path"].update(poses=7),
    "path.tip_length_mm": lambda document: document["path"].update(tip_length_mm=12.2474488),
    "digests.path": lambda document: document["digests"].update(path="00"),
    "digests.registration": lambda document: document["digests"].update(registration="00"),
}


@pytest.mark.parametrize(("word", "change"), FORGERIES.items(), ids=FORGERIES)
def test_every_part_of_the_verdict_is_compared(admitted, word, change):
    differs(forge(admitted, in_document(change)), f"verdict {word}")


def test_flat_fields_must_be_those_of_the_document(admitted):
    differs(forge(admitted, changed(records.AuditVerdict, worst_certified=99.0)), "verdict worst_certified")


@pytest.mark.parametrize("document", ["7", "{", "[" * 100_000])
def test_a_document_that_is_none_differs(admitted, document):
    differs(forge(admitted, changed(records.AuditVerdict, document=document)), "not a JSON object")


def test_a_document_of_another_kind_differs(admitted):
    differs(forge(admitted, changed(records.AuditVerdict, document="{}")), "not a verdict document")


def test_boundary_records_must_be_those_of_the_document(admitted):
    forged = forge(
        admitted, changed(records.AuditBoundary, lambda record: record.name == "top", clearance=1.0)
    )
    differs(forged, "boundary top")


def test_a_boundary_record_that_is_missing_differs(admitted):
    def drop(record):
        return None if isinstance(record, records.AuditBoundary) and record.name == "top" else record

    differs(forge(admitted, drop), "boundaries: 10 recorded")


# ---------------------------------------------------------------- forged approaches


def in_approach(change):
    """An edit of the approach's document and of the flat fields that follow from it."""

    def edit(record):
        if not isinstance(record, records.AuditApproach):
            return record
        document = json.loads(record.document)
        change(document)
        bound = wire_permit().approach if document["verdict"] == "admissible" else None
        return records.AuditApproach.of(
            document, start_joints_u=record.start_joints_u, bound=bound, reason=record.reason or ""
        )

    return edit


def leg(name, side, **changes):
    return lambda document: document["legs"][name][side].update(changes)


APPROACHES = {
    "approach entry_um": lambda document: document.update(entry_um=document["entry_um"] + 1),
    "approach exit_um": lambda document: document.update(exit_um=0),
    "approach entry_joints.0": lambda document: document["entry_joints"].__setitem__(0, 0.0),
    "approach start_joints.3": lambda document: document["start_joints"].__setitem__(3, 0.0),
    "approach clearance_um": lambda document: document.update(clearance_um=9_000),
    "approach start_tolerance_mm": lambda document: document.update(start_tolerance_mm=0.0),
    "approach legs.approach.inner.clearance": leg("approach", "inner", clearance=50.0),
    "approach legs.entry.top.certified": leg("entry", "top", certified=50.0),
    "approach legs.exit.left.deadband": leg("exit", "left", deadband=1.0),
    "approach legs.retract.right.violated": leg("retract", "right", violated=True),
    "approach legs.retract.outer.certified: recomputed only": lambda document: document["legs"]["retract"].pop("outer"),
    "approach reasons": lambda document: document.update(reasons=["none"]),
    "approach verdict": lambda document: document.update(verdict="inadmissible"),
}  # fmt: skip


@pytest.mark.parametrize(("word", "change"), APPROACHES.items(), ids=APPROACHES)
def test_every_part_of_the_approach_is_compared(admitted, word, change):
    differs(forge(admitted, in_approach(change)), word)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("entry_um", 10_671),
        ("exit_um", 9_999),
        ("entry_joints_u", (0, 0, 0, 0, 0)),
        ("exit_joints_u", ()),
        ("speed_percent", 26),
        ("speed_percent", None),
        ("worst_leg", "exit"),
        ("worst_boundary", "top"),
        ("worst_certified", 99.0),
        ("reason", "all is well"),
    ],
)
def test_what_is_bound_and_said_of_the_approach_is_recomputed(admitted, field, value):
    differs(forge(admitted, changed(records.AuditApproach, **{field: value})), f"approach {field}: recorded")


def test_an_approach_from_elsewhere_is_computed_from_there(admitted):
    elsewhere = (*STANDS[:2], 52_000_000, *STANDS[3:])
    forged = forge(admitted, changed(records.AuditApproach, start_joints_u=elsewhere))
    differs(forged, "approach verdict: recorded admissible, recomputed inadmissible")
    differs(forged, "a permit left; the approach is recorded as admissible and recomputed as inadmissible")
    differs(forged, "a start left; the approach is recorded as admissible and recomputed as inadmissible")
    differs(forged, "the permit's start joints are not the verified")
    differs(forged, " mm, q3 ")
    differs(forged, "verified q0 ")
    differs(forged, "q2 52.000000 mm")


def test_the_words_of_an_older_verifier_may_be_others(admitted):
    other = changed(records.AuditApproach, reason="in other words")
    differs(forge(admitted, other), "approach reason: recorded in other words")
    older = replayed(forge(forge(admitted, changed(records.AuditOpen, verifier="another")), other))
    assert not any("reason" in line for line in older.differences)


@pytest.mark.parametrize(
    ("setting", "word"),
    [
        (
            "[approach]\napproach_clearance_mm = 12.5",
            "approach clearance_um: recorded 10000, recomputed 12500",
        ),
        ("[approach]\napproach_speed_percent = 30", "approach speed_percent: recorded 25, recomputed 30"),
        ("[start]\nstart_tolerance_mm = 1.0", "approach start_tolerance_mm: recorded 0.5, recomputed 1.0"),
        ("[start]\nstart_tolerance_deg = 0.5", "approach start_tolerance_deg"),
    ],
)
def test_the_approach_is_computed_with_the_sites_settings(tmp_path, setting, word):
    site = f'schema = "cutgate.site/1"\n{setting}\n'.encode()
    differs(session_log(tmp_path, site=site).log.read_bytes(), word)


def test_a_site_that_is_damaged_is_bad_input(tmp_path):
    bad(session_log(tmp_path, site=b"schema = 7").log.read_bytes(), "site.toml")


@pytest.mark.parametrize("joints", [(1, 2, 3), ()])
def test_start_joints_that_are_none_are_bad_input(admitted, joints):
    bad(forge(admitted, changed(records.AuditApproach, start_joints_u=joints)), "start joints")


def test_an_approach_document_that_is_none_differs(admitted):
    differs(
        forge(admitted, changed(records.AuditApproach, document="7")),
        "approach: the recorded document is not a JSON object",
    )


def test_on_another_cpu_the_words_about_an_approach_are_not_comparable(admitted):
    data = forge(admitted, changed(records.AuditOpen, cpu_dispatch=("Z80",)))
    data = forge(data, changed(records.AuditApproach, reason="another last digit"))
    assert replayed(data).outcome is ReplayOutcome.IDENTICAL
    differs(forge(data, changed(records.AuditApproach, worst_certified=99.0)), "approach worst_certified")


# ---------------------------------------------------------------- forged inputs


def attachment(name, content):
    return lambda found, data: content if found == name else data


def test_another_path_than_the_plans_differs(admitted):
    forged = forge(admitted, attachments=attachment(names.PATH, inputs(REFUSED).path))
    differs(forged, "the uploaded path is not the one")


def test_other_limits_than_the_verdicts_differ(admitted):
    limits = records_limits(admitted, 0)
    differs(forge(admitted, attachments=attachment(names.LIMITS, limits)), "verdict digests.limits")


def test_limits_that_robot_toml_does_not_approve_differ(admitted):
    differs(forge(admitted, attachments=attachment(names.LIMITS, records_limits(admitted, 0))), "approves")


def records_limits(data, joint):
    """The recorded limits with one joint's upper limit a degree wider."""
    found = Limits.parse(read_log(data).scan.attachment(names.LIMITS).data)
    upper = tuple(value + 1_000_000 * (number == joint) for number, value in enumerate(found.q_max_u))
    return replace(found, q_max_u=upper).body()


def test_another_registration_differs(admitted):
    other = inputs(REFUSED).registration
    assert registration_from_bytes("x", other).id == "test"
    differs(forge(admitted, attachments=attachment("registration.json", other)), "the uploaded path is not")


def test_an_admissible_verdict_needs_its_proof(admitted):
    differs(forge(admitted, attachments=attachment(names.PROOF, None)), "proof.bin is missing")


def test_a_proof_that_cannot_be_read_differs(admitted):
    differs(forge(admitted, attachments=attachment(names.PROOF, b"damaged")), "do not begin as a certificate")


def test_a_proof_that_states_more_than_it_proves_differs(admitted):
    proof = Certificate.parse(proof_of())
    bold = replace(proof, bounds={**proof.bounds, "outer": proof.bounds["outer"] + 500.0})
    differs(forge(admitted, attachments=attachment(names.PROOF, bold.body())), "the proof: outer: ")


def test_a_proof_that_states_too_little_differs(admitted):
    proof = Certificate.parse(proof_of())
    shy = replace(proof, bounds={name: v for name, v in proof.bounds.items() if name != "speed 1"})
    differs(forge(admitted, attachments=attachment(names.PROOF, shy.body())), "states nothing")


def test_a_refused_log_needs_no_proof(refused):
    assert names.PROOF not in {entry.name for entry in read_log(refused).scan.attachments}
    assert replayed(refused).outcome is ReplayOutcome.IDENTICAL


def test_a_plan_that_is_refused_differs(admitted):
    differs(forge(admitted, attachments=attachment("plan.csv", b"x,y\n")), "give no path")


@pytest.mark.parametrize(
    "name", [names.ROBOT, names.PATH, names.LIMITS, names.CALIBRATION, names.TOOL, "plan.csv"]
)
def test_without_an_input_nothing_is_replayed(admitted, name):
    bad(forge(admitted, attachments=attachment(name, None)), "missing")


def test_without_a_registration_it_is_the_identity(admitted):
    differs(
        forge(admitted, attachments=attachment("registration.json", None)), "verdict digests.registration"
    )


@pytest.mark.parametrize(("name", "word"), [(names.ROBOT, "robot.toml"), (names.TOOL, "no problem")])
def test_an_input_that_is_damaged_is_bad_input(admitted, name, word):
    bad(forge(admitted, attachments=attachment(name, b"damaged")), word)


def test_a_verifier_that_gives_up_is_bad_input(admitted):
    def broken(_problem):
        raise ValueError("no problem of this kind")

    assert replayed(admitted, broken).outcome is ReplayOutcome.BAD_INPUT


def test_a_record_that_cannot_be_read_is_bad_input(admitted):
    def odd(record):
        return (
            record.model_copy(update={"poses": "many"})
            if isinstance(record, records.AuditVerdict)
            else record
        )

    with pytest.warns(UserWarning, match="serializ"):
        forged = forge(admitted, odd)
    bad(forged, "poses")


def test_no_log_is_bad_input():
    bad(b"hello", "not an audit log")


def test_a_log_without_record_0_is_bad_input(admitted):
    end = admitted.index(b"\x06", 8)
    assert replayed(admitted[: min(end, 60)]).outcome is ReplayOutcome.BAD_INPUT


def test_a_damaged_log_differs(admitted):
    damaged = admitted.replace(b'"accepted"', b'"accepteD"').replace(b'"holds":true', b'"holds":null', 1)
    result = replayed(damaged)
    assert result.outcome is not ReplayOutcome.IDENTICAL
    assert "TAMPERED" in result.differences[0] or "cannot be read" in result.differences[0]


# ---------------------------------------------------------------- what was enabled


def left_out(kind, when):
    return lambda record: None if isinstance(record, kind) and when(record) else record


def stage(kind, name):
    return lambda record: (record.kind, record.stage) == (kind, name)


@pytest.mark.parametrize("kind", ["permit", "start"])
def test_nothing_leaves_without_its_authorisation(older, kind):
    forged = forge(older, left_out(records.AuditPermit, stage(kind, "authorised")))
    differs(forged, f"a {kind} left without a record that authorised it")


def test_a_session_of_version_3_replays(older):
    result = replayed(older)
    assert (result.outcome, result.differences) == (ReplayOutcome.IDENTICAL, ())


@pytest.mark.parametrize("kind", ["permit", "start"])
def test_what_names_another_tree_than_was_signed_differs(admitted, older, kind):
    """The record says one thing, what was signed another."""
    told = f"the {kind}'s log is not the one that was signed"
    signed = [
        record.record
        for _, data in read_log(admitted).each(records.AuditPermit.TOPIC)
        if stage(kind, "sent")(record := records.AuditPermit.model_validate_json(data))
    ]
    other = bytearray.fromhex(signed[0])
    other[-40] ^= 1  # of the size
    forged = forge(admitted, changed(records.AuditPermit, stage(kind, "sent"), record=other.hex()))
    differs(forged, told)


@pytest.mark.parametrize("kind", ["permit", "start"])
def test_another_record_of_the_same_kind_authorises_nothing(older, kind):
    """As one that was authorised and withheld, and then left all the same under another number."""
    when = stage(kind, "sent")
    forged = forge(older, changed(records.AuditPermit, when, token=9))
    differs(forged, f"a {kind} left without a record that authorised it")


def test_no_start_leaves_without_an_acknowledged_permit(admitted):
    differs(
        forge(admitted, left_out(records.AuditPermit, stage("permit", "acknowledged"))),
        "without an acknowledged",
    )


def test_nothing_leaves_on_an_inadmissible_verdict(admitted):
    def refuse(document):
        document["verdict"] = "inadmissible"

    result = replayed(forge(admitted, in_document(refuse)))
    assert result.outcome is ReplayOutcome.DIFFERS
    for kind in ("permit", "start"):
        assert any(
            f"a {kind} left; the verdict is recorded as inadmissible" in line for line in result.differences
        )


def test_a_permit_on_a_refused_path_is_named(older, refused):
    """The refused session, given the permit that left in the admitted one."""
    sent = next(
        record
        for _, data in read_log(older).each(records.AuditPermit.TOPIC)
        if stage("permit", "sent")(record := records.AuditPermit.model_validate_json(data))
    )
    forged = forge(refused, lambda record: sent if isinstance(record, records.AuditDecision) else record)
    differs(forged, "a permit left; the verdict is recorded as inadmissible and recomputed as inadmissible")
    differs(forged, "the permit's path digest is not the verdict's")


def test_nothing_leaves_without_a_verdict(admitted):
    def drop(record):
        return None if isinstance(record, records.AuditVerdict | records.AuditBoundary) else record

    differs(forge(admitted, drop), "a permit left without a verdict")


def test_nothing_leaves_without_a_verified_approach(admitted):
    forged = forge(admitted, lambda record: None if isinstance(record, records.AuditApproach) else record)
    for kind in ("permit", "start"):
        differs(forged, f"a {kind} left without a verified approach")


def test_an_approach_belongs_to_the_verdict_before_it(admitted):
    """A later verdict needs an approach of its own."""
    found = read_log(admitted).of(records.AuditVerdict.TOPIC)[0]
    queue = [records.AuditVerdict.model_validate_json(json.dumps(found))]
    forged = forge(
        admitted,
        lambda record: queue.pop() if queue and isinstance(record, records.AuditDecision) else record,
    )
    differs(forged, "a permit left without a verified approach")


def test_nothing_leaves_on_an_inadmissible_approach(admitted):
    forged = forge(admitted, in_approach(lambda document: document.update(verdict="inadmissible")))
    for kind in ("permit", "start"):
        differs(
            forged, f"a {kind} left; the approach is recorded as inadmissible and recomputed as admissible"
        )


@pytest.mark.parametrize(
    ("field", "value", "name"),
    [
        ("start_joints_u", (0, *STANDS[1:]), "start joints"),
        ("approach.entry_um", 0, "entry"),
        ("approach.entry_joints_u", STANDS, "entry"),
        ("approach.exit_um", 1, "exit"),
        ("approach.exit_joints_u", STANDS, "exit"),
        ("approach.speed_percent", 100, "approach speed"),
    ],
)
def test_the_permit_binds_the_approach_that_was_verified(admitted, field, value, name):
    record = altered(named_permit(), field, value).canonical().hex()
    forged = forge(admitted, changed(records.AuditPermit, stage("permit", "sent"), record=record))
    differs(forged, f"the permit's {name} are not the verified")


@pytest.mark.parametrize("record", [None, "00", "xyz"])
def test_a_permit_that_cannot_be_read_differs(admitted, record):
    forged = forge(admitted, changed(records.AuditPermit, stage("permit", "sent"), record=record))
    differs(forged, "the permit's record cannot be read", Status.TAMPERED)


@pytest.mark.parametrize("record", [None, "00", "xyz"])
def test_a_start_that_cannot_be_read_differs(admitted, record):
    forged = forge(admitted, changed(records.AuditPermit, stage("start", "sent"), record=record))
    differs(forged, "the start's record cannot be read", Status.TAMPERED)


def test_a_start_names_the_permit_that_had_left(admitted):
    other = wire_start(altered(named_permit(), "lifetime_s", 121), NAMED).canonical().hex()
    forged = forge(admitted, changed(records.AuditPermit, stage("start", "sent"), record=other))
    differs(forged, "a start left for another permit than the one that had left")


@pytest.mark.parametrize("name", ["path", "limits", "calibration", "tool", "registration", "configuration"])
def test_the_permits_digests_are_those_that_were_signed(admitted, name):
    signed = altered(named_permit(), f"{name}_digest", bytes(32)).canonical().hex()
    forged = forge(admitted, changed(records.AuditPermit, stage("permit", "sent"), record=signed))
    differs(forged, f"the permit's {name} digest is not the one that was signed")


def test_a_permits_configuration_is_that_of_the_files_that_are_attached(tmp_path):
    site = b'schema = "cutgate.site/1"\n'
    log = session_log(tmp_path, site=site).log.read_bytes()
    assert replayed(log).outcome is ReplayOutcome.IDENTICAL
    told = "the permit's configuration is not that of robot.toml, site.toml and the options"
    for other in (site + b"\n", None):
        differs(
            forge(log, attachments=lambda name, data, other=other: other if name == names.SITE else data),
            told,
        )


def test_a_simulation_that_was_allowed_is_part_of_the_permits_configuration(admitted):
    def allow(record):
        if isinstance(record, records.AuditOpen):
            option = records.Option(name="simulated controller", value="allowed by --allow-simulated")
            return record.model_copy(update={"simulation": (option,)})
        return record

    differs(forge(admitted, allow), "the permit's configuration is not that of")


@pytest.mark.parametrize("name", ["path", "limits", "calibration", "tool", "registration"])
def test_the_permits_digests_are_the_verdicts(admitted, name):
    forged = forge(
        admitted, changed(records.AuditPermit, stage("permit", "sent"), **{f"{name}_sha256": "00"})
    )
    differs(forged, f"the permit's {name} digest is not the verdict's")


def test_nothing_leaves_while_a_permissive_fails(admitted):
    failing = records.PermissiveValue(
        name="emergency stop", holds=False, text="pressed", bound="clear", remedy=""
    )
    forged = forge(
        admitted,
        changed(records.AuditDecision, lambda record: record.disposition == "sent", permissives=(failing,)),
    )
    differs(forged, "did not hold: emergency stop")


@pytest.mark.parametrize("event", ["joints measured", "progress reported", "heartbeat", "time passed"])
@pytest.mark.parametrize("moving", ["starting", "cutting", "finishing"])
def test_no_arm_goes_on_that_was_not_where_it_was_verified(tmp_path, moving, event):
    """What the tracking monitor showed, and what came of it: a log that takes back the stop differs."""
    log = small_log(tmp_path, frames=False).log.read_bytes()
    off = records.PermissiveValue(
        name="measured joints to the verified path", holds=False, value=1.0, bound="<= 0.255 deg", remedy=""
    )

    def decided(holds, to_state, event=event):
        rule = off.model_copy(update={"holds": holds})
        told = {"from_state": moving, "to_state": to_state, "event": event, "permissives": (rule,)}
        return forge(log, changed(records.AuditDecision, **told))

    for to_state in ("stopping", "stopped"):
        assert replayed(decided(holds=False, to_state=to_state)).outcome is ReplayOutcome.IDENTICAL
    for to_state in ("cutting", "finishing", "done"):
        differs(decided(holds=False, to_state=to_state), "let the arm go on although this did not hold: meas")
        assert replayed(decided(holds=True, to_state=to_state)).outcome is ReplayOutcome.IDENTICAL
    said = decided(holds=False, to_state=moving, event="said start")
    assert replayed(said).outcome is ReplayOutcome.IDENTICAL, (
        "a word that is refused shows what else does not hold"
    )


def test_a_reset_needs_its_authorisation_and_no_verdict(tmp_path):
    log = small_log(tmp_path, frames=False).log.read_bytes()

    def resets(*stages):
        queue = [records.AuditPermit(kind="reset", stage=name, token=9) for name in stages]
        return lambda record: queue.pop(0) if queue and isinstance(record, records.AuditDecision) else record

    differs(forge(log, resets("sent")), "a reset left without a record that authorised it")
    for sound in (("authorised", "sent", "acknowledged"), ("authorised", "withheld")):
        assert replayed(forge(log, resets(*sound))).outcome is ReplayOutcome.IDENTICAL
