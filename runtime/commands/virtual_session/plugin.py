"""pytest plugin: sessions of our runtime in virtual time (docs/hil.md).

pytest loads this module in every project of an environment that has cutgate: it imports nothing but pytest, and does
nothing for a test that asks for none of its fixtures.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from cutgate.runtime.commands.in_virtual_time import BenchInVirtualTime
    from cutgate.runtime.commands.virtual_session.session import VirtualSession


@pytest.fixture
def cutgate_virtual_session(cutgate_virtual: BenchInVirtualTime) -> Callable[..., VirtualSession]:
    """Begins a session of our runtime on the bus of ``cutgate_virtual``: ``cutgate_virtual_session(files=None, fd=False)``."""
    from functools import partial  # noqa: PLC0415

    from cutgate.runtime.commands.virtual_session.session import VirtualSession  # noqa: PLC0415

    return partial(VirtualSession, cutgate_virtual)
