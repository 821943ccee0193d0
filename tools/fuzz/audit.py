"""Session logs: whatever stands in one, it is judged, shown and decided again without an exception.

A log is fuzzed as bytes, and as JSON whose chain, checksums and index were computed anew, for that is what a
forger hands in.
"""

import contextlib
import io
import json
import tempfile
from collections.abc import Iterator
from copy import deepcopy
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from mcap.writer import LIBRARY_IDENTIFIER, CompressionType, Writer
from rich.console import Console

from cutgate.runtime.audit import recovery
from cutgate.runtime.audit.chain import GENESIS, LINKED, ChainLink, covered, follow
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.heads import closing_head, recoverable_head
from cutgate.runtime.audit.inspect import Log, Status, read_log
from cutgate.runtime.audit.records import MODELS, AuditAttachment, AuditCheckpoint, AuditClose, AuditPermit
from cutgate.runtime.audit.replay import replay
from cutgate.runtime.audit.schema import schema_bytes
from cutgate.runtime.audit.tree import Tree
from cutgate.runtime.audit.writer import ENCODING, METADATA, PROFILE, SCHEMA_ENCODING, schema_name
from cutgate.runtime.review.show import print_story
from cutgate.runtime.review.story import story
from cutgate.runtime.verification import certified
from tests.logs import signature_of, signer_of
from tests.runtime.audit.build import LOG_ID, VERIFIER, TreesAgain, session_log
from tools.fuzz.harness import Family, choose, expect

Message = tuple[str, dict[str, Any]]

NO_FRAMES: Final = b""
"""A session that was made up has passed no bus."""
NASTY: Final[tuple[Any, ...]] = (
    10**400,
    -(10**30),
    1e999,
    -0.0,
    0,
    True,
    None,
    "",
    "\ud800",
    "\x1b[2J[bold]\n\0",
    "9" * 400,
    [],
    {},
    [[[[[]]]]],
    [None, 1, "x"],
    {"sec": 10**18, "nsec": 0},
    {"sec": -(10**400), "nsec": True},
    '{"guidance": {"translation_mm": [1e999, 1, 2], "yaw_deg": 1' + "0" * 400 + "}}",
    '{"path": {"tip_length_mm": 1' + "0" * 400 + "}}",
    "[" * 990 + "]" * 990,
    '{"a":' * 980 + "1" + "}" * 980,
)
"""Values that a field of a record does not have; some are JSON documents inside one."""


def check(data: bytes) -> None:
    """The first byte chooses: bytes as they stand, or a forged log."""
    how, rest = choose(data, (_raw, _forged))
    how(rest)


def _raw(data: bytes) -> None:
    found = scan(data)
    expect(found.mcap or bool(found.problems), "what is no log has a problem")
    expect(len(recoverable_head(io.BytesIO(data))) == 64, "a head is 32 bytes")
    with contextlib.suppress(ValueError):
        expect(len(closing_head(io.BytesIO(data))) == 64, "a head is 32 bytes")
    expect(
        sum(len(entry.data) for entry in found.attachments) <= len(data), "no attachment comes from nowhere"
    )
    judged(data)


def _forged(data: bytes) -> None:
    """Three bytes an edit: which record or attachment, where in it, and what it becomes."""
    messages, attachments = copied()
    edits = [data[at : at + 3].ljust(3, b"\0") for at in range(0, min(len(data), 30), 3)]
    for which, place, value in edits:
        if which % 2:
            edited(messages[which // 2 % len(messages)][1], place, deepcopy(NASTY[value % len(NASTY)]))
        else:
            name = sorted(attachments)[which // 2 % len(attachments)]
            attachments[name] = altered(attachments[name], place, value)
    judged(written(messages, attachments))


def copied() -> tuple[list[Message], dict[str, bytes]]:
    """Records and attachments of a session that was admitted and cut."""
    return [(topic, json.loads(content)) for topic, content in MESSAGES], dict(ATTACHMENTS)


def altered(data: bytes, place: int, value: int) -> bytes:
    """One byte in 256th parts of the way changed, or everything from there on missing."""
    at = len(data) * place // 256
    return data[:at] if value == 0 or not data else data[:at] + bytes([data[at] ^ value]) + data[at + 1 :]


def edited(content: dict[str, Any], place: int, value: Any) -> None:
    """Put a value somewhere into a record: at a key, inside a list or table, or into the document it carries."""
    keys = sorted(content)
    key = keys[place % len(keys)]
    inner = content[key]
    if isinstance(inner, dict) and inner and place & 128:
        edited(inner, place >> 1 & 127, value)
    elif isinstance(inner, list) and inner and isinstance(inner[0], dict) and place & 128:
        edited(inner[0], place >> 1 & 127, value)
    elif key == "document" and place & 64 and isinstance(inner, str) and inner.startswith('{"schema"'):
        document = json.loads(inner)
        edited(document, place * 7 % 256, value)
        content[key] = json.dumps(document)
    else:
        content[key] = value


def judged(data: bytes) -> Log:
    """Read, show and replay; a replay runs only where the log is one, as the command does."""
    log = read_log(data, NO_FRAMES, signature_of(data))
    expect((log.report.status is Status.OK) == (not log.report.reasons), "what is not OK has a reason")
    _recovered(log)
    json.dumps(told := story(log, Path("session.mcap"), None), default=str)
    print_story(Console(file=io.StringIO(), width=100), told)
    replay(log, certified.verify, verifier=VERIFIER)
    return log


def _recovered(log: Log) -> None:
    """A log that is cut and no worse has a copy that holds the same, is never OK, and has no copy itself."""
    if recovery.refused(log) is None:
        told = recovery.what_is_told(log, "cut.mcap", "ab" * 32, VERIFIER)
        copy = read_log(b"".join(recovery.copied(log, told)))
        expect(recovery.agrees(copy, log, told), "a copy holds what was whole, and is INCOMPLETE")
        expect(recovery.refused(copy) is not None, "a copy is not recovered again")


def written(messages: list[Message], attachments: dict[str, bytes]) -> bytes:
    """A log of these records, its links, digests, counts, checksums and index made to fit."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE, enable_data_crcs=True)
    writer.start(PROFILE, LIBRARY_IDENTIFIER)
    writer.add_metadata(METADATA, {"log_id": LOG_ID})
    for name, data in attachments.items():
        writer.add_attachment(0, 0, name, MEDIA_TYPES[name], data)
    channels: dict[str, int] = {}
    head, tree, trees = GENESIS, Tree(), TreesAgain(bytes.fromhex(LOG_ID))
    signer = signer_of(SESSION)
    assert signer is not None  # noqa: S101 - made here
    for number, (topic, content) in enumerate(messages):
        model = TOPICS[topic]
        if topic not in channels:
            schema = writer.register_schema(schema_name(model), SCHEMA_ENCODING, schema_bytes(model))
            channels[topic] = writer.register_channel(topic, ENCODING, schema)
        linked = content | {"prev": head.hex()} if topic.startswith(LINKED) else content
        if topic == AuditClose.TOPIC:
            linked = linked | {"message_count": len(messages)}
        if topic == AuditAttachment.TOPIC and content.get("name") in list(attachments):
            kept = attachments[content["name"]]
            linked = linked | {"sha256": sha256(kept).hexdigest(), "size": len(kept)}
        if topic == AuditPermit.TOPIC:
            linked = _named_again(linked, trees)
        if topic == AuditCheckpoint.TOPIC and (topic, content) in UNEDITED:
            note = signer.checkpoint(tree.size, tree.root)
            linked = linked | {"size": tree.size, "root": tree.root.hex(), "note": note}
        data = json.dumps(linked).encode()
        times = {"log_time": number, "publish_time": number, "sequence": number, "data": data}
        writer.add_message(channel_id=channels[topic], **times)
        link = covered(ChainLink(topic, ENCODING, schema_name(model), schema_bytes(model), **times))
        head = follow(head, link)
        tree.append(link)
        if content.get("disposition") == "authorised":
            trees.authorised(tree)
    writer.finish()
    return stream.getvalue()


def _named_again(content: dict[str, Any], trees: TreesAgain) -> dict[str, Any]:
    """A permit or start with the tree that this log has; one that was edited until it is none stays so."""
    with contextlib.suppress(ValueError, KeyError):
        again = trees.named_again(AuditPermit.model_validate_json(json.dumps(content)))
        return content | {name: getattr(again, name) for name in NAMED if content.get(name) is not None}
    return content


def _session() -> bytes:
    with tempfile.TemporaryDirectory() as directory:
        return session_log(Path(directory)).log.read_bytes()


NAMED: Final = ("log_size", "log_root", "record")
TOPICS: Final = {model.TOPIC: model for model in MODELS}
SESSION: Final = _session()
MESSAGES: Final = tuple((message.topic, message.link.data) for message in scan(SESSION).messages)
ATTACHMENTS: Final = {entry.name: entry.data for entry in scan(SESSION).attachments}
MEDIA_TYPES: Final = {entry.name: entry.media_type for entry in scan(SESSION).attachments}
UNEDITED: Final = [(topic, json.loads(data)) for topic, data in MESSAGES if topic == AuditCheckpoint.TOPIC]
COPY: Final = written(*copied())


def _seeds() -> Iterator[bytes]:
    """The session as it was written and written again, cut short, and every kind of record edited."""
    if any(
        read_log(log, NO_FRAMES, signature_of(log)).report.status is not Status.OK for log in (SESSION, COPY)
    ):
        raise ValueError("the example is no sound log")
    yield b"\0" + SESSION
    yield b"\0" + SESSION[: len(SESSION) // 2]
    yield b"\0" + SESSION[: len(SESSION) - 100]
    few = [message for message in copied()[0] if message[0] != AuditAttachment.TOPIC]
    yield b"\0" + written([*few[:3], few[-1]], {})
    yield b"\1"
    topics = [topic for topic, _ in MESSAGES]
    for topic in dict.fromkeys(topics):
        yield b"\1" + bytes([2 * topics.index(topic) + 1, 64, 14])
    for number in range(len(ATTACHMENTS)):
        yield b"\1" + bytes([2 * number, 128, 1])


FAMILY = Family(check, tuple(_seeds()))
