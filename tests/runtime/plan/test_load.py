"""Plans, tool paths and registrations: what is read, what is refused and how it is said."""

import copy
import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import InputError
from cutgate.runtime.plan.load import (
    PLAN_EXTENSIONS,
    load_plan,
    load_registration,
    plan_from_bytes,
    registration_from_bytes,
)
from cutgate.runtime.plan.toolpath import csv

EYE = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
TURNED = [[0.0, -1.0, 0.0, 10.0], [1.0, 0.0, 0.0, -20.0], [0.0, 0.0, 1.0, 30.0], [0.0, 0.0, 0.0, 1.0]]
PLAN = {
    "schema": "cutgate.plan/1",
    "id": "p",
    "implant": "stem",
    "side": "left",
    "units": "mm",
    "tool_length_mm": 160.0,
    "feed_mm_s": 20.0,
    "ct_T_implant": TURNED,
    "ct_id": "ct",
    "poses": [[0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [1.0, 2.0, 3.0, 0.6, 0.0, 0.8], [1, 2, 4, 1, 0, 0]],
}
REGISTRATION = {
    "schema": "cutgate.registration/1",
    "id": "r",
    "R_T_CT": TURNED,
    "residual_rms_mm": 0.3,
    "created_utc": "2026-01-02T03:04:05Z",
    "ct_id": "ct",
}
CSV = "x,y,z,i,j,k\n0,0,0,0,0,1\n1,2,3,.6,0,0.8\n1e0,+2.,-4E-1,1,0,0\n"


def changed(document, path, value):
    """A copy with one value set; `del` removes the key."""
    result = copy.deepcopy(document)
    *place, last = path
    target = result
    for key in place:
        target = target[key]
    if value is del_:
        del target[last]
    else:
        target[last] = value
    return result


def del_():
    """Marks a key to remove."""


def read_plan(document) -> object:
    return plan_from_bytes(Path("some.json"), json.dumps(document).encode())


def read_registration(document) -> object:
    return registration_from_bytes(Path("some.json"), json.dumps(document).encode())


def message_of(act) -> str:
    with pytest.raises(InputError) as caught:
        act()
    return str(caught.value)


def test_a_plan_is_what_its_file_says(tmp_path):
    (tmp_path / "p.json").write_text(json.dumps(PLAN), encoding="utf-8")
    loaded = load_plan(tmp_path / "p.json")
    plan = loaded.value
    assert (plan.id, plan.implant, plan.side, plan.ct_id) == ("p", "stem", "left", "ct")
    assert (plan.tool_length_mm, plan.feed_mm_s) == (160.0, 20.0)
    assert plan.ct_T_implant.tolist() == TURNED
    assert plan.tips_mm.tolist() == [[0, 0, 0], [1, 2, 3], [1, 2, 4]]
    assert np.allclose(plan.axes, [[0, 0, 1], [0.6, 0, 0.8], [1, 0, 0]], atol=1e-15)


def test_tool_length_and_ct_may_be_absent():
    plan = read_plan(changed(changed(PLAN, ["tool_length_mm"], del_), ["ct_id"], del_))
    assert (plan.tool_length_mm, plan.ct_id) == (None, None)


def test_axes_within_a_thousandth_are_normalised():
    plan = read_plan(changed(PLAN, ["poses", 0], [0, 0, 0, 0, 0, 1.001]))
    assert plan.axes[0].tolist() == [0, 0, 1]


def test_a_tool_path_has_identity_placement_and_no_feed(tmp_path):
    for name in ("blade.csv", "BLADE.CSV"):
        (tmp_path / name).write_text(CSV, encoding="utf-8")
        plan = load_plan(tmp_path / name).value
        assert (plan.id.lower(), plan.implant, plan.feed_mm_s, plan.ct_id) == ("blade", None, None, None)
        assert plan.ct_T_implant.tolist() == EYE
        assert plan.tips_mm.tolist() == [[0, 0, 0], [1, 2, 3], [1, 2, -0.4]]


def test_line_ends_of_windows_and_a_missing_last_one_are_read():
    for text in (CSV.replace("\n", "\r\n"), CSV.rstrip("\n")):
        assert len(plan_from_bytes(Path("p.csv"), text.encode()).tips_mm) == 3


def test_a_registration_is_what_its_file_says(tmp_path):
    (tmp_path / "r.json").write_text(json.dumps(REGISTRATION), encoding="utf-8")
    found = load_registration(tmp_path / "r.json").value
    assert found.matrix.tolist() == TURNED
    assert found.created == datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
    assert (found.id, found.residual_rms_mm, found.ct_id) == ("r", 0.3, "ct")


def skewed(row, column, value):
    return changed(TURNED, [row, column], value)


BAD_TRANSFORMS = [
    (skewed(3, 3, 2.0), "last row"),
    (skewed(3, 0, 1e-9), "last row"),
    (skewed(0, 1, -1.000002), "orthonormal"),
    (skewed(2, 2, -1.0), "determinant"),
    (skewed(0, 0, 1e200), "entry beyond 1"),
    (skewed(0, 3, 2e5), "translated by at most"),
    (skewed(0, 3, True), "number"),
    (skewed(0, 3, "1"), "number"),
    (TURNED[:3], "given"),
    ([row[:3] for row in TURNED], "given"),
    ([*TURNED, [0.0, 0.0, 0.0, 1.0]], "at most 4"),
    (4, "list"),
    ({"a": 1}, "list"),
]


@pytest.mark.parametrize(("matrix", "words"), BAD_TRANSFORMS)
def test_a_transform_that_is_not_rigid_is_refused(matrix, words):
    for message in (
        message_of(lambda: read_plan(changed(PLAN, ["ct_T_implant"], matrix))),
        message_of(lambda: read_registration(changed(REGISTRATION, ["R_T_CT"], matrix))),
    ):
        assert words in message
        assert "ct_T_implant" in message or "R_T_CT" in message


def test_a_transform_orthonormal_to_a_millionth_is_accepted():
    assert read_registration(changed(REGISTRATION, ["R_T_CT"], skewed(0, 1, -1.0 + 4e-7))).id == "r"


def turned_by(*, decimals=16, scale=1.0):
    """A rotation about an oblique axis, as a file with so many decimals has it."""
    c, s = np.cos(0.7), np.sin(0.7)
    level = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    matrix = np.eye(4)
    matrix[:3, :3] = np.round(scale * level @ level[[2, 0, 1]][:, [2, 0, 1]] @ level, decimals)
    return matrix.tolist()


@pytest.mark.parametrize("decimals", [1, 2, 3, 4, 5, 6])
def test_a_rotation_of_too_few_decimals_is_told_how_many_it_needs(decimals):
    message = message_of(
        lambda: read_registration(changed(REGISTRATION, ["R_T_CT"], turned_by(decimals=decimals)))
    )
    assert f"its rotation has {decimals} decimals, which is too few: write 7 or more" in message
    assert read_registration(changed(REGISTRATION, ["R_T_CT"], turned_by(decimals=7))).id == "r"


@pytest.mark.parametrize("scale", [0.9, 0.99, 1.001, 1.01])
@pytest.mark.parametrize("decimals", [5, 16])
def test_a_scaling_is_not_taken_for_too_few_decimals(scale, decimals):
    refused = changed(REGISTRATION, ["R_T_CT"], turned_by(scale=scale, decimals=decimals))
    assert message_of(lambda: read_registration(refused)).endswith("no scaling, no shear")
    assert message_of(lambda: read_registration(changed(refused, ["R_T_CT"], skewed(2, 2, scale)))).endswith(
        "no shear"
    )


@pytest.mark.parametrize(
    ("found", "remedy"),
    [
        ("2026-01-15T08:21:47+01:00", "convert it, do not relabel it: write 2026-01-15T07:21:47Z"),
        ("2026-01-15T00:21:47.5-05:30", "convert it, do not relabel it: write 2026-01-15T05:51:47.500000Z"),
        ("2026-01-15T08:21:47", "it names no zone: convert it from local time to UTC, unless it is UTC already, and end it with Z"),
        ("0001-01-01T00:00:00+01:00", "convert it, do not relabel it"),
        ("yesterday", "write for example 2026-03-01T08:30:00Z"),
    ],
)  # fmt: skip
def test_a_time_of_another_zone_is_to_be_converted_and_never_relabelled(found, remedy):
    message = message_of(lambda: read_registration(changed(REGISTRATION, ["created_utc"], found)))
    assert (
        message == f"some.json: created_utc is {json.dumps(found)}, must be an ISO-8601 time in UTC; {remedy}"
    )


@pytest.mark.parametrize(
    ("read", "document", "line"),
    [
        (read_plan, changed(PLAN, ["feed_mm_s"], "20"), 'feed_mm_s is "20", must be a valid number; write the number without quotes'),
        (read_plan, changed(PLAN, ["id"], 20), "id is 20, must be a valid string; write it in quotes"),
        (read_plan, changed(PLAN, ["poses", 1], ["1", 2, 3, 0, 0, 1]), "poses.1 is ['1', 2, 3, 0, 0, 1], must be six numbers x, y, z, i, j, k; write its numbers without quotes"),
        (read_registration, changed(REGISTRATION, ["R_T_CT", 0, 3], "10"), 'R_T_CT.0.3 is "10", must be a valid number; write the number without quotes'),
    ],
)  # fmt: skip
def test_text_where_a_number_is_asked_is_shown_as_text_with_the_right_remedy(read, document, line):
    assert message_of(lambda: read(document)) == f"some.json: {line}"


def test_quotes_in_a_tool_path_are_named():
    quoted = CSV.replace("1,2,3,.6", '1,"2",3,.6')
    message = message_of(lambda: plan_from_bytes(Path("some.csv"), quoted.encode()))
    assert message.endswith("column y is '\"2\"', must be a finite decimal number; write it without quotes")


def test_nobody_is_told_to_raise_a_limit_that_is_the_wires():
    longest = b"x,y,z,i,j,k\n" + b"\n" * 1_048_577
    assert message_of(lambda: plan_from_bytes(Path("p.csv"), longest)).endswith("poses; part the path")


BAD_PLANS = [
    (["schema"], "cutgate.plan/2", ("schema", "cutgate.plan/2", "cutgate.plan/1")),
    (["schema"], "cutgate.registration/1", ("schema", "cutgate.registration/1", "cutgate.plan/1")),
    (["schema"], del_, ("schema", "missing", "cutgate.plan/1")),
    (["id"], del_, ("id", "missing", "given")),
    (["id"], "", ("id", '""', "at least 1")),
    (["side"], "middle", ("side", "middle", "'left' or 'right'")),
    (["units"], "inch", ("units", "inch", "'mm'")),
    (["feed_mm_s"], 0, ("feed_mm_s", "0", ">= 0.001")),
    (["feed_mm_s"], del_, ("feed_mm_s", "missing")),
    (["feed_mm_s"], "20", ("feed_mm_s", "20", "number")),
    (["tool_length_mm"], -1, ("tool_length_mm", "-1", ">= 0")),
    (["extra"], 1, ("extra", "1", "known keys")),
    (["poses"], [], ("poses", "0 poses", ">= 2")),
    (["poses"], [[0, 0, 0, 0, 0, 1]], ("poses", "1 poses", ">= 2")),
    (["poses"], 3, ("poses", "3", "list")),
    (["poses", 1], 3, ("poses.1", "3", "six numbers")),
    (["poses", 1], [0, 0, 0, 0, 1], ("poses.1", "six numbers")),
    (["poses", 1], [0, 0, 0, 0, 0, True], ("poses.1", "True", "six numbers")),
    (["poses", 1], [0, 0, 0, 0, 0, "1"], ("poses.1", "'1'", "six numbers")),
    (["poses", 1], [0, 0, 0, 0, 0, None], ("poses.1", "None", "six numbers")),
    (["poses", 1], [[0], 0, 0, 0, 0, 1], ("poses.1", "[[0]", "six numbers")),
    (["poses", 1], [10_001, 0, 0, 0, 0, 1], ("poses.1", "10001", "+-10000")),
    (["poses", 1], [10**400, 0, 0, 0, 0, 1], ("line 1 column", "10000", "a double can hold")),
    (["poses", 1], [0, 0, 0, 0, 0, 1.0011], ("poses.1", "1.0011", "length 1 within 0.001")),
    (["poses", 1], [0, 0, 0, 0, 0, 0], ("poses.1", "of length 0", "length 1")),
]


@pytest.mark.parametrize(("place", "value", "parts"), BAD_PLANS)
def test_a_bad_plan_is_refused_naming_file_key_value_and_bound(place, value, parts):
    message = message_of(lambda: read_plan(changed(PLAN, place, value)))
    assert all(part in message for part in ("some.json", *parts)), message


def test_further_bad_poses_are_counted():
    bad = changed(changed(PLAN, ["poses", 1], [0, 0, 0, 0, 0, 2]), ["poses", 2], [0, 0, 0, 0, 0, 3])
    assert "of length 2 (1 more like it)" in message_of(lambda: read_plan(bad))


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_numbers_that_are_not_finite_are_refused(number):
    text = json.dumps(PLAN).replace("20.0", number)
    assert "finite" in message_of(lambda: plan_from_bytes(Path("p.json"), text.encode()))


BAD_REGISTRATIONS = [
    (["created_utc"], "yesterday", ("created_utc", "yesterday", "ISO-8601")),
    (["created_utc"], "2026-01-02T03:04:05", ("created_utc", "2026-01-02", "UTC")),
    (["created_utc"], "2026-01-02T03:04:05+01:00", ("created_utc", "+01:00", "UTC")),
    (["created_utc"], 5, ("created_utc", "5", "string")),
    (["residual_rms_mm"], -0.1, ("residual_rms_mm", "-0.1", ">= 0")),
    (["residual_rms_mm"], del_, ("residual_rms_mm", "missing")),
    (["age"], 1, ("age", "1", "known keys")),
    (["schema"], "cutgate.plan/1", ("schema", "cutgate.plan/1", "cutgate.registration/1")),
]


@pytest.mark.parametrize(("place", "value", "parts"), BAD_REGISTRATIONS)
def test_a_bad_registration_is_refused_naming_file_key_value_and_bound(place, value, parts):
    message = message_of(lambda: read_registration(changed(REGISTRATION, place, value)))
    assert all(part in message for part in ("some.json", *parts)), message


BAD_CSVS = [
    ("", ("line 1", "x,y,z,i,j,k")),
    ("0,0,0,0,0,1\n", ("line 1", "'0,0,0,0,0,1'")),
    ("X,Y,Z,I,J,K\n" + CSV, ("line 2 column X", "'x'", "finite decimal")),
    ("\ufeff\ufeff" + CSV, ("line 1", "header")),
    ("x" + CSV, ("line 1", "header")),
    ("x,y,z,i,j,k\n", ("poses", "0 poses", ">= 2")),
    ("x,y,z,i,j,k\n0,0,0,0,0,1\n", ("poses", "1 poses", ">= 2")),
    (CSV + "\n", ("line 5", "empty")),
    (CSV.replace("1,2,3", "1,2,3,4"), ("line 3", "7 fields", "six numbers")),
    (CSV.replace("1,2,3", "1,2"), ("line 3", "5 fields")),
    (CSV.replace("1,2,3", "1,2,nan"), ("line 3 column z", "nan", "finite decimal")),
    (CSV.replace("1,2,3", "1,2,inf"), ("line 3 column z", "inf")),
    (CSV.replace("1,2,3", "1,1_0,3"), ("line 3 column y", "1_0")),
    (CSV.replace("1,2,3", "1,,3"), ("line 3 column y", "''")),
    (CSV.replace("1,2,3", "0x1,2,3"), ("line 3 column x", "0x1")),
    (CSV.replace("1,2,3", "\u0661,2,3"), ("line 3 column x",)),
    (CSV.replace("1,2,3", "1e999,2,3"), ("line 3", "inf", "finite")),
    (CSV.replace("1,2,3", "10000.1,2,3"), ("line 3", "10000.1", "+-10000")),
    (CSV.replace(".6,0,0.8", ".6,0,0.9"), ("line 3", "of length 1.08167", "length 1")),
    (CSV.replace("\n1,", "\n# a comment\n1,"), ("line 3", "1 fields")),
]


@pytest.mark.parametrize(("text", "parts"), BAD_CSVS)
def test_a_bad_tool_path_is_refused_naming_line_value_and_bound(text, parts):
    message = message_of(lambda: plan_from_bytes(Path("some.csv"), text.encode()))
    assert all(part in message for part in ("some.csv", *parts)), message


@pytest.mark.parametrize("name", ["p.doc", "p", "p.step", "p.json.gz"])
@pytest.mark.parametrize("there", [True, False])
def test_another_extension_is_refused_naming_the_accepted_ones(name, there, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if there or "." not in name:
        (tmp_path / name).touch()
    message = message_of(lambda: load_plan(name))
    assert name in message
    assert f"must be {' or '.join(PLAN_EXTENSIONS)} for a plan or tool path" in message
    accepted = "must be .json or .tfm or .txt or .mat or .h5 for a registration"
    assert accepted in message_of(lambda: load_registration(name))


EXAMPLES = [
    (load_plan, "hip-stem", "hip-stem.plan.json"),
    (load_plan, "femoral", "femoral.plan.json"),
    (load_plan, "tibial", "tibial.plan.json"),
    (load_registration, "registration-first", "registration-first.json"),
    (load_registration, "registration-second", "registration-second.json"),
    (load_registration, "registration-femoral", "registration-femoral.json"),
    (load_registration, "registration-tibial", "registration-tibial.json"),
]


@pytest.mark.parametrize(("load", "name", "file"), EXAMPLES, ids=[name for _, name, _ in EXAMPLES])
def test_an_example_can_be_named_where_no_such_file_is(load, name, file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).mkdir()
    loaded = load(name)
    assert loaded.path.samefile(Path(__file__).parents[3] / "examples" / file)
    assert loaded.data == loaded.path.read_bytes()
    (tmp_path / name).rmdir()
    (tmp_path / name).touch()
    assert "extension is missing" in message_of(lambda: load(name))


@pytest.mark.parametrize(
    "name", ["femorl", "", "femoral.plan", "Femoral", "nowhere.json", "registration", "fem\0", "*"]
)
def test_what_is_neither_file_nor_example_is_refused_with_the_examples_names(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused = {load: message_of(lambda load=load: load(name)) for load in (load_plan, load_registration)}
    if name == "femoral.plan":
        assert all("extension is .plan" in message for message in refused.values())
        return
    assert "no such file; check the name, or name an example: femoral, hip-stem, tibial" in refused[load_plan]
    names = "registration-femoral, registration-first, registration-second, registration-tibial"
    assert f"or name an example: {names}" in refused[load_registration]


def test_more_poses_than_the_limit_are_refused():
    for name, data in (("p.json", json.dumps(PLAN)), ("p.csv", CSV)):
        assert len(plan_from_bytes(Path(name), data.encode(), 3).tips_mm) == 3
        message = message_of(lambda name=name, data=data: plan_from_bytes(Path(name), data.encode(), 2))
        assert "3 poses" in message
        assert "<= 2 poses" in message


def test_a_tool_path_as_windows_writes_it_is_the_same():
    plain = plan_from_bytes(Path("p.csv"), CSV.encode())
    for text in ("\ufeff" + CSV, CSV.replace("\n", "\r\n"), "\ufeff" + CSV.replace("\n", "\r\n")):
        found = plan_from_bytes(Path("p.csv"), text.encode())
        assert np.array_equal(found.tips_mm, plain.tips_mm)
        assert np.array_equal(found.axes, plain.axes)


def test_a_byte_order_mark_before_json_is_named():
    for load in (plan_from_bytes, registration_from_bytes):
        with pytest.raises(
            InputError, match=r"line 1 is a byte-order mark, .*; save the file as UTF-8 without it"
        ):
            load(Path("p.json"), "\ufeff{}".encode())


def test_a_file_over_the_size_limit_is_refused(tmp_path):
    for name in ("p.json", "p.csv"):
        (tmp_path / name).write_text(" " * 100, encoding="utf-8")
        message = message_of(lambda name=name: load_plan(tmp_path / name, size_limit=99))
        assert (
            "size is 100 bytes, must be <= 99 bytes; raise file_size_limit_mb in a site.toml (--site of run and verify)"
            in message
        )


def test_a_registration_has_a_bound_of_its_own(tmp_path):
    data = json.dumps(REGISTRATION).encode().ljust(100_000)
    assert registration_from_bytes(Path("r.json"), data).id == "r"
    (tmp_path / "r.json").write_bytes(data + b" ")
    for act in (
        lambda: load_registration(tmp_path / "r.json"),
        lambda: registration_from_bytes(Path("r.json"), data + b" "),
    ):
        assert "size is 100001 bytes, must be <= 100000 bytes; it holds something else" in message_of(act)


CROWDS = [
    ('{"poses": [' + "[], " * 1002 + "[]]}", "1004 times '['", 1003),
    ('{"poses": [' + "{}, " * 999 + "{}]}", "1001 times '{'", 1000),
    ('{"poses": [' + "1, " * 1019 + "1]}", "1019 times ','", 1018),
    ('{"id": "' + "," * 1019 + '"}', "1019 times ','", 1018),
]


@pytest.mark.parametrize(("text", "found", "bound"), CROWDS, ids=["lists", "objects", "numbers", "text"])
def test_what_would_take_more_memory_than_the_longest_path_is_refused_before_it_is_parsed(
    text, found, bound, monkeypatch
):
    monkeypatch.setattr(json, "loads", lambda *_, **__: pytest.fail("parsed"))
    message = message_of(lambda: plan_from_bytes(Path("p.json"), text.encode(), 3))
    assert f"p.json is {found}, must be <= {bound} for 3 poses; it holds something else" in message


def test_the_longest_path_is_not_a_crowd():
    plan = changed(PLAN, ["poses"], [PLAN["poses"][0]] * 5000)
    data = json.dumps(changed(plan, ["id"], "[{,:" * 50)).encode()
    assert len(plan_from_bytes(Path("p.json"), data, 5000).tips_mm) == 5000


@pytest.mark.parametrize("end", ["", "\n"])
def test_lines_are_counted_before_any_becomes_text(end, monkeypatch):
    text = "x,y,z,i,j,k\n" + "\n".join(["0,0,0,0,0,1"] * 3) + end
    assert len(plan_from_bytes(Path("p.csv"), text.encode(), 3).tips_mm) == 3
    monkeypatch.setattr(csv, "decode", lambda *_: pytest.fail("read"))
    message = message_of(lambda: plan_from_bytes(Path("p.csv"), text.encode(), 2))
    assert "p.csv: poses is 3 poses, must be <= 2 poses; raise pose_limit" in message
    assert "1000000 poses" in message_of(lambda: plan_from_bytes(Path("p.csv"), b"\n" * 1_000_001, 10))


def is_number(cell: str) -> bool:
    """Oracle: float() reads it, and nothing stands there that only Python or IEEE 754 writes."""
    if set(cell.lower()) & set("_ainfty") or not cell.isascii():
        return False
    try:
        float(cell.strip(" \t"))
    except ValueError:
        return False
    return cell.strip(" \t") == cell.strip()


@given(
    st.text(alphabet="0123456789+-.eE \t_nx,", max_size=12) | st.floats().map(str) | st.integers().map(str)
)
def test_a_number_is_what_float_reads_without_its_extras(cell):
    plain = csv._Form(csv._PLAIN, csv._POINT, (False,) * 6)
    assert bool(plain.cell(0).fullmatch(cell)) is is_number(cell)


def error_of(act) -> InputError | None:
    """The refusal, if there is one; any other exception is the test's failure."""
    try:
        act()
    except InputError as error:
        return error
    return None


JSONISH = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=10,
)


@given(st.sampled_from(sorted(PLAN)), JSONISH, st.integers(0, 5) | st.none())
def test_a_plan_with_any_value_anywhere_is_read_or_refused(key, value, entry):
    place = ["poses", 1, entry] if entry is not None else [key]
    document = changed(PLAN, place, value)
    error = error_of(lambda: plan_from_bytes(Path("f.json"), json.dumps(document).encode()))
    assert error is None or str(error).startswith("f.json")


@given(st.binary(max_size=100), st.sampled_from(["f.json", "f.csv"]))
def test_any_bytes_are_read_or_refused(data, name):
    for kind in (plan_from_bytes, registration_from_bytes):
        assert error_of(lambda kind=kind: kind(Path(name), data)) is not None


@given(st.integers(0, len(CSV) - 1), st.integers(0, 255))
def test_a_tool_path_with_any_byte_changed_is_read_or_refused(place, byte):
    data = bytearray(CSV.encode())
    data[place] = byte
    error = error_of(lambda: plan_from_bytes(Path("f.csv"), bytes(data)))
    assert error is None or str(error).startswith("f.csv")
