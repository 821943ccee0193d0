"""Whole sessions with bulk records in CAN FD frames; and a side that uses them against one that does not."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from cutgate.protocol.frames import BULK_IDS
from cutgate.protocol.states import ControllerState, StopCause
from cutgate.protocol.transfer import FD_LENGTHS
from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.interlock.state import Phase
from tests.runtime.session.pair import Pair, job_of, pair_of
from tests.runtime.session.wire import CONTROLLER, RUNTIME, double, flip, lose, nth


@pytest.fixture
def with_fd(tmp_path, tmp_path_factory) -> Iterator[Callable[..., Pair]]:
    """A pair of which these sides use FD frames."""
    with ExitStack() as stack:
        yield lambda *sides: stack.enter_context(pair_of(tmp_path, *job_of(tmp_path_factory), fd=sides))


@pytest.fixture
def pair(with_fd) -> Pair:
    return with_fd(RUNTIME, CONTROLLER)


def test_a_session_over_fd_cuts_every_segment_and_leaves_a_log_that_replays(pair):
    assert pair.end() is Phase.DONE
    assert any("DONE: 5 segments executed" in line for line in pair.said)
    pair.run(0.2)
    assert pair.close().closed
    assert pair.read().report.status is Status.OK
    assert pair.replayed().outcome is ReplayOutcome.IDENTICAL


def test_bulk_frames_alone_are_fd_and_everything_else_is_8_bytes_classic(pair):
    pair.end()
    for seen in pair.wire.seen:
        assert seen.is_fd is (seen.can_id in BULK_IDS), seen
        assert len(seen.data) in (FD_LENGTHS if seen.is_fd else (8,)), seen
    assert max(len(seen.data) for seen in pair.wire.seen) == 64


def test_the_raw_frames_in_the_log_say_which_are_fd(pair):
    pair.end()
    pair.close()
    lines = [line.split()[2] for line in pair.paths.candump.read_text(encoding="ascii").splitlines()]
    bulk = [line for line in lines if line.startswith(("640", "641"))]
    assert bulk
    assert all(line[3:6] == "##5" for line in bulk)
    assert not any("##" in line for line in lines if line not in bulk)


@pytest.mark.parametrize(
    ("change", "which"),
    [(lose, 0), (lose, 2), (double, 0), (double, 1), (flip, 0), (flip, 1), (flip, 2)],
)
@pytest.mark.parametrize("can_id", BULK_IDS)
def test_a_disturbed_fd_frame_never_leads_to_a_permit_of_other_bytes(pair, can_id, change, which):
    """It fails the transfer, is caught by a CRC, or was padding: then the session goes on with the right bytes."""
    pair.wire.rules.append(nth(can_id, range(which, which + 1), change))
    assert pair.end(60.0) in (Phase.DONE, Phase.STOPPED)
    if pair.phase is Phase.DONE:
        assert pair.state.stored.digest == pair.job.path_digest
        return
    causes = (StopCause.TRANSFER_FAILED, StopCause.PROTOCOL_VIOLATION)
    assert pair.state.cause in causes, pair.state.reason
    pair.run(3.0)
    assert pair.controller.state in (ControllerState.INHIBITED, ControllerState.FAULT)


@pytest.mark.parametrize("side", [RUNTIME, CONTROLLER])
def test_one_side_alone_with_fd_ends_in_words_before_anything_is_uploaded(with_fd, side):
    pair = with_fd(side)
    assert pair.end() is Phase.STOPPED
    assert pair.state.cause is StopCause.TRANSFER_FAILED
    assert pair.state.reason
    pair.run(3.0)
    assert pair.controller.state in (ControllerState.INHIBITED, ControllerState.FAULT)
    assert Phase.VERIFYING not in pair.notes.phases
    assert pair.close().closed
    assert pair.read().report.status is Status.OK
    assert "limits, calibration and tool did not arrive" in pair.state.reason
