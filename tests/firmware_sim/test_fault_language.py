"""A fault is a line and a line is a fault: read, written and refused."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cutgate.config.refusal import InputError
from cutgate.firmware_sim.fault_language import (
    BY_MAX_MS,
    FAULT_TABLE,
    LINE_MAX,
    MESSAGES,
    SEED_MAX,
    TIMES_MAX,
    ByRule,
    MessageAction,
    MessageFault,
    parse_fault,
)
from cutgate.firmware_sim.faults import FaultName, FaultSpec
from cutgate.protocol.frames import SENT_BY
from cutgate.protocol.states import ControllerState

STATES = st.sampled_from(ControllerState)


@st.composite
def message_faults(draw):
    action = draw(st.sampled_from(MessageAction))
    high = draw(st.integers(1, BY_MAX_MS))
    by = st.just((high, high)) | st.tuples(st.integers(0, high), st.just(high))
    rule = FAULT_TABLE[action].by
    by_ms = None if rule is ByRule.NEVER else draw(by if rule is ByRule.MUST else st.none() | by)
    return MessageFault(
        action,
        draw(st.sampled_from(sorted(MESSAGES))),
        by_ms,
        draw(st.none() | STATES),
        draw(st.none() | st.integers(1, TIMES_MAX)),
        draw(st.integers(1, 1_000_000)) / 1_000_000,
        draw(st.integers(0, SEED_MAX)),
    )


FAULTS = message_faults() | st.builds(FaultSpec, st.sampled_from(FaultName), STATES)


@given(FAULTS)
def test_what_is_written_is_read_as_the_same_fault(fault):
    line = str(fault)
    assert parse_fault(line) == fault
    assert len(line) <= LINE_MAX


@given(FAULTS, st.randoms())
def test_the_order_of_what_follows_the_message_says_nothing(fault, random):
    action, *rest = str(fault).replace("by ", "by_").split(" ")
    head, tail = rest[:1], rest[1:]
    random.shuffle(tail)
    assert parse_fault(" ".join([action, *head, *tail]).replace("by_", "by ")) == fault


ALPHABET = st.sampled_from(
    [
        *MessageAction,
        *MESSAGES,
        *FaultName,
        "@",
        "cutting",
        "x3",
        "by",
        "30ms",
        "p=",
        "0.1",
        "seed=7",
        " ",
        "\n",
        "1",
    ]
)


@given(st.lists(ALPHABET, max_size=8).map("".join) | st.text(max_size=40))
def test_whatever_is_read_is_written_so_that_it_is_read_again_and_the_rest_is_refused(line):
    try:
        fault = parse_fault(line, "here")
    except InputError as error:
        told = str(error)
    else:
        assert parse_fault(str(fault)) == fault
        return
    assert told.startswith("here: ")
    assert told.isprintable()


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("corrupt RuntimeHeartbeat", MessageFault(MessageAction.CORRUPT, "RuntimeHeartbeat")),
        (
            "lose ControllerHeartbeat @cutting x3",
            MessageFault(MessageAction.LOSE, "ControllerHeartbeat", None, ControllerState.CUTTING, 3),
        ),
        (
            "delay Joints01 by 30ms @permitted p=0.1 seed=7",
            MessageFault(MessageAction.DELAY, "Joints01", (30, 30), ControllerState.PERMITTED, None, 0.1, 7),
        ),
        ("lose any p=1", MessageFault(MessageAction.LOSE, "any", times=None)),
        ("lose any p=1 x1", MessageFault(MessageAction.LOSE, "any")),
        ("repeat any by 0..5ms", MessageFault(MessageAction.REPEAT, "any", (0, 5))),
        ("flip-path-bit @cutting", FaultSpec(FaultName.FLIP_PATH_BIT, ControllerState.CUTTING)),
        ("flip-path-bit@cutting", FaultSpec(FaultName.FLIP_PATH_BIT, ControllerState.CUTTING)),
        ("hang", FaultSpec(FaultName.HANG, ControllerState.LOADED)),
    ],
)
def test_a_line_means_this(line, fault):
    assert parse_fault(line) == fault


@pytest.mark.parametrize(
    "line",
    [
        "lose any",
        "lose any p=1",
        "lose any x2",
        "lose any x1 p=0.5",
        "lose any p=0.000001",
        "delay any by 5..30ms @cutting x3 p=0.25 seed=9",
        "delay any by 30ms",
        "hang@loaded",
    ],
)
def test_a_line_in_its_usual_form_is_written_as_it_was(line):
    assert str(parse_fault(line)) == line


def test_a_fault_concerns_the_identifiers_of_its_message():
    for name, ids in MESSAGES.items():
        assert parse_fault(f"lose {name}").can_ids == ids


@pytest.mark.parametrize(
    ("line", "allowed"),
    [
        ("explode", "use one of flip-path-bit, .* of messages: lose, corrupt, "),
        ("", "use one of flip-path-bit"),
        ("LOSE any", "of messages: lose, "),
        (" lose any", "of messages: lose, "),
        ("hang @moon", "state must be one of inhibited"),
        ("lose", "message must be one of ControllerFault, .*, any"),
        ("lose Heartbeat", "message must be one of ControllerFault, .*, any"),
        ("lose  any", "message must be one of"),
        ("lose any @moon", "state must be one of inhibited, open, loaded"),
        ("lose any by 3ms", "lose takes no `by`; leave it out"),
        ("delay any", "delay needs `by`, for example `by 30ms`"),
        ("delay any by 0ms", "after the message may come `by 30ms`"),
        ("delay any by 9..3ms", "by must be 1ms to 10000ms"),
        ("delay any by 10001ms", "by must be 1ms to 10000ms"),
        ("delay any by 3s", "after the message may come"),
        ("lose any x0", "may come .*`xN`"),
        ("lose any x9999999", "times must be x1 to x1000000"),
        ("lose any p=0.0", "p must be over 0, at most 1"),
        ("lose any p=2", "may come .*`p=0.1`"),
        ("lose any p=nan", "may come .*`p=0.1`"),
        ("lose any seed=-1", "may come .*`seed=7`"),
        ("lose any seed=4294967296", "seed must be 0 to 4294967295"),
        ("lose any seed=1 seed=2", "seed= is given twice"),
        ("lose any x3x3", "'x3x3' is not understood"),
        ("lose any x3\n", "is not understood"),
        ("lose any x3 ", "is not understood"),
        ("lose any x3\x1b[31m", "is not understood"),
        ("lose any " + "x3 " * 100, "at most 200 characters"),
    ],
)
def test_what_is_no_fault_is_refused_with_what_is_allowed_there(line, allowed):
    with pytest.raises(InputError) as refused:
        parse_fault(line, "--fault")
    text = str(refused.value)
    assert text.startswith("--fault")
    assert re.search(allowed, text), text
    assert "\x1b" not in text


@pytest.mark.parametrize(
    "wrong",
    [
        {"message": "nobody"},
        {"by_ms": (1, 1)},
        {"times": 0},
        {"probability": 0.0},
        {"probability": 1.5},
        {"probability": 1 / 3},
        {"probability": float("nan")},
        {"seed": -1},
    ],
)
def test_no_fault_can_be_made_that_no_line_says(wrong):
    with pytest.raises(ValueError, match=r"must|takes no"):
        MessageFault(**{"action": MessageAction.LOSE, "message": "any"} | wrong)


def test_the_table_has_every_fault_and_every_identifier_has_a_name():
    assert list(FAULT_TABLE) == [*MessageAction, *FaultName]
    single = {name: ids for name, ids in MESSAGES.items() if name != "any"}
    assert all(len(ids) == 1 for ids in single.values())
    assert MESSAGES["any"] == frozenset().union(*single.values()) == frozenset().union(*SENT_BY.values())
    assert {"RuntimeControl", "ControllerControl", "RuntimeBulk", "ControllerBulk"} <= set(single)


def test_the_manual_lists_the_table():
    page = (Path(__file__).parents[2] / "docs" / "hil.md").read_text(encoding="utf-8")
    for name, row in FAULT_TABLE.items():
        assert f"| `{name}` | {row.does} |" in page, name
    for name in MESSAGES:
        assert f"`{name}`" in page, name
