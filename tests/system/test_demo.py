"""``cutgate demo``: the whole story in processes of its own, as a newcomer runs it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from cutgate.runtime.audit.inspect import Status
from tests.system.harness import judged

pytestmark = pytest.mark.processes


def test_the_demo_refuses_explains_and_cuts(tmp_path):
    (tmp_path / "demo").mkdir()  # one that is there and empty will do
    command = [sys.executable, "-m", "cutgate.runtime.cli", "demo", "--out", str(tmp_path / "demo"), "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    document = json.loads(done.stdout)
    assert document["as_told"] is True
    assert document["elapsed_s"] < 30.0
    first, second = document["sessions"]
    assert (first["outcome"], second["outcome"]) == ("not_admitted", "completed")
    assert first["verdict"]["verdict"] == "inadmissible"
    assert first["verdict"]["guidance"]["verified"] is True
    assert second["verdict"]["verdict"] == "admissible"
    assert [review["replay"] for review in document["reviews"]] == ["IDENTICAL", "IDENTICAL"]
    assert all(judged(Path(run["log"]["mcap"])).report.status is Status.OK for run in (first, second))
    for run, report in zip((first, second), document["reports"], strict=True):
        assert Path(report) == Path(run["log"]["mcap"]).with_suffix(".html")
        assert '<header id="top">' in Path(report).read_text(encoding="utf-8")
