"""A disk that is slow, full or silent: nothing is enabled without it, and nothing that stops waits for it."""

import errno
import os
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from cutgate.protocol import records
from cutgate.protocol.frames import RuntimeHeartbeat, RuntimeStop
from cutgate.protocol.states import ControllerState, RuntimeCode, StopCause
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.interlock.state import Phase, Withheld
from tests.runtime.audit.test_written import later
from tests.runtime.session.pair import Disk
from tests.runtime.session.test_session import first_frames


def full(operation, _count):
    if operation == "write":
        raise OSError(errno.ENOSPC, "no space")


def codes(pair):
    return {beat.code for _, beat in pair.wire.frames(RuntimeHeartbeat)}


def test_a_disk_that_never_answers_lets_no_permit_leave(pair):
    pair.begin()
    pair.disk.answers = False
    pair.end()
    assert (pair.phase, pair.state.cause) == (Phase.STOPPED, StopCause.AUDIT_FAILED)
    assert not first_frames(pair, records.Permit)
    assert codes(pair) == {RuntimeCode.INHIBIT}
    paths = pair.close()
    assert not paths.closed
    assert "did not answer" in paths.reason


@pytest.mark.parametrize(
    ("before", "pending", "record"),
    [
        (Phase.VERIFYING, Phase.AUTHORISING_PERMIT, records.Permit),
        (Phase.PERMITTED, Phase.AUTHORISING_START, records.Start),
    ],
)
def test_a_decision_that_does_not_become_durable_in_time_is_an_audit_failure(pair, before, pending, record):
    pair.begin()
    pair.prover.answer, answer = (lambda request: None), pair.prover.answer
    pair.to(Phase.VERIFYING)
    if before is Phase.PERMITTED:
        pair.prover.give(*answer(pair.prover.asked[0]))
        pair.to(Phase.PERMITTED)
        pair.disk.answers = False
    else:
        pair.disk.answers = False
        pair.prover.give(*answer(pair.prover.asked[0]))
    pair.to(pending)
    began_s = pair.clock()
    pair.end()
    assert pair.clock() - began_s <= 1.0 + 2 * pair.cycle_s + 0.02
    assert pair.state.cause is StopCause.AUDIT_FAILED
    assert not first_frames(pair, record)
    pair.run(0.2)
    assert (pair.controller.state, pair.controller.cause) == (
        ControllerState.FAULT,
        StopCause.AUDIT_FAILED,
    )


@pytest.mark.parametrize("phase", [Phase.AUTHORISING_PERMIT, Phase.AUTHORISING_START, Phase.CUTTING])
def test_the_stop_frame_does_not_wait_for_a_silent_disk(pair, phase):
    pair.to(Phase.COLLECTING if phase is Phase.AUTHORISING_PERMIT else Phase.PERMITTED)
    if phase is Phase.CUTTING:
        pair.to(Phase.CUTTING)
    pair.disk.answers = False
    pair.to(phase)
    said_s = pair.clock() + pair.cycle_s
    pair.say("stop")
    (seen, stop) = pair.wire.frames(RuntimeStop)[0]
    assert (seen.at_s, stop.cause) == (said_s, StopCause.OPERATOR_STOP)
    pair.run(0.05)
    assert pair.controller.cause is StopCause.OPERATOR_STOP
    assert not pair.controller.may_move


def test_a_full_disk_stops_the_cut(pair):
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING)
    pair.disk.trouble = full
    assert (
        pair.end(limit_s=1.1) is Phase.STOPPED
    )  # with the next chunk, not only after the checkpoint's deadline
    assert pair.state.cause is StopCause.AUDIT_FAILED
    assert (pair.controller.state, pair.controller.cause) == (
        ControllerState.FAULT,
        StopCause.AUDIT_FAILED,
    )
    assert any("No space left" in note for note in pair.notes.notes)
    assert not pair.close().closed
    assert pair.read().report.status is Status.INCOMPLETE


@pytest.mark.parametrize(("delay_s", "phase"), [(3.0, Phase.CUTTING), (6.0, Phase.STOPPED)])
def test_a_slow_checkpoint_stops_the_cut_only_beyond_its_own_deadline(pair, delay_s, phase):
    pair.power_up(time_scale=0.02)
    pair.to(Phase.CUTTING)
    pair.disk.delay_s, pair.cycle_s = delay_s, 0.02
    pair.run(6.5)
    assert pair.phase is phase
    if phase is Phase.STOPPED:
        assert pair.state.cause is StopCause.AUDIT_FAILED


@pytest.mark.parametrize(("waited_s", "phase"), [(5.0, Phase.CUTTING), (5.0001, Phase.STOPPING)])
def test_a_disk_that_has_taken_as_long_as_the_deadline_is_not_yet_late(pair, monkeypatch, waited_s, phase):
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING)
    monkeypatch.setattr(pair.log, "oldest_pending_s", lambda _now_s: waited_s)
    pair.run_cycle()
    assert pair.phase is phase
    assert pair.state.reason == ("" if phase is Phase.CUTTING else "the disk has not answered for 5 s")


def test_a_durable_decision_that_no_longer_holds_is_withheld(pair):
    """The registration grows too old while the permit's record is on its way to the disk."""
    pair.begin(replace(pair.job, registration_age_s=0.0, registration_max_age_s=0.5))
    pair.to(Phase.UPLOADING)
    pair.disk.delay_s = 0.8
    assert pair.end() is Phase.REFUSED
    assert any(isinstance(effect, Withheld) for effect in pair.notes.effects)
    assert "age of the registration" in pair.state.reason
    assert not first_frames(pair, records.Permit)
    pair.run(1.0).close()
    stages = [record["stage"] for record in pair.read().of("/audit/permit")]
    assert stages == ["authorised", "withheld"]


def test_the_enabling_device_released_before_the_start_is_durable_takes_the_start_back(pair):
    pair.to(Phase.PERMITTED)
    pair.disk.delay_s = 0.3
    pair.to(Phase.AUTHORISING_START)
    pair.controller_terminal.type("release")
    pair.until(lambda: pair.phase is Phase.PERMITTED)
    assert any(isinstance(effect, Withheld) for effect in pair.notes.effects)
    pair.run(0.5)
    assert not first_frames(pair, records.Start)
    pair.disk.delay_s = 0.0
    assert pair.end() is Phase.DONE  # pressed again, said again


# ---------------------------------------------------------------- a log that is lost


def overwrite(path):
    later(path)
    with path.open("r+b") as file:
        file.write(b"\x89mcap")


def readable_for_all(path):
    path.chmod(0o644)


LOSSES = {
    "the folder is deleted": (lambda log: shutil.rmtree(log.path.parent), "LOCK was deleted"),
    "the folder is renamed": (lambda log: log.path.parent.rename(log.path.parent.with_name("x")), "LOCK was ren"),
    "the log is deleted": (lambda log: log.path.unlink(), "mcap was deleted"),
    "the log is renamed": (lambda log: log.path.rename(log.path.with_name("x")), "mcap was renamed or moved"),
    "the log is cut": (lambda log: os.truncate(log.path, 100), "mcap was cut to 100 bytes"),
    "the log is replaced": (
        lambda log: shutil.copy(log.path, log.path.with_name("x")).replace(log.path),
        "another file was put in its place",
    ),
    "the log is overwritten": (lambda log: overwrite(log.path), "mcap was overwritten"),
    "the raw frames are deleted": (lambda log: log.candump_path.unlink(), "candump.log was deleted"),
    "the raw frames are cut": (lambda log: os.truncate(log.candump_path, 0), "candump.log was cut to 0 bytes"),
}  # fmt: skip
"""What others do to a log, and how the operator is told."""


@pytest.mark.parametrize("loss", LOSSES)
def test_no_start_leaves_once_the_log_is_lost(pair, loss):
    act, told = LOSSES[loss]
    pair.to(Phase.PERMITTED)
    act(pair.log)
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.AUDIT_FAILED
    assert not first_frames(pair, records.Start)
    assert any(told in note for note in pair.notes.notes), pair.notes.notes
    pair.run(0.2)
    assert pair.controller.cause is StopCause.AUDIT_FAILED
    assert not pair.close().closed


@pytest.mark.parametrize("loss", LOSSES)
def test_a_cut_that_nobody_can_prove_is_stopped_with_the_next_chunk(pair, loss):
    act, told = LOSSES[loss]
    pair.power_up(time_scale=0.05)
    pair.to(Phase.CUTTING).run(2.0)
    act(pair.log)
    assert pair.end(limit_s=1.0 + 2 * pair.cycle_s) is Phase.STOPPED
    assert pair.state.cause is StopCause.AUDIT_FAILED
    assert any(told in note for note in pair.notes.notes), pair.notes.notes
    assert (pair.controller.state, pair.controller.cause) == (ControllerState.FAULT, StopCause.AUDIT_FAILED)
    assert not pair.close().closed


@pytest.mark.parametrize("loss", LOSSES)
def test_a_log_that_is_lost_at_the_very_end_is_not_closed(pair, loss):
    act, told = LOSSES[loss]
    assert pair.end() is Phase.DONE
    act(pair.log)
    paths = pair.close()
    assert not paths.closed
    assert told in paths.reason


@pytest.mark.parametrize(
    "look", [Path.touch, Path.read_bytes, readable_for_all], ids=lambda look: look.__name__
)
def test_whoever_only_looks_at_the_log_stops_nothing(pair, look):
    pair.to(Phase.CUTTING)
    later(pair.log.path)
    look(pair.log.path)
    assert pair.end() is Phase.DONE
    assert pair.close().closed
    assert pair.read().report.status is Status.OK


# ---------------------------------------------------------------- a disk that somebody else fills


@dataclass
class Crowded(Disk):
    """Once it is ``full``, nothing finds room on it but what was reserved before."""

    full: bool = False
    room: dict[int, int] = field(default_factory=dict)

    def _no_room_without(self, reserved, needed):
        if self.full and not needed <= reserved:
            raise OSError(errno.ENOSPC, "no room")

    def create(self, path):
        self._no_room_without(0, 1)
        return super().create(path)

    def prepare(self, path):
        self._no_room_without(0, 1)
        return super().prepare(path)

    def reserve(self, descriptor, path, size):
        self._no_room_without(self.room.get(descriptor, 0), size)
        self.room[descriptor] = max(size, self.room.get(descriptor, 0))
        return super().reserve(descriptor, path, size)

    def write(self, descriptor, data):
        self._no_room_without(self.room.get(descriptor, 0), os.fstat(descriptor).st_size + len(data))
        return super().write(descriptor, data)

    def replace(self, prepared, data):
        self._no_room_without(self.room.get(prepared.descriptor, 0), len(data))
        super().replace(prepared, data)


@pytest.mark.parametrize("since", [Phase.PERMITTED, Phase.CUTTING, Phase.DONE])
def test_a_cut_that_was_permitted_is_not_stopped_by_a_disk_that_others_fill(pair, since):
    pair.disk = Crowded(clock=pair.clock)
    pair.to(since)
    pair.disk.full = True
    assert pair.end() is Phase.DONE
    assert pair.close().closed
    assert pair.read().report.status is Status.OK


def test_a_disk_that_is_full_before_the_permit_lets_none_leave(pair):
    pair.disk = Crowded(clock=pair.clock)
    pair.begin()
    pair.disk.room.clear()
    pair.disk.full = True
    assert pair.end() is Phase.STOPPED
    assert not first_frames(pair, records.Permit)
