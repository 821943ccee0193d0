"""Time of day as the protocol counts it: whole microseconds since 1970, UTC."""

from datetime import UTC, datetime, timedelta
from typing import Final

BEGINNING: Final = datetime(1970, 1, 1, tzinfo=UTC)


def since_1970_us(at: datetime) -> int:
    """As the protocol counts it.

    Args:
        at: aware.
    """
    return (at - BEGINNING) // timedelta(microseconds=1)
