"""The normative page of the wire says what the program does, where that can be read out of the program."""

import re
from pathlib import Path

import pytest

from cutgate.config.constants import REGISTRATIONS_MAX
from cutgate.firmware_sim.rules import (
    ACKNOWLEDGE_RULES,
    OPEN_RULES,
    PERMIT_RULES,
    RESET_RULES,
    START_RULES,
    WITHDRAW_RULES,
)
from cutgate.protocol import records
from cutgate.protocol.wire import Record, layout

PAGE = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text(encoding="utf-8")
ORDER = dict(re.findall(r"^\| (\w+) \| ((?:[A-Z_]+(?:, )?)+) \|$", PAGE, re.MULTILINE))


@pytest.mark.parametrize(
    ("request_name", "rules"),
    [
        ("Open", OPEN_RULES),
        ("Acknowledge", ACKNOWLEDGE_RULES),
        ("Permit", PERMIT_RULES),
        ("Start", START_RULES),
        ("Reset", RESET_RULES),
        ("Withdraw", WITHDRAW_RULES),
    ],
)
def test_the_page_names_the_reasons_in_the_order_in_which_they_are_judged(request_name, rules):
    assert ORDER[request_name].split(", ") == [refusal.name for refusal, _ in rules]


def test_no_other_order_is_on_the_page():
    assert set(ORDER) == {"Open", "Acknowledge", "Permit", "Start", "Reset", "Withdraw"}


CONTROL = [kind for kind in records.RECORDS.values() if kind.CHANNEL is records.Channel.CONTROL]


@pytest.mark.parametrize("kind", CONTROL, ids=lambda kind: kind.__name__)
def test_every_control_record_is_on_the_page_with_its_fields_in_their_order(kind: type[Record]):
    (body,) = re.findall(
        rf"^\| 0x{kind.TYPE:02X} \| {kind.__name__}\b[^|]*\|[^|]*\|(.*)\|$", PAGE, re.MULTILINE
    )
    said = body.split(", ")
    assert len(said) == len(layout(kind)) or body.strip() == ""
    for text, (name, _) in zip(said, layout(kind), strict=False):
        short = re.sub(r"_(digest|version|u)$", "", name).replace("_", " ")
        assert text.replace("_", " ").strip().startswith(short), name


def test_the_room_for_registrations_is_on_the_page():
    assert f"room for {REGISTRATIONS_MAX} registrations" in PAGE.replace("\n", " ")


def test_the_version_is_on_the_page():
    assert f"protocol_version u16 ({records.PROTOCOL_VERSION})" in PAGE
