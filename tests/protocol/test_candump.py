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
