"""How fast the certified verification is, as ratios in one run: ``python benchmarks/verification.py``.

The rival is what a careful engineer would write instead: sample the path densely, run vectorised inverse
kinematics in numpy and take the smallest joint margins. It proves nothing between its samples.
"""

import platform
import resource
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from config.load import load_robot
from config.records import calibration_record, limits_record, tool_record
from runtime.plan.load import load_plan, load_registration
from runtime.plan.prepare import prepare
from runtime.verification import certified
from runtime.verification.problem import Problem
from runtime.verification.recorded import problem_from_records

EXAMPLES = Path(__file__).parents[1] / "examples"
RUNS = 7
Floats = NDArray[np.float64]


def hip_stem() -> Problem:
    """The example's second placement: 2000 poses, 5003.6 mm, turning axis."""
    robot = load_robot(EXAMPLES / "robot.toml").value
    plan = load_plan(EXAMPLES / "hip-stem.plan.json")
    placed = load_registration(EXAMPLES / "registration-second.json")
    path = prepare(plan, placed, robot, now=datetime.now(UTC)).path
    bodies = (limits_record(robot).body(), calibration_record(robot).body(), tool_record(robot).body())
    return problem_from_records(path.body(), *bodies, robot)


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


def dense(problem: Problem, step_mm: float) -> Floats:
    """Smallest margin of each joint at samples at most ``step_mm`` apart along the tip, rad and mm, shape (5,)."""
    lengths = np.linalg.norm(np.diff(problem.tips_mm, axis=0), axis=1)
    tips, axes = sampled(problem, np.maximum(1, np.ceil(lengths / step_mm)).astype(np.int64))
    wrist = tips + problem.tool_length_mm * axes
    a0, a1 = problem.arm.upper_mm, problem.arm.forearm_mm
    cosine = (np.square(wrist[:, :2]).sum(axis=1) - a0 * a0 - a1 * a1) / (2 * a0 * a1)
    q1 = np.arccos(cosine)
    q0 = np.arctan2(wrist[:, 1], wrist[:, 0]) - np.arctan2(a1 * np.sin(q1), a0 + a1 * cosine)
    roll = np.arctan2(axes[:, 1], axes[:, 0]) - q0 - q1
    q3 = np.mod(roll + np.pi, 2 * np.pi) - np.pi
    joints = np.stack((q0, q1, wrist[:, 2], q3, np.arccos(axes[:, 2])), axis=1)
    margin: Floats = np.minimum(joints - problem.lower, problem.upper - joints).min(axis=0)
    return margin


def seconds(*works: Callable[[], object]) -> list[float]:
    """Median seconds of each, the works taken in turn so that a drifting machine hits all alike."""
    times: list[list[float]] = [[] for _ in works]
    for run in range(RUNS + 1):
        for work, kept in zip(works, times, strict=True):
            began = time.perf_counter()
            work()
            if run:  # the first warms up
                kept.append(time.perf_counter() - began)
    return [median(kept) for kept in times]


def main() -> None:
    """Print the table."""
    problem = hip_stem()
    print(
        f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, median of {RUNS}"
    )
    own, coarse, fine = seconds(
        lambda: certified.verify(problem), lambda: dense(problem, 1.0), lambda: dense(problem, 0.1)
    )
    print(f"hip stem, 2000 poses, 5003.6 mm: certified {own * 1e3:.1f} ms, proved for every point")
    print(f"  sampled at 1 mm   {coarse * 1e3:6.1f} ms: certified takes {own / coarse:.2f} of it")
    print(f"  sampled at 0.1 mm {fine * 1e3:6.1f} ms: certified takes {own / fine:.2f} of it")
    print("growth, the same path cut finer:")
    for parts in (1, 5, 50, 500):
        many = finer(problem, parts)
        began = time.perf_counter()
        verdict = certified.verify(many)
        took = time.perf_counter() - began
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"  {len(many.tips_mm):8} poses {took * 1e3:8.1f} ms {took / len(many.tips_mm) * 1e6:5.2f} us a segment, "
            f"peak {peak:4.0f} MiB, {'admissible' if verdict.admissible else 'inadmissible'}"
        )


if __name__ == "__main__":
    main()
