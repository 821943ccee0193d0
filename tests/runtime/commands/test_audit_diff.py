"""``cutgate audit diff``: exit codes, the document, and what is seen of it."""

import json
import shutil

import pytest

from cutgate.runtime.audit import records
from cutgate.runtime.audit.signing.signer import sidecar_of
from cutgate.runtime.commands import audit_diff
from cutgate.runtime.commands.app import execute
from cutgate.runtime.commands.screen import LiteralConsole
from tests.logs import signature_of
from tests.runtime.audit.build import forge, session_log
from tests.runtime.audit.test_replay import changed

COLUMNS = 80


@pytest.fixture(scope="module")
def admitted(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("admitted")).log


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("refused"), 850.0).log


@pytest.fixture
def diff(capsys, monkeypatch):
    """Runs the command on a screen of 80 columns."""
    monkeypatch.setattr(
        audit_diff, "output", lambda: LiteralConsole(width=COLUMNS, force_terminal=False, no_color=True)
    )

    def call(*arguments):
        code = execute(["audit", "diff", *map(str, arguments)])
        found = capsys.readouterr()
        return code, found.out, found.err

    return call


def forged(log, folder, edit):
    copy = folder / log.name
    data = forge(log.read_bytes(), edit)
    copy.write_bytes(data)
    sidecar_of(copy).write_bytes(signature_of(data) or b"")
    shutil.copy(log.with_suffix(".candump.log"), folder)
    return copy


def test_a_log_equals_itself(diff, admitted):
    code, out, err = diff(admitted, admitted)
    assert (code, err) == (0, "")
    assert "EQUAL: none of" in out
    assert "DIFFERENT" not in out


def test_what_differs_is_a_table_and_what_is_equal_a_line(diff, admitted, refused):
    code, out, _ = diff(admitted, refused)
    assert code == 1
    for text in (
        "DIFFERENT",
        "registration: 1 of",
        "R_T_CT[0]",
        "verdict: ",
        "top violated",
        "outer violated",
    ):
        assert (text in out) == (text != "top violated"), text
    assert "approach: only in A" in out
    equal = " ".join(out.split()).split("number of their values: ")[1].split(" Timing")[0]
    assert "robot (" in equal
    assert "verdict" not in equal
    assert "Timing, which makes no sessions different" in out


def test_nothing_is_wider_than_the_screen_but_names_of_files(diff, admitted, refused):
    out = diff(admitted, refused)[1]
    wide = [line for line in out.splitlines() if len(line) > COLUMNS]
    assert all(line.strip() in (str(admitted), str(refused)) for line in wide)


def test_both_values_are_told_to_the_last_digit_that_differs(diff, admitted, tmp_path):
    def nudge(record):
        if isinstance(record, records.AuditBoundary) and record.name == "top":
            return record.model_copy(update={"certified": record.certified + 2e-6})
        return record

    code, out, _ = diff(admitted, forged(admitted, tmp_path, nudge))
    assert code == 1
    (line,) = [one for one in out.splitlines() if one.startswith("top certified")]
    first, second = line.split()[-2:]
    assert float(second) - float(first) == pytest.approx(2e-6, abs=1e-6)


def test_as_one_json_document(diff, admitted, refused):
    code, out, _ = diff(admitted, refused, "--json")
    document = json.loads(out)
    assert code == 1
    assert (document["schema"], document["equal"]) == ("cutgate.audit-diff/1", False)
    assert [document[side]["log"] for side in "ab"] == [str(admitted), str(refused)]
    (verdict,) = [
        entry
        for section in document["sections"]
        for entry in section["differences"]
        if (section["section"], entry["what"]) == ("verdict", "verdict")
    ]
    assert verdict == {"what": "verdict", "a": "admissible", "b": "inadmissible"}
    code, out, _ = diff(admitted, admitted, "--json")
    assert (code, json.loads(out)["equal"]) == (0, True)


@pytest.mark.parametrize("place", [0, 1])
@pytest.mark.parametrize("name", ["absent.mcap", "pyproject.toml", "."])
def test_what_is_no_log_is_refused(diff, admitted, name, place):
    arguments = [admitted, admitted]
    arguments[place] = name
    code, out, err = diff(*arguments)
    assert (code, out) == (2, "")
    assert name in err


@pytest.mark.parametrize("arguments", [[], ["one.mcap"], ["a", "b", "c"]])
def test_other_than_two_logs_are_refused(diff, arguments):
    assert diff(*arguments)[0] == 2


def test_a_log_that_does_not_verify_is_told_and_differs(diff, admitted, tmp_path):
    copy = tmp_path / "cut.mcap"
    copy.write_bytes(admitted.read_bytes()[:-100])
    shutil.copy(admitted.with_suffix(".candump.log"), tmp_path / "cut.candump.log")
    code, out, _ = diff(admitted, copy)
    assert code == 1
    assert "B  INCOMPLETE" in out
    assert "the file ends early" in out
    assert "log: 1 of 1 values" in out


def test_what_a_log_says_is_data(diff, admitted, tmp_path):
    text = "x\nEQUAL: \x1b[2J[bold]" + "\u202e"
    copy = forged(
        admitted,
        tmp_path,
        changed(records.AuditOpen, operator=text, simulation=(records.Option(name=text, value=text),)),
    )
    code, out, _ = diff(admitted, copy)
    assert code == 1
    assert [c for c in out if not (c.isprintable() or c == "\n")] == []
    assert not any(line.startswith("EQUAL") for line in out.splitlines())
    assert "[bold]" in out


def test_a_time_that_is_far_apart_is_listed_and_makes_no_difference(diff, admitted, tmp_path):
    def later(record):
        if isinstance(record, records.AuditClose):
            return record.model_copy(update={"monotonic": records.Time(sec=500, nsec=0)})
        return record

    code, out, _ = diff(admitted, forged(admitted, tmp_path, later))
    assert code == 0
    (line,) = [one for one in out.splitlines() if one.startswith("opening to end, s")]
    assert float(line.split()[-1]) > 400.0
