"""Records and the path: envelopes, bodies, block by block assembly, and who signed."""

import struct
import zlib
from collections.abc import Iterator

import numpy as np

from cutgate.protocol.codes import PresharedKey
from cutgate.protocol.coding import decode, encode, written
from cutgate.protocol.conversation import Open, OtherVersion, SignedRecord
from cutgate.protocol.records import (
    PROTOCOL_VERSION,
    RECORDS,
    Acknowledge,
    Assembly,
    Calibration,
    Envelope,
    Limits,
    Path,
    PathBlock,
    Record,
    RecordError,
    Reset,
    Side,
    Tool,
    pack,
    split,
    unpack,
)
from cutgate.protocol.states import StopCause
from cutgate.protocol.wire import Channel
from tests.protocol.sessions import CODES, KEY, TAG
from tests.runtime.audit.build import inputs, wire_permit
from tools.fuzz.harness import Family, attempt, choose, expect

PRESHARED = PresharedKey(KEY)
HEAD = struct.Struct("<BBHII")


def check(data: bytes) -> None:
    """The first byte chooses what the rest is parsed as."""
    what, rest = choose(data, PARSERS)
    what(rest)


def _envelope(data: bytes) -> None:
    """As it stands, and with a length and a CRC that are right."""
    for candidate in (data, _sealed(data)):
        for sender, channel in (
            (None, None),
            (Side.RUNTIME, Channel.CONTROL),
            (Side.CONTROLLER, Channel.BULK),
        ):
            envelope = attempt(
                RecordError, lambda c=candidate, s=sender, h=channel: unpack(c, sender=s, channel=h)
            )
            if envelope is not None:
                _one_form(envelope, candidate)


def _one_form(envelope: Envelope, data: bytes) -> None:
    if isinstance(envelope.record, OtherVersion):
        expect(envelope.record.protocol_version != PROTOCOL_VERSION, "of ours all is read")
    else:
        again = pack(envelope.record, envelope.session, envelope.sequence)
        expect(again == data, f"{envelope.record} has one form")


def _sealed(data: bytes) -> bytes:
    code, reserved, _, session, sequence = HEAD.unpack(data[: HEAD.size].ljust(HEAD.size, b"\0"))
    body = data[HEAD.size : HEAD.size + 4079]
    covered = HEAD.pack(code, reserved, len(body), session, sequence) + body
    return covered + struct.pack("<I", zlib.crc32(covered))


def _body(data: bytes) -> None:
    """A record's body; nobody has signed it, whatever code it carries."""
    kind, body = choose(data, KINDS)
    if kind is PathBlock:
        body = body[:16] + struct.pack("<I", zlib.crc32(body[16:])) + body[20:] if data[0] & 64 else body
    record = attempt(RecordError, kind.parse, body)
    if record is None:
        return
    expect(record.body() == body, f"{record} has one form")
    if isinstance(record, Limits | Calibration | Tool):
        record.problems()
    if isinstance(record, Open):
        honest = record == PRESHARED.sign_open(record)
        expect(PRESHARED.open_authentic(record) == honest, "only the key's holder opens")
    elif isinstance(record, SignedRecord):
        honest = record == CODES.sign(record, 7)
        expect(CODES.authentic(record, 7) == honest, "only the key's holder signs")


def _path(data: bytes) -> None:
    path = attempt(RecordError, Path.parse, data)
    if path is not None:
        expect(path.body() == data, "a path has one form")
        lengths = (path.axes**2).sum(axis=1)
        expect(bool((abs(lengths - 1.0) <= 1e-12).all()), "every axis is a unit vector")
        expect(len(path.tips_mm) == len(path) >= 2, "a path has two poses or more")


def _assembly(data: bytes) -> None:
    """Blocks of two paths in any order, some altered: what is complete is what was taken, in order."""
    assembly, taken = Assembly(), b""
    for at in range(0, len(data), 3):
        which, place, change = data[at : at + 3].ljust(3, b"\0")
        body = bytearray(BLOCKS[which % len(BLOCKS)].body())
        if which & 128:
            body[place % 80] ^= change or 1
        block = attempt(RecordError, PathBlock.parse, bytes(body))
        after = block and attempt(RecordError, assembly.add, block)
        if block and after:
            taken += block.decoded()
            assembly = after
        expect(len(taken) <= assembly.total, "no more is stored than was announced")
        whole = attempt(RecordError, lambda kept=assembly: kept.data)
        expect((whole is not None) == assembly.complete, "data is there when it is complete")
        expect(whole is None or whole == taken, "what is complete is what came")


def _coding(data: bytes) -> None:
    """As the coded poses of a block, and as poses to be coded; the first byte says how many the block holds."""
    count = 1 + data[0] % 200 if data else 1
    poses = attempt(RecordError, decode, data[1:], count)
    if poses is not None:
        expect(poses.shape == (count, 5), "so many poses as the place has")
        expect(encode(poses) == data[1:], "coded poses have one form")
    filled = (data * (1 + 20 * count // max(len(data), 1)))[: 20 * count].ljust(20 * count, b"\0")
    poses = np.frombuffer(filled, dtype="<i4").reshape(-1, 5)
    expect(bool((decode(encode(poses), count) == poses).all()), "what is sent is read as what it was")


PARSERS = (_envelope, _body, _path, _assembly, _coding)
KINDS: tuple[type[Record], ...] = tuple(RECORDS.values())
PATH = inputs().path
LONGER = PATH[:36] + struct.pack("<I", 450) + (PATH[40:] * 75)
BLOCKS = (*split(LONGER), *split(LONGER + bytes(20 * 3)))


def _seeds() -> Iterator[bytes]:
    i = inputs()
    signed = CODES.sign(wire_permit(), 7)
    bodies: list[Record] = [
        signed,
        Limits.parse(i.limits),
        Calibration.parse(i.calibration),
        Tool.parse(i.tool),
        Acknowledge(3, StopCause.BONE_MOVED),
        Reset(bytes(16), 1, bytes(32), StopCause.SECOND_NODE),
        BLOCKS[0],
        BLOCKS[2],
    ]
    for record in bodies:
        yield bytes([PARSERS.index(_envelope)]) + pack(record, TAG, 7)
        yield bytes([PARSERS.index(_body), KINDS.index(type(record))]) + record.body()
    reserved = HEAD.pack(Acknowledge.TYPE, 1, 18, TAG, 7) + Acknowledge(3, StopCause.BONE_MOVED).body()
    yield bytes([PARSERS.index(_envelope)]) + reserved
    yield bytes([PARSERS.index(_path)]) + i.path
    yield bytes([PARSERS.index(_path)]) + LONGER
    for order in ((0, 1, 2), (3, 4, 5), (0, 4, 2), (0, 0, 1), (128, 1, 2)):
        yield bytes([PARSERS.index(_assembly)]) + b"".join(bytes([which, 17, 3]) for which in order)

    for block in BLOCKS:
        coded = block.data[40:] if block.index == 0 else block.data
        poses = len(block.decoded()) // 20 - (2 if block.index == 0 else 0)
        yield bytes([PARSERS.index(_coding), poses - 1]) + coded
    for poses in (1, 2, 9):
        raw = np.arange(5 * poses, dtype=np.int32).reshape(-1, 5) ** 3
        yield bytes([PARSERS.index(_coding), poses - 1]) + encode(raw)
        yield bytes([PARSERS.index(_coding), poses - 1]) + written(raw, [(7, 33)] * 5)


FAMILY = Family(check, tuple(_seeds()))
