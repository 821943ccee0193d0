"""Registrations that SimpleITK wrote map points as SimpleITK does; frame and direction are as they are declared."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cutgate.config.load import InputError
from cutgate.config.model import Site
from cutgate.runtime.plan.load import load_placed, load_registration, registration_from_bytes
from cutgate.runtime.plan.registration import checked
from cutgate.runtime.plan.registrations.declared import NOTHING, Declared
from cutgate.runtime.plan.registrations.foreign import Converted
from tests.runtime.plan.registrations.itk_files import (
    ALL,
    CT_TO_ROBOT,
    LPS,
    MADE,
    RAS,
    ROBOT_TO_CT,
    TAKEN_AT,
    affine,
    versor,
    written,
)

POINTS = np.random.default_rng(20).uniform(-300.0, 300.0, (12, 3))
FLIP = np.array([-1.0, -1.0, 1.0])
both = pytest.mark.parametrize("extension", [".tfm", ".txt", ".h5"])


def mapped(registration, points):
    matrix = registration.value.matrix
    return points @ matrix[:3, :3].T + matrix[:3, 3]


@both
@pytest.mark.parametrize("kind", MADE)
def test_points_are_mapped_as_the_program_maps_them_that_wrote_the_file(tmp_path, kind, extension):
    transform = MADE[kind]()
    found = load_registration(written(tmp_path, transform, extension), ALL)
    expected = [transform.TransformPoint(point) for point in POINTS.tolist()]
    np.testing.assert_allclose(mapped(found, POINTS), expected, rtol=0.0, atol=1e-9)


@both
def test_a_transform_from_robot_to_ct_is_inverted(tmp_path, extension):
    transform = versor()
    found = load_registration(written(tmp_path, transform, extension), replace(ALL, direction=ROBOT_TO_CT))
    robot = [transform.GetInverse().TransformPoint(point) for point in POINTS.tolist()]
    np.testing.assert_allclose(mapped(found, POINTS), robot, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("direction", [CT_TO_ROBOT, ROBOT_TO_CT])
def test_a_plan_in_ras_is_reversed_on_the_side_of_the_ct_alone(tmp_path, direction):
    """What the file has in LPS is the same point of the bone; where the robot stands has nothing to do with it."""
    transform = versor()
    file = written(tmp_path, transform, ".tfm")
    lps = load_registration(file, replace(ALL, direction=direction))
    ras = load_registration(file, replace(ALL, direction=direction, frame=RAS))
    np.testing.assert_array_equal(mapped(ras, POINTS * FLIP), mapped(lps, POINTS))


def test_every_number_of_a_plain_matrix_survives(tmp_path):
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(affine().GetMatrix()).reshape(3, 3)
    matrix[:3, 3] = (0.1 + 0.2, -1.0 / 3.0, 5e-324)
    for name, separator in (("a.txt", " "), ("b.mat", ", "), ("c.txt", "\t"), ("d.TXT", ",")):
        file = tmp_path / name
        file.write_text("\n".join(separator.join(map(repr, row)) for row in matrix.tolist()))
        np.testing.assert_array_equal(load_registration(file, ALL).value.matrix, matrix)
    ras = load_registration(file, replace(ALL, frame=RAS)).value.matrix
    np.testing.assert_array_equal(ras, matrix @ np.diag([-1.0, -1.0, 1.0, 1.0]))


@pytest.mark.parametrize("begin", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_line_ends_and_the_mark_of_windows_change_nothing(tmp_path, begin, end):
    file = written(tmp_path, affine(), ".tfm")
    plain = load_registration(file, ALL)
    file.write_bytes(begin + file.read_bytes().replace(b"\n", end))
    assert load_registration(file, ALL).value == plain.value
    matrix = tmp_path / "m.txt"
    rows = [b" ".join(b"%r" % float(x) for x in row) for row in plain.value.R_T_CT]
    matrix.write_bytes(begin + end.join([*rows, b"", b""]))
    assert load_registration(matrix, ALL).value.R_T_CT == plain.value.R_T_CT


def test_what_is_loaded_is_the_json_that_was_made_of_it_and_the_source_is_kept(tmp_path):
    file = written(tmp_path, versor(), ".tfm")
    found = load_registration(file, ALL)
    assert isinstance(found, Converted)
    assert (found.source, found.declared, found.path) == (file.read_bytes(), ALL, file)
    assert json.loads(found.data) == {
        "schema": "cutgate.registration/1",
        "id": "from-itk",
        "R_T_CT": found.value.matrix.tolist(),
        "residual_rms_mm": 0.31,
        "created_utc": TAKEN_AT,
    }
    again = registration_from_bytes(file, found.data)
    assert again == found.value
    assert again.digest == found.value.digest
    assert str(ALL) == (
        f"--registration-frame lps --registration-direction ct-to-robot --taken-at {TAKEN_AT} "
        "--registration-residual-mm 0.31"
    )


# ---------------------------------------------------------------- what is declared


@pytest.mark.parametrize(
    ("field", "said"),
    [
        ("frame", "--registration-frame: is needed with"),
        ("direction", "--registration-direction: is needed with"),
        ("taken_at", "--taken-at: is needed with"),
        ("residual_mm", "--registration-residual-mm: is needed with"),
    ],
)
@both
def test_nothing_is_guessed_that_the_file_does_not_say(tmp_path, extension, field, said):
    file = written(tmp_path, versor(), extension)
    with pytest.raises(InputError) as caught:
        load_registration(file, replace(ALL, **{field: None}))
    assert len(caught.value.problems) == 1
    assert said in str(caught.value)
    with pytest.raises(InputError) as caught:
        load_registration(file)
    assert len(caught.value.problems) == 4


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"taken_at": "2026-03-01T08:30:00"}, "--taken-at is 2026-03-01T08:30:00, must be an ISO-8601 time in UTC; it names no"),
        ({"taken_at": "2026-03-01T09:30:00+01:00"}, "convert it, do not relabel it: write 2026-03-01T08:30:00Z"),
        ({"taken_at": "yesterday"}, "--taken-at is yesterday"),
        ({"taken_at": "2026-03-01T08:30:00.1234567Z"}, "must be at most six digits behind the second"),
        ({"residual_mm": 100.5}, "--registration-residual-mm is 100.5, must be 0 to 100 mm"),
        ({"residual_mm": -0.1}, "--registration-residual-mm is -0.1"),
        ({"residual_mm": float("nan")}, "--registration-residual-mm is nan"),
    ],
)  # fmt: skip
def test_what_is_declared_has_its_bounds(tmp_path, changes, said):
    file = written(tmp_path, versor(), ".tfm")
    with pytest.raises(InputError) as caught:
        load_registration(file, replace(ALL, **changes))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("declared", "option"),
    [
        (Declared(frame=LPS), "--registration-frame is lps"),
        (Declared(direction=CT_TO_ROBOT), "--registration-direction is ct-to-robot"),
        (Declared(taken_at=TAKEN_AT), f"--taken-at is {TAKEN_AT}"),
        (Declared(residual_mm=0.0), "--registration-residual-mm is 0.0"),
    ],
)
def test_what_a_json_says_itself_is_not_to_be_declared(declared, option):
    with pytest.raises(InputError) as caught:
        load_registration("registration-first", declared)
    assert f"{option}, must be left out: " in str(caught.value)
    assert "registration-first.json says it itself" in str(caught.value)
    with pytest.raises(InputError, match="no registration is given"):
        load_placed(None, declared)
    assert load_placed(None, NOTHING) is None
    assert load_placed("registration-first").value.id == "example-first"


# ---------------------------------------------------------------- mistakes that check points find


@pytest.mark.parametrize(
    ("changes", "shift_scale"),
    [({"direction": ROBOT_TO_CT}, 1.0), ({"frame": RAS}, 1.0), ({}, 1e-3)],
    ids=["direction", "frame", "metres"],
)
def test_a_wrong_declaration_and_metres_are_found_by_check_points(tmp_path, changes, shift_scale):
    transform = versor()
    landmarks = [(12.0, -31.0, 40.0), (-38.0, 5.0, 22.0), (8.0, 44.0, -12.0)]
    points = [
        {"id": str(n), "ct_mm": ct, "robot_mm": transform.TransformPoint(ct)}
        for n, ct in enumerate(landmarks)
    ]
    right = load_registration(written(tmp_path, transform, ".tfm"), ALL)
    transform.SetTranslation(tuple(shift_scale * x for x in transform.GetTranslation()))
    wrong = load_registration(written(tmp_path, transform, ".tfm"), replace(ALL, **changes))

    def outside(found):
        document = json.loads(found.data) | {"check_points": points}
        return checked(registration_from_bytes(found.path, json.dumps(document).encode()), Site()).outside

    assert outside(right) == ()
    assert len(outside(wrong)) == 3
