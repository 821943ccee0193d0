"""Typed frames against the DBC."""

import math
from dataclasses import fields
from importlib.resources import files
from typing import get_type_hints

import cantools.database
import numpy as np
import pytest
from can.io.canutils import CanutilsLogReader
from hypothesis import given
from hypothesis import strategies as st

from cutgate.protocol import frames
from cutgate.protocol.frames import (
    BULK_IDS,
    CONTROL_IDS,
    DATA_IDS,
    DATABASE,
    FRAMES,
    IDS,
    JOINT_COUNT_MAX,
    ROTATION_DEG,
    SENT_BY,
    SLIDE_MM,
    ControllerFault,
    ControllerHeartbeat,
    Frame,
    FrameError,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    RuntimeHeartbeat,
    RuntimeStop,
    codes,
    decode_frame,
    encode_frame,
    joint_frames,
    joint_values,
    message_of,
)
from cutgate.protocol.link import Link
from cutgate.protocol.parameters import ROTATION_DEG_GOES, ROTATION_DEG_STANDS, SLIDE_MM_MAX
from cutgate.protocol.states import ControllerState, FaultCode, RuntimeCode, StopCause, StopCode
from cutgate.protocol.wire import Side
from tests.protocol.sessions import CODES

DBC = files("cutgate.protocol").joinpath("cutgate.dbc")


def bounds(kind: type[Frame], name: str) -> tuple[int, int]:
    signal = message_of(kind).get_signal_by_name(name)
    if signal.is_signed:
        return -(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1
    return 0, (1 << signal.length) - 1


def any_frame(kind: type[Frame]) -> st.SearchStrategy[Frame]:
    hints = get_type_hints(kind)
    values = {}
    for field in fields(kind):
        holds = hints[field.name]
        if holds is bool:
            values[field.name] = st.booleans()
        elif holds is int:
            values[field.name] = st.integers(*bounds(kind, field.name))
        else:
            values[field.name] = st.sampled_from(list(holds))
    return st.builds(kind, **values)


all_frames = st.one_of([any_frame(kind) for kind in FRAMES.values()])


@given(all_frames, st.integers(0, 255), st.integers(0, 0xFFFFFFFF))
def test_every_frame_round_trips(frame: Frame, counter: int, tag: int):
    can_id, data = encode_frame(frame, counter, tag)
    assert (can_id, len(data), data[2]) == (IDS[type(frame)], 8, counter)
    assert decode_frame(can_id, data) == frame


@given(all_frames)
def test_stock_cantools_reads_the_same_fields(frame: Frame):
    can_id, data = encode_frame(frame, 9, 1)
    seen = DATABASE.decode_message(can_id, data, decode_choices=False, scaling=False)
    assert isinstance(seen, dict)
    assert {name: int(value) for name, value in vars(frame).items()}.items() <= seen.items()
    assert seen["counter"] == 9


def test_identifiers_and_senders():
    assert {can_id: (kind.__name__, kind.SENDER.name) for can_id, kind in FRAMES.items()} == {
        0x010: ("ControllerFault", "CONTROLLER"),
        0x011: ("RuntimeStop", "RUNTIME"),
        0x080: ("RuntimeHeartbeat", "RUNTIME"),
        0x081: ("ControllerHeartbeat", "CONTROLLER"),
        0x300: ("Joints01", "CONTROLLER"),
        0x301: ("Joints23", "CONTROLLER"),
        0x302: ("Joint4", "CONTROLLER"),
        0x303: ("Progress", "CONTROLLER"),
    }
    assert SENT_BY[Side.RUNTIME] == {0x011, 0x080, 0x600, 0x640}
    assert SENT_BY[Side.CONTROLLER] == {0x010, 0x081, 0x300, 0x301, 0x302, 0x303, 0x601, 0x641}


def test_dbc_lists_exactly_the_frames_and_names_their_senders():
    assert {message.frame_id for message in DATABASE.messages} == set(FRAMES)
    for can_id, kind in FRAMES.items():
        message = DATABASE.get_message_by_frame_id(can_id)
        assert message.senders == [kind.SENDER.name.capitalize()]
        assert message.length == 8
        assert {signal.name for signal in message.signals} - {"reserved"} == {"crc", "counter"} | {
            field.name for field in fields(kind)
        }


def test_data_ids_are_unique_and_not_zero():
    assert len(set(DATA_IDS.values())) == len(FRAMES)
    assert 0 not in DATA_IDS.values()


def test_dbc_value_tables_equal_the_enumerations():
    for (can_id, name), enumeration in codes().items():
        choices = DATABASE.get_message_by_frame_id(can_id).get_signal_by_name(name).choices
        assert choices is not None
        assert {value: str(text) for value, text in choices.items()} == {
            int(member): member.name for member in enumeration
        }


def test_dbc_cycle_times_units_and_comments():
    assert {
        message.name: message.cycle_time for message in DATABASE.messages if message.cycle_time
    } == dict.fromkeys(
        ("RuntimeHeartbeat", "ControllerHeartbeat", "Joints01", "Joints23", "Joint4", "Progress"), 20
    )
    units = {signal.name: signal.unit for message in DATABASE.messages for signal in message.signals}
    assert (units["q0"], units["q2"], units["q4"]) == ("deg", "mm", "deg")
    for message in DATABASE.messages:
        assert message.comment
        assert all(signal.comment for signal in message.signals)


@pytest.mark.parametrize(
    ("kind", "values", "why"),
    [
        (RuntimeHeartbeat, {"code": RuntimeCode.CUT, "epoch": 32}, r"epoch is 32, must be in 0\.\.31"),
        (RuntimeHeartbeat, {"code": RuntimeCode.CUT, "epoch": -1}, "epoch is -1"),
        (RuntimeHeartbeat, {"code": 0x5555, "epoch": 0}, "must be RuntimeCode"),
        (RuntimeHeartbeat, {"code": RuntimeCode.CUT, "epoch": True}, "must be int"),
        (RuntimeHeartbeat, {"code": RuntimeCode.CUT, "epoch": 1.0}, "must be int"),
        (Joints01, {"q0": 1 << 19, "q1": 0}, "q0 is 524288"),
        (Joints01, {"q0": 0, "q1": -(1 << 19) - 1}, "q1 is -524289"),
        (Progress, {"segment": 1 << 24, "fraction": 0}, "segment is"),
        (Progress, {"segment": 0, "fraction": math.nan}, "must be int"),
    ],
)
def test_value_beyond_its_bits_is_refused_and_never_wrapped(
    kind: type[Frame], values: dict[str, int], why: str
):
    with pytest.raises(FrameError, match=why):
        kind(**values)


def plain(can_id: int, payload: int) -> bytes:
    return bytes(3) + payload.to_bytes(5, "little")


@pytest.mark.parametrize(
    ("can_id", "payload", "why"),
    [
        (0x080, 3 << 24, "RuntimeHeartbeat.code is 0x3, which is no RuntimeCode"),
        (0x081, 0, "no ControllerState"),
        (0x010, 0x6699 | 99 << 16, "cause is 0x63"),
        (0x011, 0x55AA | 1 << 32, "reserved is 0x1"),
        (0x123, 0, "identifier 0x123 is not listed"),
    ],
)
def test_content_that_is_not_listed_is_refused(can_id: int, payload: int, why: str):
    with pytest.raises(FrameError, match=why):
        decode_frame(can_id, plain(can_id, payload))


def test_another_length_is_refused():
    with pytest.raises(FrameError, match="7 bytes, must be 8"):
        decode_frame(0x303, bytes(7))


@given(st.tuples(*[st.floats(-45.0, 45.0)] * 2, st.floats(-5242.8, 5242.8), *[st.floats(-45.0, 45.0)] * 2))
def test_joints_travel_within_half_a_count(joints: tuple[float, ...]):
    values = joint_values(*joint_frames(joints))
    assert np.allclose(
        values, joints, rtol=0, atol=[math.radians(0.002501)] * 2 + [0.005001] + [math.radians(0.002501)] * 2
    )


@pytest.mark.parametrize("joint", range(5))
@pytest.mark.parametrize("value", [math.nan, math.inf, 6000.0, -6000.0])
def test_joint_that_cannot_be_reported_is_refused(joint: int, value: float):
    joints = [0.0] * 5
    joints[joint] = value
    with pytest.raises(FrameError):
        joint_frames(joints)


@pytest.mark.parametrize(
    ("joint", "value", "text"),
    [
        (0, math.radians(2700), r"q0 is 2700\.000 deg, a joints frame carries \+-2621\.435 deg"),
        (2, -5300.0, r"q2 is -5300\.000 mm, a joints frame carries \+-5242\.870 mm"),
        (3, -1e300, r"q3 is .* deg"),
    ],
)
def test_what_cannot_be_reported_is_said_in_degrees_and_mm_never_in_counts(joint, value, text):
    joints = [0.0] * 5
    joints[joint] = value
    with pytest.raises(FrameError, match=text):
        joint_frames(joints)


def test_a_joint_may_go_where_a_frame_reports_it_with_a_revolution_to_spare():
    most = JOINT_COUNT_MAX * ROTATION_DEG
    assert bounds(Joints01, "q0")[1] == bounds(Joints23, "q2")[1] == JOINT_COUNT_MAX
    assert most - 361 < ROTATION_DEG_GOES <= most - 360
    assert ROTATION_DEG_GOES < ROTATION_DEG_STANDS < most
    assert SLIDE_MM_MAX <= JOINT_COUNT_MAX * SLIDE_MM  # no limit of the slide, elbow or pitch lies beyond


@pytest.mark.parametrize("kind", FRAMES.values(), ids=lambda kind: kind.__name__)
def test_every_number_of_a_frame_is_taken_to_its_bounds_and_not_one_further(kind: type[Frame]):
    holding = {field.name: get_type_hints(kind)[field.name] for field in fields(kind)}
    least = {name: holds() if holds in (bool, int) else min(holds) for name, holds in holding.items()}
    for name in (name for name, holds in holding.items() if holds is int):
        low, high = bounds(kind, name)
        for value in (low, high):
            frame = kind(**least | {name: value})
            assert decode_frame(*encode_frame(frame, 0, 1)) == frame
        for value in (low - 1, high + 1):
            with pytest.raises(FrameError, match=rf"must be in {low}\.\.{high}"):
                kind(**least | {name: value})


def test_what_the_link_fills_in_is_empty_until_then():
    beats = (
        RuntimeHeartbeat(RuntimeCode.CUT, 3),
        ControllerHeartbeat(ControllerState.CUTTING, 3, StopCause.NONE, True, True, True),
    )
    assert [(beat.echo, beat.tag) for beat in beats] == [(255, 0)] * 2
    assert RuntimeStop(StopCode.STOP, StopCause.BONE_MOVED).echo == 255
    assert Joint4(7).tag == 0
    assert ControllerFault(FaultCode.STOPPED, StopCause.BONE_MOVED).detail == 0


@pytest.mark.parametrize("sign", [1, -1])
def test_the_farthest_joints_that_a_frame_carries_are_reported(sign: int):
    deg, mm = JOINT_COUNT_MAX * ROTATION_DEG, JOINT_COUNT_MAX * SLIDE_MM
    joints = [sign * math.radians(deg)] * 2 + [sign * mm] + [sign * math.radians(deg)] * 2
    first, second, third = joint_frames(joints)
    assert {first.q0, first.q1, second.q2, second.q3, third.q4} == {sign * JOINT_COUNT_MAX}
    assert np.allclose(joint_values(first, second, third), joints, rtol=1e-12)


def test_four_joints_are_no_sample():
    with pytest.raises(FrameError, match="five"):
        joint_frames([0.0] * 4)


def test_progress_in_parts():
    assert Progress(3, 65535).part == 1.0
    assert Progress(3, 0).part == 0.0


def test_a_file_that_is_no_can_database_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cantools.database, "load_string", lambda *_args, **_kwargs: object())
    with pytest.raises(TypeError, match="not a CAN database"):
        frames._load()


def test_transfer_channels_have_their_own_identifiers():
    assert (CONTROL_IDS, BULK_IDS) == ((0x600, 0x601), (0x640, 0x641))


def test_recorded_candump_is_read_by_cantools_alone(tmp_path):
    """A log of both sides, read back with python-can and the DBC file; nothing of ours decodes it."""
    sides = {side: Link(side, 0.1, 0.02) for side in Side}
    for link in sides.values():
        link.open(CODES, 0.0)
    sent = [
        RuntimeHeartbeat(RuntimeCode.CUT, 3),
        ControllerHeartbeat(ControllerState.CUTTING, 3, StopCause.NONE, True, True, True),
        *joint_frames([0.1, 0.2, 300.0, -0.3, 1.5]),
        Progress(12, 32768),
        RuntimeStop(StopCode.STOP, StopCause.BONE_MOVED),
        ControllerFault(FaultCode.STOPPED, StopCause.BONE_MOVED, 7),
    ]
    log = tmp_path / "candump.log"
    lines = []
    for at, frame in enumerate(sent):
        can_id, data = sides[frame.SENDER].encode(frame, at * 0.001)
        lines.append(f"({at * 0.001:.6f}) vcan0 {can_id:03X}#{data.hex().upper()}\n")
    log.write_text("".join(lines), encoding="ascii")

    database = cantools.database.load_string(DBC.read_text(encoding="ascii"), "dbc")
    with CanutilsLogReader(log) as reader:
        decoded = [
            (message.arbitration_id, database.decode_message(message.arbitration_id, message.data))
            for message in reader
        ]
    names = [database.get_message_by_frame_id(can_id).name for can_id, _ in decoded]
    assert names == [type(frame).__name__ for frame in sent]
    by_name = {name: {key: value if isinstance(value, (int, float)) else str(value) for key, value in signals.items()} for name, (_, signals) in zip(names, decoded, strict=True)}  # fmt: skip
    assert by_name["RuntimeHeartbeat"]["code"] == "CUT"
    assert by_name["ControllerHeartbeat"]["state"] == "CUTTING"
    assert by_name["ControllerHeartbeat"]["device_pressed"] == "PRESSED"
    assert by_name["RuntimeStop"]["cause"] == "BONE_MOVED"
    assert by_name["ControllerFault"]["detail"] == 7
    assert by_name["Joints01"]["q0"] == pytest.approx(math.degrees(0.1), abs=0.0026)
    assert by_name["Joints23"]["q2"] == 300.0
    assert by_name["Joint4"]["q4"] == pytest.approx(math.degrees(1.5), abs=0.0026)
    assert by_name["Joints01"]["counter"] == by_name["Joints23"]["counter"] == by_name["Joint4"]["counter"]
    assert by_name["Progress"]["fraction"] == pytest.approx(0.5, abs=1e-4)
    assert Joints23 in IDS
    assert Joint4 in IDS
