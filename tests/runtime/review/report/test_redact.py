"""What a page leaves out: every name that a log holds, wherever it stands; and nothing of what was decided."""

import html
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.runtime.audit import records
from cutgate.runtime.audit.inspect import read_log
from cutgate.runtime.review.report.redact import LEFT_OUT, NAMES_MAX, Redaction
from tests.runtime.audit.build import forge, small_log

LOG = "20261128T224041Z-deadbeef"
NAMES = {
    "account": "ort.assistant (uid 1007)",
    "host": "theatre-seven",
    "operator": "Dr <Ann> Müller",
    "previous_log": "20261127T101010Z-cafecafe.mcap",
    "series": "5eed" * 8,
}


def of(*names):
    return Redaction(frozenset(names))


def edited(record):
    if isinstance(record, records.AuditOpen):
        bus = records.Option(name="bus", value="cutgate//run/theatre/bus.sock")
        return record.model_copy(update=NAMES | {"simulation": (bus,)})
    if isinstance(record, records.AuditOperator):
        return record.model_copy(
            update={"accepted": False, "reason": "because Smith waits", "what": "SMITHS_WORD"}
        )
    if isinstance(record, records.AuditDecision):
        return record.model_copy(update={"session": "ab12cd34" * 8})
    return record


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    """A log with a name in every field that can hold one."""
    return read_log(forge(small_log(tmp_path_factory.mktemp("named")).log.read_bytes(), edited))


def test_every_name_in_the_records_is_left_out_in_sentences_too(named):
    redaction = Redaction.of(named, f"/media/stick/{LOG}.mcap", f"/media/stick/{LOG}.candump.log")
    gone = [
        *NAMES.values(), "ort.assistant", "20261127T101010Z-cafecafe", LOG, f"{LOG}.mcap", "/media/stick", "ab12cd34" * 8,
        "ab12cd34", "because Smith waits", "SMITHS_WORD", "cutgate//run/theatre/bus.sock", "bus.sock",
        named.report.log_id, named.report.log_id[:8],
    ]  # fmt: skip
    for name in gone:
        assert redaction.text(f"it was {name}, they say") == f"it was {LEFT_OUT}, they say", name
        assert redaction.text(f"IT WAS {name.upper()}.") == f"IT WAS {LEFT_OUT}.", name


def test_what_was_decided_stays(named):
    redaction = Redaction.of(named, f"{LOG}.mcap")
    for text in (
        "verdict admissible, 22.894 mm, required 5 mm",
        "robot.toml",
        "a1b2" * 16,
        "/audit/decision",
    ):
        assert redaction.text(text) == text


def test_a_short_name_is_left_out_as_a_whole_word_alone():
    redaction = of("vm")
    assert redaction.text("on vm, vmware, (vm)") == f"on {LEFT_OUT}, vmware, ({LEFT_OUT})"
    assert of("theatre7").text("theatre7b") == f"{LEFT_OUT}b"


def test_the_longest_name_is_left_out_first():
    assert of("or", "or-two").text("on or-two") == f"on {LEFT_OUT}"


@pytest.mark.parametrize("name", ["20260107", "4711-2", "1.2.840.113619"])
def test_a_name_of_digits_is_a_name(name):
    assert of(name).text(f"CT {name} of it") == f"CT {LEFT_OUT} of it"


def test_a_document_keeps_its_form_numbers_and_field_names():
    document = {
        "host": "theatre-seven",
        "numbers": [1.5, None, True],
        "of": {"theatre-seven": "x"},
        "verdict": "ok",
    }
    assert of("theatre-seven", "verdict").apply(document) == {
        "host": LEFT_OUT,
        "numbers": [1.5, None, True],
        "of": {LEFT_OUT: "x"},
        "verdict": "ok",
    }


@pytest.mark.parametrize("field", ["session", "nonce", "argv", "document", "candump"])
def test_fields_that_hold_nothing_but_names_are_left_out_whatever_they_hold(field):
    assert of().apply({field: "anything"}) == {field: LEFT_OUT}
    assert of().apply({field: ["--operator", "Ann"]}) == {field: []}


def test_what_is_nested_without_end_is_cut_off():
    deep = []
    for _ in range(500):
        deep = [deep]
    assert json.dumps(of().apply(deep)).count("[") < 100


def test_of_html_only_the_text_is_changed():
    page = '<section id="vm" class="vm"><p>on vm &amp; vm</p>\n</section>'
    assert (
        of("vm").page(page)
        == f'<section id="vm" class="vm"><p>on {LEFT_OUT} &amp; {LEFT_OUT}</p>\n</section>'
    )


def test_a_name_that_was_escaped_is_found_as_well():
    name = "Dr <Ann> & 'co'\x1b"
    shown = html.escape(name.replace("\x1b", "\\x1b"))
    assert of(name).page(f"<p>by {shown}!</p>") == f"<p>by {LEFT_OUT}!</p>"


def test_two_sessions_leave_out_what_either_names():
    assert (of("theatre-seven") | of("smithson")).text(
        "smithson in theatre-seven"
    ) == f"{LEFT_OUT} in {LEFT_OUT}"


def test_of_a_log_with_too_many_names_nothing_is_told():
    many = Redaction(frozenset(f"name-{k:08}" for k in range(NAMES_MAX + 1)))
    assert many.text("permit left") == LEFT_OUT
    assert many.page("<p>permit left</p>") == f"<p>{LEFT_OUT}</p>"
    assert many.apply({"t_s": 1.0, "text": "x"}) == {"t_s": 1.0, "text": LEFT_OUT}


def test_the_names_of_a_log_are_bounded(tmp_path):
    number = iter(range(10_000))

    def edit(record):
        if isinstance(record, records.AuditOperator):
            return record.model_copy(update={"accepted": False, "reason": f"reason {next(number):06}"})
        return record

    data = forge(small_log(tmp_path, decisions=NAMES_MAX + 50).log.read_bytes(), edit)
    assert Redaction.of(read_log(data)).text("anything at all") == LEFT_OUT


@given(st.text(min_size=8).filter(lambda text: any(map(str.isalnum, text))), st.text(), st.text())
def test_no_long_name_is_ever_left(name, before, after):
    assert name not in of(name).text(before + name + after)
    assert name not in json.dumps(of(name).apply({"text": [before + name + after]}), ensure_ascii=False)


@given(st.data())
def test_damaged_logs_have_their_names_left_out_without_an_error(old_logs, data):
    log = bytearray(old_logs["stopped"])
    for _ in range(data.draw(st.integers(1, 20))):
        log[data.draw(st.integers(0, len(log) - 1))] = data.draw(st.integers(0, 255))
    read = read_log(bytes(log))
    assert isinstance(Redaction.of(read, "x.mcap").text("y"), str)
