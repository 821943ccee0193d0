"""A pair for every test, admissible unless asked otherwise."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.runtime.session.pair import INADMISSIBLE_MM, Pair, job_of, pair_of


@pytest.fixture
def pair(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    with pair_of(tmp_path, *job_of(tmp_path_factory)) as made:
        yield made


@pytest.fixture
def outside(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    """A pair whose bone stands out of reach."""
    with pair_of(tmp_path, *job_of(tmp_path_factory, INADMISSIBLE_MM)) as made:
        yield made
