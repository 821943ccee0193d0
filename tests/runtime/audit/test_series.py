"""A folder of logs as a chain: every manipulation is named, and nothing is found where there was none."""

import random
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from time import process_time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.series import SeriesFound, examine, utc
from cutgate.runtime.audit.series_facts import Folder, FolderSession, HeadNamed, PreviousNamed, WitnessNamed
from cutgate.runtime.audit.series_rules import RULES, WORST, SeriesFinding, worst
from cutgate.runtime.audit.signing.log_key import LogKey

SERIES = bytes(range(16))
START_NS = 1_790_000_000_000_000_000
HOUR_NS = 3_600_000_000_000


def digest(*parts: object) -> str:
    return sha256(repr(parts).encode()).hexdigest()


def keys(count: int, series: bytes = SERIES, enrolled: tuple[int, ...] = (1,)) -> list[LogKey]:
    """The keys of so many sessions; at these epochs enrolled, else certified."""
    found: list[LogKey] = []
    for epoch in range(1, count + 1):
        secret = sha256(b"%b %d" % (series, epoch)).digest()
        found.append(LogKey(series, epoch, secret) if epoch in enrolled else found[-1].following(secret))
    return found


def previous(one: FolderSession | None) -> PreviousNamed:
    """What the session behind this one says of it."""
    if one is None:
        return PreviousNamed()
    return PreviousNamed(one.file, one.head, one.size, one.root, one.epoch, crashed=not one.closed)


def series_of(
    count: int,
    *,
    crashed: tuple[int, ...] = (),
    enrolled: tuple[int, ...] = (1,),
    series: bytes = SERIES,
    old: int = 0,
    tag: str = "",
) -> list[FolderSession]:
    """A folder's sessions as they were written: first those of the older form, then signed ones."""
    found: list[FolderSession] = []
    all_keys = keys(count, series, enrolled)
    seen: WitnessNamed | None = None
    for number in range(old + count):
        key = None if number < old else all_keys[number - old].public
        before = found[-1] if found else None
        name = previous(before)
        if key is None:
            name = PreviousNamed(name.log, name.head, crashed=name.crashed)
        log_id = digest(series, tag, number)[:32]
        tree = (7, digest("tree", log_id))
        starts = number % 2 == 0
        closed = number not in crashed
        found.append(
            FolderSession(
                file=f"{number:05d}-{log_id[:8]}.mcap",
                log_id=log_id,
                status=Status.OK if closed and key is not None else Status.INCOMPLETE,
                closed=closed,
                size=20 + number,
                root=digest("root", log_id),
                head=digest("head", log_id),
                opened_ns=START_NS + number * HOUR_NS,
                last_ns=START_NS + number * HOUR_NS + HOUR_NS // 2,
                key=key,
                enrolled="no session before" if key is not None and key.certificate is None else None,
                previous=name,
                trees=frozenset({tree} if starts else set()),
                starts=starts,
                witnesses=(seen,) if seen is not None else (),
            )
        )
        if starts:
            seen = WitnessNamed(log_id, *tree, found=True)
    return found


def head_of(one: FolderSession) -> HeadNamed:
    series = None if one.key is None else one.key.series.hex()
    return HeadNamed(one.file, one.closed, one.head, series, one.epoch, one.size, one.root)


def examined(sessions: list[FolderSession], head: HeadNamed | None = None, **options) -> SeriesFound:
    shuffled = list(sessions)
    random.Random(len(sessions)).shuffle(shuffled)
    return examine(Folder(shuffled, head, **options))


def codes(found: SeriesFound) -> set[str]:
    return {finding.code for finding in found.findings}


# ---------------------------------------------------------------- untouched


@given(
    count=st.integers(1, 12),
    old=st.integers(0, 4),
    crashed=st.sets(st.integers(0, 15)),
    pinned=st.none() | st.integers(1, 12),
)
def test_an_untouched_series_has_no_finding(count, old, crashed, pinned):
    sessions = series_of(count, old=old, crashed=tuple(crashed))
    key = None if pinned is None else keys(count)[min(pinned, count) - 1].public
    found = examined(sessions, head_of(sessions[-1]), pinned=key)
    last = {"crashed-last"} if not sessions[-1].closed else set()
    form = {"old-form", "enrolled"} if old else set()
    assert codes(found) == last | form
    assert [joined.session for joined in found.joined] == sessions
    whole = not old and all(one.closed for one in sessions)
    assert found.status is (Status.OK if whole else Status.INCOMPLETE)


def test_an_untouched_folder_of_the_older_form_is_incomplete_and_in_its_order():
    sessions = series_of(0, old=6, crashed=(2,))
    found = examined(sessions, head_of(sessions[-1]))
    assert codes(found) == {"old-form"}
    assert found.status is Status.INCOMPLETE
    assert [joined.how for joined in found.joined] == [
        "the first, older form", "follows, older form", "follows, older form", "after a crash, older form",
        "follows, older form", "follows, older form",
    ]  # fmt: skip


def test_each_session_says_how_it_is_joined():
    sessions = series_of(5, crashed=(1,), enrolled=(1, 4))
    found = examined(sessions, head_of(sessions[-1]))
    assert [joined.how for joined in found.joined] == [
        "enrolled here", "follows", "after a crash", "follows, enrolled here", "follows",
    ]  # fmt: skip
    assert found.key.startswith("from the logs themselves (epoch 1: ")
    assert found.witness == "of 4 logs that a controller told of 4 found"
    assert found.anchor == "not given"


# ---------------------------------------------------------------- manipulated

Manipulation = Callable[[list[FolderSession], int], "tuple[list[FolderSession], HeadNamed | None]"]


def removed(sessions, at):
    return sessions[:at] + sessions[at + 1 :], head_of(sessions[-1])


def swapped(sessions, at):
    """Two files have each other's names."""
    a, b = sessions[at], sessions[at - 1]
    kept = [one for one in sessions if one not in (a, b)]
    return [*kept, replace(a, file=b.file), replace(b, file=a.file)], head_of(sessions[-1])


def copied(sessions, at):
    return [*sessions, replace(sessions[at], file="copy.mcap")], head_of(sessions[-1])


def written_twice(sessions, at):
    """Another session with the same epoch's key."""
    log_id = digest("other")[:32]
    other = replace(sessions[at], file="other.mcap", log_id=log_id, head=digest("h"), root=digest("r"))
    return [*sessions, other], head_of(sessions[-1])


def foreign_put_in(sessions, at):
    other = series_of(len(sessions), series=bytes(16))[at]
    return [*sessions, replace(other, file="foreign.mcap")], head_of(sessions[-1])


def replaced_by_foreign(sessions, at):
    other = series_of(len(sessions), series=bytes(16))[at]
    left, head = removed(sessions, at)
    return [*left, replace(other, file=sessions[at].file)], head


def rewritten(sessions, at):
    """The holder of that epoch's key writes another log in its place."""
    other = replace(sessions[at], head=digest("h"), root=digest("r"), trees=frozenset())
    return [*sessions[:at], other, *sessions[at + 1 :]], head_of(sessions[-1])


def shortened(sessions, at):
    other = replace(sessions[at], size=6, head=digest("h"), root=digest("r"), closed=False, trees=frozenset())
    return [*sessions[:at], other, *sessions[at + 1 :]], head_of(sessions[-1])


def renamed(sessions, at):
    return [*sessions[:at], replace(sessions[at], file="x.mcap"), *sessions[at + 1 :]], head_of(sessions[-1])


def key_exchanged(sessions, at):
    """Another key of this epoch, with the certificate of the real one."""
    key = replace(sessions[at].key, public=LogKey(SERIES, 1, bytes(32)).public.public)
    return [*sessions[:at], replace(sessions[at], key=key), *sessions[at + 1 :]], head_of(sessions[-1])


def put_back_in_time(sessions, at):
    other = replace(sessions[at], opened_ns=sessions[at - 1].last_ns - 1)
    return [*sessions[:at], other, *sessions[at + 1 :]], head_of(sessions[-1])


def old_form_put_in(sessions, at):
    other = replace(sessions[at], key=None, file="old.mcap", log_id=digest("o")[:32], enrolled=None)
    return [*sessions, other], head_of(sessions[-1])


def old_head(sessions, at):
    return sessions, head_of(sessions[at - 1])


def foreign_head(sessions, _at):
    return sessions, replace(head_of(sessions[-1]), series=bytes(16).hex())


def no_head(sessions, _at):
    return sessions, None


def head_changed(sessions, at):
    name = ("size", "root", "head", "epoch")[at % 4]
    value = {"size": 1, "root": digest(1), "head": digest(2), "epoch": 99}[name]
    return sessions, replace(head_of(sessions[-1]), **{name: value})


def last_erased(sessions, _at):
    return sessions[:-1], head_of(sessions[-1])


def begins_anew(sessions, at):
    other = replace(sessions[at], previous=PreviousNamed())
    return [*sessions[:at], other, *sessions[at + 1 :]], head_of(sessions[-1])


def passed_over(sessions, at):
    """It says that it follows on another one than the one before it."""
    other = replace(sessions[at], previous=replace(sessions[at].previous, log=sessions[-1].file))
    return [*sessions[:at], other, *sessions[at + 1 :]], head_of(sessions[-1])


def called_whole(sessions, at):
    """A log that ends early, though the next session found it closed."""
    other = replace(sessions[at], closed=False)
    return [*sessions[:at], other, *sessions[at + 1 :]], head_of(sessions[-1])


def without_certificate(sessions, at):
    key = replace(sessions[at].key, certificate=None)
    return [*sessions[:at], replace(sessions[at], key=key), *sessions[at + 1 :]], head_of(sessions[-1])


NAMED: dict[Manipulation, set[str]] = {
    removed: {"epoch-missing", "begins-late", "head-log-missing"},
    swapped: {"link-differs", "head-old"},
    copied: {"copy"},
    written_twice: {"doubled"},
    foreign_put_in: {"foreign"},
    replaced_by_foreign: {"foreign"},
    rewritten: {"link-differs", "head-differs"},
    shortened: {"link-differs", "head-differs"},
    renamed: {"renamed"},
    key_exchanged: {"certificate-wrong"},
    put_back_in_time: {"clock-back"},
    old_form_put_in: {"old-form-late"},
    old_head: {"head-old"},
    foreign_head: {"head-foreign"},
    no_head: {"head-missing"},
    head_changed: {"head-differs"},
    last_erased: {"head-log-missing"},
    begins_anew: {"begins-anew"},
    passed_over: {"link-differs"},
    called_whole: {"cut-off"},
    without_certificate: {"certificate-missing"},
}
"""Of each one a code that it must be named by."""
NOT_THE_FIRST = {
    swapped,
    put_back_in_time,
    key_exchanged,
    begins_anew,
    passed_over,
    old_head,
    without_certificate,
}
INCOMPLETE_ONLY = {no_head}


@pytest.mark.parametrize("act", NAMED, ids=lambda act: act.__name__)
@settings(max_examples=20)
@given(count=st.integers(2, 9), at=st.integers(0, 8))
def test_every_manipulation_is_named(act, count, at):
    sessions = series_of(count)
    at = at % count
    if act in NOT_THE_FIRST:
        at = max(at, 1)
    found = examined(*act(sessions, at))
    assert codes(found) & NAMED[act]
    missing_first = act is removed and at == 0
    if act in INCOMPLETE_ONLY or (missing_first and "witness-missing" not in codes(found)):
        assert found.status is Status.INCOMPLETE
    else:
        assert found.status is Status.TAMPERED


def test_several_of_them_at_once_are_named_all():
    sessions = series_of(12)
    left = [*sessions[:3], *sessions[4:8], *sessions[9:], replace(sessions[5], file="copy.mcap")]
    found = examined(left, head_of(sessions[-2]))
    assert {"epoch-missing", "copy", "head-old"} <= codes(found)
    gaps = [finding.what for finding in found.findings if finding.code == "epoch-missing"]
    assert gaps == ["the session of epoch 4", "the session of epoch 9"]


def test_a_gap_of_many_epochs_is_one_finding_however_wide():
    sessions = series_of(3)
    far = replace(sessions[2], key=replace(sessions[2].key, epoch=4_000_000_000))
    found = examined([*sessions[:2], far], head_of(far))
    (gap,) = [finding for finding in found.findings if finding.code == "epoch-missing"]
    assert gap.what == "the sessions of epochs 3 to 3999999999"


def only(found: SeriesFound) -> SeriesFinding:
    (finding,) = found.findings
    return finding


@given(count=st.integers(3, 8), at=st.integers(1, 6))
def test_a_gap_is_one_finding_and_explains_all_that_does_not_fit_behind_it(count, at):
    sessions = [replace(one, witnesses=()) for one in series_of(count)]
    at = min(at, count - 2)
    finding = only(examined(*removed(sessions, at)))
    assert (finding.code, finding.file) == ("epoch-missing", sessions[at + 1].file)
    assert finding.what == f"the session of epoch {at + 1}"
    assert str(finding).startswith(
        f"{finding.file}: the session of epoch {at + 1} is not in this folder, must be between {sessions[at - 1].file}"
    )


def test_the_first_session_says_which_one_is_not_here():
    sessions = [replace(one, witnesses=()) for one in series_of(4)]
    finding = only(examined(sessions[2:], head_of(sessions[-1])))
    assert (finding.code, finding.bound) == ("begins-late", f"not in this folder: {sessions[1].file}")
    alone = replace(sessions[2], previous=PreviousNamed())
    finding = only(examined([alone], head_of(alone)))
    assert (finding.code, finding.bound) == ("begins-late", "not in this folder: the one of epoch 2")


def test_a_double_is_named_by_its_epoch_or_by_its_log_where_it_has_none():
    sessions = series_of(2)
    assert only(examined(*written_twice(sessions, 1))).what == "what is of epoch 2"
    old = series_of(0, old=2)
    other = replace(old[0], file="other.mcap", head=digest("x"))
    found = examined([*old, other], head_of(old[1]))
    assert [finding.what for finding in found.findings if finding.code == "doubled"] == [
        f"what is of log {old[0].log_id}"
    ]


def test_a_session_may_begin_in_the_moment_in_which_the_one_before_was_closed():
    sessions = series_of(2)
    at_once = replace(sessions[1], opened_ns=sessions[0].last_ns)
    assert codes(examined([sessions[0], at_once], head_of(at_once))) == set()


def test_a_session_taken_away_and_the_state_before_it_put_back_is_a_gap_of_epochs():
    """The next session names the one before the one that was taken, and its key is of the epoch behind."""
    sessions = series_of(3)
    third = replace(sessions[2], previous=previous(sessions[0]))
    found = examined([sessions[0], third], head_of(third))
    (gap,) = [finding for finding in found.findings if finding.code == "epoch-missing"]
    assert gap.what == "the session of epoch 2"
    assert f"it calls {sessions[0].file} the one before it" in str(gap)


def test_a_session_taken_away_with_its_key_is_missed_by_the_controller_alone():
    sessions = series_of(3)
    again = replace(series_of(2, tag="again")[1], previous=previous(sessions[0]))
    taken = WitnessNamed(sessions[1].log_id, 7, digest("tree", sessions[1].log_id), found=False)
    found = examined([sessions[0], replace(again, witnesses=(taken,))], head_of(again))
    assert codes(found) == {"witness-unknown"}
    assert found.status is Status.INCOMPLETE


@pytest.mark.parametrize("part", ["size", "root", "head", "epoch"])
@given(at=st.integers(1, 5))
def test_whatever_a_session_says_of_the_one_before_must_be_so(part, at):
    sessions = series_of(6)
    for value in ({"size": 1, "epoch": 77}.get(part, digest("x")), None):
        named = replace(sessions[at].previous, **{part: value})
        changed = [*sessions[:at], replace(sessions[at], previous=named), *sessions[at + 1 :]]
        found = examined(changed, head_of(sessions[-1]))
        (finding,) = found.findings
        assert (finding.code, finding.file) == ("link-differs", sessions[at].file)
        assert finding.what == f"{part} of {sessions[at - 1].file}"
        assert "not given" in str(finding) or str(value) in str(finding)


def test_a_closed_log_that_is_called_crashed_is_told():
    sessions = series_of(3)
    named = replace(sessions[1].previous, crashed=True)
    found = examined([sessions[0], replace(sessions[1], previous=named), sessions[2]], head_of(sessions[2]))
    assert codes(found) == {"closed-called-crashed"}
    assert found.status is Status.INCOMPLETE
    assert [joined.how for joined in found.joined] == ["enrolled here", "after a crash", "follows"]


def test_a_note_about_the_one_before_is_told():
    sessions = series_of(2)
    named = replace(sessions[1].previous, note="HEAD could not be read")
    found = examined([sessions[0], replace(sessions[1], previous=named)], head_of(sessions[1]))
    assert codes(found) == {"previous-noted"}
    assert "HEAD could not be read" in str(found.findings[0])


def test_a_session_that_was_cut_before_record_0_leaves_its_place_open():
    sessions = series_of(2)
    blank = FolderSession("blank.mcap", "", Status.INCOMPLETE, False, 0, None, "00" * 32, 0, 0)
    named = PreviousNamed("blank.mcap", "00" * 32, 0, digest(), None, crashed=True)
    found = examined([sessions[0], blank, replace(sessions[1], previous=named)], head_of(sessions[1]))
    assert codes(found) == {"link-unknown", "before-record-0"}
    assert found.joined[-1].how == "cut before record 0"
    assert codes(examined([sessions[0], blank], HeadNamed("blank.mcap", closed=False))) == {
        "before-record-0",
        "crashed-last",
    }
    begins = Folder([sessions[0], blank], HeadNamed("blank.mcap", closed=False), running=True)
    assert codes(examine(begins)) == {"running"}, "a session that has just begun"


# ---------------------------------------------------------------- order, copies, what is no log


def test_a_clock_that_goes_back_behind_a_crash_is_no_wrong():
    sessions = series_of(3, crashed=(1,))
    third = replace(sessions[2], opened_ns=sessions[1].opened_ns)
    assert codes(examined([*sessions[:2], third], head_of(third))) == set()
    earlier = replace(third, opened_ns=sessions[0].opened_ns)
    assert codes(examined([*sessions[:2], earlier], head_of(earlier))) == {"clock-back"}


def test_a_recovered_copy_beside_its_original_takes_no_place():
    sessions = series_of(3, crashed=(1,))
    copy = replace(sessions[1], file="r.mcap", recovered_from=sessions[1].file)
    found = examined([*sessions, copy], head_of(sessions[2]))
    assert codes(found) == {"recovered-copy"}
    assert found.joined[-1].how == f"recovered copy of {sessions[1].file}"
    other = replace(copy, head=digest("x"))
    assert codes(examined([*sessions, other], head_of(sessions[2]))) == {"doubled"}
    alone = examined([sessions[0], copy, sessions[2]], head_of(sessions[2]))
    assert codes(alone) == {"renamed"}


def test_foreign_files_are_passed_over_unless_somebody_names_them():
    sessions = series_of(3)
    junk = [FolderSession(f"junk{n}.mcap", "", Status.UNREADABLE, False, 0, None, "", 0, 0) for n in range(9)]
    found = examined([*sessions, *junk], head_of(sessions[2]))
    assert (codes(found), found.status) == ({"not-a-log"}, Status.OK)
    assert "and 4 more" in str(found.findings[0])
    written_over = replace(junk[0], file=sessions[1].file)
    found = examined([sessions[0], written_over, sessions[2]], head_of(sessions[2]))
    assert {"named-unreadable", "epoch-missing"} <= codes(found)
    assert found.status is Status.TAMPERED


def test_an_empty_folder_is_unreadable_and_one_with_a_head_alone_lacks_its_log():
    for sessions in ([], [FolderSession("junk.mcap", "", Status.UNREADABLE, False, 0, None, "", 0, 0)]):
        found = examine(Folder(sessions, None))
        assert "no-logs" in codes(found)
        assert found.status is Status.UNREADABLE
    found = examine(Folder([], head_of(series_of(1)[0])))
    assert (codes(found), found.status) == ({"head-log-missing"}, Status.TAMPERED)


@given(st.permutations(range(5)))
def test_logs_of_the_older_form_are_ordered_by_what_they_name_whatever_their_times(order):
    sessions = [
        replace(one, opened_ns=START_NS + n * HOUR_NS, last_ns=START_NS + n * HOUR_NS)
        for one, n in zip(series_of(0, old=5), order, strict=True)
    ]
    found = examined(sessions, head_of(sessions[-1]))
    assert [joined.session.file for joined in found.joined] == [one.file for one in sessions]
    assert codes(found) == {"old-form"}


@given(at=st.integers(1, 3))
def test_a_log_of_the_older_form_that_is_missing_is_named(at):
    sessions = series_of(0, old=5)
    found = examined([*sessions[:at], *sessions[at + 1 :]], head_of(sessions[-1]))
    assert codes(found) - {"witness-missing"} == {"old-form", "log-missing"}
    assert sessions[at].file in str(found.findings[0])


def test_logs_of_the_older_form_that_name_each_other_are_no_endless_walk():
    a, b = series_of(0, old=2)
    a = replace(a, previous=PreviousNamed(b.file, b.head))
    assert examined([a, b], head_of(b)).status is Status.INCOMPLETE


# ---------------------------------------------------------------- keys


def test_a_new_enrolment_in_the_middle_is_told_and_wrong_only_under_an_earlier_pinned_key():
    sessions, all_keys = series_of(6, enrolled=(1, 4)), keys(6, enrolled=(1, 4))
    head = head_of(sessions[-1])
    for epoch, expected, status in (
        (None, {"enrolled"}, Status.OK),
        (4, {"enrolled"}, Status.OK),
        (6, {"enrolled"}, Status.OK),
        (1, {"enrolled", "key-not-certified"}, Status.TAMPERED),
        (3, {"enrolled", "key-not-certified"}, Status.TAMPERED),
    ):
        pinned = None if epoch is None else all_keys[epoch - 1].public
        found = examined(sessions, head, pinned=pinned)
        assert (epoch, codes(found), found.status) == (epoch, expected, status)


@given(count=st.integers(1, 8), epoch=st.integers(1, 8))
def test_the_key_of_another_site_is_never_taken(count, epoch):
    sessions = series_of(count)
    other = LogKey(SERIES, epoch, bytes(32)).public
    found = examined(sessions, head_of(sessions[-1]), pinned=other)
    if epoch <= count:
        assert "key-differs" in codes(found)
        assert found.status is Status.TAMPERED
    else:
        assert codes(found) == {"key-not-reached"}
        assert found.status is Status.INCOMPLETE


def test_a_pinned_key_vouches_from_the_epoch_before_the_first_log_on_and_not_from_further():
    sessions, all_keys = series_of(6), keys(6)
    later = sessions[3:]
    head = head_of(sessions[-1])
    assert codes(examined(later, head, pinned=all_keys[2].public)) == {"begins-late", "witness-missing"}
    other = LogKey(SERIES, 3, bytes(32)).public
    assert "key-differs" in codes(examined(later, head, pinned=other))
    assert "key-not-reached" in codes(examined(later, head, pinned=all_keys[1].public))


def test_a_pinned_key_of_another_series_makes_every_log_foreign():
    sessions = series_of(3)
    found = examined(sessions, head_of(sessions[-1]), pinned=keys(1, bytes(16))[0].public)
    assert codes(found) == {"foreign", "key-not-reached", "head-foreign"}


@pytest.mark.parametrize("other", [bytes(16), b"\xff" * 16], ids=["less", "greater"])
@pytest.mark.parametrize("later", [False, True])
def test_those_that_belong_here_are_the_most_and_of_equally_many_the_oldest(other, later):
    own, foreign = series_of(4), series_of(3, series=other)
    shift_ns = HOUR_NS if later else -HOUR_NS
    foreign = [replace(one, file=f"f{one.file}", opened_ns=one.opened_ns + shift_ns) for one in foreign]
    found = examined([*own, *foreign], head_of(own[-1]))
    assert {finding.file for finding in found.findings if finding.code == "foreign"} == {
        one.file for one in foreign
    }
    found = examined([*own[:3], *foreign], head_of(own[2]))
    strangers = foreign if later else own[:3]
    assert {finding.file for finding in found.findings if finding.code == "foreign"} == {
        one.file for one in strangers
    }


def test_the_key_line_names_who_vouches():
    sessions, all_keys = series_of(4), keys(4)
    head = head_of(sessions[-1])
    pinned = all_keys[2].public
    assert examined(sessions, head, pinned=pinned).key == (
        f"pinned ({pinned.fingerprint}, epoch 3), vouches for 2 by certificates, and by what they say for 2 "
        "before them; epochs 1 to 4"
    )
    assert "does not vouch" in examined(removed(sessions, 2)[0], head, pinned=all_keys[0].public).key
    assert examined(series_of(0, old=1)).key == "none (nothing here is signed)"
    mixed = series_of(2, old=3)
    found = examined(mixed, head_of(mixed[-1]), pinned=all_keys[0].public)
    assert "vouches for 2 by certificates, and by what they say for 3 before them" in found.key


@pytest.mark.parametrize(
    ("epoch", "reached"), [(1, False), (2, True), (3, True), (4, True), (5, True), (6, False)]
)
def test_a_pinned_key_reaches_from_the_epoch_before_the_first_log_to_that_of_the_last(epoch, reached):
    sessions, all_keys = [replace(one, witnesses=()) for one in series_of(6)], keys(6)
    found = examined(sessions[2:5], head_of(sessions[4]), pinned=all_keys[epoch - 1].public)
    assert codes(found) == {"begins-late"} | (set() if reached else {"key-not-reached"})


# ---------------------------------------------------------------- witness, HEAD, anchors


@given(at=st.integers(0, 5))
def test_what_a_controller_saw_must_be_here_as_it_saw_it(at):
    sessions = series_of(7)
    seen = next(
        one for one in sessions if one.witnesses and one.witnesses[0].log_id == sessions[at // 2 * 2].log_id
    )
    for change, expected in (
        ({"root": digest("x")}, "witness-differs"),
        ({"size": 8}, "witness-differs"),
        ({"size": 10**9}, "witness-differs"),
        ({"log_id": "ff" * 16}, "witness-missing"),
        ({"log_id": "ff" * 16, "found": False}, "witness-unknown"),
    ):
        told = replace(seen.witnesses[0], **change)
        changed = [replace(one, witnesses=(told,)) if one is seen else one for one in sessions]
        found = examined(changed, head_of(sessions[-1]))
        assert [(finding.code, finding.file) for finding in found.findings] == [(expected, seen.file)]
        was_here = "and was here when" in str(only(found))
        assert was_here is (expected == "witness-missing")


def test_of_an_archived_log_the_size_alone_is_compared_and_that_is_told():
    sessions = series_of(4)
    stub = replace(sessions[0], archived=True, trees=frozenset())
    found = examined([stub, *sessions[1:]], head_of(sessions[-1]))
    assert (codes(found), found.status) == (set(), Status.OK)
    assert found.witness == "of 3 logs that a controller told of 1 found, 2 archived (root not checked)"
    short = replace(stub, size=3)
    assert "witness-differs" in codes(examined([short, *sessions[1:]], head_of(sessions[-1])))


def test_a_session_that_is_running_is_told_and_one_that_crashed_too():
    sessions = series_of(3, crashed=(2,))
    head = head_of(sessions[-1])
    running, crashed = only(examined(sessions, head, running=True)), only(examined(sessions, head))
    assert (running.code, running.bound) == ("running", "running: its log is not whole yet")
    assert (crashed.code, crashed.bound) == ("crashed-last", "never closed: it has crashed")


def test_times_that_no_clock_has_are_told_as_numbers():
    assert utc(1_790_000_000_123_456_789) == "2026-09-21T14:13:20.123Z"
    assert utc(10**30) == f"{10**30} ns"


def test_a_head_that_calls_a_torn_log_closed_is_wrong():
    sessions = series_of(2)
    found = examined([sessions[0], replace(sessions[1], closed=False)], head_of(sessions[1]))
    assert codes(found) == {"cut-off"}


def test_anchors_are_looked_for_among_all_roots_and_heads():
    sessions = series_of(4)
    sessions[1] = replace(sessions[1], anchors=frozenset({digest("between")}), root=None)
    sessions[2] = replace(sessions[2], previous=replace(sessions[2].previous, root=None))
    kept = (sessions[0].root, sessions[2].head, next(iter(sessions[0].trees))[1])
    found = examined(sessions, head_of(sessions[-1]), anchors=kept)
    assert (codes(found), found.anchor) == (set(), "3 of 3 found")
    assert examined(sessions, head_of(sessions[-1]), anchors=(digest("between"),)).anchor == "1 of 1 found"
    found = examined(sessions, head_of(sessions[-1]), anchors=(*kept, digest("x")))
    assert (codes(found), found.anchor) == ({"anchor-missing"}, "3 of 4 found")


# ---------------------------------------------------------------- the table, and time


def test_each_rule_of_the_table_is_met_by_a_test():
    """Here, or where folders are read: in the tests of the commands."""
    here = Path(__file__)
    others = ("../commands/test_audit_folder.py", "../commands/test_audit_archive.py")
    text = "".join((here.parent / name).read_text() for name in (here.name, *others))
    assert {code for code in RULES if f'"{code}"' not in text} == set()


def test_the_worst_is_tampered_then_unreadable_then_incomplete():
    assert WORST == (Status.TAMPERED, Status.UNREADABLE, Status.INCOMPLETE, Status.OK)
    assert worst([Status.OK, Status.INCOMPLETE, Status.UNREADABLE]) is Status.UNREADABLE
    assert worst([]) is Status.OK


def test_a_finding_names_file_value_bound_and_what_to_do_and_escapes_what_it_shows():
    finding = SeriesFinding("log-missing", "a\x1b.mcap", "the session before", "b", "in this folder")
    assert str(finding) == (
        "a\\x1b.mcap: the session before is b, must be in this folder; put it back from a backup or an archive; "
        "if there is none, keep all that is here and find out who took it"
    )


def test_time_grows_with_the_number_of_sessions_and_not_with_its_square():
    """Without signatures, whose time is theirs: sixteen times as many take far less than 256 times as long."""
    times = []
    for count in (250, 4000):
        sessions = series_of(0, old=count)
        head = head_of(sessions[-1])
        begun = process_time()
        examined(sessions, head)
        times.append(process_time() - begun)
    assert times[1] < 80 * max(times[0], 0.001)
