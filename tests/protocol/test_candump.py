"""Lines of a log of frames, as `candump -L` of can-utils prints them."""

import io

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol import candump


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({}, "(1.000002) can0 012#AB\n"),
        ({"is_extended": True}, "(1.000002) can0 00000012#AB\n"),
        ({"is_remote": True}, "(1.000002) can0 012#R\n"),
        ({"is_remote": True, "remote_length": 8}, "(1.000002) can0 012#R8\n"),
        ({"is_error": True}, "(1.000002) can0 20000012#AB\n"),
        ({"is_fd": True}, "(1.000002) can0 012##4AB\n"),
        ({"is_fd": True, "bit_rate_switch": True}, "(1.000002) can0 012##5AB\n"),
        ({"is_fd": True, "bit_rate_switch": True, "error_state": True}, "(1.000002) can0 012##7AB\n"),
    ],
    ids=str,
)
def test_a_line_has_the_form_of_candump(options, line):
    assert candump.line(1_000_002_999, "can0", 0x12, b"\xab", **options) == line


@given(
    can_id=st.integers(0, 0x7FF),
    extended=st.booleans(),
    kind=st.sampled_from(["data", "remote", "fd"]),
    data=st.binary(max_size=8),
    time_ns=st.integers(0, 4_000_000_000_000_000_000),
)
def test_another_reader_finds_the_frame_again(can_id, extended, kind, data, time_ns):
    text = candump.line(
        time_ns,
        "vcan0",
        can_id,
        data,
        is_extended=extended,
        is_remote=kind == "remote",
        is_fd=kind == "fd",
    )
    (read,) = can.CanutilsLogReader(io.StringIO(text))
    assert (read.arbitration_id, read.is_extended_id, read.channel) == (can_id, extended, "vcan0")
    assert (read.is_remote_frame, read.is_fd) == (kind == "remote", kind == "fd")
    assert kind == "remote" or bytes(read.data) == data
    assert read.timestamp == pytest.approx(time_ns // 1000 / 1e6, rel=1e-9)


def test_another_reader_takes_an_error_for_no_data():
    bus_error = 0x80  # the one class that python-can's reader knows
    (read,) = can.CanutilsLogReader(io.StringIO(candump.line(0, "vcan0", bus_error, bytes(8), is_error=True)))
    assert read.is_error_frame


# ---------------------------------------------------------------- read again

names = st.text(st.characters(codec="ascii", exclude_categories=("C", "Z")), min_size=1, max_size=20)


@st.composite
def frames(draw):
    """Any frame that a bus carries, at a whole microsecond."""
    kind = draw(st.sampled_from(["classic", "fd", "remote", "error"]))
    is_extended = kind != "error" and draw(st.booleans())
    most = candump.EXTENDED_MAX if is_extended or kind == "error" else candump.STANDARD_MAX
    length = draw(st.sampled_from(candump.FD_LENGTHS) if kind == "fd" else st.integers(0, 8))
    return candump.RawFrame(
        draw(st.integers(0, 9_999_999_999_999_999)) * 1000,
        draw(names),
        draw(st.integers(0, most)),
        b"" if kind == "remote" else draw(st.binary(min_size=length, max_size=length)),
        is_extended=is_extended,
        is_remote=kind == "remote",
        is_error=kind == "error",
        is_fd=kind == "fd",
        bit_rate_switch=kind == "fd" and draw(st.booleans()),
        error_state=kind == "fd" and draw(st.booleans()),
        remote_length=length if kind == "remote" else 0,
    )


@given(frames())
def test_what_is_written_is_read_as_the_same_frame(frame):
    assert candump.parse(frame.line) == frame


@given(frames())
def test_python_can_reads_the_same(frame):
    (read,) = can.CanutilsLogReader(io.StringIO(frame.line))
    if frame.is_error and not frame.can_id & 0x80:
        return  # python-can knows no other class of errors
    if frame.is_error:
        assert read.is_error_frame
        return
    assert (read.arbitration_id, bytes(read.data), read.is_extended_id) == (
        frame.can_id, frame.data, frame.is_extended
    )  # fmt: skip
    assert (read.is_remote_frame, read.is_fd) == (frame.is_remote, frame.is_fd)
    assert (read.bitrate_switch, read.error_state_indicator) == (frame.bit_rate_switch, frame.error_state)
    assert read.timestamp == pytest.approx(frame.time_ns / 1e9, abs=2e-6)


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        ("(1.5) can0 7ff#", candump.RawFrame(1_500_000_000, "can0", 0x7FF)),
        ("(1.123456789) can0 123#aB", candump.RawFrame(1_123_456_789, "can0", 0x123, b"\xab")),
        ("(1.0)  can0\t123#AB  \r\n", candump.RawFrame(1_000_000_000, "can0", 0x123, b"\xab")),
        ("(1.0) can0 123#AB R", candump.RawFrame(1_000_000_000, "can0", 0x123, b"\xab")),
        ("(1.0) can0 123#0011223344556677_F T", candump.RawFrame(1_000_000_000, "can0", 0x123, bytes.fromhex("0011223344556677"))),
        ("(1.0) can0 123#R", candump.RawFrame(1_000_000_000, "can0", 0x123, is_remote=True)),
        ("(1.0) can0 123##1", candump.RawFrame(1_000_000_000, "can0", 0x123, is_fd=True, bit_rate_switch=True)),
        ("(1.0) can0 20000004#00", candump.RawFrame(1_000_000_000, "can0", 4, b"\0", is_error=True)),
    ],
)  # fmt: skip
def test_lines_of_other_options_are_read(text, frame):
    assert candump.parse(text) == frame


@pytest.mark.parametrize(
    "text",
    [
        "", "#", "(1.0) can0 123", "1.0 can0 123#", "(1) can0 123#", "(1.0) 123#", "(1.0) can0 123#A", "(1.0) can0 123#AG",
        "(1.0) can0 1234#", "(1.0) can0 800#", "(1.0) can0 40000000#", "(1.0) can0 FFFFFFFF#", "(1.0) can0 123#R9",
        "(1.0) can0 123#001122334455667788", "(1.0) can0 123##0" + "00" * 9, "(1.0) can0 123##0" + "00" * 65,
        "(-1.0) can0 123#", "(1.0000000001) can0 123#", "(99999999999.0) can0 123#", "(1.0) can0 123#AB X",
        "(1.0) can0 123#AB\n(1.0) can0 123#AB", "(\u0661.0) can0 123#", "  vcan0  123   [1]  AB", "(1.0) " + "i" * 65 + " 123#",
    ],
)  # fmt: skip
def test_what_is_no_line_is_refused(text):
    with pytest.raises(candump.CandumpError):
        candump.parse(text)


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(text):
    try:
        frame = candump.parse(text)
    except candump.CandumpError:
        return
    assert candump.parse(frame.line).data == frame.data
