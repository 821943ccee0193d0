"""Input files of a short session: 300 poses in the middle of the example robot's workspace, done in a second."""

import json
import math
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cutgate.config.key import new_key_file
from cutgate.config.load import EXAMPLES
from cutgate.protocol.codes import KEY_BYTES

STANDS: Final = "-35.5,79.5,340,-4,30.5"
"""Where the arm stands at power-up, deg and mm: half a degree from the entry pose, so that no test waits for the approach."""
POSES: Final = 300
FEED_MM_S: Final = 2.0
UNIT: Final = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
SITE: Final = """schema = "cutgate.site/1"
clock_skew_s = 0
[timing]
heartbeat_ms = 50
timeout_ms = 1000
[approach]
approach_clearance_mm = 0.5
[controller]
simulated = true
"""
"""Time-outs of a desktop on which other tests run; a simulated controller is allowed."""


@dataclass(frozen=True)
class HilFiles:
    """What a session reads, and where the simulated arm stands at power-up (deg and mm, None: the middle of its limits)."""

    plan: Path
    robot: Path
    registration: Path
    site: Path
    key: Path
    joints: str | None = None


def write_files(folder: Path) -> HilFiles:
    """Write a short plan, its registration, a site and a new key into a folder that exists."""
    files = HilFiles(
        plan=folder / "plan.json",
        robot=EXAMPLES / "robot.toml",
        registration=folder / "registration.json",
        site=folder / "site.toml",
        key=folder / "site.key",
        joints=STANDS,
    )
    files.plan.write_text(json.dumps(short_plan()), encoding="utf-8")
    files.registration.write_text(json.dumps(unit_registration()), encoding="utf-8")
    files.site.write_text(SITE, encoding="utf-8")
    new_key_file(files.key, secrets.token_bytes(KEY_BYTES))
    return files


def short_plan() -> dict[str, Any]:
    """36 mm of path, two blocks on the wire."""
    poses = []
    for number in range(POSES):
        part = number / (POSES - 1)
        lean, toward = math.radians(30 + 10 * part), math.radians(40 + 20 * part)
        axis = (math.sin(lean) * math.cos(toward), math.sin(lean) * math.sin(toward), math.cos(lean))
        tip = (630 - 30 * part, -5 * math.sin(6 * part), 200.0)
        poses.append([round(value, 6) for value in (*tip, *axis)])
    return {
        "schema": "cutgate.plan/1",
        "id": "short",
        "implant": "none",
        "side": "left",
        "units": "mm",
        "feed_mm_s": FEED_MM_S,
        "ct_T_implant": UNIT,
        "poses": poses,
    }


def unit_registration() -> dict[str, Any]:
    """The plan is in the robot's coordinates."""
    return {
        "schema": "cutgate.registration/1",
        "id": "unit",
        "R_T_CT": UNIT,
        "residual_rms_mm": 0.1,
        "created_utc": "2026-01-01T00:00:00Z",
    }
