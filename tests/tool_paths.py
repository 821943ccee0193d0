"""Tool paths of five-axis milling that tests read: our own, and where they are present real ones of others."""

from pathlib import Path

import pytest

OWN = Path(__file__).parent / "data"
REAL = Path(__file__).parents[2] / "shared" / "paths"


def tool_path(name: str) -> Path:
    """The file of that name; the test is skipped where it is one that we may not ship and that is not there."""
    if (OWN / name).exists():
        return OWN / name
    if not (REAL / name).exists():
        pytest.skip(f"{name}, a real tool path that is not ours to ship, is not there")
    return REAL / name
