"""Translations of a path judged by the dense oracle, pose by pose: the reference for the search."""

import math

import numpy as np

from tests.oracle.dense import SIDES, Dense, Samples


def admitted(problem, translations, *, reserve_mm=0.0, reserve_rad=0.0):
    """Whether all poses keep their deadbands and the reserve after each translation (k, 3).

    All moved poses are laid one after the other and judged in one go; nothing between them is looked at.
    """
    k, n = len(translations), len(problem.tips_mm)
    if k == 0:
        return np.zeros(0, dtype=bool)
    tips = (problem.tips_mm[None, :, :] + np.asarray(translations)[:, None, :]).reshape(-1, 3)
    axes = np.tile(problem.axes, (k, 1))
    oracle = Dense(problem, per_segment=2)
    xy, q = oracle.joints(tips, axes)
    sides = np.stack([oracle.side_distance(xy, name) for name in SIDES], axis=1)
    bent = (q[:, 1] >= oracle.q1[0]) & (q[:, 1] <= oracle.q1[1])
    turned = np.mod(q[:, 0] - oracle.lo[0], 2 * math.pi) <= oracle.hi[0] - oracle.lo[0]
    nothing = np.zeros(len(q))
    x = Samples(nothing, nothing, q, sides, bent & turned, oracle.strays(xy, q))
    keep = problem.deadband.arm_mm + oracle.error_mm + reserve_mm
    bounding = oracle.signed(x)[:, : 2 if oracle.full else 4].min(axis=1)
    slide = np.minimum(oracle.hi[2] - q[:, 2], q[:, 2] - oracle.lo[2])
    fits = (np.minimum(bounding, slide) >= keep).reshape(k, n)
    wrist = problem.deadband.wrist_rad + oracle.error_rad + reserve_rad
    down, up = (wrist + x.strays[:, side].reshape(k, n) for side in (0, 1))
    roll = np.unwrap(q[:, 3].reshape(k, n), axis=1)
    return fits.all(axis=1) & _some_turn(roll, oracle.lo[3] + down, oracle.hi[3] - up)


def _some_turn(angle, lower, upper):
    """Whether one whole number of turns brings all angles of a row between their limits."""
    least, most = ((lower - angle) / (2 * math.pi)).max(axis=1), ((upper - angle) / (2 * math.pi)).min(axis=1)
    return np.ceil(least) <= np.floor(most)


def grid(centre, half, step):
    """Planar translations about a centre, with its height, shape (k, 3)."""
    ticks = np.arange(-half, half + step / 2, step)
    x, y = np.meshgrid(ticks, ticks)
    flat = np.stack((x.ravel(), y.ravel(), np.zeros(x.size)), axis=1)
    return flat + np.asarray(centre)
