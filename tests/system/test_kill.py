"""SIGKILL of the runtime in every phase: what was enabled is on record, the arm is stopped, the log is believable.

The oracle knows nothing of the runtime's own bookkeeping. A disk notes how many bytes of the log the last sync
covered; an observer of the bus reads that note the moment a PERMIT or START begins; afterwards the log is cut at
that offset and read with the stock mcap reader: the record that authorises must be in what is left.
"""

import json
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import can
import pytest
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from cutgate.protocol import records
from cutgate.protocol.frames import IDS, ControllerHeartbeat
from cutgate.runtime.audit.inspect import Status, verify_log
from cutgate.runtime.interlock.state import Phase
from tests.system.children import HALF_THE_CUT, SECOND_BLOCK, Script, synced_bytes
from tests.system.harness import FAST, ROBOT, SAFE, Rig

pytestmark = pytest.mark.processes

AT_ONCE = 3
"""Sessions at the same time: they mostly wait."""
SYNC_S = 0.02
"""A slow disk: a permit that did not wait for it would be 20 ms early."""
RESETS = (Phase.HELD, Phase.NONCE_RESET, Phase.AUTHORISING_RESET, Phase.RESETTING)


@dataclass(frozen=True)
class Moment:
    """When the runtime dies: on reaching a phase with nothing of it sent, or with its frames just sent."""

    at: str
    sent: bool = False

    def __str__(self) -> str:
        return f"{self.at}, sent" if self.sent else str(self.at)


BEFORE_PERMIT = (
    *map(Moment, (Phase.WAITING, Phase.OPENING)),
    Moment(Phase.OPENING, sent=True),
    *map(Moment, RESETS),
    Moment(Phase.RESETTING, sent=True),
    *map(Moment, (Phase.COLLECTING, Phase.UPLOADING, SECOND_BLOCK, Phase.VERIFYING, Phase.ADMITTED)),
    *map(Moment, (Phase.REFUSED, Phase.NONCE_PERMIT, Phase.AUTHORISING_PERMIT, Phase.PERMITTING)),
)
BEFORE_START = (
    Moment(Phase.PERMITTING, sent=True),
    *map(
        Moment, (Phase.PERMITTED, Phase.STOPPED, Phase.NONCE_START, Phase.AUTHORISING_START, Phase.STARTING)
    ),
)
AFTER_START = (
    Moment(Phase.STARTING, sent=True),
    *map(Moment, (Phase.CUTTING, HALF_THE_CUT, Phase.FINISHING, Phase.STOPPING, Phase.DONE)),
)
MOMENTS = (*BEFORE_PERMIT, *BEFORE_START, *AFTER_START)


@dataclass(frozen=True)
class Killed:
    """What is left of a killed session."""

    code: int
    enabled: tuple[tuple[str, int], ...]
    """PERMIT and START as seen on the bus, each with the bytes of log that were durable at that moment."""
    log: bytes
    state: str
    told: str


def killed(folder: Path, moment: Moment, *, unsynced: bool = False) -> Killed:
    """A session whose runtime dies at this moment."""
    folder.mkdir()
    note, enabled = folder / "synced", []

    def look(message: can.Message) -> None:
        enabled.extend(
            (kind.__name__.lower(), synced_bytes(note))
            for kind in (records.Permit, records.Start)
            if begins(message, kind)
        )

    with Rig(folder) as rig:
        rig.bus.at_once = look
        sim = rig.sim(scale=FAST if moment.at in (HALF_THE_CUT, Phase.FINISHING, Phase.DONE) else 1)
        if moment.at in RESETS:  # a node that speaks for the controller makes it latch
            rig.bus.bus.send(can.Message(0, IDS[ControllerHeartbeat], is_extended_id=False, data=bytes(8)))
            sim.line("state FAULT")
        run = rig.run(
            robot=approved(folder, moment),
            script=Script(
                at=moment.at,
                sent=moment.sent,
                synced=note,
                sync_s=SYNC_S,
                unsynced=unsynced,
                space_unanswered=moment.at == Phase.ADMITTED,
            ),
        )
        code = run.exit(
            {
                "say acknowledge": lambda: run.say("acknowledge"),
                "say reset": lambda: run.say("reset"),
                "permitted:": lambda: run.say("quit") if moment.at == Phase.STOPPED else sim.say("hold"),
                "say start$": lambda: run.say("start"),
                " cutting$": lambda: run.say("stop") if moment.at == Phase.STOPPING else None,
            }
        )
        state = rig.at_rest(sim)  # by then the observer has seen every frame of the session
        return Killed(code, tuple(enabled), rig.logs()[-1].read_bytes(), state, run.told + sim.told)


def begins(message: can.Message, kind: type[records.Record]) -> bool:
    """Whether this is the first frame of such a record: 0x600, ISO-TP first frame, then the record's type."""
    return message.arbitration_id == 0x600 and message.data[0] >> 4 == 1 and message.data[2] == kind.TYPE


def approved(folder: Path, moment: Moment) -> Path:
    """The robot file; where the session is to be refused, with limits that are not the controller's."""
    if moment.at != Phase.REFUSED:
        return ROBOT
    other = folder / "robot.toml"
    text = ROBOT.read_text(encoding="utf-8")
    other.write_text(text.replace("q0_deg = [-80.0, 80.0]", "q0_deg = [-80.0, 79.0]"), encoding="utf-8")
    return other


def authorised(log: bytes) -> list[str]:
    """What the stock reader finds authorised in the beginning of a log; it stops where the file is torn."""

    def whole() -> Iterator[object]:
        try:
            yield from StreamReader(BytesIO(log)).records
        except McapError:
            return

    topics: dict[int, str] = {}
    found = []
    for record in whole():
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message) and topics[record.channel_id] == "/audit/permit":
            content = json.loads(record.data)
            if content["stage"] == "authorised":
                found.append(content["kind"])
    return found


def unrecorded(session: Killed) -> list[str]:
    """What was enabled although its record was not durable."""
    return [kind for kind, size in session.enabled if kind not in authorised(session.log[:size])]


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    """Every session of this module, by its moment."""
    folder = tmp_path_factory.mktemp("killed")
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return {
            moment: pool.submit(killed, folder / str(number), moment) for number, moment in enumerate(MOMENTS)
        }


every_moment = pytest.mark.parametrize("moment", MOMENTS, ids=str)


def test_every_phase_is_among_the_moments():
    assert {moment.at for moment in MOMENTS} >= set(Phase)
    assert len(MOMENTS) >= 25


@every_moment
def test_what_was_enabled_was_durable_before(sessions, moment):
    session = sessions[moment].result()
    assert session.code == -signal.SIGKILL, session.told
    seen = [kind for kind, _ in session.enabled]
    expected = (
        [] if moment in BEFORE_PERMIT else ["permit"] if moment in BEFORE_START else ["permit", "start"]
    )
    assert seen == expected
    assert unrecorded(session) == []


@every_moment
def test_the_controller_is_left_inhibited(sessions, moment):
    assert sessions[moment].result().state.split()[0] in SAFE


@every_moment
def test_the_log_is_incomplete_but_not_tampered_with(sessions, moment):
    report = verify_log(sessions[moment].result().log)
    assert report.status in (Status.OK, Status.INCOMPLETE)
    assert report.messages > 0


def test_without_syncing_the_same_look_finds_the_permit_unrecorded(tmp_path):
    """The guard taken out: shows that the tests above can fail."""
    session = killed(tmp_path / "unsynced", Moment(Phase.CUTTING), unsynced=True)
    assert unrecorded(session) == ["permit", "start"]
