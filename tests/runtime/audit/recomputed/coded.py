"""A session's log and raw frames with one thing altered, everything else made to fit but what needs the key."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from io import BytesIO

from cutgate.config.session_keys import SessionKeys
from cutgate.protocol import candump
from cutgate.protocol import records as wire
from cutgate.protocol.e2e import protect
from cutgate.protocol.frames import DATA_IDS
from cutgate.protocol.transfer import Transfer
from cutgate.protocol.wire import Side
from cutgate.runtime.audit import records
from cutgate.runtime.audit.inspect import Log, read_log
from cutgate.runtime.audit.recomputed.authenticated import CodesFound, check_codes
from cutgate.runtime.audit.recomputed.opening import opening_of, session_keys
from tests.logs import signature_of
from tests.runtime.audit.build import forge
from tests.runtime.session.pair import KEY, Pair


@dataclass(frozen=True)
class Coded:
    """One session's two files."""

    log: bytes
    frames: bytes

    @classmethod
    def of(cls, pair: Pair) -> "Coded":
        """Of a session that has ended."""
        paths = pair.close()
        return cls(paths.log.read_bytes(), paths.candump.read_bytes())

    @property
    def read(self) -> Log:
        return read_log(self.log, self.frames, signature_of(self.log))

    def check(self, key: bytes | SessionKeys = KEY, *, raw: bool = True) -> CodesFound:
        return check_codes(self.read, BytesIO(self.frames) if raw else None, key)

    @property
    def keys(self) -> SessionKeys:
        """The keys of this session alone."""
        opening = opening_of(self.read)
        assert opening is not None
        found = session_keys(self.read.report.log_id, opening, KEY)
        assert found is not None
        return found

    @property
    def tag(self) -> int:
        return wire.session_tag(self.keys.codes.digest)

    # ------------------------------------------------------------ alterations

    def edited(self, edit: Callable[[records.LogRecord], records.LogRecord | None]) -> "Coded":
        """Records changed or, where nothing is returned, taken out; chain and counts made to fit."""
        return replace(self, log=forge(self.log, edit, trees_again=False))

    def session(self, **changes: str) -> "Coded":
        """Another record of how it was opened."""
        return self.edited(
            lambda one: one.model_copy(update=changes) if isinstance(one, records.AuditSession) else one
        )

    def permit(self, kind: str, **changes: object) -> "Coded":
        """Another permit, start or reset that left."""

        def edit(one: records.LogRecord) -> records.LogRecord:
            sent = isinstance(one, records.AuditPermit) and (one.kind, one.stage) == (kind, "sent")
            return one.model_copy(update=changes) if sent else one

        return self.edited(edit)

    def single_frames(self, can_id: int, direction: str) -> list[int]:
        """Which of all frames in the log are these, once the session is open."""
        found, count, opened = [], 0, False
        for topic, data in self.read.each(records.AuditSession.TOPIC, records.CanFrame.TOPIC):
            opened |= topic == records.AuditSession.TOPIC
            if topic == records.CanFrame.TOPIC:
                frame = records.CanFrame.model_validate_json(data)
                if opened and (frame.id, frame.direction) == (can_id, direction):
                    found.append(count)
                count += 1
        return found

    def frame(self, which: int, change: Callable[[bytes], bytes], *, protected: bool = True) -> "Coded":
        """Another single frame, in both files; ``protected``: with a CRC that fits."""
        count = -1
        lines = self.frames.splitlines(keepends=True)
        tag = self.tag

        def edit(one: records.LogRecord) -> records.LogRecord:
            nonlocal count
            count += isinstance(one, records.CanFrame)
            if not isinstance(one, records.CanFrame) or count != which:
                return one
            old = bytes.fromhex(one.data)
            new = change(old)
            if protected:
                new = protect(new[3:], new[2], DATA_IDS[one.id], tag)
            (place,) = [
                number for number, line in enumerate(lines) if is_of(candump.parse(line.decode()), one)
            ]
            lines[place] = lines[place].replace(old.hex().upper().encode(), new.hex().upper().encode())
            return one.model_copy(update={"data": new.hex()})

        changed = self.edited(edit)
        return replace(changed, frames=b"".join(lines))

    def raw(self, change: Callable[[list[bytes]], list[bytes]]) -> "Coded":
        """Other lines of raw frames."""
        return replace(self, frames=b"".join(change(self.frames.splitlines(keepends=True))))


def is_of(frame: candump.RawFrame, record: records.CanFrame) -> bool:
    stamp = record.stamp.nanoseconds // 1000
    return (frame.time_us, frame.can_id, frame.data.hex()) == (stamp, record.id, record.data)


def flipped(data: bytes, place: int, mask: int) -> bytes:
    """One byte altered."""
    return bytes([*data[:place], data[place] ^ mask, *data[place + 1 :]])


def envelope(data: str, change: Callable[[bytes], bytes]) -> str:
    """A record in hex with its body changed, and a CRC-32 that fits."""
    old = bytes.fromhex(data)
    read = wire.unpack(old)
    body = change(read.record.body())
    kind = type(read.record)
    return wire.pack(kind.parse(body), read.session, read.sequence).hex()


def carried(payload: bytes, side: Side) -> list[tuple[int, bytes]]:
    """The frames of a record on the control channel, flow control of the other side between them."""
    ids = {Side.RUNTIME: (0x600, 0x601), Side.CONTROLLER: (0x601, 0x600)}[side]
    sender, receiver = Transfer(*ids), Transfer(*reversed(ids))
    sender.send(payload, now_s=0.0)
    frames = []
    while sender.sending:
        for one, other in ((sender, receiver), (receiver, sender)):
            for can_id, data in one.outgoing():
                frames.append((can_id, data))
                other.feed(data)
    return frames
