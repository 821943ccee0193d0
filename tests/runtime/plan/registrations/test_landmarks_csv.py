"""Landmarks as CSV: read as they stand, or refused with line and column."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import InputError
from cutgate.runtime.plan.registrations.landmarks_csv import Landmark, read_landmarks

FILE = Path("landmarks.csv")
HEADER = "id,ct_x,ct_y,ct_z,robot_x,robot_y,robot_z"
ROW = "P1,1,-2.5,3e1,4,5,6"

COORDINATE = st.floats(-100_000.0, 100_000.0)


@given(
    st.lists(
        st.tuples(
            st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=20),
            st.tuples(COORDINATE, COORDINATE, COORDINATE),
            st.tuples(COORDINATE, COORDINATE, COORDINATE),
            st.booleans(),
        ),
        max_size=8,
        unique_by=lambda one: one[0],
    ),
    st.sampled_from(["\n", "\r\n"]),
    st.sampled_from(["", "\ufeff"]),
)
def test_what_is_written_is_read_with_every_number(landmarks, end, begin):
    lines = [f"{HEADER},use"]
    for name, ct, robot, held_out in landmarks:
        quoted = '"' + name.replace('"', '""') + '"'
        lines.append(",".join((quoted, *map(repr, (*ct, *robot)), "check" if held_out else "fit")))
    data = (begin + end.join(lines) + end).encode()
    assert read_landmarks(FILE, data) == tuple(Landmark(*one) for one in landmarks)


def test_without_a_use_every_landmark_is_fitted():
    (found,) = read_landmarks(FILE, f"{HEADER}\n{ROW}".encode())
    assert found == Landmark("P1", (1.0, -2.5, 30.0), (4.0, 5.0, 6.0), held_out=False)
    (found,) = read_landmarks(FILE, f"{HEADER},use\n{ROW},\n".encode())
    assert not found.held_out
    (found,) = read_landmarks(FILE, f"{HEADER}, use\n{ROW.replace(',', ' , ')} , check \n".encode())
    assert found.held_out
    assert found.id == "P1"


BAD = [
    ("", "line 1 is '', must be the header id,ct_x"),
    ("x,y,z\n1,2,3", "line 1 is 'x,y,z'"),
    (f"{HEADER},weight\n{ROW},1", "line 1"),
    (f"{HEADER}\nP1,1,2,3,4,5", "line 2 is 6 fields, must be 7 fields"),
    (f"{HEADER}\n{ROW},fit", "line 2 is 8 fields, must be 7 fields"),
    (f"{HEADER},use\n{ROW}", "line 2 is 7 fields, must be 8 fields"),
    (f"{HEADER}\n{ROW}\n\nP2,1,2,3,4,5,6", "line 3 is empty"),
    (f"{HEADER}\n,1,2,3,4,5,6", "line 2 id is of 0 characters, must be 1 to 64 characters"),
    (f"{HEADER}\n{'P' * 65},1,2,3,4,5,6", "line 2 id is of 65 characters"),
    (f"{HEADER}\n{ROW}\n{ROW}", "line 3 id is 'P1', must be another name than line 2 has"),
    (f"{HEADER}\n{ROW.replace('4', 'nan')}", "line 2 number 4 is 'nan', must be a finite decimal number"),
    (f"{HEADER}\n{ROW.replace('4', '1e999')}", "line 2 number 4 is '1e999'"),
    (f"{HEADER}\n{ROW.replace('4', '4' * 70)}", "line 2 number 4 is 70 characters"),
    (f"{HEADER}\n{ROW.replace('4', '')}", "line 2 number 4 is ''"),
    (f"{HEADER}\n{ROW.replace('4', '0x4')}", "line 2 number 4 is '0x4'"),
    (f"{HEADER}\n{ROW.replace('4', '100000.1')}", "line 2 robot_x is 100000, must be within +-100000 mm"),
    (f"{HEADER},use\n{ROW},no", "line 2 use is 'no', must be fit, check, or nothing"),
    (f'{HEADER}\n"P1,1,2,3,4,5,6', "must be comma-separated values"),
    (f'{HEADER}\n"P1"x,1,2,3,4,5,6', "must be comma-separated values"),
    (HEADER + "\n" + "\n".join(f"P{n},1,2,3,4,5,6" for n in range(1001)), "1001 landmarks, must be <= 1000"),
    (f"{HEADER}\n{ROW}" + " " * 100_000, "size is"),
    (f"{HEADER}\n\x1b[2J,1,2,3,4,5,x", "line 2 number 6 is 'x'"),
]


@pytest.mark.parametrize(("text", "said"), BAD, ids=range(len(BAD)))
def test_anything_else_is_refused_with_its_line(text, said):
    with pytest.raises(InputError) as caught:
        read_landmarks(FILE, text.encode())
    assert said in str(caught.value)
    assert "\x1b" not in str(caught.value)


def test_a_name_over_two_lines_moves_the_lines_behind_it():
    with pytest.raises(InputError, match="line 4 number 6 is 'x'"):
        read_landmarks(FILE, f'{HEADER}\n"P\n1",1,2,3,4,5,6\nP2,1,2,3,4,5,x\n'.encode())


@given(st.text(st.sampled_from('id,ct_xyzrobuse"\r\n 0123456789.-+e\x00'), max_size=300))
def test_whatever_stands_there_it_is_read_or_refused_in_words(text):
    for data in (text, f"{HEADER}\n{text}", f"{HEADER},use\n{ROW},fit\n{text}"):
        try:
            read_landmarks(FILE, data.encode())
        except InputError as error:
            assert str(error).startswith("landmarks.csv: ")  # noqa: PT017 - it may be read as well
