"""What is no rigid registration is refused with its kind, amount and place; hostile files in bounded time."""

import sys
import zlib

import h5py
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 - as its manual does
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.load import SETTINGS_LIMIT, InputError
from cutgate.runtime.plan.load import load_registration
from cutgate.runtime.plan.registrations.foreign import FOREIGN_EXTENSIONS
from tests.runtime.plan.registrations.itk_files import (
    ALL,
    affine,
    euler,
    rotation,
    similarity,
    versor,
    written,
)

HEADER = "#Insight Transform File V1.0\n#Transform 0\n"
IDENTITY = (
    "Transform: AffineTransform_double_3_3\nParameters: 1 0 0 0 1 0 0 0 1 1 2 3\nFixedParameters: 0 0 0\n"
)


def refusal(folder, name, content):
    file = folder / name
    if content is not None:
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        load_registration(file, ALL)
    return str(caught.value)


def linear(matrix):
    made = sitk.AffineTransform(3)
    made.SetMatrix(np.asarray(matrix, dtype=float).ravel().tolist())
    return made


def spline():
    return sitk.BSplineTransform(3, 1)


def field():
    return sitk.DisplacementFieldTransform(sitk.Image([2, 2, 2], sitk.sitkVectorFloat64))


TURN = rotation(0.2, 0.4, -0.3)
NOT_RIGID = {
    "scaled": (lambda: similarity(1.02), "line 3 is a scale of 1.02, must be rigid", "without scale"),
    "in metres": (lambda: linear(0.001 * TURN), "a scale of 0.001", "units must be mm on both sides"),
    "from metres": (lambda: linear(1000.0 * TURN), "a scale of 1000", "units must be mm on both sides"),
    "scaled along axes": (lambda: linear(TURN @ np.diag([1, 1.1, 1])), "scales of 1, 1.1, 1 along x, y, z", "scale"),
    "sheared": (lambda: linear(TURN @ [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]), "a shear that stretches by 0.951", "shear"),
    "mirrored": (lambda: linear(TURN @ np.diag([1, 1, -1])), "a mirror image (determinant -1)", "reversed alone"),
    "mirrored and scaled": (lambda: linear(-2.0 * TURN), "a mirror image (determinant -8)", "reversed alone"),
    "nothing": (lambda: linear(np.zeros((3, 3))), "a scale of 0", "rigid"),
    "a little off": (lambda: linear(TURN * (1 + 1e-6)), "a scale of 1.000001", "rigid"),
    "rounded": (lambda: linear(TURN.round(4)), "a shear that stretches", "its rotation has 4 decimals, which is too few"),
    "far away": (lambda: sitk.TranslationTransform(3, (0, 0, 100_001.0)), "translation [0.0, 0.0, 100001.0]", "mm"),
    "B-spline": (spline, "a B-spline, which bends the bone (BSplineTransform)", "rigid"),
    "displacement field": (field, "a displacement field, which bends the bone", "rigid"),
    "scale versor": (sitk.ScaleVersor3DTransform, "a scale along each axis", "rigid"),
    "scale skew": (sitk.ScaleSkewVersor3DTransform, "a scale and a shear", "rigid"),
    "scale transform": (lambda: sitk.ScaleTransform(3, (1, 1, 2)), "a scale (ScaleTransform", "rigid"),
    "composite of a scale": (
        lambda: sitk.CompositeTransform([affine(), similarity(0.5), similarity(2.0)]), "a scale of 0.5", "without scale",
    ),
    "2-D": (lambda: sitk.AffineTransform(2), "AffineTransform_double_2_2", "of three dimensions"),
    "a versor alone": (sitk.VersorTransform, "VersorTransform_double_3_3", "one of AffineTransform"),
}  # fmt: skip


@pytest.mark.parametrize("kind", NOT_RIGID)
@pytest.mark.parametrize("extension", [".tfm", ".h5"])
def test_what_another_program_wrote_and_is_not_rigid_is_refused_with_kind_and_amount(
    tmp_path, kind, extension
):
    make, found, remedy = NOT_RIGID[kind]
    said = refusal(tmp_path, written(tmp_path, make(), extension).name, None)
    assert found.removeprefix("line 3 is ") in said
    assert remedy in said
    assert ("line " in said) is (extension == ".tfm")


def test_a_rotation_that_is_rigid_to_1e_6_is_taken_as_it_is_written(tmp_path):
    matrix = TURN.round(7)
    found = load_registration(written(tmp_path, linear(matrix), ".tfm"), ALL)
    np.testing.assert_array_equal(found.value.matrix[:3, :3], matrix)


BAD_TEXTS = {
    "empty": ("", "line 1 is '', must be '#Insight Transform File V1.0'"),
    "another header": ("#Insight Transform File V2.0\n" + IDENTITY, "line 1"),
    "no transform": (HEADER, "it holds no transform"),
    "no parameters": (HEADER + IDENTITY.split("Fixed", maxsplit=1)[0], "line 3 is a AffineTransform without FixedParameters"),
    "no fixed ones": (HEADER + IDENTITY.replace("Parameters: 1", "#"), "without Parameters"),
    "eleven": (HEADER + IDENTITY.replace(" 3\n", "\n"), "line 3 is 11 parameters, must be 12 parameters for Affine"),
    "two fixed": (HEADER + IDENTITY.replace("0 0 0\n", "0 0\n", 1), "2 fixed parameters, must be 3 fixed parameters"),
    "NaN": (HEADER + IDENTITY.replace("1 2 3", "nan 2 3"), "line 4 number 10 is 'nan', must be a finite decimal number"),
    "inf": (HEADER + IDENTITY.replace("1 2 3", "1 -inf 3"), "line 4 number 11 is '-inf'"),
    "too large": (HEADER + IDENTITY.replace("1 2 3", "1 1e999 3"), "line 4 number 11 is '1e999'"),
    "digits": (HEADER + IDENTITY.replace("1 2 3", f"1 2.{'3' * 70} 3"), "line 4 number 11 is 72 characters"),
    "underscore": (HEADER + IDENTITY.replace("1 2 3", "1_0 2 3"), "'1_0'"),
    "comma": (HEADER + IDENTITY.replace("1 2 3", "1,2 2 3"), "'1,2'"),
    "other digits": (HEADER + IDENTITY.replace("1 2 3", "\u0661 2 3"), "line 4 number 10"),
    "many": (HEADER + IDENTITY.replace("1 2 3", "1 " * 20_000), "line 4 is more than 100 numbers"),
    "twice": (HEADER + IDENTITY + "Parameters: 1\n", "line 6 is Parameters a second time"),
    "another line": (HEADER + IDENTITY + "Origin: 1\n", "line 6 is 'Origin: 1', must be Transform:, Parameters:"),
    "no colon": (HEADER + IDENTITY + "end\n", "line 6 is 'end'"),
    "numbers first": (HEADER + "Parameters: 1\n", "line 3 is Parameters before any Transform"),
    "two transforms": (HEADER + IDENTITY + IDENTITY, "line 6 is a second transform (AffineTransform), must be one transform"),
    "an empty composite": (HEADER + "Transform: CompositeTransform_double_3_3\n", "an empty composite"),
    "a composite with numbers": (
        HEADER + "Transform: CompositeTransform_double_3_3\nParameters: 1\n" + IDENTITY, "a composite with parameters",
    ),
    "a composite within": (
        HEADER + 2 * "Transform: CompositeTransform_double_3_3\n" + IDENTITY, "line 4 is a composite within a composite",
    ),
    "too many transforms": (
        HEADER + "Transform: CompositeTransform_double_3_3\n" + 101 * IDENTITY, "must be at most 100 transforms",
    ),
    "no type": (HEADER + IDENTITY.replace("AffineTransform_double_3_3", ""), "must be a type of ITK"),
    "a long type": (HEADER + IDENTITY.replace("Affine", "A" * 50_000), "must be a type of ITK"),
    "an escape": (HEADER + IDENTITY.replace("Affine", "\x1b[2J"), "must be a type of ITK"),
    "versor": (
        HEADER + "Transform: VersorRigid3DTransform_double_3_3\nParameters: 1 1 0 0 0 0\nFixedParameters: 0 0 0\n",
        "a versor of length 1.41421, must be at most 1",
    ),
    "degrees": (
        HEADER + "Transform: Euler3DTransform_double_3_3\nParameters: 90 0 0 0 0 0\nFixedParameters: 0 0 0\n",
        "must be radians, within a revolution",
    ),
    "order": (
        HEADER + "Transform: Euler3DTransform_double_3_3\nParameters: 0 0 0 0 0 0\nFixedParameters: 0 0 0 2\n",
        "an order 2, must be 0 (Rz Rx Ry) or 1 (Rz Ry Rx)",
    ),
    "centre": (HEADER + IDENTITY.replace("0 0 0\n", "0 1e6 0\n", 1), "centre [0.0, 1000000.0, 0.0]"),
    "an entry": (HEADER + IDENTITY.replace("s: 1 0", "s: 1e200 0"), "an entry of 1e+200"),
    "UTF-16": ((HEADER + IDENTITY).encode("utf-16"), "a byte-order mark of UTF-16"),
    "bytes": (b"\x00\xff" * 100, "UTF-8 text"),
    "huge": (b" " * (SETTINGS_LIMIT + 1), f"size is {SETTINGS_LIMIT + 1} bytes"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_TEXTS)
def test_a_text_that_is_no_transform_is_refused_naming_the_line(tmp_path, case):
    content, said = BAD_TEXTS[case]
    found = refusal(tmp_path, "r.tfm", content)
    assert said in found
    assert "\x1b" not in found
    assert len(found) < 1000


ROWS = "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n"
BAD_MATRICES = {
    "empty": ("", "0 rows, must be four lines of four numbers"),
    "three rows": (ROWS[:-8], "3 rows"),
    "five rows": (ROWS + "0 0 0 1\n", "5 rows"),
    "one line": (ROWS.replace("\n", " "), "line 1 is 16 numbers, must be four numbers"),
    "three numbers": (ROWS.replace(" 6", ""), "line 2 is 3 numbers"),
    "column by column": ("1 0 0 0\n0 1 0 0\n0 0 1 0\n5 6 7 1\n", "line 4 is [5.0, 6.0, 7.0, 1.0], must be 0 0 0 1; write"),
    "brackets": ("[" + ROWS, "line 1 number 1 is '[1'"),
    "two commas": (ROWS.replace("0 6", "0,,6"), "line 2 is 5 numbers"),
    "a comment": ("# mm\n" + ROWS, "line 1 is 2 numbers"),
    "NaN": (ROWS.replace("5", "NaN"), "line 1 number 4 is 'NaN'"),
    "digits": (ROWS.replace("5", "5" * 61), "line 1 number 4 is 61 characters"),
    "a long line": (ROWS.replace("5", "5" * 90_000), "line 1 is 90006 characters"),
    "many lines": ("\n" * 90_000, "90000 lines"),
    "scaled": (ROWS.replace("1", "2").replace("0 0 0 2", "0 0 0 1"), "matrix is a scale of 2"),
    "far": (ROWS.replace("5", "100001"), "translated by [100001.0, 6.0, 7.0], must be at most 100000 mm"),
    "mirrored": (ROWS.replace("1 0 0 5", "-1 0 0 5"), "a mirror image (determinant -1)"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_MATRICES)
@pytest.mark.parametrize("name", ["r.txt", "r.mat"])
def test_a_text_that_is_no_rigid_matrix_is_refused_naming_the_line(tmp_path, case, name):
    content, said = BAD_MATRICES[case]
    found = refusal(tmp_path, name, content)
    assert said in found
    assert len(found) < 1000


# ---------------------------------------------------------------- HDF5


def altered(folder, change):
    file = written(folder, euler(), ".h5")
    with h5py.File(file, "r+") as opened:
        change(opened, opened["TransformGroup/0"])
    return refusal(folder, file.name, None)


def put(name, value, **options):
    def change(_opened, group):
        del group[name]
        group.create_dataset(name, data=value, **options)

    return change


def virtual(_opened, group):
    del group["TransformParameters"]
    layout = h5py.VirtualLayout(shape=(6,), dtype="f8")
    layout[:] = h5py.VirtualSource("/etc/passwd", "d", shape=(6,))
    group.create_virtual_dataset("TransformParameters", layout)


def external(_opened, group):
    del group["TransformParameters"]
    group.create_dataset("TransformParameters", (6,), "f8", external=[("/etc/passwd", 0, 48)])


def linked(opened, _group):
    del opened["TransformGroup"]
    opened["TransformGroup"] = h5py.ExternalLink("other.h5", "/TransformGroup")


def soft(opened, _group):
    opened.move("TransformGroup", "elsewhere")
    opened["TransformGroup"] = h5py.SoftLink("/elsewhere")


def renamed(opened, _group):
    opened.move("TransformGroup/0", "TransformGroup/7")


def crowded(opened, _group):
    for number in range(1, 103):
        opened.create_group(f"TransformGroup/{number}")


def misspelt(_opened, group):
    group["TranformParameters"] = group["TransformParameters"]


def long_type(_opened, group):
    del group["TransformType"]
    group.create_dataset("TransformType", (1,), "S500000000")  # never written: it takes no room in the file


def long_chunk(_opened, group):
    del group["TransformParameters"]
    group.create_dataset("TransformParameters", (6,), "f8", maxshape=(None,), chunks=(2**25,))


def long_stream(_opened, group):
    """A chunk of six numbers whose deflate stream goes on and on: the library inflates all of it."""
    del group["TransformParameters"]
    numbers = group.create_dataset("TransformParameters", (6,), "f8", chunks=(6,), compression="gzip")
    numbers.id.write_direct_chunk((0,), zlib.compress(bytes(2**23), 9))


P, F, T = "TransformParameters", "TransformFixedParameters", "TransformType"
BAD_HDF5 = {
    "no group": (lambda opened, _: opened.pop("TransformGroup"), "TransformGroup is missing"),
    "empty": (lambda opened, _: opened["TransformGroup"].pop("0"), "TransformGroup is 0 members"),
    "renamed": (renamed, "TransformGroup is 7, must be named 0 to 0"),
    "crowded": (crowded, "103 members, must be 1 to 100 transforms"),
    "no type": (lambda _, group: group.pop(T), "TransformGroup/0/TransformType is missing"),
    "no numbers": (lambda _, group: group.pop(P), "TransformGroup/0/TransformParameters is missing"),
    "no fixed": (lambda _, group: group.pop(F), "TransformGroup/0/TransformFixedParameters is missing"),
    "two spellings": (misspelt, "TransformParameters and TranformParameters"),
    "few": (put(P, np.zeros(5)), "5 parameters, must be 6 parameters for Euler3DTransform"),
    "many": (put(P, np.zeros(101)), "of shape (101,), must be a list of at most 100 values"),
    "a bomb": (put(P, np.zeros(2**22), compression="gzip", chunks=(2**22,)), "of shape (4194304,)"),
    "a type of 500 MB": (long_type, "values or chunks of 500000000 bytes, must be <= 1048576 bytes"),
    "a chunk of 268 MB": (long_chunk, "values or chunks of 268435456 bytes"),
    "a long stream": (long_stream, "bytes in the file, must be <= 4096 bytes"),
    "other filters": (put(P, np.zeros(6), compression="gzip", shuffle=True), "plain, or deflated once"),
    "a table": (put(P, np.zeros((2, 3))), "of shape (2, 3)"),
    "NaN": (put(P, [np.nan] * 6), "finite numbers"),
    "integers": (put(P, np.zeros(6, "i8")), "of type int64, must be numbers of 4 or 8 bytes"),
    "texts": (put(P, "1 2 3 4 5 6"), "must be numbers of 4 or 8 bytes"),
    "a number as type": (put(T, [1.0]), "1 values of type float64, must be one text"),
    "another type": (put(T, ["\x1b[2JTransform"]), "must be a type of ITK"),
    "more than a transform": (
        lambda _, group: group.create_dataset("Extra", data=1), "is Extra, must be TransformType, TransformParameters and",
    ),
    "external link": (linked, "TransformGroup is a link, must be there, in the file itself"),
    "soft link": (soft, "TransformGroup is a link"),
    "external data": (external, "data of another file"),
    "virtual data": (virtual, "data of another file"),
    "a dataset as group": (
        lambda opened, _: (opened.pop("TransformGroup"), opened.create_dataset("TransformGroup", data=1)), "must be a group",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_HDF5)
def test_hdf5_that_itk_did_not_write_is_refused_naming_the_place(tmp_path, case):
    change, said = BAD_HDF5[case]
    found = altered(tmp_path, change)
    assert said in found
    assert "\x1b" not in found


def test_numbers_that_were_deflated_as_itk_does_it_are_read(tmp_path):
    file = written(tmp_path, euler(), ".h5")
    as_written = load_registration(file, ALL).value
    with h5py.File(file, "r+") as opened:
        group = opened["TransformGroup/0"]
        numbers = group[P][()]
        put(P, numbers, compression="gzip")(opened, group)
    assert load_registration(file, ALL).value == as_written


def test_the_misspelt_names_of_earlier_versions_are_read(tmp_path):
    file = written(tmp_path, euler(), ".h5")
    as_written = load_registration(file, ALL).value
    with h5py.File(file, "r+") as opened:
        group = opened["TransformGroup/0"]
        group.move(P, P.replace("Transform", "Tranform"))
        group.move(F, F.replace("Transform", "Tranform"))
    assert load_registration(file, ALL).value == as_written


def test_a_fixed_length_type_is_read(tmp_path):
    file = written(tmp_path, euler(), ".h5")
    as_written = load_registration(file, ALL).value
    with h5py.File(file, "r+") as opened:
        put(T, np.array(b"Euler3DTransform_double_3_3"))(opened, opened["TransformGroup/0"])
    assert load_registration(file, ALL).value == as_written


@given(cut=st.integers(0, 8300), at=st.integers(0, 8300), value=st.integers(0, 255))
def test_damaged_hdf5_is_refused_or_says_the_same_kind_of_thing(cut, at, value, tmp_path_factory):
    folder = tmp_path_factory.getbasetemp()
    file = folder / "whole.h5"
    if not file.exists():
        sitk.WriteTransform(versor(), str(file))
    data = bytearray(file.read_bytes())
    data[min(at, len(data) - 1)] = value
    for name, content in (("cut.h5", file.read_bytes()[:cut]), ("bytes.h5", bytes(data))):
        damaged = folder / name
        damaged.write_bytes(content)
        try:
            found = load_registration(damaged, ALL).value.matrix[:3, :3]
        except InputError:
            continue
        np.testing.assert_allclose(found.T @ found, np.eye(3), atol=2e-6)


def test_without_h5py_the_extra_is_named_and_other_formats_are_read(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    said = refusal(tmp_path, written(tmp_path, euler(), ".h5").name, None)
    assert "HDF5 is read by h5py, which is not installed; install it: pip install 'cutgate[h5]'" in said
    assert load_registration(written(tmp_path, euler(), ".tfm"), ALL)


@given(
    text=st.text(st.sampled_from("#:Transform Parameters 0123456789.eE+-,\t\r\n\x00\x1bnaif"), max_size=400),
    extension=st.sampled_from(FOREIGN_EXTENSIONS),
    begin=st.sampled_from(["", HEADER, HEADER + IDENTITY]),
)
def test_whatever_a_file_holds_it_is_read_or_refused_in_words(text, extension, begin, tmp_path_factory):
    file = tmp_path_factory.getbasetemp() / f"any{extension}"
    file.write_text(begin + text, encoding="utf-8", newline="")
    try:
        load_registration(file, ALL)
    except InputError as error:
        assert str(file) in str(error)  # noqa: PT017 - it may be read as well


@pytest.mark.parametrize("extension", [".tfm", ".txt", ".mat"])
def test_the_longest_texts_of_one_thing_are_refused_or_nothing_but_blanks(tmp_path, extension):
    for piece in ("1 ", "1", " ", ",", "\n", "0.", "1e", "Transform: ", "Parameters: 1\n", "\t, "):
        whole = (HEADER + IDENTITY if extension == ".tfm" else "") + piece * (90_000 // len(piece))
        if extension == ".tfm" and not piece.strip():
            (tmp_path / "r.tfm").write_text(whole)
            assert load_registration(tmp_path / "r.tfm", ALL).value.R_T_CT[0][3] == 1.0
        else:
            assert len(refusal(tmp_path, f"r{extension}", whole)) < 1000
