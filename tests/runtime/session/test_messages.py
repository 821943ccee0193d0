"""What crosses between runtime and verification process: plain data within bounds, or nothing."""

import json
import math
import pickle
import time
import tracemalloc
from dataclasses import FrozenInstanceError, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from cutgate.runtime.session.messages import (
    _ANSWER,
    ANSWER_BYTES_MAX,
    LENGTH_BYTES,
    REQUEST_BYTES_MAX,
    Bound,
    Broken,
    Claim,
    Frames,
    Guided,
    MessageError,
    Request,
    framed,
    parse_answer,
    shown,
)
from cutgate.runtime.session.prover import answers
from cutgate.runtime.verification.advice import Move as FoundMove
from tests.runtime.session.pair import INADMISSIBLE_MM, request_of

DIGEST = "ab" * 32
CLAIM = {
    "kind": "claim",
    "request": 5,
    "admissible": True,
    "path": DIGEST,
    "limits": DIGEST,
    "calibration": DIGEST,
    "tool": DIGEST,
    "start_joints_u": [1, 2, 3, 4, 5],
    "approach": {
        "entry_um": 1,
        "exit_um": 2,
        "entry_joints_u": [1, 2, 3, 4, 5],
        "exit_joints_u": [-1, 2, 3, 4, 2**63 - 1],
        "speed_percent": 25,
    },
}
MOVE = {
    "boundary": "outer",
    "kind": "move",
    "direction": [1.0, 0.0, 0.0],
    "distance_mm": 1.5,
    "angle_deg": None,
}
GUIDANCE = {
    "translation_mm": [1.0, 2.0, 3.0],
    "yaw_deg": 0.0,
    "pivot_mm": [0.0, 0.0, 0.0],
    "moves": [MOVE],
    "predicted_clearance_mm": 5.3,
    "verified": True,
    "text": "move it",
    "none_possible": False,
    "at_least_mm": 1.0,
    "reserve_mm": 0.2,
    "reserve_deg": 0.1,
}
GUIDED = {"kind": "guided", "request": 5, "guidance": GUIDANCE}
BROKEN = {"kind": "broken", "request": 5, "reason": "ValueError: no"}


def test_what_the_program_says_is_read_as_it_was_said(tmp_path_factory):
    for bone_x_mm in (None, INADMISSIBLE_MM):
        asked = request_of(tmp_path_factory, *([bone_x_mm] if bone_x_mm else []))
        for said in answers(asked):
            body = said.model_dump_json().encode()
            assert parse_answer(body) == said
            assert len(body) < ANSWER_BYTES_MAX / 4


def test_a_request_is_read_as_it_was_asked(tmp_path_factory):
    asked = request_of(tmp_path_factory)
    assert Request.parse(asked.body(), asked.path) == asked
    assert asked.path.hex().encode() not in asked.body()
    assert len(asked.body()) < REQUEST_BYTES_MAX / 4
    with pytest.raises(FrozenInstanceError):
        asked.number = 6
    with pytest.raises(ValueError, match="not JSON compliant"):
        replace(asked, start_tolerance_mm=math.nan).body()


@pytest.mark.parametrize("message", [CLAIM, GUIDED, BROKEN, {**CLAIM, "approach": None}])
def test_a_message_within_its_bounds_is_read(message):
    assert json.loads(parse_answer(json.dumps(message).encode()).model_dump_json()) == message


def changed(message, place, value):
    """The message with one value replaced."""
    first, *rest = place
    part = message[first] if first in message or isinstance(message, list) else None
    new = changed(part, rest, value) if rest else value
    if isinstance(message, list):
        return [*message[:first], new, *message[first + 1 :]]
    return {**message, first: new}


@pytest.mark.parametrize(
    ("message", "place", "value"),
    [
        (CLAIM, ["kind"], "verdict"),
        (CLAIM, ["kind"], None),
        (CLAIM, ["request"], "5"),
        (CLAIM, ["request"], 5.0),
        (CLAIM, ["request"], True),
        (CLAIM, ["request"], 2**63),
        (CLAIM, ["request"], -(2**63) - 1),
        (CLAIM, ["request"], 10**4000),
        (CLAIM, ["admissible"], 1),
        (CLAIM, ["admissible"], "true"),
        (CLAIM, ["admissible"], None),
        (CLAIM, ["path"], DIGEST.upper()),
        (CLAIM, ["path"], DIGEST + "\n"),
        (CLAIM, ["path"], DIGEST[:-1]),
        (CLAIM, ["tool"], 7),
        (CLAIM, ["start_joints_u"], [1, 2, 3, 4]),
        (CLAIM, ["start_joints_u"], [1, 2, 3, 4, 5, 6]),
        (CLAIM, ["start_joints_u"], [1, 2, 3, 4, 5.5]),
        (CLAIM, ["start_joints_u"], [[1], 2, 3, 4, 5]),
        (CLAIM, ["approach"], []),
        (CLAIM, ["approach", "entry_um"], None),
        (CLAIM, ["approach", "more"], 1),
        (CLAIM, ["__class__"], "Answer"),
        (CLAIM, ["course"], []),
        (GUIDED, ["guidance", "verified"], "yes"),
        (GUIDED, ["guidance", "yaw_deg"], "1"),
        (GUIDED, ["guidance", "translation_mm"], [1.0, 2.0]),
        (GUIDED, ["guidance", "moves"], [MOVE] * 21),
        (GUIDED, ["guidance", "moves", 0, "kind"], "jump"),
        (GUIDED, ["guidance", "moves", 0, "boundary"], "x" * 41),
        (GUIDED, ["guidance", "text"], "x" * 2001),
        (GUIDED, ["guidance", "text"], "\x1b[2J ADMISSIBLE"),
        (GUIDED, ["guidance", "text"], "two\nlines"),
        (GUIDED, ["guidance", "text"], "turned \u202e round"),
        (BROKEN, ["reason"], "\x07"),
        (BROKEN, ["reason"], None),
    ],
)
def test_whatever_is_otherwise_is_no_message(message, place, value):
    with pytest.raises(MessageError):
        parse_answer(json.dumps(changed(message, place, value)).encode())


def test_a_message_that_was_read_cannot_be_changed():
    with pytest.raises(ValidationError, match="frozen"):
        parse_answer(json.dumps({**CLAIM, "admissible": False}).encode()).admissible = True


def test_the_first_thing_that_is_wrong_is_named_with_its_place():
    for message, said in (
        ({**CLAIM, "tool": 7, "limits": 7}, "claim.limits: Input should be a valid string"),
        ({**CLAIM, "kind": "verdict" * 50}, "Input tag 'verdictverdict"),
        (7, "Input should be an object"),
    ):
        with pytest.raises(MessageError) as refused:
            parse_answer(json.dumps(message).encode())
        assert str(refused.value).startswith(said)


def test_what_is_said_of_foreign_bytes_ends_after_200_characters():
    with pytest.raises(MessageError) as refused:
        parse_answer(json.dumps({**CLAIM, "x" * 5000: 1}).encode())
    assert len(str(refused.value)) == 200


def test_so_much_is_read_and_no_more():
    """As said in docs/architecture.md: what a cycle of the loop can be kept busy with."""
    assert (ANSWER_BYTES_MAX, REQUEST_BYTES_MAX) == (16_384, 262_144)


def test_where_the_arm_stands_is_taken_as_it_is_asked(tmp_path_factory):
    joints_u = (1_000_000, 2_000_000, 3_000_000, 4_000_000, 5_000_000)
    start = replace(
        request_of(tmp_path_factory),
        start_joints_u=joints_u,
        clearance_um=12_346,
        start_tolerance_mm=0.7,
        start_tolerance_deg=0.3,
    ).start
    assert (start.clearance_um, start.tolerance_mm) == (12_346, 0.7)
    assert start.tolerance_rad == pytest.approx(math.radians(0.3))
    assert start.joints == pytest.approx(
        [math.radians(1), math.radians(2), 3, math.radians(4), math.radians(5)]
    )


@pytest.mark.parametrize("name", [*CLAIM, *CLAIM["approach"]])
def test_nothing_may_be_missing_from_a_claim(name):
    if name == "kind":
        return  # without it nobody knows that it is one: the case above
    whole = {key: value for key, value in CLAIM.items() if key != name}
    inner = {key: value for key, value in CLAIM["approach"].items() if key != name}
    with pytest.raises(MessageError):
        parse_answer(json.dumps({**whole, **({} if name == "approach" else {"approach": inner})}).encode())


class Bomb:
    """What pickle would run."""

    went_off = False

    def __reduce__(self):
        return setattr, (Bomb, "went_off", True)


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"null",
        b"[]",
        b"7",
        b'"claim"',
        b"{",
        b"[" * ANSWER_BYTES_MAX,
        b'{"kind":' * 2000,
        json.dumps(CLAIM).encode()[:-1],
        json.dumps(CLAIM).encode() + b"{}",
        json.dumps(CLAIM).encode().replace(b"25", b"NaN"),
        json.dumps(GUIDED).encode().replace(b"5.3", b"NaN"),
        json.dumps(GUIDED).encode().replace(b"5.3", b"Infinity"),
        json.dumps(GUIDED).encode().replace(b"5.3", b"1e999"),
        json.dumps(GUIDED).encode().replace(b"move it", b"\xff\xfe"),
        json.dumps(GUIDED).encode().replace(b"move it", b"\\ud800"),
        pickle.dumps(Bomb()),
        bytes(ANSWER_BYTES_MAX),
        b"{" + b",".join(b'"%d":0' % number for number in range(1600)) + b',"kind":"claim"}',
    ],
    ids=range(19),
)
def test_bytes_that_are_no_message_are_refused_in_words_at_once_and_with_little_memory(body):
    tracemalloc.start()
    began_s = time.thread_time()
    with pytest.raises(MessageError) as refused:
        parse_answer(body)
    spent_s = time.thread_time() - began_s
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert str(refused.value).isprintable()
    assert 0 < len(str(refused.value)) <= 200
    assert most < 8_000_000
    assert spent_s < 1.0  # 5 ms untraced, see docs/benchmarks-wire.md
    assert not Bomb.went_off


def test_what_a_refusal_repeats_of_foreign_bytes_cannot_act_on_a_terminal():
    body = json.dumps({**CLAIM, "\x1b[2J\u202e": 1}).encode()
    with pytest.raises(MessageError, match=r"\\x1b\[2J\\u202e: Extra inputs are not permitted"):
        parse_answer(body)


@given(st.text(), st.integers(0, 300))
def test_shown_text_has_printable_characters_alone_and_is_no_longer_than_asked(text, most):
    out = shown(text, most)
    assert out.isprintable()
    assert len(out) <= most
    if text.isprintable():
        assert out == text[:most]


# ---------------------------------------------------------------- frames


@given(st.lists(st.binary(min_size=1, max_size=300), min_size=1, max_size=5), st.data())
def test_messages_come_out_one_by_one_however_the_bytes_arrive(bodies, data):
    stream, found, frames = b"".join(map(framed, bodies)), [], Frames(300)
    while stream:
        size = data.draw(st.integers(1, frames.missing))
        body = frames.add(stream[:size])
        stream = stream[size:]
        found += [] if body is None else [body]
    assert found == bodies
    assert frames.missing == LENGTH_BYTES


@pytest.mark.parametrize("length", [0, 301, 1 << 20, (1 << 32) - 1])
@pytest.mark.parametrize("parts", [(4,), (1, 3), (3, 1)])
def test_a_length_that_no_message_has_is_refused_before_anything_of_it_is_read(length, parts):
    frames, head = Frames(300), length.to_bytes(4, "big")
    assert frames.missing == 4
    for size in parts[:-1]:
        assert frames.add(head[:size]) is None
        head = head[size:]
    with pytest.raises(MessageError, match=f"a message of {length} bytes is announced, must have 1..300"):
        frames.add(head)


def test_the_longest_message_is_taken():
    frames = Frames(300)
    assert frames.add((300).to_bytes(4, "big")) is None
    assert frames.missing == 300
    assert frames.add(bytes(300)) == bytes(300)


def test_a_claim_binds_nothing_where_nothing_is_bound():
    assert Bound.of(None) is None
    assert isinstance(parse_answer(json.dumps(CLAIM).encode()), Claim)
    assert isinstance(parse_answer(json.dumps(GUIDED).encode()), Guided)
    assert Guided.of(3, None).guidance is None
    assert Broken(reason="no").request == 0


def test_guidance_is_known_to_the_rest_of_the_program_as_it_was_found(tmp_path_factory):
    asked = request_of(tmp_path_factory, INADMISSIBLE_MM)
    _, guided = answers(asked)
    value = parse_answer(guided.model_dump_json().encode()).guidance.value
    assert Guided.of(asked.number, value) == guided
    assert len(value.moves) > 0
    assert {type(move) for move in value.moves} == {FoundMove}


@pytest.mark.parametrize(
    "body",
    [
        b'{"kind":"guided","guidance":{"moves":[' + b",".join([b"{}"] * 5000) + b"]}}",
        b'{"kind":"claim","start_joints_u":[' + b",".join([b'""'] * 5000) + b"]}",
    ],
)
def test_a_list_that_is_wrong_in_every_place_is_left_at_the_first(body):
    """To tell each of 25 000 errors takes four heartbeats."""
    assert len(body) <= ANSWER_BYTES_MAX
    with pytest.raises(ValidationError) as told:
        _ANSWER.validate_json(body)
    assert told.value.error_count() < 30
