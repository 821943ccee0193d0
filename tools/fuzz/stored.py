"""Files that the program keeps for itself: the controller's memory, the last log's head, the key; and option texts."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

from cutgate.config.key import load_key
from cutgate.config.load import InputError
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.faults import FaultSpec
from cutgate.firmware_sim.state import Memory
from cutgate.protocol.states import StopCause
from cutgate.runtime.audit.directory import HEAD, Head, Listed, previous_session
from cutgate.runtime.session import withdrawn
from tools.fuzz.harness import Family, attempt, choose, expect

DIRECTORY = tempfile.TemporaryDirectory(prefix="cutgate-fuzz-")
PLACE = Path(DIRECTORY.name)
NOW_US = 1_795_000_000_000_000


def check(data: bytes) -> None:
    """The first byte chooses which file the rest is."""
    read, rest = choose(data, READERS)
    read(rest)


def _written(name: str, data: bytes) -> Path:
    path = PLACE / name
    path.write_bytes(data)
    path.chmod(0o600)
    return path


def _memory(data: bytes) -> None:
    path = _written("memory.json", data)
    remembered = attempt(memory.ControllerMemoryError, memory.load, path, NOW_US)
    if remembered is not None:
        memory.save(path, remembered)
        expect(memory.load(path, NOW_US) == remembered, "what is remembered stays remembered")


def _head(data: bytes) -> None:
    _written(HEAD, data)
    previous = attempt(InputError, previous_session, PLACE)  # one that is too large is refused
    if previous is not None:
        expect(
            previous.log is None or Path(previous.log).name == previous.log, "a log's name leads nowhere else"
        )
        expect(previous.note is not None, "no log is there: that is said, whatever HEAD says")
    (PLACE / HEAD).unlink()


def _key(data: bytes) -> None:
    key = attempt(InputError, load_key, _written("key", data))
    expect(key is None or len(key) == 32, "a key is 32 bytes")


def _fault(data: bytes) -> None:
    with contextlib.suppress(UnicodeDecodeError):
        spec = attempt(ValueError, FaultSpec.parse, data.decode())
        if spec is not None:
            again = f"{spec.name}@{spec.state.name.lower()}"
            expect(FaultSpec.parse(again) == spec, "a fault can be named again")


def _withdrawn(data: bytes) -> None:
    _written(withdrawn.WITHDRAWN, data)
    listed = attempt(InputError, withdrawn.load, PLACE)
    if listed is not None:
        expect(all(len(entry.registration) == 32 for entry in listed), "an entry has a SHA-256")
        added = withdrawn.Withdrawal(bytes(32), "a.mcap", bytes(32), datetime(2026, 1, 1, tzinfo=UTC))
        withdrawn.add(PLACE, [added])
        expect(withdrawn.load(PLACE) == (*listed, added), "what is withdrawn stays withdrawn")


READERS: tuple[Callable[[bytes], None], ...] = (_memory, _head, _key, _fault, _withdrawn)


def _text_of(remembered: Memory) -> str:
    path = PLACE / "seed.json"
    memory.save(path, remembered)
    return path.read_text(encoding="ascii")


def _seeds() -> Iterator[bytes]:
    withdrawn = Memory(
        withdrawn=frozenset({bytes(32)}),
        earlier=frozenset({bytes(range(32))}),
        barrier_us=NOW_US,
        withdrawal_due=True,
        latched=StopCause.SECOND_NODE,
    )
    before = (
        '{"schema": "cutgate.sim-memory/1", "content": {"named": [], "withdrawn": [], "latched": "NONE"}}'
    )
    examples = {
        _memory: (_text_of(Memory()), _text_of(withdrawn), before, '{"schema": ' + "[" * 5000),
        _head: (
            Head("a.mcap", "ab" * 32, closed=True, listed=Listed()).encode().decode(),
            Head("a.mcap", "ab" * 32, closed=True, listed=Listed(3, "ab" * 32)).encode().decode(),
            Head("a.mcap", None, closed=False).encode().decode(),
            Head("a\0b", None, closed=False).encode().decode(),
            Head("\ud800", None, closed=False).encode().decode(),
            Head("..", None, closed=False).encode().decode(),
            "[" * 5000,
        ),
        _key: ("ab" * 32 + "\n", "ab" * 31, "zz" * 32),
        _withdrawn: (
            f"{'ab' * 32} a.mcap\n",
            f"{'ab' * 32} a.mcap\n{'0f' * 32} b.mcap {'cd' * 32} 2026-11-27T10:00:00.250000Z\n",
            f"{'ab' * 32} a.mcap - 2026-02-31T10:00:00.250000Z\n",
            f"{'ab' * 32}",
            f"{'ab' * 31} a.mcap",
            f"{'ab ' * 32}\t a.mcap\n",
        ),
        _fault: ("flip-path-bit@permitted", "reboot", "hang@", "@", "hang@cutting@x"),
    }
    for number, read in enumerate(READERS):
        for example in examples[read]:
            yield bytes([number]) + example.encode()


FAMILY = Family(check, tuple(_seeds()))
