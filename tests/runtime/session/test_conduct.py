"""A session's parts put together: what cannot be begun leaves a closed log."""

from types import SimpleNamespace

import pytest

from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.interlock.state import Phase
from cutgate.runtime.session import conduct
from tests.logs import judged
from tests.runtime.audit.build import open_log
from tests.runtime.interlock.builders import DEADLINES, TIMING


@pytest.fixture
def log(tmp_path):
    with open_log(tmp_path) as made:
        yield made


def test_a_verification_process_that_cannot_be_started_leaves_a_closed_log(log, monkeypatch):
    def none_left(_path):
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(conduct.Worker, "start", none_left)
    state = SimpleNamespace(
        job=SimpleNamespace(timing=TIMING, deadlines=DEADLINES, path=b"", fd=False), phase=Phase.WAITING
    )
    given = conduct.Given(None, None, state, bytes(32), None, "a/b", log, bytes(16), (), fd=False)
    with pytest.raises(OSError, match="temporarily unavailable"):
        conduct.conduct(given, None, None)
    found = judged(log.path)
    assert found.report.status is Status.OK
    (closed,) = found.of("/audit/close")
    assert (closed["clean"], closed["outcome"]) == (False, "the verification process cannot be started")
