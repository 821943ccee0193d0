"""CSV in the forms that programs make of it: read as the same numbers, or refused with line and column."""

import math
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import InputError
from cutgate.runtime.plan.load import plan_from_bytes
from cutgate.runtime.plan.toolpath.csv import read_csv
from cutgate.runtime.plan.toolpath.csv_writer import write_csv
from cutgate.runtime.plan.toolpath.model import PLAIN, Cut
from tests.tool_paths import tool_path

LIMIT = 100_000


def read(text: str | bytes, limit: int = LIMIT) -> tuple[Cut, list[tuple[int, str]]]:
    """The cut, and what was told of it."""
    told = []
    data = text if isinstance(text, bytes) else text.encode()
    (cut,) = read_csv("f.csv", data, PLAIN, limit, lambda line, words: told.append((line, words))).cuts
    return cut, told


def refusal(text: str, limit: int = LIMIT) -> str:
    with pytest.raises(InputError) as caught:
        read(text, limit)
    return str(caught.value)


def same(cut: Cut, other: Cut) -> bool:
    return np.array_equal(cut.tips_mm, other.tips_mm) and np.array_equal(cut.axes, other.axes)


# ------------------------------------------------------------ round trips

LENGTH = st.decimals(-400, 400, places=6)
ANGLE = st.floats(0.0, 2.0 * math.pi)


@st.composite
def paths(draw):
    """Rows of six decimal numbers; the first axis shows that commas are decimal signs."""
    tips = draw(st.lists(st.tuples(LENGTH, LENGTH, LENGTH), min_size=2, max_size=6))
    rows = []
    for tip in tips:
        along, about = draw(ANGLE), draw(ANGLE)
        axis = (
            math.sin(along) * math.cos(about),
            math.sin(along) * math.sin(about),
            math.cos(along),
        )
        rows.append([*tip, *(Decimal(f"{part:.9f}") for part in axis)])
    return rows


@st.composite
def dialects(draw):
    delimiter = draw(st.sampled_from([",", ";", "\t", " "]))
    comma = draw(st.booleans()) and delimiter in ";\t"
    names = draw(
        st.sampled_from(
            [
                "x y z i j k",
                "X Y Z I J K",
                "x y z nx ny nz",
                "PX PY PZ ax ay az",
                "x y z axis_x axis_y axis_z",
            ]
        )
    ).split()
    unit = draw(st.sampled_from(["", "mm", "m", "in", "inch"]))
    where = draw(st.sampled_from(["header", "row"]))
    shape = "{}_{}" if delimiter == " " else draw(st.sampled_from(["{}_{}", "{} [{}]", "{} ({})", "{}/{}"]))
    feed = draw(st.sampled_from([None, ("f", "mm/min"), ("Feed", "mm/s")]))
    number = draw(st.sampled_from([None, "n", "ID"]))
    order = draw(st.permutations(range(6 + (feed is not None) + (number is not None))))
    return {
        "delimiter": delimiter,
        "comma": comma,
        "names": names,
        "unit": unit,
        "where": where,
        "shape": shape,
        "feed": feed,
        "number": number,
        "order": order,
        "quoted": draw(st.booleans()) and delimiter != " ",
        "end": draw(st.sampled_from(["\n", "\r\n"])),
        "before": draw(st.sampled_from(["", "# made by hand\n", "// one\n\n#two\n"])),
        "mark": draw(st.booleans()),
        "pad": draw(st.sampled_from(["", " "])) if delimiter in ",;\t" else "",
    }


PER_MM = {
    "": Fraction(1),
    "mm": Fraction(1),
    "m": Fraction(1, 1000),
    "in": Fraction(10, 254),
    "inch": Fraction(10, 254),
}


def written(rows, form) -> str:
    """An independent writer: numbers are turned into the file's unit as decimals of 30 digits."""
    names = list(form["names"])
    units = [form["unit"]] * 3 + [""] * 3
    table = [[f"{Decimal(v):f}" for v in row] for row in rows]
    if form["unit"] not in ("", "mm"):
        scale = PER_MM[form["unit"]]
        for row in table:
            row[:3] = [
                f"{Decimal((Fraction(v) * scale).numerator) / Decimal((Fraction(v) * scale).denominator):f}"
                for v in row[:3]
            ]
    if form["feed"]:
        names.append(form["feed"][0])
        units.append(form["feed"][1])
        for k, row in enumerate(table):
            row.append(str(60 * (k + 1)))
    if form["number"]:
        names.append(form["number"])
        units.append("")
        for k, row in enumerate(table):
            row.append(str(10 * k + 10))
    below = form["where"] == "row" and any(units) and form["delimiter"] != " "
    head = [
        form["shape"].format(name, unit) if unit and not below else name
        for name, unit in zip(names, units, strict=True)
    ]
    mark = '"{}"' if form["quoted"] else "{}"
    lines = [[mark.format(cell) for cell in head]]
    if below:
        lines.append([f"[{unit}]" if unit else "" for unit in units])
    sign = "," if form["comma"] else "."
    lines += [[mark.format(cell.replace(".", sign)) for cell in row] for row in table]
    text = form["before"] + "".join(
        form["delimiter"].join(form["pad"] + line[k] + form["pad"] for k in form["order"]) + "\n"
        for line in lines
    )
    return ("\ufeff" if form["mark"] else "") + text.replace("\n", form["end"])


@given(paths(), dialects())
def test_what_any_dialect_says_is_read_as_the_same_numbers(rows, form):
    if form["comma"]:
        rows[0][0] = Decimal("0.5")  # else nothing may prove that the comma is a decimal one
    text = written(rows, form)
    cut, told = read(text)
    plain, silent = read("x,y,z,i,j,k\n" + "\n".join(",".join(f"{v:f}" for v in row) for row in rows))
    assert silent == []
    assert np.array_equal(cut.axes, plain.axes)
    if form["unit"] in ("", "mm"):
        assert np.array_equal(cut.tips_mm, plain.tips_mm)
    else:  # one rounding of the file's number, one of the product
        assert np.all(np.abs(cut.tips_mm - plain.tips_mm) <= 2.0 * np.spacing(np.abs(plain.tips_mm)))
    lines = text.split("\n")
    assert [lines[line - 1] for line in cut.lines] == lines[len(lines) - 1 - len(rows) : len(lines) - 1]
    assert cut.positioning.tolist() == [True] + [False] * (len(rows) - 1)
    assert math.isnan(cut.feeds_mm_s[0])
    if form["feed"]:
        slower = 60.0 if form["feed"][1] == "mm/min" else 1.0
        assert np.allclose(cut.feeds_mm_s[1:] * slower, [60.0 * k for k in range(2, len(rows) + 1)])
    else:
        assert np.isnan(cut.feeds_mm_s).all()
    words = " ".join(text for _, text in told)
    for departs, said in (
        (form["delimiter"] != ",", "separated by"),
        (form["comma"], "decimal signs"),
        (form["quoted"], "in quotes"),
        (form["unit"] in ("m", "in", "inch"), "multiplied"),
        (form["feed"], "the feed in"),
        (form["number"], "running number"),
        (form["before"], "not read"),
    ):
        assert (said in words) == bool(departs), (words, said)


AXIS = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda axis: math.hypot(*axis) > 0.1)


@given(
    st.lists(st.tuples(st.tuples(*[st.floats(-9999.0, 9999.0)] * 3), AXIS), min_size=2, max_size=20),
)
def test_what_is_written_is_read_again_to_the_last_bit(poses):
    tips = np.array([tip for tip, _ in poses])
    axes = np.array([axis for _, axis in poses])
    text = "x,y,z,i,j,k\n" + "\n".join(
        ",".join(map(repr, row))
        for row in np.hstack([tips, axes / np.linalg.norm(axes, axis=1)[:, None]]).tolist()
    )
    cut = read(text)[0]
    data = write_csv(cut)
    again, told = read(data)
    assert same(cut, again)
    assert told == []
    assert data.startswith(b"x,y,z,i,j,k\n")


def test_many_axes_are_written_so_that_they_are_read_again():
    draws = np.random.default_rng(7)
    axes = draws.normal(size=(20_000, 3))
    text = "x,y,z,i,j,k\n" + "\n".join(
        ",".join(map(repr, row))
        for row in np.hstack(
            [draws.uniform(-1e4, 1e4, axes.shape), axes / np.linalg.norm(axes, axis=1)[:, None]]
        ).tolist()
    )
    cut = read(text)[0]
    assert same(cut, read(write_csv(cut))[0])


def test_an_axis_that_normalising_never_gives_is_written_as_it_is():
    axis = math.nextafter(1.0, 2.0)
    cut = read("x,y,z,i,j,k\n0,0,0,0,0,1\n1,0,0,0,0,1")[0]
    cut.axes[1, 2] = axis
    assert write_csv(cut).split(b"\n")[2] == f"1.0,0.0,0.0,0.0,0.0,{axis!r}".encode()


@pytest.mark.parametrize("name", ["blade-channel.csv", "whole-wheel.csv"])
def test_a_tool_path_of_a_mill_is_read_again(name):
    cut = read(tool_path(name).read_bytes())[0]
    assert same(cut, read(write_csv(cut))[0])


def test_columns_made_even_by_spaces_and_tabs_are_read():
    cut, told = read(" x  y z   i j k\n0 0  0\t0 0 1\n  1.5\t -2 3 0.6 0 0.8  \n")
    assert cut.tips_mm.tolist() == [[0, 0, 0], [1.5, -2, 3]]
    assert told == [(1, "columns are separated by spaces")]


def test_tables_of_numpy_are_read(tmp_path):
    table = np.array([[0.0, 0, 0, 0, 0, 1], [1.5, 2, 3, 0.6, 0, 0.8]])
    for delimiter, names in ((" ", "x y z i j k"), (",", "x,y,z,i,j,k")):
        np.savetxt(tmp_path / "n.csv", table, delimiter=delimiter, header=names)
        cut, told = read((tmp_path / "n.csv").read_bytes())
        assert cut.tips_mm.tolist() == table[:, :3].tolist()
        assert cut.lines.tolist() == [2, 3]
        assert (1, "the comment before the first pose names the columns: read as the header") in told


def test_the_separator_that_excel_reads_may_stand_in_the_first_line():
    cut, told = read("sep=;\nx;y;z;i;j;k\n0;0;0;0;0;1\n1,5;0;0;0;0;1\n")
    assert cut.tips_mm[1].tolist() == [1.5, 0.0, 0.0]
    assert told == [
        (2, "columns are separated by semicolons"),
        (4, "commas in numbers are decimal signs"),
    ]


def test_what_was_understood_is_told_with_its_line():
    _, told = read(
        "# one\n\nN;F [mm/min];Y;X;Z;nx;ny;nz\n;;in;in;in;;;\n1;60;0,5;0;0;0;0;1\n2;60;1;0;0;0;0;1\n"
    )
    assert told == [
        (1, "2 lines of comments, or blank ones, before the header: not read"),
        (4, "read as a line of units"),
        (3, "columns are separated by semicolons"),
        (3, "columns y,x,z,nx,ny,nz are read as y,x,z,i,j,k"),
        (3, "lengths are in in: multiplied by 25.4 to mm"),
        (3, "column n is a running number: not used"),
        (3, "column f is the feed in mm/min of the move that ends at its pose"),
        (5, "commas in numbers are decimal signs"),
    ]


def test_one_feed_of_the_file_is_the_plans():
    text = "x,y,z,i,j,k,f_mm_s\n0,0,0,0,0,1,0\n1,0,0,0,0,1,12.5\n2,0,0,0,0,1,12.5\n"
    assert plan_from_bytes(Path("p.csv"), text.encode()).feed_mm_s == 12.5


# ------------------------------------------------------------ refusals

ROWS = "0,0,0,0,0,1\n1,2,3,.6,0,0.8\n"
TWO = ROWS.replace(",", ";")
H = "x,y,z,i,j,k"
BAD = {
    "two delimiters": ("x,y,z;i,j,k\n" + ROWS, "line 1", "one delimiter"),
    "no header": ("# some\n\n" + ROWS, "line 3 is '0,0,0,0,0,1'", "the header x,y,z,i,j,k; write it as the first line"),
    "a comment that is no header": ("# from a mill\n" + ROWS, "line 2", "the header x,y,z,i,j,k"),
    "nothing but comments": ("# some\n", "line 2", "the header x,y,z,i,j,k"),
    "a column twice": ("x,y,z,i,j,k,X\n" + ROWS, "line 1 column 7 is 'x'", "has x already; remove one"),
    "an axis twice": ("x,y,z,i,j,k,nx\n" + ROWS, "line 1 column 7 is 'nx'", "has i already"),
    "two numbers": ("n,x,y,z,i,j,k,id\n" + ROWS, "line 1 column 8 is 'id'", "has n already"),
    "a column missing": ("x,y,z,i,j\n" + ROWS, "line 1 is 'x,y,z,i,j'", "k is missing"),
    "angles": ("x,y,z,a,b\n" + ROWS, "line 1 column 4 is 'a'", "rotary angles are to be written as tool axes"),
    "two kinds of axis": ("x,y,z,i,ny,k\n" + ROWS, "line 1 is 'i,ny,k'", "names of one kind"),
    "two kinds of point": ("px,y,z,i,j,k\n" + ROWS, "line 1 is 'px,y,z'", "names of one kind"),
    "an unknown column": ("x,y,z,i,j,k,t\n" + ROWS, "line 1 column 7 is 't'", "a feed or a running number"),
    "a column without a name": (H + ",\n" + ROWS, "line 1 column 7 is ''", "name it"),
    "half a quote": ('"x,y,z,i,j,k\n' + ROWS, "line 1 column 1", "header"),
    "centimetres": ("x [cm],y [cm],z [cm],i,j,k\n" + ROWS, "line 1 column x [cm] is 'cm'", "mm, m, in or inch"),
    "a unit of an axis": ("x,y,z,i [mm],j,k\n" + ROWS, "line 1 column i [mm] is 'mm'", "none"),
    "two units": ("x [mm],y [in],z [mm],i,j,k\n" + ROWS, "line 1 column y [in] is in", "mm, as x [mm] is"),
    "a unit of one only": ("x [in],y,z [in],i,j,k\n" + ROWS, "line 1 column y is without a unit", "in, as x [in] is"),
    "units that differ": ("x [in],y,z,i,j,k\nmm,mm,mm,,,\n" + ROWS, "line 2 column x [in] is 'mm'", "in, as the header"),
    "a line of feet": (H + "\nft,ft,ft,,,\n" + ROWS, "column x is 'ft'", "mm, m, in or inch"),
    "a feed without a unit": (H + ",f\n" + ROWS, "line 1 column f is without a unit", "feed [mm/s]"),
    "a feed in inches": (H + ",f [in/min]\n" + ROWS, "line 1 column f [in/min] is 'in/min'", "mm/s or mm/min"),
    "no feed": (H + ",f_mm_s\n0,0,0,0,0,1,5\n1,0,0,0,0,1,0\n", "line 3 column f_mm_s is 0 mm/s", "0.001 to 10000 mm/s"),
    "a feed beyond": (H + ",f_mm_s\n0,0,0,0,0,1,5\n1,0,0,0,0,1,1e5\n", "line 3 column f_mm_s is 100000 mm/s", "0.001 to 10000"),
    "a line left out": ("n," + H + "\n1,0,0,0,0,0,1\n2,1,0,0,0,0,1\n4,2,0,0,0,0,1\n", "line 4 column n is 4", "growing by the same"),
    "lines in another order": ("n," + H + "\n2,0,0,0,0,0,1\n1,1,0,0,0,0,1\n", "line 3 column n is 1", "lines are missing"),
    "a number that is no counter": ("n," + H + "\n1.5,0,0,0,0,0,1\n2.5,1,0,0,0,0,1\n", "line 2 column n is 1.5", "whole"),
    "endless numbers": ("n," + H + "\n1e999,0,0,0,0,0,1\n1e999,1,0,0,0,0,1\n", "line 2 column n is inf", "whole"),
    "a comment below": ("x;y;z;i;j;k\n" + TWO + "# end\n", "line 4 is 1 fields", "six numbers"),
    "a blank line below": ("x;y;z;i;j;k\n" + TWO + "\n", "line 4 is empty", "six numbers"),
    "a comment like a delimiter": ("; one\nx;y;z;i;j;k\n" + TWO, "line 1 is '; one'", "begin it with #"),
    "a separator that is none": ("sep=,\nx;y;z;i;j;k\n" + TWO, "line 1 is 'sep=,'", "sep=;"),
    "point and comma": ("x;y;z;i;j;k\n0;0;0;0;0;1\n0,5;2;3;0.6;0;0,8\n", "line 3 column i is '0.6'", "decimal comma"),
    "comma and point": ("x;y;z;i;j;k\n0.5;0;0;0;0;1\n1;2;3;0,6;0;0.8\n", "line 3 column i is '0,6'", "decimal point, as those"),
    "point, comma, tabs": ("x\ty\tz\ti\tj\tk\n0.5\t0\t0\t0\t0\t1\n1\t2\t3\t0,6\t0\t0.8\n", "line 3 column i is '0,6'", "write decimal points"),
    "thousands": ("x;y;z;i;j;k\n0;0;0;0;0;1\n1.234,5;2;3;0;0;1\n", "line 3 column x is '1.234,5'", "between thousands"),
    "perhaps thousands": ("x;y;z;i;j;k\n0;0;0;0;0;1\n0;1,234;3;0;0;1\n", "line 3 column y is '1,234'", "only be a decimal one"),
    "decimal commas between commas": (H + "\n0,0,0,0,0,1\n1,5,2,5,3,5,0,0,1\n", "line 3 is 9 fields", "by semicolons"),
    "decimal commas in quotes": (H + '\n"0","0","0","0","0","1"\n"1,5","0","0","0","0","1"\n', "line 3 is 7 fields", "by semicolons"),
    "commas between spaces": ("x y z i j k\n0 0 0 0 0 1\n1,5 0 0 0 0 1\n", "line 3 column x is '1,5'", "write decimal points"),
    "spaces that do not break": ("x y z i j k\n0\u00a00 0 0 0 1\n", "line 2 is 5 fields", "six numbers"),
    "some quotes": (H + '\n0,0,0,0,0,1\n1,2,3,0,0,"1"\n', "line 3 column k is '\"1\"'", "without quotes"),
    "quotes that stop": (H + '\n"0",0,0,0,0,1\n1,2,3,0,0,1\n', "line 3 column x is '1'", "in quotes, as in line 2"),
    "text in quotes": (H + '\n"0",0,0,0,0,1\n"a",2,3,0,0,1\n', "line 3 column x is '\"a\"'", "finite decimal"),
    "not a number": ("x;y;z;i;j;k\n" + TWO + "1;nan;3;0;0;1\n", "line 4 column y is 'nan'", "finite decimal"),
    "seven columns": (H + ",n\n0,0,0,0,0,1\n", "line 2 is 6 fields", "7 numbers x,y,z,i,j,k,n"),
    "inches beyond": ("x_in,y_in,z_in,i,j,k\n0,0,0,0,0,1\n500,0,0,0,0,1\n", "line 3", "within +-10000"),
    "one pose": ("x;y;z;i;j;k\n0;0;0;0;0;1\n", "poses is 1 poses", ">= 2"),
    "no pose": ("X;y;z;i;j;k\n", "poses is 0 poses", ">= 2"),
    "a running number of one pose": ("n,x,y,z,i,j,k\n1,0,0,0,0,0,1\n", "poses is 1 poses", ">= 2"),
    "comments without end": ("#\n" * 200 + H + "\n" + ROWS, "line 101", "within the first 100 lines"),
    "an endless header": (H + " " * 1000 + ";\n" + ROWS, "line 1", "the header"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "place", "words"), BAD.values(), ids=BAD)
def test_what_could_mean_two_things_is_refused_with_its_place(text, place, words):
    message = refusal(text)
    assert message.startswith("f.csv: ")
    assert "\n" not in message
    assert place in message
    assert words in message


@pytest.mark.parametrize(
    "cell", ["0,123", ",123", "-,5", "1234,567", "1,5", "12,34", "1,2345", "1,", "-012,345"]
)
def test_one_comma_that_parts_no_thousands_shows_what_all_commas_are(cell):
    text = f"x;y;z;i;j;k\n1,234;0;0;0;0;1\n{cell};0;0;0;0;1\n"
    assert read(text)[0].tips_mm[:, 0].tolist() == [1.234, float(cell.replace(",", "."))]


@pytest.mark.parametrize("cell", ["1,234", "-12,345", "+123,456", "123,456"])
def test_where_every_comma_may_part_thousands_none_is_read(cell):
    assert "line 2 column x is '1,234'" in refusal(f"x;y;z;i;j;k\n1,234;0;0;0;0;1\n{cell};0;0;0;0;1\n")


def test_escapes_of_a_header_reach_nobody():
    assert "\x1b" not in refusal("x,y,z,i,j,k,\x1b[2J\n" + ROWS)


@pytest.mark.parametrize("head", ["", "# a\n", "// a\n\n", "\ufeff", "\ufeff# b\n", "sep=,\n", "#\n" * 100])
@pytest.mark.parametrize("units", ["", "mm,mm,mm,,,\n", "IN,IN,IN,,,\n"])
@pytest.mark.parametrize("end", ["", "\n"])
def test_lines_beside_the_poses_do_not_count_as_poses(head, units, end):
    text = f"{head}{H}\n{units}{ROWS}0,0,0,0,0,1{end}"
    assert len(read(text, 3)[0].tips_mm) == 3
    assert "poses is " in refusal(text, 2)
    assert "must be <= 2 poses; raise pose_limit" in refusal(text, 2)


def test_a_header_in_a_comment_is_not_a_pose():
    text = f"# {H}\n{ROWS}"
    assert len(read(text, 2)[0].tips_mm) == 2
    assert "2 poses, must be <= 1 poses" in refusal(text, 1)


@given(
    st.text(alphabet='xyzijknf,;\t "[]()#/_.0123456789-mni\r\n', max_size=80),
    st.sampled_from(["", "x,y,z,i,j,k\n", "x;y;z;i;j;k\n", "X\tY\tZ\tI\tJ\tK\n", "x y z i j k\n"]),
)
def test_any_text_is_read_or_refused(text, head):
    error = None
    try:
        cut = read(head + text)[0]
    except InputError as refused:
        error = refused
    assert error is None or str(error).startswith("f.csv")
    assert error is not None or (np.isfinite(cut.tips_mm).all() and len(cut.tips_mm) >= 2)
