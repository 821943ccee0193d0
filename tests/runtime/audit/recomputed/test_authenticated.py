"""Every code of a real session is checked from its log; whatever is altered without the key is found and named."""

import json
from contextlib import suppress
from dataclasses import replace
from io import BytesIO

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cutgate.config.load import InputError
from cutgate.config.session_keys import SessionKeys
from cutgate.protocol import candump
from cutgate.protocol import records as wire
from cutgate.protocol.codes import PresharedKey, SessionCodes, fingerprint
from cutgate.protocol.e2e import protect
from cutgate.protocol.frames import (
    CONTROL_IDS,
    DATA_IDS,
    IDS,
    ControllerHeartbeat,
    Joint4,
    Joints01,
    RuntimeHeartbeat,
)
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.runtime.audit import records
from cutgate.runtime.audit.inspect import Status, read_log
from cutgate.runtime.audit.recomputed import authenticated
from cutgate.runtime.audit.recomputed.authenticated import SHOWN, check_codes, when
from cutgate.runtime.interlock.state import Phase
from tests.runtime.audit.build import LOG_ID
from tests.runtime.audit.recomputed.coded import Coded, carried, envelope, flipped
from tests.runtime.session.pair import KEY, job_of, pair_of
from tests.runtime.session.wire import CONTROLLER, RUNTIME
from tools.fuzz import audit

OTHER_KEY = KEY[::-1]
NOT_OURS = "its code is none that a holder of the key made"
UNFIT = "its tag is none that a holder of the key made here"
OURS, THEIRS = IDS[RuntimeHeartbeat], IDS[ControllerHeartbeat]


def a_session(name, tmp_path_factory, lead):
    files, job = job_of(tmp_path_factory)
    job = replace(job, key_fingerprint=fingerprint(KEY))
    with pair_of(tmp_path_factory.mktemp(name), files, job) as pair:
        lead(pair)
        pair.run(0.2)
        return Coded.of(pair)


@pytest.fixture(scope="module")
def cut(tmp_path_factory):
    """A cut to its end."""
    return a_session("cut", tmp_path_factory, lambda pair: pair.end())


@pytest.fixture(scope="module")
def reset(tmp_path_factory):
    """A latched fault is left, then the registration is withdrawn."""

    def lead(pair):
        pair.latch(StopCause.LIMIT_EXCEEDED)
        pair.to(Phase.HELD).run(0.1).say("acknowledge").run(0.1)
        pair.say("reset").to(Phase.PERMITTED)
        pair.say("withdraw").end()

    return a_session("reset", tmp_path_factory, lead)


# ---------------------------------------------------------------- what fits


@pytest.mark.parametrize("held", ["pre-shared key", "session keys"])
def test_every_code_of_a_session_fits_under_either_key(cut, held):
    found = cut.check(KEY if held == "pre-shared key" else cut.keys)
    assert cut.read.report.status is Status.OK
    assert (found.answer, found.key, found.wrong, found.notes) == ("yes", held, (), ())
    counted = dict(found.checked)
    beats = len(cut.single_frames(OURS, "sent")), len(cut.single_frames(THEIRS, "received"))
    assert (counted["heartbeat sent"], counted["heartbeat received"]) == beats
    assert counted["joint sample"] == len(cut.single_frames(IDS[Joint4], "received")) > 50
    assert {counted[name] for name in ("OPEN", "OPENED", "permit", "start")} == {1}
    assert found.line == (
        f"codes: yes ({held}): OPEN, OPENED, 1 permit, 1 start, {beats[0]} heartbeats sent, {beats[1]} heartbeats "
        f"received, {counted['joint sample']} joint samples"
    )


def test_what_the_log_does_not_hold_is_checked_in_the_raw_frames(reset):
    counted = reset.check().checked
    assert [counted[name] for name in ("permit", "start", "reset", "acknowledge", "withdraw")] == [
        1,
        0,
        1,
        1,
        1,
    ]
    without = reset.check(raw=False)
    assert (without.answer, without.checked["acknowledge"], without.checked["withdraw"]) == ("yes", 0, 0)
    assert without.checked["reset"] == 1
    assert without.notes == (
        "not checked: acknowledge and withdraw, and whether the log's frames are the raw ones: they are not there",
    )


@pytest.mark.parametrize("session", ["cut", "reset"])
def test_the_keys_of_the_session_alone_say_the_same(session, request):
    coded = request.getfixturevalue(session)
    assert replace(coded.check(coded.keys), key="pre-shared key") == coded.check()


# ---------------------------------------------------------------- every code, altered


def both(coded, altered, **options):
    """What is found in an altered session, by the pre-shared key and by the session's own keys, which agree."""
    found, alone = altered.check(**options), altered.check(coded.keys, **options)
    assert (found.answer, found.wrong[:1]) == (alone.answer, alone.wrong[:1])
    return found


@pytest.mark.parametrize("raw", [True, False], ids=["raw frames", "log alone"])
@pytest.mark.parametrize("which", ["open", "opened"])
def test_an_altered_code_of_open_or_opened_is_named(cut, which, raw):
    (session,) = cut.read.of("/audit/session")
    changed = envelope(session[which], lambda body: flipped(body, len(body) - 1, 0x80))
    found = both(cut, cut.session(**{which: changed}), raw=raw)
    assert found.answer == "no"
    assert found.wrong[0] == f"/audit/session: {which.upper()}: {NOT_OURS}"
    assert found.checked["permit"] == 1  # the other one tells which session it is


@pytest.mark.parametrize("place", [2, 20, 40, 80, 170])
def test_an_altered_open_is_named(cut, place):
    (session,) = cut.read.of("/audit/session")
    found = both(cut, cut.session(open=envelope(session["open"], lambda body: flipped(body, place, 1))))
    assert found.answer == "no"
    assert found.wrong[0] == f"/audit/session: OPEN: {NOT_OURS}"


@pytest.mark.parametrize("changes", [{"session": "ab" * 32}, {"key_fingerprint": "00000000"}])
def test_what_the_session_is_called_must_be_right(cut, changes):
    found = cut.session(**changes).check()
    assert (found.answer, found.wrong_count) == ("no", 1)
    assert "/audit/session: it names another" in found.line


@pytest.mark.parametrize("kind", ["permit", "start"])
@pytest.mark.parametrize("field", ["code", "record", "sequence"])
def test_an_altered_permit_or_start_is_named_with_its_record_and_time(cut, kind, field):
    (sent,) = [one for one in cut.read.of("/audit/permit") if (one["kind"], one["stage"]) == (kind, "sent")]
    changed = sent[field] + 1 if field == "sequence" else flipped(bytes.fromhex(sent[field]), -3, 4).hex()
    found = both(cut, cut.permit(kind, **{field: changed}))
    assert (found.answer, found.checked[kind]) == ("no", 0)
    numbers = [number for number, one in enumerate(all_records(cut)) if is_sent(one, kind)]
    place = f"record {numbers[0]} (/audit/permit), {when(records.Time(**sent['utc']).nanoseconds // 1000)}: "
    assert found.wrong[0].startswith(place)
    assert found.wrong[0].endswith(f"the {kind}: {NOT_OURS}")


def all_records(coded):
    """Topic and record of everything in the log."""
    topics = [model.TOPIC for model in records.MODELS]
    return [(topic, data) for topic, data in coded.read.each(*topics)]


def frame_record(coded, which):
    """Number in the file, and content, of one of the log's frames."""
    frames = [
        (number, data) for number, (topic, data) in enumerate(all_records(coded)) if topic == "/can/frame"
    ]
    return frames[which][0], json.loads(frames[which][1])


def is_sent(one, kind):
    topic, data = one
    return topic == "/audit/permit" and f'"kind":"{kind}","stage":"sent"'.encode() in data


@pytest.mark.parametrize("field", ["code", "sequence"])
def test_a_permit_that_lacks_what_its_code_needs_is_named(cut, field):
    found = cut.permit("permit", **{field: None}).check()
    assert found.answer == "no"
    assert "(/audit/permit)" in found.wrong[0]
    assert "cannot be read" in found.wrong[0]


def test_what_is_coded_begins_with_its_domain(cut):
    (sent,) = [
        one["record"]
        for one in cut.read.of("/audit/permit")
        if (one["kind"], one["stage"]) == ("start", "sent")
    ]
    found = cut.permit("start", record=sent.removeprefix(b"cutgate/start/1\0".hex())).check()
    assert found.wrong[0].endswith(f"the start: {NOT_OURS}")


@pytest.mark.parametrize("name", ["open", "opened", "permit", "start"])
def test_a_record_that_was_answered_has_left_whole(cut, name):
    numbers, _ = control(cut, CONTROLLER if name == "opened" else RUNTIME, TYPES[name])
    found = cut.raw(
        lambda lines: [line for number, line in enumerate(lines) if number != numbers[-2]]
    ).check()
    named = name.upper() if name.startswith("open") else name
    assert (found.answer, found.wrong[0]) == (
        "no",
        f"the raw frames do not hold the {named} that the log holds",
    )


@pytest.mark.parametrize("sequence", [-1, 1 << 32, 1 << 200])
def test_a_sequence_that_no_record_has_is_named(cut, sequence):
    assert "cannot be read: it names no sequence" in cut.permit("start", sequence=sequence).check().wrong[0]


def test_an_altered_reset_is_named(reset):
    found = both(reset, reset.permit("reset", code="00" * 16))
    assert found.answer == "no"
    assert found.wrong[0].endswith(f"the reset: {NOT_OURS}")


def control(coded, side, record):
    """The lines of the frames of a record of the control channel that was sent once."""
    lines = coded.frames.splitlines(keepends=True)
    frames = [(number, candump.parse(line.decode())) for number, line in enumerate(lines)]
    begin = next(
        place
        for place, (_, frame) in enumerate(frames)
        if frame.can_id == CONTROL_IDS[side] and frame.data[0] >> 4 == 1 and frame.data[2] == record
    )
    length = (frames[begin][1].data[0] & 0xF) << 8 | frames[begin][1].data[1]
    found, carried = [frames[begin][0]], 6
    for number, frame in frames[begin + 1 :]:
        if frame.can_id == CONTROL_IDS[side] and frame.data[0] >> 4 == 2 and carried < length:
            found.append(number)
            carried += 7
    return found, length


TYPES = {
    "open": 0x02,
    "opened": 0x03,
    "permit": 0x07,
    "start": 0x08,
    "reset": 0x09,
    "acknowledge": 0x0A,
    "withdraw": 0x0B,
}


@pytest.mark.parametrize("name", TYPES)
def test_a_record_whose_raw_frames_are_altered_is_found(cut, reset, name):
    """Its CRC-32 does not fit any more, so that nobody has received this."""
    coded = cut if name == "start" else reset
    numbers, _ = control(coded, CONTROLLER if name == "opened" else RUNTIME, TYPES[name])

    def change(lines):
        frame = candump.parse(lines[numbers[-2]].decode())
        data = flipped(frame.data, 3, 1).hex().upper().encode()
        lines[numbers[-2]] = lines[numbers[-2]].replace(frame.data.hex().upper().encode(), data)
        return lines

    found = coded.raw(change).check()
    assert found.answer == "no"
    assert "raw frames" in found.wrong[0]


@pytest.mark.no_cover
@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    site=st.sampled_from(["open", "opened", "permit", "start"]),
    place=st.integers(0, 15),
    mask=st.integers(1, 255),
)
def test_every_flipped_byte_of_a_code_is_found(cut, site, place, mask):
    if site in ("open", "opened"):
        (session,) = cut.read.of("/audit/session")
        changed = envelope(session[site], lambda body: flipped(body, len(body) - 16 + place, mask))
        altered = cut.session(**{site: changed})
    else:
        (code,) = [
            one["code"]
            for one in cut.read.of("/audit/permit")
            if (one["kind"], one["stage"]) == (site, "sent")
        ]
        altered = cut.permit(site, code=flipped(bytes.fromhex(code), place, mask).hex())
    found = both(cut, altered, raw=False)
    assert found.answer == "no"
    assert site in found.wrong[0].lower()


TAGGED = [(OURS, "sent", (3, 4)), (THEIRS, "received", (3, 4)), (IDS[Joint4], "received", (6, 7))]


@pytest.mark.no_cover
@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_every_flipped_byte_of_a_tag_is_found(cut, data):
    can_id, direction, places = data.draw(st.sampled_from(TAGGED))
    which = data.draw(st.sampled_from(cut.single_frames(can_id, direction)[:-2]))
    place, mask = data.draw(st.sampled_from(places)), data.draw(st.integers(1, 255))
    altered = cut.frame(which, lambda frame: flipped(frame, place, mask), protected=data.draw(st.booleans()))
    found = both(cut, altered, raw=data.draw(st.booleans()))
    assert found.answer == "no"
    assert any(text in found.wrong[0] for text in (UNFIT, "left damaged", "damaged, this side counted 0"))


@pytest.mark.parametrize(("can_id", "direction", "places"), TAGGED)
def test_an_altered_tag_is_named_by_record_line_time_and_counter(cut, can_id, direction, places):
    which = cut.single_frames(can_id, direction)[20]
    altered = cut.frame(which, lambda frame: flipped(frame, places[1], 0x10))
    found = both(cut, altered)
    number, record = frame_record(altered, which)
    at = when(records.Time(**record["stamp"]).nanoseconds // 1000)
    assert found.wrong[0].startswith(f"record {number} (/can/frame), {at}: ")
    assert "of the raw frames)" in found.wrong[0]
    went_on = "" if direction == "sent" else ", and the session went on"
    counter = bytes.fromhex(record["data"])[2]
    what = {OURS: f"heartbeat {counter} that left", THEIRS: f"heartbeat {counter} that came"}
    what = what.get(can_id, f"joint sample {counter}")
    assert f"{what}: {UNFIT}" in found.wrong[0]
    assert found.wrong[0].endswith(went_on)


# ---------------------------------------------------------------- what is not the log's


@pytest.mark.parametrize("wrong", ["lost", "doubled", "other", "no frame", "early end", "more"])
def test_raw_frames_that_are_not_the_logs_are_named(cut, wrong):
    def change(lines):
        single = next(n for n, line in enumerate(lines) if b" 080#" in line)
        if wrong == "lost":
            del lines[single]
        elif wrong == "doubled":
            lines.insert(single, lines[single])
        elif wrong == "other":
            lines[single] = lines[single].replace(b" 080#", b" 081#")
        elif wrong == "no frame":
            lines[single] = b"what is this\n"
        elif wrong == "early end":
            del lines[-5:]
        else:
            lines.append(lines[-1])
        return lines

    found = cut.raw(change).check()
    assert found.answer == "no"
    assert "raw frames" in found.wrong[0]


def test_a_permit_that_the_raw_frames_hold_and_the_log_does_not_is_named(cut):
    def without(one):
        permit = isinstance(one, records.AuditPermit) and one.kind == "permit"
        transfer = isinstance(one, records.CanTransfer) and one.record == "Permit"
        return None if permit or transfer else one

    found = cut.edited(without).check()
    assert found.answer == "no"
    assert "the Permit: a holder of the key made it, and the log does not know it" in found.line


def test_a_session_taken_out_of_its_log_is_missed(cut):
    found = cut.edited(lambda one: None if isinstance(one, records.AuditSession) else one).check()
    assert (found.answer, found.wrong) == (
        "no",
        ("/audit/session is missing, and a permit, start or reset left",),
    )


def test_a_log_has_one_session_that_can_be_read(cut):
    twice = cut.edited(
        lambda one: (
            records.AuditSession(session="", open="", opened="")
            if isinstance(one, records.AuditProcess)
            else one
        )
    )
    assert "/audit/session is there 3 times, and a log has one session" in twice.check().line
    for changes in ({"open": "zz"}, {"opened": "00"}, {"open": cut.read.of("/audit/session")[0]["opened"]}):
        found = cut.session(**changes).check()
        assert found.answer == "no"
        assert "/audit/session cannot be read: " in found.line


def test_a_permit_that_left_is_one_of_the_records_that_left(cut):
    found = cut.edited(
        lambda one: None if isinstance(one, records.CanTransfer) and one.record == "Permit" else one
    ).check(raw=False)
    assert (found.answer, found.wrong_count) == ("no", 1)
    assert found.wrong[0].endswith("no /can/transfer is of the permit that left")


def test_no_session_has_so_many_control_records_that_memory_runs_out(cut, monkeypatch):
    monkeypatch.setattr(authenticated, "TRANSFERS_MAX", 3)
    assert "more than 3 control records left; no session has so many" in cut.check(raw=False).line


def said(record, side, session, sequence=1000):
    """The lines of raw frames of a record that somebody says."""
    frames = carried(wire.pack(record, session, sequence), side)
    return [candump.line(1_790_000_000_000_000_000, "vcan0", *frame).encode() for frame in frames]


def test_a_record_of_this_side_that_the_log_does_not_know_is_named_whatever_its_code(cut):
    acknowledge = wire.Acknowledge(0, StopCause.OPERATOR_STOP)
    signed = SessionCodes(cut.keys.codes).sign(acknowledge, 1000)
    for record, tag, told in (
        (signed, cut.tag, "the Acknowledge: a holder of the key made it, and the log does not know it"),
        (signed, 7, "the Acknowledge: a record under this side's name that the log does not know"),
        (acknowledge, cut.tag, "the Acknowledge: a record under this side's name that the log does not know"),
        (wire.Collect(), cut.tag, "the Collect: a record under this side's name that the log does not know"),
    ):
        more = said(record, RUNTIME, tag)
        found = cut.raw(lambda lines, more=more: lines + more).check()
        assert (found.answer, found.wrong_count) == ("no", 1)
        assert told in found.wrong[0]


def test_an_open_said_again_is_no_sign_of_the_key(cut):
    """Its code covers no sequence: anybody can say it again under another one. The runtime calls that a second node."""
    again = said(cut_open(cut), RUNTIME, 0)
    found = cut.raw(lambda lines: lines + again).check()
    assert found.wrong[0].endswith("the Open: a record under this side's name that the log does not know")
    fault = records.AuditFault(source="runtime", code="STOP", cause="SECOND_NODE")
    told = cut.edited(lambda one: fault if isinstance(one, records.AuditProcess) else one)
    assert replace(told, frames=cut.frames + b"".join(again)).check().answer == "yes"


def test_what_came_while_this_side_stood_still_it_called_nothing(cut):
    fault = records.AuditFault(source="runtime", code="STOP", cause="LOOP_STALLED")
    stalled = cut.edited(lambda one: fault if isinstance(one, records.AuditProcess) else one)
    found = stalled.raw(lambda lines: lines + said(wire.Collect(), RUNTIME, cut.tag)).check()
    assert (found.answer, found.wrong) == ("yes", ())
    assert found.notes[0].startswith("not checked: line ")
    assert found.notes[0].endswith("the Collect, for this side stood still and looked at nothing")


def cut_open(coded):
    return wire.unpack(bytes.fromhex(coded.read.of("/audit/session")[0]["open"])).record


def test_an_opened_with_a_wrong_code_is_told(cut):
    """It opens nothing."""
    forged = said(wire.Opened(0, ControllerState.OPEN, StopCause.NONE), CONTROLLER, cut.tag)
    found = cut.raw(lambda lines: forged + lines).check()
    assert (found.answer, found.notes) == (
        "yes",
        ("refused by this side, as it must: OPENED with a wrong code (1)",),
    )


def test_several_frames_that_do_not_fit_are_counted(cut):
    joints = cut.single_frames(IDS[Joint4], "received")[30]
    altered = cut.frame(joints, lambda frame: flipped(frame, 7, 1))
    beat = cut.single_frames(THEIRS, "received")[30]
    one, two = altered.check(), altered.frame(beat, lambda frame: flipped(frame, 3, 1)).check()
    assert (one.wrong_count, two.answer) == (1, "no")
    assert two.wrong_count >= 3  # the heartbeat, its sample's, and this side's that echoes it


# ---------------------------------------------------------------- other keys


def test_the_key_of_another_pair_is_refused_by_the_fingerprint_that_the_log_names(cut):
    with pytest.raises(InputError) as refused:
        cut.check(OTHER_KEY)
    assert f"fingerprint is {fingerprint(OTHER_KEY)}, must be {fingerprint(KEY)}" in str(refused.value)


def test_where_the_log_names_no_fingerprint_nothing_fits_under_another_key(cut):
    unnamed = cut.edited(
        lambda one: (
            one.model_copy(update={"key_fingerprint": None}) if isinstance(one, records.AuditSession) else one
        )
    )
    assert unnamed.check().answer == "yes"
    found = unnamed.check(OTHER_KEY)
    assert (found.answer, found.wrong) == (
        "no",
        (f"/audit/session: OPEN: {NOT_OURS}", f"/audit/session: OPENED: {NOT_OURS}"),
    )
    assert "not checked: everything else" in found.line


def test_the_keys_of_another_session_are_refused(cut):
    other = replace(cut.keys, log_id="ab" * 16)
    with pytest.raises(InputError, match=f"log_id is {other.log_id}, must be {cut.keys.log_id}, this log's"):
        cut.check(other)


def test_keys_that_are_not_of_the_sessions_open_fit_nothing(cut):
    """Made of another log of the same name, or OPEN is another one than they were made of."""
    other = PresharedKey(KEY).code_keys(bytes(32))
    found = cut.check(replace(cut.keys, codes=other))
    assert found.answer == "no"
    assert found.wrong[:3] == (
        f"/audit/session: OPEN: {NOT_OURS}",
        f"/audit/session: OPENED: {NOT_OURS}",
        "/audit/session: it names another session than its OPEN opens",
    )


# ---------------------------------------------------------------- what anybody on the bus can do


def attacked(tmp_path_factory, name, act):
    """A session that is cutting while somebody without the key does this."""

    def lead(pair):
        pair.to(Phase.CUTTING, Phase.STARTING)
        act(pair)
        pair.end()

    return a_session(name, tmp_path_factory, lead)


@pytest.fixture(scope="module")
def forged(tmp_path_factory):
    """A heartbeat that nobody with the key made came while the arm cut."""

    def act(pair):
        seen = [one for one in pair.wire.seen if one.can_id == THEIRS][-1]
        data = flipped(seen.data, 2, 1)
        codes = pair.session._port.endpoint.link._codes
        counter = (seen.data[2] + 1) % 256
        pair.wire.nodes[RUNTIME].put(THEIRS, protect(data[3:], counter, DATA_IDS[THEIRS], codes.tag))

    return attacked(tmp_path_factory, "forged", act)


def test_a_forged_heartbeat_that_was_refused_is_told_and_is_no_damage_to_the_log(forged):
    assert "its tag is none that a holder of the key made" in str(forged.read.of("/audit/fault"))
    found = both(forged, forged)
    assert (found.answer, found.wrong) == ("yes", ())
    assert found.notes[0].startswith(
        "refused by this side, as it must: frames that came and do not fit (1), the first: record "
    )


def test_a_forged_heartbeat_of_whose_refusal_the_log_says_nothing_was_acted_on(forged):
    silent = forged.edited(lambda one: None if isinstance(one, records.AuditFault) else one)
    found = silent.check()
    assert found.answer == "no"
    assert found.wrong[0].endswith(", and the session went on")


@pytest.mark.parametrize(
    ("source", "cause"), [("controller", "AUTHENTICATION_FAILED"), ("runtime", "HEARTBEAT_LOST")]
)
def test_a_fault_that_is_no_refusal_excuses_no_frame(forged, source, cause):
    def edit(one):
        fault = isinstance(one, records.AuditFault)
        return one.model_copy(update={"source": source, "cause": cause}) if fault else one

    found = forged.edited(edit).check()
    assert found.answer == "no"
    assert found.wrong[0].endswith(", and the session went on")


def test_what_came_last_was_not_acted_on(cut):
    """No heartbeat left behind it: the log ends there, or this side fell silent."""
    which = cut.single_frames(THEIRS, "received")[-1]
    altered = cut.frame(which, lambda frame: flipped(frame, 3, 1))
    count = -1

    def silent(one):
        nonlocal count
        count += isinstance(one, records.CanFrame)
        return None if isinstance(one, records.CanFrame) and one.id == OURS and count > which else one

    found = altered.edited(silent).check(raw=False)
    assert (found.answer, found.wrong) == ("yes", ())
    assert found.notes[0].startswith("refused by this side, as it must: frames that came and do not fit (1)")


def test_a_frame_that_came_damaged_was_counted_by_this_side(cut):
    which = cut.single_frames(0x303, "received")[3]
    found = cut.frame(which, lambda frame: flipped(frame, 4, 1), protected=False).check()
    assert found.wrong == ("1 frames of the controller are damaged, this side counted 0",)
    closed = cut.edited(
        lambda one: (
            one.model_copy(update={"bus": one.bus.model_copy(update={"crc_failures": 1})})
            if isinstance(one, records.AuditClose)
            else one
        )
    )
    again = closed.frame(which, lambda frame: flipped(frame, 4, 1), protected=False).check()
    assert (again.answer, again.notes) == ("yes", ("not checked: frames that came damaged (1)",))


def test_a_refusal_after_which_this_side_went_on_enabling_was_none(cut):
    """A forged frame, and a fault that excuses it, in a log whose heartbeats still say CUT."""
    which = cut.single_frames(THEIRS, "received")[40]
    altered = cut.frame(which, lambda frame: flipped(frame, 3, 1))
    number, _ = frame_record(altered, which)
    fault = records.AuditFault(source="runtime", code="STOP", cause="AUTHENTICATION_FAILED", detail="forged")
    count = -1

    def excused(one):
        nonlocal count
        count += 1
        return fault if count == number + 4 else one  # in the place of the progress frame behind it

    found = altered.edited(excused).check(raw=False)
    assert found.answer == "no"
    assert found.wrong[0].endswith(", and the session went on although this side refused it")


def test_a_second_node_under_this_sides_name_is_told(tmp_path_factory):
    def act(pair):
        mine = [one for one in pair.wire.seen if one.can_id == CONTROL_IDS[RUNTIME]]
        pair.wire.nodes[RUNTIME].put(CONTROL_IDS[RUNTIME], b"\x02\x07\x00" + bytes(5))
        pair.wire.nodes[RUNTIME].put(OURS, mine[0].data)

    found = attacked(tmp_path_factory, "second", act).check()
    assert (found.answer, found.wrong) == ("yes", ())
    assert "a second node spoke under this side's name, and stopped the session" in found.notes


# ---------------------------------------------------------------- logs that are not whole


@pytest.mark.parametrize("part", [0.85, 0.6])
def test_a_log_that_ends_early_is_checked_as_far_as_it_goes(cut, part):
    torn = Coded(cut.log[: int(part * len(cut.log))], cut.frames[: int(part * len(cut.frames))])
    assert torn.read.report.status is Status.INCOMPLETE
    found = torn.check()
    assert (found.answer, found.wrong) == ("yes", ())
    assert found.checked["heartbeat sent"] > 5
    assert "not checked: what log or raw frames have lost at their end" in found.notes


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_whatever_bytes_there_are_an_answer_is_given(cut, data):
    """Of files altered anywhere, cut anywhere: it is told, never raised, but for a key of another log."""
    log, frames = bytearray(cut.log), bytearray(cut.frames)
    for file in (log, frames):
        for _ in range(data.draw(st.integers(0, 3))):
            file[data.draw(st.integers(0, len(file) - 1))] = data.draw(st.integers(0, 255))
        if data.draw(st.booleans()):
            del file[data.draw(st.integers(0, len(file))) :]
    with suppress(InputError):
        assert Coded(bytes(log), bytes(frames)).check(data.draw(st.sampled_from([KEY, KEYS]))).line


def few(coded):
    """A log's first record of each kind that is looked at, as JSON."""
    wanted = [
        "/audit/open",
        "/can/transfer",
        "/audit/session",
        "/audit/permit",
        "/can/frame",
        "/audit/fault",
        "/audit/close",
    ]
    found = {}
    for topic, data in all_records(coded):
        record = json.loads(data)
        if topic in wanted and (topic != "/audit/permit" or record["stage"] == "sent"):
            found.setdefault(topic, record)
    return found


@pytest.mark.no_cover
def test_no_value_that_no_session_writes_is_an_exception(forged):
    """Each in each field, in a log whose chain and index fit."""
    sound, few_frames = few(forged), forged.frames[:1000]
    assert len(sound) == 7
    for topic, record in sound.items():
        for name in record:
            for value in audit.NASTY[::5]:
                messages = [*(sound | {topic: record | {name: value}}).items()]
                log = read_log(audit.written(messages, {}))
                with suppress(InputError):
                    assert check_codes(log, BytesIO(few_frames), KEY).line


KEYS = SessionKeys("00000001" + LOG_ID[8:], bytes(16), PresharedKey(KEY).code_keys(bytes(32)))


def test_no_more_than_so_many_are_named_and_all_are_counted(cut):
    changed = cut.edited(
        lambda one: (
            one.model_copy(update={"data": "00" * 8})
            if isinstance(one, records.CanFrame) and one.direction == "sent"
            else one
        )
    )
    found = changed.check(raw=False)
    sent = len(cut.single_frames(OURS, "sent"))
    assert (len(found.wrong), found.wrong_count) == (SHOWN, sent + 1)  # and the END
    assert f"; {found.wrong_count - 1} more do not fit; OPEN, OPENED, " in found.line


@pytest.mark.parametrize("time_us", [0, -1, 1 << 63, 1 << 200])
def test_whatever_stands_for_a_time_can_be_told(time_us):
    assert when(time_us)


def test_joints_without_a_tag_are_covered_by_the_samples(cut):
    which = cut.single_frames(IDS[Joints01], "received")[10]
    counter = bytes.fromhex(frame_record(cut, which)[1]["data"])[2]
    found = cut.frame(which, lambda frame: flipped(frame, 4, 1)).check()
    assert f"joint sample {counter}: {UNFIT}" in found.wrong[0]
