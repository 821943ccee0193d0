"""The table of records: all but frames and samples, numbered as in the file, at most so many, nothing of it an error."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.review.report import records
from cutgate.runtime.review.report.records import COLUMNS, TEXT_MAX, rows
from tests.runtime.audit.build import small_log


@pytest.mark.parametrize("name", ["finished", "refused", "crashed"])
def test_every_record_but_the_frames_has_a_row_with_its_number_in_the_file(old_logs, name):
    found = rows(read_log(old_logs[name]))
    messages = scan(old_logs[name]).messages
    expected = [(k, message.topic) for k, message in enumerate(messages) if message.topic != "/can/frame"]
    assert found["columns"] == list(COLUMNS)
    assert [(row[0], row[2]) for row in found["rows"]] == expected
    assert found["rows"][0][1] == 0.0
    json.dumps(found, allow_nan=False)


def test_a_row_says_what_it_is_about_and_what_else_stands_in_it(admitted):
    found = {row[3]: row[4] for row in rows(read_log(admitted))["rows"] if row[2] == "/audit/boundary"}
    assert "deadband 5.0" in found["inner"]
    assert "violated no" in found["inner"]
    verdict = next(row for row in rows(read_log(admitted))["rows"] if row[2] == "/audit/verdict")
    assert verdict[3] == "admissible"
    assert "document of " in verdict[4]
    assert "cutgate.verdict/1" not in verdict[4]


def test_of_more_records_than_a_page_holds_the_middle_is_left_out_and_counted(tmp_path, monkeypatch):
    log = read_log(small_log(tmp_path, decisions=40).log.read_bytes())
    whole = rows(log)["rows"]
    monkeypatch.setattr(records, "ROWS_MAX", 11)
    found = rows(log)["rows"]
    assert found[:6] == whole[:6]
    assert found[7:] == whole[-5:]
    assert found[6] == [None, None, "", f"{len(whole) - 11} records are left out here; the log has them", ""]


def test_what_is_shown_of_a_record_is_asked_for(admitted):
    found = rows(read_log(admitted), lambda record: {"name": "nothing"})["rows"]
    assert {(row[3], row[4]) for row in found} == {("nothing", "")}
    assert found[-1][1] > 0.0


@given(st.data())
def test_a_log_with_damaged_bytes_has_rows_of_bounded_length(old_logs, data):
    log = bytearray(old_logs["refused"])
    for _ in range(data.draw(st.integers(1, 20))):
        log[data.draw(st.integers(0, len(log) - 1))] = data.draw(st.integers(0, 255))
    for row in rows(read_log(bytes(log)))["rows"]:
        assert len(row[3]) <= TEXT_MAX + 3
        assert len(row[4]) <= TEXT_MAX + 3
