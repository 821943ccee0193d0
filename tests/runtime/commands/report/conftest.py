"""The sessions that are reported."""

import pytest

from tests.runtime.commands.report.sessions import logs_of


@pytest.fixture(scope="package")
def logs(tmp_path_factory):
    return logs_of(tmp_path_factory)
