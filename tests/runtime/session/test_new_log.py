"""A new log says who runs the session, where and on what, and holds every input file."""

import os
import socket

import pytest

from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session.new_log import new_log
from cutgate.runtime.verification.asked import BEST
from tests.logs import judged
from tests.runtime.session.pair import job_of

LOG_ID = bytes(range(16))


@pytest.mark.processes
@pytest.mark.parametrize("operator", [None, "Dr. Müller"])
def test_the_log_says_who_ran_the_session_and_where(tmp_path, tmp_path_factory, operator):
    files, job = job_of(tmp_path_factory)
    log = new_log(tmp_path, files, job.path, "test/x", BEST, operator, log_id=LOG_ID)
    log.close(final_state=Phase.WAITING, outcome="x", clean=True)
    (opened,) = judged(log.path).of("/audit/open")
    assert opened.get("operator") == operator
    assert str(os.getuid()) in opened["account"]
    assert opened["host"] == socket.gethostname()
