"""A session with a simulated controller, in virtual time, whose log is exported; and the file, read in both ways."""

import json
import math
from collections import defaultdict
from contextlib import redirect_stderr
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Message, Schema

from cutgate.runtime.audit.container.scan import walk
from cutgate.runtime.audit.container.stored import Scan, Stored
from cutgate.runtime.commands.app import execute
from cutgate.runtime.interlock.state import Phase
from tests.runtime.session.pair import Pair


class Exported(NamedTuple):
    """A message of the file, parsed."""

    topic: str
    schema: str
    time_ns: int
    data: dict[str, Any]


def finished_session(pair: Pair) -> Path:
    """The log of a session that cut to its end, or was refused, whichever it comes to."""
    pair.power_up(time_scale=2.0)
    assert pair.begin().end(limit_s=60.0) in (Phase.DONE, Phase.REFUSED)
    return pair.close().log


def export(log: Path, out: Path) -> tuple[int, str]:
    """Exit code, and what is said on standard error, in one line."""
    said = StringIO()
    with redirect_stderr(said):
        code = execute(["audit", "export", str(log), "--to", "foxglove", "-o", str(out)])
    return code, " ".join(said.getvalue().split())


def exported(log: Path, folder: Path) -> bytes:
    """The file that is made of a log."""
    out = folder / "out.mcap"
    code, said = export(log, out)
    assert code == 0, said
    return out.read_bytes()


def quaternion_matrix(q: dict[str, float]) -> Any:
    """The rotation of a unit quaternion, shape (3, 3)."""
    x, y, z, w = (q[name] for name in "xyzw")
    assert math.hypot(x, y, z, w) == pytest.approx(1.0, abs=1e-8)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def matrix(transform: dict[str, Any]) -> Any:
    """A frame's transform, shape (4, 4)."""
    out = np.eye(4)
    out[:3, :3] = quaternion_matrix(transform["rotation"])
    out[:3, 3] = [transform["translation"][name] for name in "xyz"]
    return out


def read_linearly(data: bytes) -> list[tuple[Schema, Channel, Message]]:
    """As a reader finds the messages that goes from front to back."""
    return list(NonSeekingReader(BytesIO(data), validate_crcs=True).iter_messages(log_time_order=False))


def read_indexed(data: bytes) -> list[tuple[Schema, Channel, Message]]:
    """As a reader finds the messages that begins with the summary."""
    return list(make_reader(BytesIO(data), validate_crcs=True).iter_messages())


def by_topic(data: bytes) -> dict[str, list[Exported]]:
    """Every message, by its topic."""
    found = defaultdict(list)
    for schema, channel, message in read_indexed(data):
        one = Exported(channel.topic, schema.name, message.log_time, json.loads(message.data))
        found[channel.topic].append(one)
    return dict(found)


def stored(log: Path) -> list[Stored]:
    """Every record of a log."""
    return list(walk(BytesIO(log.read_bytes()), Scan()))
