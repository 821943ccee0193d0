"""A registration of another program in a session: what is decided on is the JSON made of it, and the log keeps both."""

import json

import pytest

from cutgate.runtime.audit.replay import ReplayOutcome
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.plan.registrations.declared import CtFrame, Declared, TransformDirection
from cutgate.runtime.session.job import make_job, read_files
from cutgate.runtime.session.new_log import new_log
from cutgate.runtime.verification.asked import BEST
from tests.logs import judged
from tests.runtime.audit.build import inputs
from tests.runtime.session.pair import NOW, PLACED, pair_of

MATRIX = b"\xef\xbb\xbf1, 0, 0, 500\r\n0, 1, 0, 50\r\n0, 0, 1, 120\r\n0, 0, 0, 1\r\n"
DECLARED = Declared(CtFrame.LPS, TransformDirection.CT_TO_ROBOT, "2026-01-01T00:00:00Z", 0.2)


@pytest.fixture
def files(tmp_path):
    """The same place as that of `inputs`, as a plain matrix."""
    (tmp_path / "plan.csv").write_bytes(inputs().plan)
    (tmp_path / "robot.toml").write_bytes(inputs().robot.data)
    (tmp_path / "navigated.TXT").write_bytes(MATRIX)
    names = (tmp_path / name for name in ("plan.csv", "robot.toml", "navigated.TXT"))
    return read_files(*names, None, None, allow_simulated=True, declared=DECLARED)


def test_a_session_is_the_same_as_with_the_json_and_replays_from_that_alone(files, tmp_path):
    job = make_job(files, now=NOW)
    assert job.path == inputs().path
    assert job.place == inputs().placed.place
    PLACED[job.registration] = files.placed
    with pair_of(tmp_path, files, job) as pair:
        assert pair.end() is Phase.DONE
        assert pair.close().closed
        assert pair.replayed().outcome is ReplayOutcome.IDENTICAL


@pytest.mark.processes
def test_the_log_has_the_json_the_file_itself_and_what_was_declared(files, tmp_path):
    log = new_log(tmp_path / "logs", files, inputs().path, "test/x", BEST, None, log_id=bytes(16))
    log.close(final_state=Phase.WAITING, outcome="x", clean=True)
    found = judged(log.path)
    assert found.scan.attachment("registration-source.txt").data == MATRIX
    document = json.loads(found.scan.attachment("registration.json").data)
    assert document["R_T_CT"] == [[1, 0, 0, 500], [0, 1, 0, 50], [0, 0, 1, 120], [0, 0, 0, 1]]
    (opened,) = found.of("/audit/open")
    assert {"name": "registration declared", "value": str(DECLARED)} in opened["simulation"]
