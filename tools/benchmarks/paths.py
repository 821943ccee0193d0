"""The paths that are timed: a hip stem, a level pocket, and the four zigzags of the paper's Table 1."""

import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cutgate.config.load import load_robot
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.protocol.arrays import Floats
from cutgate.runtime.plan.load import load_plan, load_registration
from cutgate.runtime.plan.prepare import Prepared, prepare
from cutgate.runtime.verification.problem import Arm, Deadband, Problem
from cutgate.runtime.verification.recorded import problem_from_records

EXAMPLES = Path(__file__).parents[2] / "examples"

LENGTH_MM, EXTENT_MM, STROKES = 17501.0, 225.0, 25
TABLE_1 = ((765.299, 90.0, 97), (274.514, 90.0, 83), (500.0, 90.0, 47), (546.458, 0.0, 65))
"""Placements of the zigzag, rho in mm and phi in deg, and the evaluations that the paper prints."""

TABLE_2 = (
    (5000.0, 500, "hip-stem", "second"),
    (7000.0, 700, "femoral", "femoral"),
    (3000.0, 300, "tibial", "tibial"),
)
"""Path lengths, mm, the bounds that the paper prints for a deadband of 5 mm, the shipped plan and its registration."""


def prepared(registration: str, name: str = "hip-stem") -> tuple[Prepared, Problem]:
    """A shipped plan under one of its registrations; the hip stem has 2000 poses, 5003.6 mm, turning axis."""
    robot = load_robot(EXAMPLES / "robot.toml").value
    plan = load_plan(EXAMPLES / f"{name}.plan.json")
    placed = load_registration(EXAMPLES / f"registration-{registration}.json")
    ready = prepare(plan, placed, robot, now=datetime.now(UTC), clock_skew_s=0.0)
    bodies = (limits_record(robot).body(), calibration_record(robot).body(), tool_record(robot).body())
    return ready, problem_from_records(ready.path.body(), *bodies, robot, any_branch=True)


def hip_stem() -> Problem:
    """The example's second placement, which is admissible."""
    return prepared("second")[1]


def level_pocket() -> Problem:
    """The same robot: 2000 poses in 50 lines of 100 mm at constant height and axis, the wrist's radius changing."""
    k = np.arange(2000)
    line, along = k // 40, k % 40
    x = 2.5 * np.where(line % 2 == 0, along, 39 - along)
    tips = np.stack((440.0 + 1.6 * line, x - 48.75, np.full(2000, 120.0)), axis=1)
    lean = math.radians(20.0)
    axes = np.tile((math.sin(lean) * 0.6, math.sin(lean) * 0.8, math.cos(lean)), (2000, 1))
    return replace(hip_stem(), tips_mm=tips, axes=axes)


def zigzag(rho_mm: float, phi_deg: float) -> Problem:
    """The paper's arm, annulus 100..1000 mm, deadband 25 mm, and the reconstructed zigzag of Table 1."""
    k = np.arange(STROKES + 1)
    width = math.sqrt(LENGTH_MM**2 - EXTENT_MM**2) / STROKES
    x, y = -width / 2 * (-1.0) ** k, -EXTENT_MM / 2 + k * EXTENT_MM / STROKES
    c, s = math.cos(math.radians(phi_deg)), math.sin(math.radians(phi_deg))
    axes = np.tile((1.0, 0.0, 0.0), (len(k), 1))
    free = math.radians(36000.0)
    return Problem(
        tips_mm=np.stack((c * x - s * y + rho_mm - 160.0, s * x + c * y, np.zeros(len(k))), axis=1),
        axes=axes,
        feed_mm_s=10.0,
        tool_length_mm=160.0,
        arm=Arm(550.0, 450.0, "right"),
        lower=np.array((-free, 0.0, -1e4, -free, 0.0)),
        upper=np.array((free, math.pi, 1e4, free, math.pi)),
        speed=np.full(5, 1e9),
        deadband=Deadband(25.0, math.radians(2.0)),
    )


def finer(problem: Problem, parts: int) -> Problem:
    """The same path with each segment cut into equal parts."""
    tips, axes = sampled(problem, np.full(len(problem.tips_mm) - 1, parts))
    return replace(problem, tips_mm=tips, axes=axes)


def sampled(problem: Problem, parts: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Tips and unit axes at equal steps of every segment, both ends included."""
    segment = np.repeat(np.arange(len(parts)), parts)
    s = (np.arange(len(segment)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[segment]
    tips = problem.tips_mm[segment] * (1 - s)[:, None] + problem.tips_mm[segment + 1] * s[:, None]
    axes = problem.axes[segment] * (1 - s)[:, None] + problem.axes[segment + 1] * s[:, None]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return np.vstack((tips, problem.tips_mm[-1:])), np.vstack((axes, problem.axes[-1:]))
