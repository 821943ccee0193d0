"""A forged log is judged, shown and replayed without an exception: values that no session writes, one by one."""

import json

import pytest

from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.replay import ReplayOutcome, replay
from tools.fuzz import audit

HUGE = 10**400
VERDICT = "/audit/verdict"


def forged(topic: str, *place: str, value: object) -> bytes:
    """The session with this value at this place of the first record of a topic; a document is text inside it."""
    messages, attachments = audit.copied()
    content = next(content for found, content in messages if found == topic)
    if place[0] == "document":
        document = json.loads(content["document"])
        put(document, place[1:], value)
        content["document"] = json.dumps(document)
    else:
        put(content, place, value)
    return audit.written(messages, attachments)


def put(table: dict, place: tuple[str, ...], value: object) -> None:
    for key in place[:-1]:
        table = table[key]
    table[place[-1]] = value


def test_the_session_written_again_is_sound_and_identical():
    log = audit.judged(audit.COPY)
    assert log.report.status is Status.OK
    assert replay(log, audit.certified.verify, verifier=audit.VERIFIER).outcome is ReplayOutcome.IDENTICAL


@pytest.mark.parametrize(
    ("topic", "place", "value"),
    [
        ("/audit/open", ("monotonic",), {"sec": HUGE, "nsec": 0}),
        ("/audit/decision", ("monotonic",), {"sec": -HUGE, "nsec": 0}),
        ("/audit/open", ("utc",), {"sec": 10**18, "nsec": 0}),
        ("/audit/open", ("utc",), {"sec": -(10**18), "nsec": 0}),
        ("/audit/boundary", ("certified",), HUGE),
        ("/audit/approach", ("entry_um",), HUGE),
        ("/audit/verdict", ("document", "path", "tip_length_mm"), HUGE),
        ("/audit/verdict", ("document", "deadband", "arm_mm"), 0),
        ("/audit/verdict", ("document", "path", "poses"), HUGE),
        ("/audit/verdict", ("document",), json.dumps({"a": HUGE})),
        ("/audit/verdict", ("elapsed_ms",), 1e999),
        ("/audit/permit", ("record",), "zz"),
    ],
)
def test_a_value_no_session_writes_is_no_exception(topic, place, value):
    if place == ("document",):
        messages, attachments = audit.copied()
        next(content for found, content in messages if found == topic)["document"] = value
        data = audit.written(messages, attachments)
    else:
        data = forged(topic, *place, value=value)
    audit.judged(data)


def test_documents_of_any_depth_are_no_exception():
    """Deeper than one reader's recursion, less deep than another's; alone, and inside a whole document."""
    document = json.loads(json.loads(dict(audit.MESSAGES)[VERDICT])["document"])
    for form in ("HERE", json.dumps(document | {"more": "HERE"})):
        for depth in (*range(870, 1000, 9), 5000):
            messages, attachments = audit.copied()
            verdict = next(content for topic, content in messages if topic == VERDICT)
            deep = '{"a":' * depth + "1" + "}" * depth
            verdict["document"] = form.replace('"HERE"', deep).replace("HERE", deep)
            audit.judged(audit.written([*messages[:3], (VERDICT, verdict), messages[-1]], attachments))


def test_no_length_in_a_log_is_believed():
    """Every 8-byte stretch of the session's frame and of its first records set to the largest number there is."""
    data = audit.SESSION
    for at in (*range(8, 200, 3), *range(200, len(data), 997)):
        changed = data[:at] + b"\xff" * 8 + data[at + 8 :]
        found = scan(changed)
        assert sum(len(entry.data) for entry in found.attachments) <= len(data)
