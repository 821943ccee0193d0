"""Records and frames in the forms of other programs: nothing is lost, and no cell of a table is a formula."""

import csv
import io
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cutgate.runtime.audit.container.stored import ChannelInfo, Stored
from cutgate.runtime.review.exported import (
    LEADING,
    NESTING_MAX,
    header_line,
    json_line,
    row_line,
    row_of,
    table_name,
)

finite = st.floats(allow_nan=False, allow_infinity=False)
scalars = st.none() | st.booleans() | st.integers() | finite | st.text(max_size=9)
documents = st.dictionaries(
    st.text(),
    st.recursive(
        scalars,
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
        max_leaves=6,
    ),
    max_size=5,
)
FORMULA = "=+-@"


def stored(data, topic="/a/b", sequence=3, log_time=1_500_000_001, publish_time=7):
    content = data if isinstance(data, bytes) else json.dumps(data).encode()
    return Stored(ChannelInfo(topic, "json", "S", b"{}", b""), log_time, publish_time, sequence, content, 0)


def table(*documents):
    """The cells of the table, and its columns."""
    messages = [stored(document) for document in documents]
    columns = list(dict.fromkeys(name for message in messages for name in row_of(message)))
    text = header_line(columns) + "".join(row_line(message, columns) for message in messages)
    return list(csv.reader(io.StringIO(text, newline=""))), text


# ---------------------------------------------------------------- JSON lines


@given(documents, st.text(max_size=9), st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1))
def test_a_line_holds_all_of_a_record(document, topic, sequence, time):
    line = json_line(stored(document, topic, sequence, time, time))
    assert line.isascii()
    assert line.count("\n") == 1
    assert line.endswith("\n")
    found = json.loads(line)
    assert found == {
        "topic": topic,
        "sequence": sequence,
        "log_time": {"sec": time // 10**9, "nsec": time % 10**9},
        "publish_time": {"sec": time // 10**9, "nsec": time % 10**9},
        "data": document,
    }


@pytest.mark.parametrize(
    "data", [b"", b"[1]", b"{", b'{"x":NaN}', b'{"x":1e999}', b"\xff\n", b'{"x":' * 3000 + b"1" + b"}" * 3000]
)
def test_what_is_no_object_of_finite_numbers_is_there_in_hex(data):
    found = json.loads(json_line(stored(data)))
    assert bytes.fromhex(found["data_hex"]) == data
    assert "data" not in found


@pytest.mark.parametrize(
    ("levels", "whole"), [(1, True), (NESTING_MAX, True), (NESTING_MAX + 1, False), (400, False)]
)
def test_how_deep_a_record_may_be_nested_is_no_matter_of_pythons_version(levels, whole):
    data = b'{"x":' * levels + b"1" + b"}" * levels
    assert ("data" in json.loads(json_line(stored(data)))) == whole
    assert ("data_hex" not in row_of(stored(data))) == whole
    data = b'{"x":' + b"[" * (levels - 1) + b"1" + b"]" * (levels - 1) + b"}"
    assert ("data" in json.loads(json_line(stored(data)))) == whole


# ---------------------------------------------------------------- tables


@settings(max_examples=60)
@given(st.lists(documents, min_size=1, max_size=3))
def test_a_table_has_a_line_for_each_record_and_no_formula_in_it(documents):
    cells, text = table(*documents)
    assert text.count("\n") == len(cells) == len(documents) + 1
    assert {len(row) for row in cells} == {len(cells[0])}
    for row, document in zip(cells[1:], documents, strict=True):
        texts = [name for name, value in row_of(stored(document)).items() if isinstance(value, str)]
        for name in texts:
            cell = row[
                len(LEADING)
                + list(dict.fromkeys(n for d in documents for n in row_of(stored(d)))).index(name)
            ]
            assert not cell.lstrip().startswith(tuple(FORMULA))
            assert "\t" not in cell
            assert "\r" not in cell
    assert not any(cell.lstrip().startswith(tuple(FORMULA)) for cell in cells[0])


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@SUM(A1)", "=cmd|' /C calc'!A0", "  =1", "'=1", "'"])
def test_a_text_that_would_be_a_formula_begins_with_an_apostrophe_that_can_be_taken_off(text):
    (_, (*_, cell)), _ = table({"x": text})
    assert cell == f"'{text}"


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        (-5, "-5"), (-0.25, "-0.25"), (1e-9, "1e-09"), (True, "true"), (None, ""), ("a,b", "a,b"), ('say "x"', 'say "x"'),
        ("two\nlines", "two\\nlines"), ("\x1b[2J", "\\x1b[2J"), ("\t=1", "\\t=1"), ("Müller", "Müller"), ([1, "=2"], '[1,"=2"]'),
        ([], "[]"), ({}, "{}"), ({"sec": 5, "nsec": 6}, "5.000000006"), ({"sec": -1, "nsec": 0}, "-1.000000000"),
    ],
    ids=repr,
)  # fmt: skip
def test_numbers_are_numbers_and_texts_are_on_one_line(value, cell):
    (_, (*_, found)), _ = table({"x": value})
    assert found == cell


def test_objects_become_columns_and_what_is_absent_is_empty():
    cells, _ = table({"a": {"b": 1, "c": {"d": "x"}}}, {"e": 2})
    assert cells == [
        [*LEADING, "a.b", "a.c.d", "e"],
        ["3", "1.500000001", "0.000000007", "1", "x", ""],
        ["3", "1.500000001", "0.000000007", "", "", "2"],
    ]


def test_what_is_no_object_is_a_column_of_hex():
    cells, _ = table(b"\x00=")
    assert cells[0][-1] == "data_hex"
    assert cells[1][-1] == "003d"


@given(st.lists(st.text(max_size=8), unique=True, max_size=20))
def test_each_topic_has_a_file_of_its_own_in_the_folder(topics):
    names = []
    for topic in topics:
        names.append(table_name(topic, names))
    assert len(set(names)) == len(topics)
    for name in names:
        assert name.removesuffix(".csv").replace("-", "a").isalnum()
        assert name.isascii()


def test_the_names_are_those_of_the_topics():
    assert table_name("/audit/decision", ()) == "audit-decision.csv"
    assert table_name("/../etc/passwd", ()) == "etc-passwd.csv"
    assert table_name("//", ("topic.csv",)) == "topic-2.csv"
