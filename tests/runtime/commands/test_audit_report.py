"""``cutgate audit report``: a page is written whole or not at all, is text of a log and nothing else, and names nobody if asked."""

import base64
import hashlib
import json
import re
import shutil
from pathlib import Path

import pytest

from cutgate.config.screen import printable
from cutgate.runtime.audit import records
from cutgate.runtime.audit.reading import candump_of, reading
from cutgate.runtime.audit.signing.signer import sidecar_of
from cutgate.runtime.commands.app import execute
from cutgate.runtime.commands.audit_report import write_report
from cutgate.runtime.commands.report.page import REDACTED
from cutgate.runtime.review.report.integrity import NOT_REPLAYED
from cutgate.runtime.review.report.redact import LEFT_OUT
from tests.runtime.audit.build import forge, session_log
from tests.runtime.review.report.page import Page

OLD = Path(__file__).parents[2] / "compat" / "0.1.0" / "sessions"
SIZE_MAX = 2_000_000
QUESTIONS = (
    "Was it allowed, and why?",
    "What stopped it, where, and what was done then?",
    "How close did it come?",
)


@pytest.fixture(scope="module")
def admitted(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("admitted")).log


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    return session_log(tmp_path_factory.mktemp("refused"), 850.0).log


@pytest.fixture(scope="module")
def page(admitted, tmp_path_factory):
    """The page of a session."""
    file = tmp_path_factory.mktemp("page") / "page.html"
    write_report([admitted], file)
    return file.read_text(encoding="utf-8")


@pytest.fixture
def report(capsys, tmp_path):
    """Runs the command: exit code, the page or None, and what was printed."""

    def run(*arguments, out=None):
        page = out or tmp_path / "page.html"
        code = execute(["audit", "report", *map(str, arguments), "-o", str(page)])
        found = capsys.readouterr()
        return code, page.read_text(encoding="utf-8") if page.is_file() else None, found.out + found.err

    return run


def top_of(text):
    """The first screen."""
    return re.search(r'<header id="top">.*?</header>', text, flags=re.DOTALL)[0]


def data_of(text):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text)[1])


def forged(log, folder, edit, attachments=lambda _name, data: data):
    """A log with other records, beside it what lay beside the first."""
    copy = folder / log.name
    copy.write_bytes(forge(log.read_bytes(), edit, attachments))
    shutil.copy(candump_of(log), folder)
    return copy


# ---------------------------------------------------------------- the page


def test_one_session_is_a_page_with_the_three_answers_in_its_first_screen(report, admitted):
    code, text, said = report(admitted)
    assert code == 0
    assert len(text.encode()) < SIZE_MAX
    assert re.search(rf"page\.html: written, {len(text.encode()) / 1000:.0f} kB, \d+\.\d s\n", said)
    Page(text)
    top = Page(top_of(text)).text
    assert all(question in top for question in QUESTIONS)
    assert "IDENTICAL: decided again from the log alone" in top
    (session,) = data_of(text)["sessions"]
    assert session["name"] == admitted.name


def test_the_page_loads_and_runs_nothing_but_its_own(page):
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)[1]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe" not in policy
    elements = Page(page).elements
    assert not any(
        name.startswith("on") or name == "style" for _, attributes in elements for name in attributes
    )
    assert not any("src" in attributes for _, attributes in elements)
    links = [attributes["href"] for name, attributes in elements if name == "a"]
    ids = {attributes["id"] for _, attributes in elements if "id" in attributes}
    assert links
    assert all(link[0] == "#" and link[1:] in ids for link in links)


def test_no_two_elements_have_the_same_id(report, admitted, refused):
    text = report(admitted, refused, "--no-replay")[1]
    ids = [attributes["id"] for _, attributes in Page(text).elements if "id" in attributes]
    assert len(set(ids)) == len(ids)


def test_two_sessions_have_their_answers_and_what_differs(report, refused, admitted):
    code, text, _ = report(refused, admitted, "--no-replay")
    assert code == 0
    top = Page(top_of(text)).text
    assert all(top.count(question) == 2 for question in QUESTIONS)
    assert refused.name in top
    assert admitted.name in top
    assert "DIFFERENT: " in Page(text).text
    assert len(data_of(text)["sessions"]) == 2


@pytest.mark.parametrize("log", sorted(OLD.glob("*.mcap")), ids=lambda log: log.stem[-8:])
def test_every_log_of_0_1_0_has_a_page(report, log):
    code, text, _ = report(log, "--no-replay")
    assert code == 0
    Page(text)
    assert "INCOMPLETE (unsigned, old form)" in top_of(text)


def test_what_was_not_decided_again_is_said(report, admitted):
    text = report(admitted, "--no-replay")[1]
    assert NOT_REPLAYED in Page(top_of(text)).text
    assert "IDENTICAL" not in top_of(text)


def test_a_tampered_log_says_so_before_anything_else(report, admitted, tmp_path):
    copy = tmp_path / admitted.name
    copy.write_bytes(admitted.read_bytes().replace(b"time scale", b"time skale"))
    code, text, _ = report(copy)
    assert code == 0
    assert Page(top_of(text)).text.startswith(
        "The log was TAMPERED with: nothing that it says is to be believed."
    )
    assert '<p class="warning">' in top_of(text)


def test_a_crashed_log_that_was_cut_off_has_a_page(report, admitted, tmp_path):
    copy = tmp_path / "cut.mcap"
    copy.write_bytes(admitted.read_bytes()[: admitted.stat().st_size // 2])
    code, text, _ = report(copy)
    assert code == 0
    assert "INCOMPLETE" in top_of(text)


def test_keys_and_anchors_of_the_reviewer_count(report, admitted):
    code, text, _ = report(admitted, "--no-replay", "--anchor", "00" * 32)
    assert code == 0
    assert "TAMPERED" in top_of(text)
    with reading(admitted) as log:
        head = log.report.head
    assert f"anchor {head} at record" in Page(report(admitted, "--no-replay", "--anchor", head)[1]).text


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("content", [b"", b"hello"])
def test_a_file_that_is_no_log_has_no_page(report, tmp_path, content):
    other = tmp_path / "other.mcap"
    other.write_bytes(content)
    code, text, said = report(other)
    assert (code, text) == (2, None)
    assert "other.mcap" in said


def test_no_such_log(report, tmp_path):
    code, text, said = report(tmp_path / "none.mcap")
    assert (code, text) == (2, None)
    assert "none.mcap" in said


def test_a_page_has_the_ending_of_one(report, admitted, tmp_path):
    code, text, said = report(admitted, out=tmp_path / "page.pdf")
    assert (code, text) == (2, None)
    assert "--out" in said
    assert ".html" in said


def test_a_page_that_cannot_be_written_leaves_nothing(report, admitted, tmp_path):
    code, _, said = report(admitted, out=tmp_path / "missing" / "page.html")
    assert code == 2
    assert "cannot be written" in said
    assert list(tmp_path.iterdir()) == []


def test_an_older_page_is_replaced_as_other_commands_do(report, admitted, tmp_path):
    (tmp_path / "page.html").write_text("old")
    assert report(admitted)[1].startswith("<!DOCTYPE html>")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


# ---------------------------------------------------------------- what a log says is text

HOSTILE = "</script><script>alert(1)</script>\"><img src=x onerror=y><b>a\x1b[31m\x07b\u202eb\u2066c'&amp;"


def test_no_text_field_of_a_log_is_markup_or_a_control_character(report, page, admitted, tmp_path):
    def edit(record):
        if isinstance(record, records.AuditCheckpoint):
            return record
        texts = {
            name: HOSTILE
            for name, value in record
            if (isinstance(value, str) or value is None)
            and name
            in {
                "account", "host", "operator", "software", "previous_note", "event", "reason", "first_out", "outcome", "what",
                "detail", "difference", "worst_boundary", "elbow",
            }
        }  # fmt: skip
        if isinstance(record, records.AuditDecision):
            entry = records.PermissiveValue(
                name=HOSTILE, holds=False, text=HOSTILE, bound=HOSTILE, remedy=HOSTILE
            )
            texts |= {"permissives": (entry,), "from_state": HOSTILE}
        if isinstance(record, records.AuditBoundary):
            texts |= {"name": HOSTILE}
        return record.model_copy(update=texts)

    code, text, _ = report(forged(admitted, tmp_path, edit), "--no-replay")
    assert code == 0
    for name in ("script", "img", "b"):
        assert len(Page(text).of(name)) == len(Page(page).of(name))
    body = text[text.index("<body") : text.rindex("<script>")]
    assert not any(character in body for character in "\x1b\x07\u202e\u2066")
    shown = printable(HOSTILE)
    assert Page(text).text.count(shown) > 10
    assert shown in data_of(text)["sessions"][0]["lanes"][0]["spans"][0]["state"]
    assert holds_its_hashes(text)


def holds_its_hashes(text):
    """Whether the policy names the script and the style that the page has."""
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text)[1]
    script = text[text.rindex("<script>") + len("<script>") : text.rindex("</script>")]
    style = text[text.index("<style>") + len("<style>") : text.index("</style>")]
    return all(
        f"{kind}-src 'sha256-{base64.b64encode(hashlib.sha256(own.encode()).digest()).decode()}'" in policy
        for kind, own in (("script", script), ("style", style))
    )


def test_the_policy_names_script_and_style_by_their_hashes(page):
    assert holds_its_hashes(page)


# ---------------------------------------------------------------- names

NAMES = {
    "account": "ortassistant (uid 1007)",
    "host": "theatre-seven",
    "operator": "Doktor <Ann> Müllerin",
    "previous_log": "20261127T101010Z-cafecafe.mcap",
    "candump": "20261128T224041Z-smithson.candump.log",
    "series": "5eed5eed" * 4,
}
REGISTRATION = {"id": "REG-smithson-1954", "ct_id": "CT-99812-x"}
ARGUMENTS = (
    "run",
    "/home/surgeon/smithson-left.plan.csv",
    "--site",
    "/etc/cutgate/site.toml",
    "--operator",
    "Ann M.",
)


def named(record):
    if isinstance(record, records.AuditDecision) and record.sequence == 1:
        return records.AuditProcess(
            role="runtime", pid=1, argv=ARGUMENTS, prev=record.prev, monotonic=record.monotonic
        )
    if isinstance(record, records.AuditOpen):
        return record.model_copy(update=NAMES)
    if isinstance(record, records.AuditDecision):
        reason = f"registration {REGISTRATION['id']} of {REGISTRATION['ct_id']} on {NAMES['host']}"
        return record.model_copy(update={"session": "ab12cd34" * 8, "reason": reason})
    if isinstance(record, records.AuditClose):
        return record.model_copy(
            update={"outcome": f"done by {NAMES['operator']} with smithson-left.plan.csv"}
        )
    return record


def registered(name, data):
    return json.dumps(json.loads(data) | REGISTRATION).encode() if name == "registration.json" else data


@pytest.fixture
def with_names(admitted, tmp_path):
    folder = tmp_path / "ward-nine"
    folder.mkdir()
    log = forged(admitted, folder, named, registered)
    return log.rename(folder / "20261128T224041Z-smithson.mcap")


def gone(log):
    """Everything that names somebody or something."""
    with reading(log) as read:
        log_id = read.report.log_id
    return [
        log_id, log_id[:8], "ortassistant", "theatre-seven", "Müllerin", "M\\u00fcllerin", "cafecafe", "smithson", "5eed5eed",
        "REG-smithson-1954", "CT-99812-x", "ab12cd34", "ward-nine", "surgeon", str(log.parent),
    ]  # fmt: skip


def test_no_name_of_a_log_is_left_in_a_redacted_page(report, with_names):
    whole = report(with_names, "--no-replay")[1].casefold()
    code, text, _ = report(with_names, "--no-replay", "--redact")
    assert code == 0
    missing = {name for name in gone(with_names) if name.casefold() not in whole}
    assert missing <= {
        "M\\u00fcllerin",
        "0123456789abcdef" * 2,
        "5eed5eed",
        str(with_names.parent),
        "ward-nine",
    }
    assert [name for name in gone(with_names) if name.casefold() in text.casefold()] == []
    Page(text)
    (session,) = data_of(text)["sessions"]
    assert (session["name"], session["redacted"]) == ("first session", True)
    assert LEFT_OUT in Page(top_of(text)).text
    assert REDACTED in Page(text).text


def test_what_was_decided_stays_in_a_redacted_page(report, page, admitted):
    for shown in (page, report(admitted, "--redact")[1]):
        assert "The path was allowed and cut to its end" in Page(top_of(shown)).text
        assert "nearest was" in Page(top_of(shown)).text


def test_two_redacted_sessions_are_told_apart_and_what_names_differ_is_still_different(
    report, with_names, refused
):
    text = report(with_names, refused, "--no-replay", "--redact")[1]
    assert [session["name"] for session in data_of(text)["sessions"]] == ["first session", "second session"]
    assert [name for name in gone(with_names) if name.casefold() in text.casefold()] == []
    assert "operator (left out) (absent)" in Page(text).text


def test_the_sidecar_beside_a_log_is_asked(report, page, admitted, tmp_path):
    assert sidecar_of(admitted).is_file()
    assert "OK (signed" in top_of(page)
    copy = tmp_path / admitted.name
    shutil.copy(admitted, copy)
    shutil.copy(candump_of(admitted), tmp_path)
    assert "INCOMPLETE" in top_of(report(copy)[1])
