"""The longest turn of both loops while a long path is uploaded, checked and verified."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from pages import Rows
from paths import EXAMPLES

from cutgate.config.key import new_key_file
from cutgate.firmware_sim.hil.hub import hub_process
from cutgate.protocol.codes import KEY_BYTES

PARTS = 100
"""Each segment of the hip stem is cut in so many: 199 901 poses."""
HEARTBEAT_S = 0.02
SITE = """schema = "cutgate.site/1"
[timing]
timeout_ms = 1000
transfer_timeout_s = 120
"""
"""The longest time-out: where other programs keep the machine busy the session goes on all the same."""
TIMED = Path(__file__).with_name("timed.py")


def longest_turns() -> Rows:
    """Hub, runtime and simulated controller as processes, bulk records in FD frames, up to the permit.

    A turn is what a loop does between two waits; CPU is what it used of the processor in it, without the times in which
    another program had it. A heartbeat period is 20 ms. The hub does not slow the bus down to its bit rate.
    """
    with tempfile.TemporaryDirectory(prefix="cutgate-") as name:
        poses, found = finer_plan(Path(name) / "plan.json"), _session(Path(name))
    yield ("path", "loop", "turns", "longest turn", "longest turn, CPU", "CPU / heartbeat period", "upload")
    for side in ("runtime", "controller"):
        told = found[side]
        turns = (str(told["turns"]), f"{told['longest_s'] * 1e3:.1f} ms", f"{told['cpu_s'] * 1e3:.1f} ms")
        ratio = f"{told['cpu_s'] / HEARTBEAT_S:.2f}"
        yield (f"{poses} poses", side, *turns, ratio, f"{found['upload_s']:.1f} s")


def finer_plan(to: Path) -> int:
    """The hip stem's plan, each segment cut into equal parts; how many poses."""
    plan = json.loads((EXAMPLES / "hip-stem.plan.json").read_text(encoding="utf-8"))
    poses = np.array(plan["poses"])
    places = np.linspace(0.0, len(poses) - 1.0, (len(poses) - 1) * PARTS + 1)
    fine = np.stack([np.interp(places, np.arange(len(poses)), column) for column in poses.T], axis=1)
    fine[:, 3:6] /= np.linalg.norm(fine[:, 3:6], axis=1, keepdims=True)
    plan["poses"] = np.round(fine, 9).tolist()
    to.write_text(json.dumps(plan), encoding="utf-8")
    return len(fine)


def _session(folder: Path) -> dict[str, Any]:
    """One session up to its permit: what both processes tell of their turns, and how long the upload took."""
    socket, key = folder / "bus.sock", folder / "bench.key"
    (folder / "site.toml").write_text(SITE, encoding="utf-8")
    new_key_file(key, bytes(range(KEY_BYTES)))
    common = ["--robot", str(EXAMPLES / "robot.toml"), "--key", str(key), "--fd"]
    common += ["--interface", "cutgate", "--channel", str(socket)]
    run = ["run", str(folder / "plan.json"), "--registration", str(EXAMPLES / "registration-second.json")]
    run += ["--site", str(folder / "site.toml"), "--log-dir", str(folder / "logs")]
    with (
        hub_process(socket),
        _start("controller", folder, ["sim", *common]) as controller,
        _start("runtime", folder, [*run, *common]) as runtime,
    ):
        try:
            _permitted(runtime)
        finally:
            for child in (runtime, controller):
                child.terminate()
                child.communicate(timeout=20.0)
    (frames,) = (folder / "logs").glob("*.candump.log")
    return {
        "upload_s": _upload_s(frames.read_text(encoding="ascii")),
        **{
            side: json.loads((folder / side).read_text(encoding="utf-8"))
            for side in ("runtime", "controller")
        },
    }


def _permitted(runtime: "subprocess.Popen[str]") -> None:
    """Wait for the permit. Raises RuntimeError where the session ends without one."""
    assert runtime.stderr is not None
    said = []
    for line in runtime.stderr:
        said.append(line)
        if "permitted:" in line:
            return
        if "STOP" in line or "refused" in line:
            break
    raise RuntimeError("".join(said))


def _start(side: str, folder: Path, arguments: list[str]) -> "subprocess.Popen[str]":
    command = [sys.executable, str(TIMED), side, str(folder / side), *arguments]
    pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
    return subprocess.Popen(command, stdin=pipe, stdout=nowhere, stderr=pipe, text=True)


def _upload_s(candump: str) -> float:
    """From the first bulk frame of the runtime to its last."""
    times = [float(line[1 : line.index(")")]) for line in candump.splitlines() if " 640##" in line]
    return times[-1] - times[0]
