"""Attacks on logs, as a table: what the attacker holds, what he does, and what ``audit verify`` says of it.

``docs/attacks.md`` is made from this table, and ``test_attacks.py`` plays each row on a folder of four sessions. In the
second and the third the arm was started; the third is the one that is attacked where nothing else is said: the operator
stopped it, and one more session followed. The page gives three answers: of the attacked log alone, of the same with the
first session's key pinned, and of the whole folder with that key pinned.
"""

import io
import json
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from cutgate.runtime.audit import records
from cutgate.runtime.audit.chain import GENESIS, ChainLink, advance, covered
from cutgate.runtime.audit.container.raw import MAGIC
from cutgate.runtime.audit.container.scan import scan
from cutgate.runtime.audit.container.stored import StoredAttachment
from cutgate.runtime.audit.directory import HEAD
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.signing.log_key import LogKey
from cutgate.runtime.audit.signing.signatures import KEY_FIELDS
from cutgate.runtime.audit.signing.signer import Sidecar, Signer, sidecar_of
from cutgate.runtime.audit.tree import Tree
from tests.logs import key_of, signature_of
from tests.runtime.audit.build import TreesAgain, decision
from tests.runtime.audit.folders import folder_of, started_tree, witness_of, write_session

OK, INCOMPLETE, TAMPERED = Status.OK, Status.INCOMPLETE, Status.TAMPERED
FIRST, STARTED, ATTACKED, LAST = range(4)
"""The four sessions."""
STOPPED: Final = (
    records.AuditOperator(word="stop", accepted=True),
    decision(9, event="Operator stop", from_state="cutting", to_state="stopped", first_out="OPERATOR_STOP"),
)
"""How the attacked session ended."""


class Holds(StrEnum):
    """What the attacker has."""

    FOLDER = "the folder and the programs"
    NEXT = "also a copy of the key file"
    OWN = "the key of that very session"


def sessions(directory: Path) -> list[Path]:
    """The four sessions, as they were written."""
    paths = folder_of(directory, 2, started=(STARTED,))
    for number in (ATTACKED, LAST):
        seen = witness_of(number - 1, {number - 1: started_tree(paths[-1])})
        started = number == ATTACKED
        behind = STOPPED if started else ()
        paths.append(write_session(directory, number, start=started, seen=seen, behind=behind))
    return paths


@dataclass
class Scene:
    """A folder that an attacker writes to.

    Attributes:
        folder: of logs.
        logs: the sessions' logs, in their order.
        at: the number of the log that is judged by itself.
    """

    folder: Path
    logs: list[Path]
    at: int = ATTACKED

    def key(self, number: int) -> LogKey:
        """The key that has signed a session."""
        return key_of(self.logs[number].read_bytes())

    def remove(self, number: int) -> None:
        """Log, raw frames and signature."""
        for path in self.files(number):
            path.unlink()

    def files(self, number: int) -> tuple[Path, Path, Path]:
        """Log, raw frames and signature."""
        log = self.logs[number]
        return log, log.with_suffix(".candump.log"), sidecar_of(log)

    def sign(self, number: int, key: LogKey | None = None) -> None:
        """Put the signature of what stands there now beside it: by the log's own key, or by another."""
        data = self.logs[number].read_bytes()
        signed = signature_of(data) if key is None else _sidecar(data, Signer(key, _opened(data)["log_id"]))
        assert signed is not None
        sidecar_of(self.logs[number]).write_bytes(signed)


Links = list[ChainLink]
Change = Callable[[Links], Iterable[ChainLink]]


def _opened(data: bytes) -> dict[str, Any]:
    return json.loads(scan(data).messages[0].link.data)


def _sidecar(data: bytes, signer: Signer) -> bytes:
    _, tree = hashes(data)
    return signer.sidecar(tree.size, tree.root, len(data), sha256(data).digest())


def changed(link: ChainLink, **fields: Any) -> ChainLink:
    """The record with other fields; None takes one away."""
    content = {**json.loads(link.data), **fields}
    kept = {name: value for name, value in content.items() if value is not None}
    data = json.dumps(kept, ensure_ascii=False, separators=(",", ":"))
    return replace(link, data=data.encode())


def rewritten(
    data: bytes,
    change: Change = lambda links: links,
    *,
    chain: bool = True,
    key: LogKey | None = None,
    attached: Callable[[StoredAttachment], bytes] = lambda entry: entry.data,
    log_id: str | None = None,
) -> bytes:
    """The log written again by the stock writer.

    Args:
        data: the log.
        change: what becomes of its records.
        chain: links, sequence and count are made to fit.
        key: signs all checkpoints anew; None where they stay as they are.
        attached: what becomes of an attachment.
        log_id: another one in the metadata.
    """
    found = scan(data)
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE, enable_data_crcs=True)
    writer.start(found.header.profile, found.header.library)
    for entry in found.metadata:
        named = {} if log_id is None else {"log_id": log_id}
        writer.add_metadata(entry.name, entry.metadata | named)
    for entry in found.attachments:
        writer.add_attachment(
            entry.create_time, entry.log_time, entry.name, entry.media_type, attached(entry)
        )
    channels: dict[tuple[str, ...], int] = {}
    links = list(change([message.link for message in found.messages]))
    for link in _fitted(links, key) if chain else links:
        if link.topic not in channels:
            schema = writer.register_schema(link.schema_name, "jsonschema", link.schema)
            channels[link.topic] = writer.register_channel(link.topic, link.encoding, schema)
        writer.add_message(channels[link.topic], link.log_time, link.data, link.publish_time, link.sequence)
    writer.finish()
    return stream.getvalue()


def _fitted(links: Links, key: LogKey | None) -> Iterator[ChainLink]:
    """Numbers, links and count made to fit; with a key also checkpoints, and what a start says of the tree."""
    log_id = json.loads(links[0].data)["log_id"]
    signer = None if key is None else Signer(key, log_id)
    head, tree, trees = GENESIS, Tree(), TreesAgain(bytes.fromhex(log_id), permit=bytes(32))
    for number, old in enumerate(links):
        link, fields = replace(old, sequence=number), {"prev": head.hex()}
        if link.topic == records.AuditClose.TOPIC:
            fields |= {"message_count": len(links)}
        elif signer is not None and link.topic == records.AuditCheckpoint.TOPIC:
            note = signer.checkpoint(tree.size, tree.root)
            fields |= {"size": tree.size, "root": tree.root.hex(), "note": note}
        elif signer is not None and link.topic == records.AuditPermit.TOPIC:
            named = trees.named_again(records.AuditPermit.model_validate_json(link.data))
            fields |= {"log_size": named.log_size, "log_root": named.log_root, "record": named.record}
        link = changed(link, **fields) if link.topic.startswith("/audit/") else link
        head = advance(head, link)
        tree.append(covered(link))
        if b'"disposition":"authorised"' in link.data:
            trees.authorised(tree)
        yield link


def hashes(data: bytes) -> tuple[bytes, Tree]:
    """The chain's head and the tree of all records of a log."""
    head, tree = GENESIS, Tree()
    for message in scan(data).messages:
        head = advance(head, message.link)
        tree.append(message.covered)
    return head, tree


# ---------------------------------------------------------------- what an attacker does


def on_log(change: Change, **options: Any) -> Callable[[Scene], None]:
    """The log written again, the signature beside it left as it is."""

    def act(scene: Scene) -> None:
        path = scene.logs[scene.at]
        path.write_bytes(rewritten(path.read_bytes(), change, **options))

    return act


def unsigned_then(act: Callable[[Scene], None]) -> Callable[[Scene], None]:
    """As this, and the signature beside the log removed."""

    def both(scene: Scene) -> None:
        act(scene)
        sidecar_of(scene.logs[scene.at]).unlink()

    return both


def of(at: int, act: Callable[[Scene], None]) -> Callable[[Scene], None]:
    """The same on another session."""

    def there(scene: Scene) -> None:
        scene.at = at
        act(scene)

    return there


def edit(topic: str, **fields: Any) -> Change:
    """The first record of this topic, changed."""

    def change(links: Links) -> Iterator[ChainLink]:
        first = next(number for number, link in enumerate(links) if link.topic == topic)
        for number, link in enumerate(links):
            yield changed(link, **fields) if number == first else link

    return change


def without(*topics: str) -> Change:
    return lambda links: [link for link in links if link.topic not in topics]


def left_out(number: int) -> Change:
    return lambda links: [*links[:number], *links[number + 1 :]]


def inserted(number: int) -> Change:
    """A word that the operator never said."""

    def change(links: Links) -> Links:
        said = next(link for link in links if link.topic == records.AuditOperator.TOPIC)
        return [*links[:number], changed(said, word="confirm WITNESS"), *links[number:]]

    return change


def swapped(number: int) -> Change:
    return lambda links: [*links[:number], links[number + 1], links[number], *links[number + 2 :]]


def doubled(number: int) -> Change:
    return lambda links: [*links[: number + 1], *links[number:]]


def cut_and_resumed(links: Links) -> Links:
    """Cut behind the checkpoint that the start names, and gone on with to a close record."""
    return [*links[:STARTED_AT], links[-1]]


def cut_and_written_on(links: Links) -> Links:
    """The same, with a word of the operator's before it."""
    said = next(link for link in links if link.topic == records.AuditOperator.TOPIC)
    return [*links[:STARTED_AT], said, links[-1]]


STARTED_AT: Final = 9
"""Number of the record that says that the start was sent; the checkpoint that it names stands before it."""


def cut_removed(links: Links) -> Links:
    """From the start on all but the close record left out, which tells another end."""
    begin = next(number for number, link in enumerate(links) if link.topic == records.AuditPermit.TOPIC)
    return [*links[:begin], changed(links[-1], final_state="refused", outcome="the operator ended it")]


def heartbeat_lost(links: Links) -> Iterator[ChainLink]:
    """The operator's word left out, a lost heartbeat in its place wherever a cause is named."""
    for link in links:
        if link.topic == records.AuditOperator.TOPIC:
            continue
        if b"OPERATOR_STOP" in link.data:
            yield changed(link, event="Heartbeat lost", first_out="HEARTBEAT_LOST")
        else:
            yield link


def stripped(links: Links) -> Iterator[ChainLink]:
    """Made to look as logs did before they were signed."""
    gone = dict.fromkeys((*KEY_FIELDS, "previous_size", "previous_root", "previous_epoch"))
    for link in links:
        if link.topic == records.AuditOpen.TOPIC:
            yield changed(link, **gone)
        elif link.topic == records.AuditPermit.TOPIC:
            yield changed(link, log_size=None, log_root=None, record=None)
        elif link.topic != records.AuditCheckpoint.TOPIC:
            yield link


def resigned(scene: Scene, change: Change, key: LogKey, **opened: Any) -> None:
    """Written again and signed whole, with a key that record 0 then names."""
    path = scene.logs[scene.at]
    named = {"public_key": key.public.public.hex(), "series": key.series.hex(), "epoch": key.epoch}
    certificate = {"certificate": key.certificate.hex() if key.certificate else None}
    opens = edit(records.AuditOpen.TOPIC, **named, **certificate, **opened)
    old = path.read_bytes()
    path.write_bytes(rewritten(old, lambda links: change(list(opens(links))), key=key))
    scene.sign(scene.at, key)


def _drawn(scene: Scene, **changes: Any) -> LogKey:
    """A key of the attacker's own, under series and epoch of the attacked session."""
    own = scene.key(scene.at)
    values: dict[str, Any] = {
        "series": own.series,
        "epoch": own.epoch,
        "certificate": own.certificate,
    } | changes
    return LogKey(values["series"], values["epoch"], bytes(range(32)), values["certificate"])


def by_another_key(scene: Scene) -> None:
    resigned(scene, heartbeat_lost, _drawn(scene))


def enrolled_by_another_key(scene: Scene) -> None:
    resigned(scene, heartbeat_lost, _drawn(scene, certificate=None), enrolled="no session before")


def of_another_series(scene: Scene) -> None:
    """A series of the attacker's own certifies the key."""
    theirs = LogKey(b"another series..", scene.key(scene.at).epoch - 1, bytes(range(1, 33)))
    resigned(scene, heartbeat_lost, theirs.following(bytes(range(32))))


def by_the_next_key(scene: Scene) -> None:
    """The past rewritten, and signed with the key that came after it: journald's CVE-2023-31439."""
    resigned(scene, heartbeat_lost, scene.key(LAST))


def by_the_next_key_under_its_epoch(scene: Scene) -> None:
    """The same, the later key named under the epoch of the session."""
    later = scene.key(LAST)
    own = scene.key(scene.at)
    resigned(scene, heartbeat_lost, LogKey(own.series, own.epoch, later.secret, own.certificate))


def checkpoints_by_the_next_key(scene: Scene) -> None:
    """Checkpoints and signature alone signed anew with it; record 0 still names the session's key."""
    path, later = scene.logs[scene.at], scene.key(LAST)
    path.write_bytes(rewritten(path.read_bytes(), heartbeat_lost, key=later))
    scene.sign(scene.at, later)


def by_its_own_key(scene: Scene) -> None:
    path, own = scene.logs[scene.at], scene.key(scene.at)
    path.write_bytes(rewritten(path.read_bytes(), heartbeat_lost, key=own))
    scene.sign(scene.at)


def last_by_its_own_key(scene: Scene) -> None:
    """The last session, which nobody else has seen: HEAD is made to fit as well."""
    scene.at = LAST
    path, own = scene.logs[LAST], scene.key(LAST)
    change = edit(records.AuditDecision.TOPIC, event="another event")
    path.write_bytes(rewritten(path.read_bytes(), change, key=own))
    scene.sign(LAST)
    head_made_to_fit(scene, LAST)


def head_made_to_fit(scene: Scene, number: int, key: LogKey | None = None) -> None:
    """HEAD with size, root and head of this log as it stands; nobody signs HEAD."""
    path, log = scene.folder / HEAD, scene.logs[number]
    head, tree = hashes(log.read_bytes())
    fitted = {"log": log.name, "size": tree.size, "root": tree.root.hex(), "head": head.hex()}
    epoch = (key or scene.key(number)).epoch
    path.write_text(json.dumps(json.loads(path.read_bytes()) | fitted | {"epoch": epoch}))


def raw_frames(scene: Scene) -> None:
    frames = scene.logs[scene.at].with_suffix(".candump.log")
    frames.write_bytes(frames.read_bytes().replace(b"0001", b"0002", 1))


def bytes_replaced(old: bytes, new: bytes) -> Callable[[Scene], None]:
    """The last place in the file where this stands: in the summary, if it is there."""

    def act(scene: Scene) -> None:
        path = scene.logs[scene.at]
        before, found, behind = path.read_bytes().rpartition(old)
        assert found
        path.write_bytes(before + new + behind)

    return act


def outside_a_chunk(scene: Scene) -> None:
    """Before the end of the data, where a linear reader shows it and an indexed one does not."""
    path = scene.logs[scene.at]
    data = path.read_bytes()
    at = next(begin for opcode, begin, _ in _records(data) if opcode == Opcode.DATA_END)
    message = (1).to_bytes(2, "little") + (99).to_bytes(4, "little") + bytes(16) + b"{}"
    path.write_bytes(data[:at] + struct.pack("<BQ", Opcode.MESSAGE, len(message)) + message + data[at:])


def torn(chunks: int) -> Callable[[Scene], None]:
    """Cut behind so many chunks, as a crash leaves it: no summary, no signature."""

    def act(scene: Scene) -> None:
        path = scene.logs[scene.at]
        data = path.read_bytes()
        end = [end for opcode, _, end in _records(data) if opcode == Opcode.CHUNK][chunks - 1]
        path.write_bytes(data[:end])
        sidecar_of(path).unlink()

    return act


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Kind, begin and end of each record of the file."""
    at = len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, size = struct.unpack_from("<BQ", data, at)
        yield opcode, at, at + 9 + size
        at += 9 + size


def index_of_a_chunk(scene: Scene) -> None:
    """A time in the first of them."""
    path = scene.logs[scene.at]
    data = bytearray(path.read_bytes())
    at = next(begin for opcode, begin, _ in _records(data) if opcode == Opcode.MESSAGE_INDEX)
    data[at + 9 + 2 + 4] ^= 1
    path.write_bytes(data)


def close_record(**fields: Any) -> Callable[[Scene], None]:
    """The last record changed, which no checkpoint signs, and the signature that does sign it removed."""
    return unsigned_then(on_log(edit(records.AuditClose.TOPIC, **fields)))


def called_a_crash(act: Callable[[Scene], None]) -> Callable[[Scene], None]:
    """The same, and HEAD says that the session was never closed."""

    def both(scene: Scene) -> None:
        act(scene)
        path = scene.folder / HEAD
        path.write_text(json.dumps(json.loads(path.read_bytes()) | {"state": "open"}))

    return both


def sidecar_of_another(number: int) -> Callable[[Scene], None]:
    def act(scene: Scene) -> None:
        sidecar_of(scene.logs[scene.at]).write_bytes(sidecar_of(scene.logs[number]).read_bytes())

    return act


def notes_exchanged(scene: Scene) -> None:
    path = sidecar_of(scene.logs[scene.at])
    found = Sidecar.parse(path.read_bytes())
    path.write_bytes(Sidecar(found.file, found.checkpoint).encode())


def checkpoint_of(pick: Callable[[Scene, Links], dict[str, Any]]) -> Callable[[Scene], None]:
    """The last checkpoint replaced by what another says, the chain made to fit."""

    def act(scene: Scene) -> None:
        def change(links: Links) -> Links:
            told = pick(scene, links)
            fields = {name: told[name] for name in ("note", "size", "root")}
            return [*links[:-2], changed(links[-2], **fields), links[-1]]

        on_log(change)(scene)

    return act


def _earlier(_scene: Scene, links: Links) -> dict[str, Any]:
    return json.loads(next(link for link in links if link.topic == records.AuditCheckpoint.TOPIC).data)


def _of_another_log(scene: Scene, _links: Links) -> dict[str, Any]:
    found = scan(scene.logs[STARTED].read_bytes()).messages
    return json.loads(found[-2].link.data)


def erased(number: int) -> Callable[[Scene], None]:
    return lambda scene: scene.remove(number)


def erased_with_head(scene: Scene) -> None:
    """HEAD made to name the session before it."""
    scene.remove(LAST)
    head_made_to_fit(scene, ATTACKED)


def and_another_session(scene: Scene) -> None:
    """The key's file was left: its epoch is ahead."""
    erased_with_head(scene)
    scene.logs.append(write_session(scene.folder, LAST + 1))
    scene.at = LAST + 1


def swapped_files(scene: Scene) -> None:
    """Two sessions under each other's names."""
    kept = [path.read_bytes() for path in scene.files(STARTED)]
    for path, other in zip(scene.files(STARTED), scene.files(ATTACKED), strict=True):
        path.write_bytes(other.read_bytes())
    for path, data in zip(scene.files(ATTACKED), kept, strict=True):
        path.write_bytes(data)


def second_log(scene: Scene) -> None:
    """A second log of the attacked session's epoch, signed with its own key, lies beside the first."""
    kept = [path.read_bytes() for path in scene.files(scene.at)]
    by_its_own_key(scene)
    for path, data in zip(scene.files(scene.at), kept, strict=True):
        other = path.with_name("20260101T000000Z-" + path.name.partition("-")[2])
        other.write_bytes(path.read_bytes())
        path.write_bytes(data)


def copied(scene: Scene) -> None:
    for path in scene.files(scene.at):
        path.with_name("2027" + path.name).write_bytes(path.read_bytes())


def put_back(scene: Scene) -> None:
    """The two last sessions gone, HEAD and all else as they were before them."""
    scene.remove(LAST)
    scene.remove(ATTACKED)
    head_made_to_fit(scene, STARTED)
    scene.at = STARTED


def head_of_before(scene: Scene) -> None:
    head_made_to_fit(scene, ATTACKED)


def forged_from_nothing(scene: Scene) -> None:
    """A session that never was, behind the last one, with a key certified by the key file's copy."""
    path = scene.logs[LAST]
    key = _drawn(scene, epoch=scene.key(LAST).epoch + 1, certificate=None)
    _next_session(scene, path, key)


def certified_from_the_key_file(scene: Scene) -> None:
    """The same with the very key that the next session would have had."""
    held = scene.key(LAST).following(bytes(range(32)))
    _next_session(scene, scene.logs[LAST], held)


def _next_session(scene: Scene, path: Path, key: LogKey) -> None:
    head, tree = hashes(path.read_bytes())
    told = {
        "log_id": "ee" * 16,
        "public_key": key.public.public.hex(),
        "epoch": key.epoch,
        "certificate": key.certificate.hex() if key.certificate else None,
        "previous_log": path.name,
        "previous_head": head.hex(),
        "previous_size": tree.size,
        "previous_root": tree.root.hex(),
        "previous_epoch": scene.key(LAST).epoch,
        "enrolled": None if key.certificate else "no session before",
    }
    hour_ns = 3_600_000_000_000

    def change(links: Links) -> Iterator[ChainLink]:
        for number, link in enumerate(links):
            utc = json.loads(link.data)["utc"]
            later = changed(link, utc={"sec": utc["sec"] + 3600, "nsec": utc["nsec"]})
            later = replace(later, log_time=link.log_time + hour_ns, publish_time=link.publish_time + hour_ns)
            yield changed(later, **told) if number == 0 else later

    data = rewritten(path.read_bytes(), change, key=key, log_id="ee" * 16)
    new = path.with_name("20290101T000000Z-eeeeeeee.mcap")
    new.write_bytes(data)
    new.with_suffix(".candump.log").write_bytes(path.with_suffix(".candump.log").read_bytes())
    scene.logs.append(new)
    scene.at = len(scene.logs) - 1
    scene.sign(scene.at, key)
    head_made_to_fit(scene, scene.at, key)


# ---------------------------------------------------------------- the table


@dataclass(frozen=True)
class Attack:
    """A row.

    Attributes:
        what: he does, in words.
        holds: what he has.
        act: does it.
        alone: what the attacked log is, verified by itself; None where it is gone.
        pinned: the same with the first session's key pinned.
        folder: the whole folder with it pinned.
        named: begins or stands in what is said: the first reason of the log, or the code of a finding in the folder.
    """

    what: str
    act: Callable[[Scene], None]
    alone: Status | None
    pinned: Status | None
    folder: Status
    named: str
    holds: Holds = Holds.FOLDER


T3: Final = (TAMPERED, TAMPERED, TAMPERED)
I3: Final = (INCOMPLETE, INCOMPLETE, INCOMPLETE)
I2T: Final = (INCOMPLETE, INCOMPLETE, TAMPERED)
FIND_BY_KEY: Final = (OK, TAMPERED, TAMPERED)
"""Signed whole by a key of the attacker's own: only who has the right key from elsewhere can tell."""
NOT_ALONE: Final = (OK, OK, TAMPERED)
"""Nothing of the log by itself is wrong; what stands around it tells."""
NOT_FOUND: Final = (OK, OK, OK)
GONE_T: Final = (None, None, TAMPERED)
OPERATOR, CLOSE = records.AuditOperator.TOPIC, records.AuditClose.TOPIC

ATTACKS: Final[dict[str, tuple[Attack, ...]]] = {
    "One record, with the stock MCAP writer": (
        Attack("edit a record", on_log(edit(OPERATOR, word="hold"), chain=False), *T3, "record 13"),
        Attack(
            "edit a record, chain anew", on_log(edit(OPERATOR, word="hold")), *T3, "record 11 is the first"
        ),
        Attack("delete a record", on_log(left_out(4), chain=False), *T3, "record 4"),
        Attack("delete a record, chain anew", on_log(left_out(4)), *T3, "record 2 is the first"),
        Attack("insert a record", on_log(inserted(4), chain=False), *T3, "record 4"),
        Attack("insert a record, chain anew", on_log(inserted(4)), *T3, "record 2 is the first"),
        Attack("swap two records", on_log(swapped(3), chain=False), *T3, "record 3"),
        Attack("swap two records, chain anew", on_log(swapped(3)), *T3, "record 2 is the first"),
        Attack("duplicate a record", on_log(doubled(4), chain=False), *T3, "record 5"),
        Attack("duplicate a record, chain anew", on_log(doubled(4)), *T3, "record 2 is the first"),
        Attack("duplicate a checkpoint, chain anew", on_log(doubled(5)), *T3, "record 5 is the first"),
    ),
    "What no record covers": (
        Attack(
            "an attachment's content",
            on_log(lambda links: links, attached=lambda _entry: b"other"),
            *T3,
            "attachment 0",
        ),
        Attack("a chunk's index", index_of_a_chunk, *T3, "the index at offset"),
        Attack(
            "the summary alone",
            bytes_replaced(b"/audit/open", b"/audit/opem"),
            *T3,
            "the summary is not that",
        ),
        Attack(
            "the same records in one chunk",
            on_log(lambda links: links),
            TAMPERED,
            TAMPERED,
            TAMPERED,
            "its file is not the one",
        ),
        Attack("a record outside a chunk", outside_a_chunk, *T3, "does not belong"),
        Attack("a byte of the raw frames", raw_frames, *T3, "raw frames"),
        Attack(
            "the same records in one chunk, signature gone",
            unsigned_then(on_log(lambda links: links)),
            *I3,
            "is not beside it",
        ),
    ),
    "The end of a log": (
        Attack("cut before the start was sent, signature gone", torn(2), *I2T, "cut-off"),
        Attack("cut behind the start, signature gone", torn(4), *I2T, "cut-off"),
        Attack(
            "cut behind a checkpoint, and records put there",
            on_log(cut_and_written_on),
            *T3,
            "record 8 is the first",
        ),
        Attack(
            "cut behind a checkpoint, and records put there, signature gone",
            unsigned_then(on_log(cut_and_written_on)),
            *T3,
            "no checkpoint signs",
        ),
        Attack(
            "cut behind a checkpoint, a close record put there",
            on_log(cut_and_resumed),
            *T3,
            "record 8 is the first",
        ),
        Attack(
            "cut behind a checkpoint, a close record put there, signature gone",
            unsigned_then(on_log(cut_and_resumed)),
            *I2T,
            "link-differs",
        ),
        Attack(
            "the close record changed, signature gone",
            close_record(final_state="refused"),
            *I2T,
            "link-differs",
        ),
        Attack(
            "the close record gone, with the signature",
            unsigned_then(on_log(without(CLOSE))),
            *I2T,
            "cut-off",
        ),
        Attack(
            "the last session's close record changed, signature gone",
            of(LAST, close_record(final_state="x")),
            *I2T,
            "head-differs",
        ),
        Attack(
            "the last session cut and called a crash in HEAD",
            of(LAST, called_a_crash(torn(2))),
            *I3,
            "crashed-last",
        ),
        Attack(
            "the last session's close record changed, signature gone, called a crash in HEAD",
            of(LAST, called_a_crash(close_record(final_state="x"))),
            *I3,
            "crashed-last",
        ),
        Attack("the last session cut, HEAD left", of(LAST, torn(2)), *I2T, "cut-off"),
    ),
    "Signatures": (
        Attack(
            "all checkpoints taken out",
            on_log(without(records.AuditCheckpoint.TOPIC)),
            *T3,
            "no checkpoint signs",
        ),
        Attack(
            "made to look unsigned, as before 0.2",
            unsigned_then(on_log(stripped)),
            INCOMPLETE,
            TAMPERED,
            TAMPERED,
            "old-form",
        ),
        Attack("a checkpoint of another size", checkpoint_of(_earlier), *T3, "it signs another tree"),
        Attack("a checkpoint of another log", checkpoint_of(_of_another_log), *T3, "no signature of the key"),
        Attack(
            "signature beside it gone",
            lambda scene: sidecar_of(scene.logs[scene.at]).unlink(),
            *I3,
            "is not beside it",
        ),
        Attack("signature of another session", sidecar_of_another(STARTED), *T3, "is not this log's"),
        Attack("its two notes exchanged", notes_exchanged, *T3, "is not this log's"),
        Attack(
            "signature emptied",
            lambda scene: sidecar_of(scene.logs[scene.at]).write_bytes(b""),
            *T3,
            "cannot be read",
        ),
    ),
    "Other keys": (
        Attack("rewritten, signed with another key", by_another_key, *FIND_BY_KEY, "certificate-wrong"),
        Attack(
            "rewritten, signed with another key that is called enrolled",
            enrolled_by_another_key,
            *FIND_BY_KEY,
            "key-not-certified",
        ),
        Attack("a key that another series certifies", of_another_series, *FIND_BY_KEY, "foreign"),
        Attack("signed with the key of the next epoch", by_the_next_key, *FIND_BY_KEY, "doubled", Holds.NEXT),
        Attack(
            "signed with the key of the next epoch under its own",
            by_the_next_key_under_its_epoch,
            *FIND_BY_KEY,
            "certificate-wrong",
            Holds.NEXT,
        ),
        Attack(
            "only checkpoints and signature by the key of the next epoch",
            checkpoints_by_the_next_key,
            *T3,
            "no signature of the key",
            Holds.NEXT,
        ),
        Attack(
            "a session that never was, with a key that nobody certified",
            forged_from_nothing,
            *FIND_BY_KEY,
            "key-not",
        ),
        Attack(
            "a session that never was, signed with the copied key, HEAD made to fit",
            certified_from_the_key_file,
            *NOT_FOUND,
            "",
            Holds.NEXT,
        ),
    ),
    "Sessions": (
        Attack("the last session erased", of(LAST, erased(LAST)), *GONE_T, "head-log-missing"),
        Attack("a session in the middle erased", erased(ATTACKED), *GONE_T, "epoch-missing"),
        Attack(
            "the last session erased, HEAD made to fit, no session since",
            of(LAST, erased_with_head),
            None,
            None,
            OK,
            "",
        ),
        Attack(
            "the last session erased, HEAD made to fit, another session run",
            and_another_session,
            *FIND_BY_KEY,
            "epoch-missing",
        ),
        Attack("HEAD as it was before the last session", head_of_before, *NOT_ALONE, "head-old"),
        Attack("HEAD gone", lambda scene: (scene.folder / HEAD).unlink(), OK, OK, INCOMPLETE, "head-missing"),
        Attack("two sessions under each other's names", swapped_files, *NOT_ALONE, "link-differs"),
        Attack(
            "a second log of the session, signed with its key", second_log, *NOT_ALONE, "doubled", Holds.OWN
        ),
        Attack("a copy under another name", copied, *NOT_ALONE, "copy"),
        Attack("folder and HEAD put back to before two sessions, no session since", put_back, *NOT_FOUND, ""),
    ),
    "A session told otherwise": (
        Attack("the cut removed", on_log(cut_removed), *T3, "record 5 is the first"),
        Attack("the cut removed, signature gone", unsigned_then(on_log(cut_removed)), *I2T, "link-differs"),
        Attack(
            "the operator's stop made a lost heartbeat", on_log(heartbeat_lost), *T3, "record 11 is the first"
        ),
        Attack(
            "stop made a lost heartbeat, signed with the session's key, the next session there",
            by_its_own_key,
            *NOT_ALONE,
            "link-differs",
            Holds.OWN,
        ),
        Attack(
            "the last session rewritten with its own key before anyone saw its root, HEAD made to fit",
            last_by_its_own_key,
            *NOT_FOUND,
            "",
            Holds.OWN,
        ),
    ),
}

JOURNALD: Final[dict[str, tuple[str, str, tuple[str, ...]]]] = {
    "CVE-2023-31437": (
        (
            "a sealed log can be modified so that part of it is not shown and the verification still finds no fault: it skips "
            "what it does not reach"
        ),
        (
            "Every byte of the file is accounted for, two ways of reading it must agree, and the signature of the closed file "
            "covers index and summary."
        ),
        ("a chunk's index", "the summary alone", "a record outside a chunk", "an attachment's content"),
    ),
    "CVE-2023-31438": (
        "a sealed log can be truncated and written on, and checking finds no fault: an epoch without a seal is none",
        (
            "Behind the last checkpoint stands nothing, or the close record alone; a closed log has its signature, and the next "
            "session and HEAD name its size. By itself a log that was cut is never OK."
        ),
        (
            "cut behind a checkpoint, and records put there",
            "cut behind a checkpoint, and records put there, signature gone",
            "cut behind a checkpoint, a close record put there, signature gone",
            "the last session cut, HEAD left",
        ),
    ),
    "CVE-2023-31439": (
        "past entries can be altered, their seals removed and made anew with a key of a later epoch",
        (
            "A log is signed by the one key that the key before it certified for its epoch; a later key certifies nothing "
            "earlier. Without a pinned key such a log by itself is OK, with the key shown that is its own; in its folder it is "
            "found."
        ),
        (
            "signed with the key of the next epoch",
            "signed with the key of the next epoch under its own",
            "only checkpoints and signature by the key of the next epoch",
        ),
    ),
}
"""What went wrong in the sealing of journald (systemd before 254): the fault, what stands against it here, and the rows."""
