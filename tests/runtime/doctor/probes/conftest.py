"""Places for probes to look at."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture
def place() -> Iterator[Path]:
    """A directory that everybody may enter, with a name short enough for a socket's path."""
    with tempfile.TemporaryDirectory(prefix="cutgate-") as directory:
        Path(directory).chmod(0o755)
        yield Path(directory)
