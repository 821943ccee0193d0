"""Fixtures of the system tests."""

import pytest

from tests.system.harness import Rig


@pytest.fixture
def rig(tmp_path):
    """A hub, with everything that is started on it ended after the test."""
    with Rig(tmp_path) as made:
        yield made
