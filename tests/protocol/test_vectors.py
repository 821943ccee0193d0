"""Golden vectors: made without this package, and equal to what it makes."""

import ast
import json
from typing import Any

import numpy as np
import pytest

from cutgate.protocol import permit
from cutgate.protocol.e2e import intact
from cutgate.protocol.frames import DATA_IDS, FRAMES, decode_frame, encode_frame
from cutgate.protocol.parameters import Calibration, Limits, Tool
from cutgate.protocol.path import Assembly, Path, PathBlock, split
from cutgate.protocol.records import (
    PROTOCOL_VERSION,
    Announce,
    Approach,
    Branch,
    Open,
    Permit,
    Reset,
    Start,
    Timing,
    digest,
    pack,
    session_digest,
    session_tag,
    unpack,
)
from cutgate.protocol.states import ControllerState, StopCause
from tests.protocol.vectors import generate


def load(name: str) -> Any:
    return json.loads((generate.HERE / f"{name}.json").read_text(encoding="ascii"))


FRAME_VECTORS = load("frames")["frames"]
OPENING = load("opening")
SIGNED = load("signed")
PARAMETERS = load("parameters")
PATH = load("path")


def test_generator_reproduces_the_files():
    for name, text in generate.files().items():
        assert (generate.HERE / name).read_text(encoding="ascii") == text, name


@pytest.mark.parametrize("name", [name.removesuffix(".json") for name in generate.files()])
def test_every_file_says_its_format_and_the_protocol_that_it_belongs_to(name: str):
    assert (load(name)["format_version"], load(name)["protocol_version"]) == (2, PROTOCOL_VERSION)


def test_every_file_of_vectors_is_generated():
    assert {file.name for file in generate.HERE.glob("*.json")} == set(generate.files())


def test_generator_does_not_import_what_it_tests():
    tree = ast.parse((generate.HERE / "generate.py").read_text(encoding="utf-8"))
    imported = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    imported += [str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert imported
    assert not [
        name for name in imported if name.split(".")[0] in ("protocol", "config", "runtime", "firmware_sim")
    ]


def test_every_frame_has_vectors():
    assert {vector["id"] for vector in FRAME_VECTORS} == set(FRAMES)


@pytest.mark.parametrize("vector", FRAME_VECTORS, ids=lambda vector: f"{vector['frame']}-{vector['counter']}")
def test_frame_bytes_equal_the_vector(vector: dict[str, Any]):
    data = bytes.fromhex(vector["data"])
    assert DATA_IDS[vector["id"]] == vector["data_id"]
    assert intact(data, vector["data_id"], vector["tag"])
    frame = decode_frame(vector["id"], data)
    assert type(frame).__name__ == vector["frame"]
    assert {name: int(value) for name, value in vars(frame).items()} == vector["fields"]
    assert encode_frame(frame, vector["counter"], vector["tag"]) == (vector["id"], data)


def hexed(name: str) -> bytes:
    return bytes.fromhex(SIGNED[name])


def test_session_digest_and_tag_equal_the_vector():
    nonces = hexed("boot_nonce"), hexed("runtime_nonce")
    assert session_digest(*nonces) == hexed("session_digest")
    assert session_tag(*nonces) == SIGNED["session_tag"]


def test_announce_equals_the_vector():
    announce = Announce(
        protocol_version=3,
        firmware_version=OPENING["firmware_version"],
        serial=OPENING["serial"],
        boot_nonce=bytes.fromhex(OPENING["boot_nonce"]),
        plant_speed_permille=OPENING["plant_speed_permille"],
        state=ControllerState(OPENING["state"]),
        cause=StopCause(OPENING["cause"]),
    )
    assert pack(announce, 0, 1).hex() == OPENING["announce"]
    assert unpack(bytes.fromhex(OPENING["announce"])).record == announce


def test_open_equals_the_vector():
    nonces = bytes.fromhex(OPENING["boot_nonce"]), bytes.fromhex(OPENING["runtime_nonce"])
    request = Open(
        3,
        *nonces,
        registration_digest=bytes.fromhex(OPENING["registration_digest"]),
        configuration_digest=bytes.fromhex(OPENING["configuration_digest"]),
        verifier_version=OPENING["verifier_version"],
        timing=Timing(**OPENING["timing"]),
    )
    assert pack(request, 0, 1).hex() == OPENING["open"]
    assert unpack(bytes.fromhex(OPENING["open"])).record == request


def a_permit() -> Permit:
    digests = {f"{name}_digest": bytes.fromhex(value) for name, value in SIGNED["digests"].items()}
    return Permit(
        nonce=generate.patterned(16, 4),
        boot_nonce=hexed("boot_nonce"),
        session_digest=hexed("session_digest"),
        serial=SIGNED["serial"],
        protocol_version=3,
        epoch=200,
        verifier_version=SIGNED["verifier_version"],
        start_joints_u=tuple(SIGNED["start_joints_u"]),
        branch=Branch("left", -1, 3),
        approach=Approach(
            **{k: tuple(v) if isinstance(v, list) else v for k, v in SIGNED["approach"].items()}
        ),
        lifetime_s=120,
        **digests,
    )


def test_signed_permit_equals_the_vector():
    signed = permit.sign(hexed("key"), a_permit())
    assert pack(signed, 0xDEADBEEF, 41) == hexed("permit")
    assert signed.digest == hexed("permit_digest")


def test_signed_start_equals_the_vector():
    start = Start(
        generate.patterned(16, 5),
        200,
        hexed("session_digest"),
        hexed("permit_digest"),
        a_permit().start_joints_u,
    )
    assert pack(permit.sign(hexed("key"), start), 0xDEADBEEF, 42) == hexed("start")


def test_signed_reset_equals_the_vector():
    reset = Reset(generate.patterned(16, 6), 201, hexed("session_digest"), StopCause.SECOND_NODE)
    assert pack(permit.sign(hexed("key"), reset), 0xDEADBEEF, 43) == hexed("reset")


@pytest.mark.parametrize("name", ["permit", "start", "reset"])
def test_vector_is_accepted_and_every_flipped_bit_of_its_body_refused(name: str):
    record = unpack(hexed(name)).record
    assert isinstance(record, Permit | Start | Reset)
    assert permit.verify(hexed("key"), record)
    body = record.body()
    for bit in range(8 * len(body)):
        changed = bytearray(body)
        changed[bit // 8] ^= 1 << bit % 8
        try:
            altered = type(record).parse(bytes(changed))
        except ValueError:
            continue
        assert not permit.verify(hexed("key"), altered), bit


LIMITS = Limits.quantised(
    q_min_deg=[-80.0, 0.0, 50.0, -170.0, 0.0],
    q_max_deg=[80.0, 145.0, 450.0, 170.0, 110.0],
    speed_deg_s=[57.29577951308232, 57.29577951308232, 200.0, 114.59155902616465, 114.59155902616465],
)
CALIBRATION = Calibration.quantised(
    upper_link_mm=450.0,
    forearm_link_mm=450.0,
    upper_link_error_mm=0.123457,
    forearm_link_error_mm=-0.05,
    joint_offset_deg=[0.1, 0.0, -0.25, 0.0, 0.000001],
    slide_tilt_mrad=[1.5, -2.25],
    residual_mm=0.3000001,
    residual_deg=0.02,
)


@pytest.mark.parametrize(
    ("name", "record"),
    [("limits", LIMITS), ("calibration", CALIBRATION), ("tool", Tool.quantised(length_mm=160.0))],
)
def test_parameter_record_equals_the_vector(name: str, record: Limits | Calibration | Tool):
    vector = PARAMETERS[name]
    assert record.body().hex() == vector["body"]
    assert digest(record.body()).hex() == vector["sha256"]
    assert pack(record, 7, record.TYPE).hex() == vector["envelope"]
    assert type(record).parse(bytes.fromhex(vector["body"])) == record


def a_path() -> Path:
    names = ("feed_mm_s", "tool_length_mm", "elbow", "q0_turns", "roll_turns")
    return Path.quantised(PATH["tips_mm"], PATH["axes"], **{name: PATH[name] for name in names})


def test_path_bytes_and_digest_equal_the_vector():
    assert a_path().body().hex() == PATH["body"]
    assert a_path().digest.hex() == PATH["sha256"]


def test_decoded_axes_equal_the_vector_to_the_last_bit():
    expected = np.array([[float.fromhex(part) for part in axis] for axis in PATH["decoded_axes"]])
    assert a_path().axes.tobytes() == expected.tobytes()


def test_path_blocks_equal_the_vector_and_assemble_to_the_path():
    assembly = Assembly()
    for at, (block, expected) in enumerate(zip(split(a_path().body()), PATH["envelopes"], strict=True)):
        assert pack(block, 7, 100 + at).hex() == expected
        received = unpack(bytes.fromhex(expected)).record
        assert isinstance(received, PathBlock)
        assembly = assembly.add(received)
    assert assembly.complete
    assert Path.parse(assembly.data) == a_path()
