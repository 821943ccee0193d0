"""A session's log verified, decided again and told."""

from pathlib import Path
from typing import Any

from cutgate.runtime.audit.inspect import Status
from cutgate.runtime.audit.reading import candump_of, reading
from cutgate.runtime.audit.replay import replay
from cutgate.runtime.review.story import story
from cutgate.runtime.session.job import VERIFIER
from cutgate.runtime.verification import certified


def reviewed(path: Path) -> dict[str, Any]:
    """The log verified, replayed and told."""
    with reading(path) as log:
        again = replay(log, certified.verify, verifier=VERIFIER)
        told = story(log, path, candump_of(path))
    return {
        "log": str(path),
        "verify": "OK" if log.report.status is Status.OK else log.report.status.name,
        "headline": log.report.headline,
        "replay": again.outcome.name,
        "why": [*log.report.reasons, *again.differences],
        "story": told,
    }
