"""SIGKILL of the runtime at seeded steps: between any two operations of the disk, after any turn on the bus.

``test_kill`` dies in each phase; here it is left to chance. What must hold whatever the moment: what was enabled is in
the synced part of the log, what was cut can be recovered, and the next session goes on with the next epoch.
"""

import random
import signal
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import can
import pytest

from cutgate.protocol import records
from cutgate.runtime.audit.inspect import Log, Status
from cutgate.runtime.commands.app import execute
from cutgate.runtime.commands.audit_folder import read_folder
from tests.logs import create, judged
from tests.runtime.audit.build import OPENED, PATIENCE_S
from tests.system.children import Script, synced_bytes
from tests.system.harness import FAST, Rig
from tests.system.test_kill import AT_ONCE, authorised, begins

pytestmark = pytest.mark.processes

SEED = 16
DISK_STEPS = 100
BEGINNING = 24
"""Steps of the disk until the next session's key is in the place of this one's."""
TURNS = 150
"""About those of a whole session; one that ends before its moment is counted as such."""


@dataclass(frozen=True)
class Left:
    """What a session leaves that was killed, or that ended before.

    Attributes:
        folder: of the logs.
        log: the session's; None if there is none.
        code: of its process.
        enabled: PERMIT and START as seen on the bus, each with the bytes of log that were durable at that moment.
        told: what it said.
    """

    folder: Path
    log: Path | None
    code: int
    enabled: tuple[tuple[str, int], ...]
    told: str


def moments(count: int) -> list[Script]:
    """Seeded: a third turns, a third steps of the disk, and a third while the log begins, which is one step in ten."""
    draw = random.Random(SEED)

    def one(number: int) -> Script:
        if number % 3 == 0:
            return Script(turn=draw.randrange(TURNS))
        if number % 3 == 1:
            return Script(disk_step=draw.randrange(DISK_STEPS))
        return Script(disk_step=number % BEGINNING // 3 * 3 + draw.randrange(3))  # from each part of it one

    return [one(number) for number in range(count)]


def session_before(folder: Path, number: int) -> int:
    """One closed session in it, or none; how many."""
    if number % 2:
        a_session(folder)
    return number % 2


def a_session(folder: Path) -> Log:
    """A session that is opened and closed; its log."""
    log = create(folder, log_id=random.randbytes(16).hex(), opened=OPENED)
    return judged(log.close(final_state="done", clean=True, timeout_s=PATIENCE_S).log)


def killed(place: Path, script: Script) -> Left:
    """A session that cuts, and dies on the way."""
    note, enabled = place / "synced", []

    def look(message: can.Message) -> None:
        enabled.extend(
            (kind.__name__.lower(), synced_bytes(note))
            for kind in (records.Permit, records.Start)
            if begins(message, kind)
        )

    before = set((place / "logs").glob("*.mcap"))
    with Rig(place) as rig:
        rig.bus.at_once = look
        sim = rig.sim(scale=FAST)
        run = rig.run(script=Script(disk_step=script.disk_step, turn=script.turn, synced=note))
        code = run.exit({"permitted:": lambda: sim.say("hold"), "say start$": lambda: run.say("start")})
        if code == -signal.SIGKILL:
            rig.at_rest(sim)  # by then the observer has seen every frame of the session
    logs = set((place / "logs").glob("*.mcap")) - before
    return Left(place / "logs", next(iter(logs), None), code, tuple(enabled), run.told)


def examined(left: Left, sessions_before: int, told: Counter[str]) -> None:
    """What must hold, whatever the moment; counted in ``told``."""
    assert left.code in (0, -signal.SIGKILL), left.told
    data = left.log.read_bytes() if left.log else b""
    assert [kind for kind, size in left.enabled if kind not in authorised(data[:size])] == []
    log = judged(left.log) if left.log else None
    opened = log.of("/audit/open") if log else []
    told["sessions"] += 1
    told["ended before their moment"] += left.code == 0
    told["died before record 0"] += not opened
    told.update(f"with {kind}" for kind, _ in left.enabled)
    if opened and log and left.log:
        told["cut behind record 0"] += not log.scan.finished
        told["recovered"] += recovered(left.log, log, left.folder.parent / "copy.mcap")
        told["records kept"] += log.report.messages
        told["bytes dropped"] += log.report.dropped_bytes
    following = a_session(left.folder).of("/audit/open")[0]
    assert following["epoch"] == sessions_before + bool(opened) + 1
    read = read_folder(left.folder)
    assert read.found.status in (Status.OK, Status.INCOMPLETE), [str(one) for one in read.found.findings]
    signed = [one.session for one in read.found.joined if one.session.key is not None]
    assert [one.epoch for one in signed] == list(range(1, len(signed) + 1))
    assert len({one.key.public for one in signed if one.key}) == len(signed)


def recovered(path: Path, log: Log, copy: Path) -> bool:
    """Whether there is a copy of it; that holds every record of the log, and is never OK."""
    if execute(["audit", "recover", str(path), "-o", str(copy)]) != 0:
        return False
    found = judged(copy).report
    assert found.status is Status.INCOMPLETE
    assert (found.messages, found.head) == (log.report.messages, log.report.head)
    return True


def killed_anywhere(folder: Path, count: int) -> Counter[str]:
    """Sessions killed at seeded moments, and what became of them."""
    told: Counter[str] = Counter()
    places = [folder / str(number) for number in range(count)]
    for place in places:
        place.mkdir()
    before = [session_before(place / "logs", number) for number, place in enumerate(places)]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for left, sessions in zip(pool.map(killed, places, moments(count)), before, strict=True):
            examined(left, sessions, told)
    print("; ".join(f"{name}: {number}" for name, number in told.items()))
    assert told["sessions"] == count
    assert told["recovered"] == told["cut behind record 0"], "each log that was cut, and none that is whole"
    return told


def test_whatever_the_moment_what_was_enabled_is_recorded_and_the_next_epoch_follows(tmp_path):
    reached_all(killed_anywhere(tmp_path, 25))


@pytest.mark.long
@pytest.mark.timeout(0)
def test_500_moments(tmp_path):
    reached_all(killed_anywhere(tmp_path, 500))


def reached_all(told: Counter[str]) -> None:
    """The moments lie before record 0, behind it, and behind the start."""
    assert told["died before record 0"] > 0
    assert told["cut behind record 0"] > 0
    assert told["with start"] > 0
