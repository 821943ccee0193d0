"""A long path costs the loops no turn: it is looked at before the session opens, in parts, or in the worker."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from cutgate.firmware_sim.upload import CHECK_POSES_PER_CYCLE
from cutgate.protocol import path as paths
from cutgate.protocol import records
from cutgate.runtime.interlock.state import Phase
from tests.runtime.session.pair import Pair

PARTS = 300


def finer(body: bytes) -> bytes:
    """The same path with each segment cut into equal parts."""
    path = records.Path.parse(body)
    places = np.linspace(0.0, len(path) - 1.0, (len(path) - 1) * PARTS + 1)
    columns = np.hstack((path.tips_mm, path.axes)).T
    found = np.stack([np.interp(places, np.arange(len(path)), column) for column in columns], axis=1)
    return records.Path.quantised(
        found[:, :3],
        found[:, 3:] / np.linalg.norm(found[:, 3:], axis=1, keepdims=True),
        feed_mm_s=path.feed_mm_s,
        tool_length_mm=path.tool_length_mm,
        elbow=path.elbow,
        q0_turns=path.q0_turns,
        roll_turns=path.roll_turns,
    ).body()


class Looks:
    """How often a whole path was parsed, and how many poses were decoded at once, outside the worker."""

    def __init__(self, pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
        self.counted: Counter[str] = Counter()
        self.counting = False
        prove, self.most = pair.prover.answer, 0

        def apart(request):
            self.counting = False
            answer = prove(request)
            self.counting = True
            return answer

        pair.prover.answer = apart
        judge, decode = records.Path.__post_init__, paths.decode_axes

        def judged(path):
            self.counted["whole path"] += self.counting
            judge(path)

        def decoded(mapped):
            if self.counting:
                self.most = max(self.most, len(mapped))
            return decode(mapped)

        monkeypatch.setattr(records.Path, "__post_init__", judged)
        monkeypatch.setattr(paths, "decode_axes", decoded)


def test_no_loop_looks_at_a_whole_path_once_the_session_opens(pair, monkeypatch):
    pair.begin(replace(pair.job, path=finer(pair.job.path)))
    poses = paths.PathHeader.of(pair.job.path).count
    looks = Looks(pair, monkeypatch)
    looks.counting = True
    pair.to(Phase.CUTTING, 60.0)
    assert looks.counted["whole path"] == 0
    assert 0 < looks.most <= CHECK_POSES_PER_CYCLE + 1 < poses


def test_the_digest_of_the_path_is_taken_before_the_first_turn(pair, monkeypatch):
    pair.begin(replace(pair.job, path=finer(pair.job.path)))
    sizes = []
    whole = records.digest
    monkeypatch.setattr(records, "digest", lambda body: sizes.append(len(body)) or whole(body))
    pair.controller_runs = False
    pair.run(0.1)
    assert pair.state.job.path_digest == whole(pair.job.path)
    assert len(pair.job.path) not in sizes
