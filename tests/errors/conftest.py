"""Rows are played once for all tests: the page shows what the tests have seen."""

from collections.abc import Callable, Iterator

import pytest

from tests.errors.matrix import Row, observe
from tests.errors.scene import Observed
from tests.runtime.session.pair import Pair, job_of, pair_of

_SEEN: dict[str, Observed] = {}


@pytest.fixture
def pair(request, tmp_path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    """Of classic frames; a parameter names the sides that use CAN FD."""
    with pair_of(tmp_path, *job_of(tmp_path_factory), fd=getattr(request, "param", ())) as made:
        yield made


@pytest.fixture
def played(tmp_path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[Row], Observed]:
    """What became of a row."""

    def play(row: Row) -> Observed:
        if row.name not in _SEEN:
            directory = tmp_path / f"{len(_SEEN)}"
            directory.mkdir()
            with pair_of(directory, *job_of(tmp_path_factory)) as pair:
                _SEEN[row.name] = observe(row, pair)
        return _SEEN[row.name]

    return play
