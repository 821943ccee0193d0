"""Golden vectors: made without this package, and equal to what it makes."""

import ast
import json
from typing import Any

import numpy as np
import pytest

from cutgate.protocol.codes import PresharedKey
from cutgate.protocol.e2e import intact
from cutgate.protocol.frames import DATA_IDS, FRAMES, decode_frame, encode_frame
from cutgate.protocol.parameters import Calibration, Limits, Tool
from cutgate.protocol.path import Assembly, Path, PathBlock, split
from cutgate.protocol.records import (
    PROTOCOL_VERSION,
    Acknowledge,
    Announce,
    Approach,
    Branch,
    Open,
    Opened,
    Permit,
    Reset,
    Side,
    SignedRecord,
    Start,
    Timing,
    TreeHead,
    Withdraw,
    digest,
    pack,
    session_digest,
    session_tag,
    unpack,
)
from cutgate.protocol.states import ControllerState, Refusal, StopCause
from tests.protocol.vectors import generate


def load(name: str) -> Any:
    return json.loads((generate.HERE / f"{name}.json").read_text(encoding="ascii"))


FRAME_VECTORS = load("frames")["frames"]
OPENING = load("opening")
SIGNED = load("signed")
TAG_VECTORS = load("tags")
PARAMETERS = load("parameters")
PATH = load("path")


def test_generator_reproduces_the_files():
    for name, text in generate.files().items():
        assert (generate.HERE / name).read_text(encoding="ascii") == text, name


@pytest.mark.parametrize("name", [name.removesuffix(".json") for name in generate.files()])
def test_every_file_says_its_format_and_the_protocol_that_it_belongs_to(name: str):
    assert (load(name)["format_version"], load(name)["protocol_version"]) == (4, PROTOCOL_VERSION)


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


KEY = PresharedKey(hexed("key"))
CODES = KEY.session(hexed("session_digest"))


def test_session_digest_and_tag_equal_the_vector():
    request = unpack(bytes.fromhex(OPENING["open"])).record
    assert isinstance(request, Open)
    assert session_digest(request) == hexed("session_digest")
    assert session_tag(hexed("session_digest")) == SIGNED["session_tag"]


def test_announce_equals_the_vector():
    announce = Announce(
        protocol_version=4,
        firmware_version=OPENING["firmware_version"],
        serial=OPENING["serial"],
        announce_nonce=bytes.fromhex(OPENING["announce_nonce"]),
        plant_speed_permille=OPENING["plant_speed_permille"],
        state=ControllerState(OPENING["state"]),
        cause=StopCause(OPENING["cause"]),
    )
    assert pack(announce, 0, 1).hex() == OPENING["announce"]
    assert unpack(bytes.fromhex(OPENING["announce"])).record == announce
    assert announce.identity_digest.hex() == OPENING["identity_digest"]


def test_open_equals_the_vector():
    request = Open(
        4,
        **{name: bytes.fromhex(OPENING[name]) for name in ("announce_nonce", "runtime_nonce")},
        **{f"{name}_digest": bytes.fromhex(OPENING[f"{name}_digest"]) for name in ("identity", "registration", "place", "configuration")},
        registration_time_us=OPENING["registration_time_us"],
        verifier_version=OPENING["verifier_version"],
        timing=Timing(**OPENING["timing"]),
    )  # fmt: skip
    signed = KEY.sign_open(request)
    assert pack(signed, 0, 1).hex() == OPENING["open"]
    assert unpack(bytes.fromhex(OPENING["open"])).record == signed


def log(at: int) -> TreeHead:
    return TreeHead(generate.patterned(16, 30), at, generate.patterned(32, 31 + at % 7))


def a_permit() -> Permit:
    digests = {f"{name}_digest": bytes.fromhex(value) for name, value in SIGNED["digests"].items()}
    return Permit(
        nonce=generate.patterned(16, 4),
        announce_nonce=bytes.fromhex(OPENING["announce_nonce"]),
        session_digest=hexed("session_digest"),
        serial=SIGNED["serial"],
        protocol_version=4,
        epoch=20,
        verifier_version=SIGNED["verifier_version"],
        start_joints_u=tuple(SIGNED["start_joints_u"]),
        branch=Branch("left", -1, 3),
        approach=Approach(
            **{k: tuple(v) if isinstance(v, list) else v for k, v in SIGNED["approach"].items()}
        ),
        lifetime_s=120,
        log=log(1000),
        **digests,
    )


REGISTERED_US = OPENING["registration_time_us"]
IN_SESSION: dict[str, tuple[int, SignedRecord]] = {
    "opened": (
        40,
        Opened(
            20, ControllerState.OPEN, StopCause.NONE, log(77), 1, 3600,
            Refusal.REGISTRATION_TOO_EARLY, REGISTERED_US - 1,
        ),
    ),
    "permit": (41, a_permit()),
    "start": (
        42,
        Start(
            generate.patterned(16, 5), 20, hexed("session_digest"), hexed("permit_digest"),
            a_permit().start_joints_u, log(1234),
        ),
    ),
    "reset": (
        43, Reset(generate.patterned(16, 6), 21, hexed("session_digest"), StopCause.SECOND_NODE),
    ),
    "acknowledge": (44, Acknowledge(21, StopCause.SECOND_NODE)),
    "withdraw": (45, Withdraw(bytes.fromhex(OPENING["place_digest"]), REGISTERED_US + 60_000_000)),
}  # fmt: skip


@pytest.mark.parametrize("name", IN_SESSION)
def test_signed_record_equals_the_vector(name: str):
    sequence, record = IN_SESSION[name]
    assert pack(CODES.sign(record, sequence), CODES.tag, sequence) == hexed(name)


def test_permit_digest_equals_the_vector():
    assert a_permit().digest == hexed("permit_digest")


def test_tags_equal_the_vector():
    sides = {side.name.lower(): side for side in Side}
    for beat in TAG_VECTORS["heartbeats"]:
        covered = bytes.fromhex(beat["last_bytes"])
        assert CODES.heartbeat_tag(sides[beat["from"]], beat["counter"], beat["echo"], covered) == beat["tag"]
    for sample in TAG_VECTORS["samples"]:
        assert CODES.sample_tag(sample["counter"], sample["joints"]) == sample["tag"]


def authentic(record: SignedRecord, sequence: int) -> bool:
    return KEY.open_authentic(record) if isinstance(record, Open) else CODES.authentic(record, sequence)


@pytest.mark.parametrize("name", ["open", *IN_SESSION])
def test_vector_is_accepted_and_every_flipped_bit_of_its_body_refused(name: str):
    data = bytes.fromhex(OPENING["open"]) if name == "open" else hexed(name)
    envelope = unpack(data)
    record, sequence = envelope.record, envelope.sequence
    assert isinstance(record, SignedRecord)
    assert authentic(record, sequence)
    body = record.body()
    for bit in range(8 * len(body)):
        changed = bytearray(body)
        changed[bit // 8] ^= 1 << bit % 8
        try:
            altered = type(record).parse(bytes(changed))
        except ValueError:
            continue
        assert not authentic(altered, sequence), bit


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
