"""Benches that are put away when a test ends."""

import os

import pytest

from tests.firmware_sim.bench import Bench


@pytest.fixture
def bench(tmp_path):
    made = []

    def make(**options):
        made.append(Bench(tmp_path, **options))
        return made[-1]

    yield make
    for one in made:
        for descriptor in one.descriptors:
            os.close(descriptor)
