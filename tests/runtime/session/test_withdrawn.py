"""The runtime's own list of withdrawn registrations: what was added stays, and a list that cannot be read stops."""

import json
import math
from dataclasses import FrozenInstanceError, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import InputError
from cutgate.protocol.times import since_1970_us
from cutgate.runtime.audit.log import AuditLog, OpenInfo
from cutgate.runtime.plan.load import registration_from_bytes
from cutgate.runtime.session import withdrawn
from cutgate.runtime.session.withdrawn import Withdrawal, complete, incomplete, load, of_now, refusal
from tests.runtime.audit.build import LOG_ID, small_log

DIGESTS = st.binary(min_size=32, max_size=32)
KNOWN = datetime(2026, 11, 27, 10, 0, 0, 250_000, tzinfo=UTC)
SKEW_S = 60.0
FILE = bytes(range(32))
TIMES = st.datetimes(datetime(1970, 1, 1), datetime(2200, 1, 1), timezones=st.just(UTC))  # noqa: DTZ001
ENTRIES = st.builds(
    Withdrawal, DIGESTS, st.from_regex(r"[0-9a-zA-Z.-]{1,40}", fullmatch=True), st.none() | DIGESTS, TIMES
)
OLD = st.builds(Withdrawal, DIGESTS, st.just("a.mcap"))


def registration(**changes):
    """One as somebody writes it, with its file's bytes."""
    content = {
        "schema": "cutgate.registration/1",
        "id": "left knee",
        "R_T_CT": [[1, 0, 0, 1.5], [0, 1, 0, -0.25], [0, 0, 1, 2.0], [0, 0, 0, 1]],
        "residual_rms_mm": 0.2,
        "created_utc": "2026-11-27T09:00:00Z",
        **changes,
    }
    return registration_from_bytes(Path("registration.json"), json.dumps(content).encode())


PLACED = registration()
WITHDRAWN = Withdrawal(FILE, "a.mcap", PLACED.place, KNOWN)
ELSEWHERE = [[1, 0, 0, 1.6], [0, 1, 0, -0.25], [0, 0, 1, 2.0], [0, 0, 0, 1]]


def later(seconds):
    """A registration of another place, so long after the withdrawal."""
    at = KNOWN + timedelta(seconds=seconds)
    return registration(R_T_CT=ELSEWHERE, created_utc=at.strftime("%Y-%m-%dT%H:%M:%S.%fZ"))


# ---------------------------------------------------------------- the list


@given(st.lists(ENTRIES | OLD, max_size=5))
def test_what_was_added_is_read_in_every_later_session(tmp_path_factory, entries):
    directory = tmp_path_factory.mktemp("logs")
    for entry in entries:
        withdrawn.add(directory, [entry])
    assert load(directory) == tuple(entries)


@pytest.mark.parametrize("directory", ["", "never made"])
def test_nothing_is_listed_where_nothing_was_withdrawn(tmp_path, directory):
    assert load(tmp_path / directory) == ()


@pytest.mark.parametrize(
    "line",
    [
        *("", "beef a.mcap", "x" * 64 + " a.mcap", "ab" * 31 + " a.mcap", "ab" * 33 + " a.mcap", " " * 70),
        "ab" * 32 + " a.mcap " + "cd" * 32,
        "ab" * 32 + " a.mcap cd 2026-11-27T10:00:00.250000Z",
        "ab" * 32 + " a.mcap - 2026-02-31T10:00:00.250000Z",
        "ab" * 32 + " a.mcap - 2026-11-27T10:00:00Z",
        "ab" * 32 + " a.mcap - 3000-01-01T00:00:00.000000Z",
        "ab" * 32 + " a.mcap - 2026-11-27T10:00:00.250000Z more",
    ],
)
def test_a_line_that_is_no_entry_is_named(tmp_path, line):
    withdrawn.add(tmp_path, [WITHDRAWN])
    with (tmp_path / withdrawn.WITHDRAWN).open("a", encoding="ascii") as file:
        file.write(line + "\n")
    with pytest.raises(InputError, match=r"line 2.*restore the list"):
        load(tmp_path)


def test_a_line_that_was_cut_short_is_named(tmp_path):
    withdrawn.add(tmp_path, [WITHDRAWN])
    file = tmp_path / withdrawn.WITHDRAWN
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"line 1.*restore the list"):
        load(tmp_path)


def test_a_list_that_cannot_be_read_stops(tmp_path):
    (tmp_path / withdrawn.WITHDRAWN).mkdir()
    with pytest.raises(InputError, match="not a regular file"):
        load(tmp_path)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / withdrawn.WITHDRAWN).write_bytes(b"\xff\n")
    with pytest.raises(InputError, match="cannot be read"):
        load(tmp_path / "b")


def test_a_list_that_has_lost_a_line_stops(tmp_path):
    small_log(tmp_path)
    for number in range(2):
        withdrawn.add(tmp_path, [replace(WITHDRAWN, registration=bytes([number]) * 32)])
    file = tmp_path / withdrawn.WITHDRAWN
    file.write_bytes(file.read_bytes().splitlines(keepends=True)[0])
    with pytest.raises(InputError, match="at least the 2 lines"):
        load(tmp_path)


@pytest.mark.parametrize("lost", [("WITHDRAWN",), ("HEAD", "WITHDRAWN")])
def test_a_list_that_is_lost_while_a_session_runs_is_missed_by_the_next_one(tmp_path, lost):
    """Also where this session adds to it, and nothing on the disk tells any more what stood there."""
    small_log(tmp_path)
    withdrawn.add(tmp_path, [WITHDRAWN])
    log = AuditLog.create(tmp_path, log_id=LOG_ID, opened=OpenInfo("cutgate", "cutgate"))
    for name in lost:
        (tmp_path / name).unlink()
    log.listed = withdrawn.add(tmp_path, [replace(WITHDRAWN, log=log.path.name)], log.listed)
    assert log.close(final_state="stopped", clean=True).closed
    with pytest.raises(InputError, match="at least the 1 lines"):
        load(tmp_path)


def test_a_list_that_others_can_write_stops(tmp_path):
    withdrawn.add(tmp_path, [WITHDRAWN])
    (tmp_path / withdrawn.WITHDRAWN).chmod(0o666)
    with pytest.raises(InputError, match="mode is 0666"):
        load(tmp_path)
    with pytest.raises(InputError, match="mode is 0666"):
        withdrawn.add(tmp_path, [WITHDRAWN])


def test_a_line_is_not_changed_afterwards():
    with pytest.raises(FrozenInstanceError):
        WITHDRAWN.place = None


# ---------------------------------------------------------------- what is refused


def test_without_a_withdrawal_nothing_is_refused():
    assert refusal((), {FILE}, PLACED, SKEW_S) == refusal((), {FILE}, None, SKEW_S) == ""


@pytest.mark.parametrize(
    "said", [PLACED, None, later(3600.0)], ids=["as it was", "no registration", "changed"]
)
def test_the_same_file_is_refused_whatever_it_says(said):
    assert refusal([WITHDRAWN], {FILE}, said, SKEW_S).startswith("this registration was withdrawn in a.mcap")


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"id": "another knee"},
        {"created_utc": "2027-01-01T00:00:00Z"},
        {"residual_rms_mm": 0.1},
        {"ct_id": "ct"},
        {"R_T_CT": [[1.0, 0.0, -0.0, 1.50], [0.0, 1e0, 0, -2.5e-1], [0, -0.0, 1, 2], [0, 0, 0, 1]]},
    ],
    ids=["bytes", "id", "time", "residual", "ct_id", "spelling of numbers"],
)
def test_the_place_stays_withdrawn_whatever_is_written_around_it(changes):
    assert refusal([WITHDRAWN], {bytes(32)}, registration(**changes), SKEW_S).startswith(
        "the same place was withdrawn in a.mcap, under whatever name"
    )


@given(
    row=st.integers(0, 2),
    column=st.integers(0, 3),
    ulps=st.integers(1, 3),
)
def test_another_place_by_the_last_bit_is_another_place(row, column, ulps):
    rows = [list(map(float, line)) for line in PLACED.R_T_CT]
    for _ in range(ulps):
        rows[row][column] = math.nextafter(rows[row][column], 9.0)
    moved = PLACED.model_copy(update={"R_T_CT": rows})
    assert (moved.place == PLACED.place) is (moved.matrix.tolist() == PLACED.matrix.tolist())
    assert moved.place != PLACED.place


@pytest.mark.parametrize(
    ("seconds", "counts"), [(-3600.0, False), (0.0, False), (60.0, False), (60.001, True)]
)
def test_only_what_was_taken_after_the_withdrawal_counts(seconds, counts):
    said = refusal([WITHDRAWN], {bytes(32)}, later(seconds), SKEW_S)
    assert (said == "") is counts
    if not counts:
        assert (
            "the withdrawal in a.mcap, known here since 2026-11-27 10:00:00 UTC (clock_skew_s 60 s)" in said
        )
        assert "what is taken from 2026-11-27 10:01:01 UTC on counts" in said, (
            "the first whole second after it"
        )


def test_the_earliest_that_is_told_does_count():
    known = KNOWN.replace(microsecond=0)
    at = datetime(2026, 11, 27, 10, 1, 1, tzinfo=UTC)
    assert "2026-11-27 10:01:01 UTC on" in refusal(
        [replace(WITHDRAWN, known=known)], {bytes(32)}, PLACED_BEFORE, SKEW_S
    )
    told = registration(R_T_CT=ELSEWHERE, created_utc=at.strftime("%Y-%m-%dT%H:%M:%SZ"))
    assert refusal([replace(WITHDRAWN, known=known)], {bytes(32)}, told, SKEW_S) == ""


PLACED_BEFORE = registration(R_T_CT=ELSEWHERE)


def test_the_last_withdrawal_is_the_barrier():
    last = Withdrawal(bytes([1]) * 32, "z.mcap", None, KNOWN + timedelta(hours=1))
    for listed in ([WITHDRAWN, last], [last, WITHDRAWN]):
        assert "the withdrawal in z.mcap" in refusal(listed, {bytes(32)}, later(120.0), SKEW_S)
        assert refusal(listed, {bytes(32)}, later(3661.0), SKEW_S) == ""


def test_after_a_withdrawal_a_path_without_a_registration_is_refused():
    assert "a registration without a time is not surely later" in refusal(
        [WITHDRAWN], {bytes(32)}, None, SKEW_S
    )


def test_the_latest_year_of_a_list_overflows_nothing():
    last = replace(WITHDRAWN, known=datetime(withdrawn.YEAR_MAX, 12, 31, 23, 59, 59, tzinfo=UTC))
    assert "3000-01-01 01:00:00 UTC on counts" in refusal([last], {bytes(32)}, PLACED_BEFORE, 3600.0)


@pytest.mark.parametrize(("back_s", "known"), [(0.0, KNOWN), (7200.0, PLACED.created)])
def test_a_clock_that_was_set_back_lowers_no_barrier(back_s, known):
    now = KNOWN - timedelta(seconds=back_s)
    assert of_now(FILE, "a.mcap", PLACED, now) == replace(WITHDRAWN, known=known)
    assert of_now(FILE, "a.mcap", None, now) == Withdrawal(FILE, "a.mcap", None, now)


# ---------------------------------------------------------------- lines of 0.1.0


def test_an_old_line_alone_refuses_its_file_and_nothing_else():
    old = Withdrawal(FILE, "a.mcap")
    assert "withdrawn in a.mcap" in refusal([old], {FILE}, PLACED, SKEW_S)
    assert refusal([old], {bytes(32)}, PLACED, SKEW_S) == ""


def test_an_old_line_is_completed_once_with_the_place_of_its_log_and_the_time_of_that():
    old, other = Withdrawal(FILE, "a.mcap"), Withdrawal(FILE, "b.mcap")
    assert incomplete([old, other, WITHDRAWN]) == (other,)
    added = complete([old, other], {"a.mcap": PLACED, "b.mcap": None}, KNOWN)
    assert added == (WITHDRAWN, Withdrawal(FILE, "b.mcap", None, KNOWN))
    assert incomplete([old, other, *added]) == ()


# ---------------------------------------------------------------- the barrier


NOW = datetime(2026, 11, 28, 12, 0, 0, 1, tzinfo=UTC)
SKEW = timedelta(seconds=60)
AHEAD = NOW + timedelta(hours=1)


def test_a_barrier_is_now_and_as_much_later_as_clocks_may_differ():
    assert withdrawn.barrier(NOW, None, PLACED, (), 60.0) == NOW + SKEW
    assert withdrawn.barrier(NOW, None, None, (WITHDRAWN,), 0.0) == NOW


@pytest.mark.parametrize("age_s", [0, 1, 7200, 0xFFFF_FFFE])
def test_a_motion_whose_age_is_known_was_then(age_s):
    assert withdrawn.barrier(NOW, age_s, PLACED, (), 60.0) == NOW - timedelta(seconds=age_s) + SKEW


def test_no_barrier_is_before_a_time_that_this_side_has_seen():
    """Never before what the list says; nor before this session's registration, where that is what was withdrawn."""
    listed = (replace(WITHDRAWN, known=AHEAD), WITHDRAWN, Withdrawal(FILE, "b.mcap"))
    for age_s in (None, 0, 7200):
        assert withdrawn.barrier(NOW, age_s, None, listed, 60.0) == AHEAD + SKEW
    said = registration(created_utc="2026-11-28T14:00:00Z")
    assert withdrawn.barrier(NOW, None, said, listed, 60.0) == said.created + SKEW
    assert withdrawn.barrier(NOW, 0, said, (), 60.0) == NOW + SKEW, "it may have been taken after the motion"


@given(TIMES)
def test_times_are_told_to_the_controller_in_whole_microseconds(at):
    told = since_1970_us(at)
    assert datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=told) == at
    assert withdrawn.of_motion("a.mcap", told, 0.0).known == at


def test_what_the_barrier_lets_pass_the_list_lets_pass_as_well():
    told = since_1970_us(withdrawn.barrier(KNOWN, 0, None, (), SKEW_S))
    entry = withdrawn.of_motion("a.mcap", told, SKEW_S)
    assert entry == Withdrawal(withdrawn.NO_REGISTRATION, "a.mcap", None, KNOWN)
    for seconds in (59.0, 60.0, 60.000_001, 61.0):
        said = later(seconds)
        assert (refusal([entry], {FILE}, said, SKEW_S) == "") is (since_1970_us(said.created) > told)


@pytest.mark.parametrize("year", [1970, withdrawn.YEAR_MAX])
def test_a_line_for_no_registration_in_particular_is_read_again(tmp_path, year):
    at = datetime(year, 12, 31, 23, 59, 59, tzinfo=UTC)
    entry = withdrawn.of_motion("a.mcap", since_1970_us(at), 0.0)
    withdrawn.add(tmp_path, [entry])
    assert load(tmp_path) == (entry,)
