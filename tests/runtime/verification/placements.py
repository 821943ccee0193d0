"""Translations of a path judged by the dense oracle, pose by pose: the reference for the search."""

import math
from dataclasses import replace

import numpy as np

from tests.oracle.dense import Dense

ARM = ("inner", "outer", "left", "right")


def admitted(problem, translations, *, reserve_mm=0.0, reserve_rad=0.0):
    """Whether all poses keep their deadbands and the reserve after each translation (k, 3).

    All moved poses are laid one after the other and judged in one go; nothing between them is looked at.
    """
    k, n = len(translations), len(problem.tips_mm)
    if k == 0:
        return np.zeros(0, dtype=bool)
    tips = (problem.tips_mm[None, :, :] + np.asarray(translations)[:, None, :]).reshape(-1, 3)
    axes = np.tile(problem.axes, (k, 1))
    laid = replace(problem, tips_mm=np.vstack((tips, tips[-1:])), axes=np.vstack((axes, axes[-1:])))
    oracle = Dense(laid, per_segment=1)
    c, d = problem.calibration, problem.deadband
    keep = d.arm_mm + c.residual_mm + d.path_tolerance_mm + reserve_mm
    names = (
        (*ARM, "top", "bottom") if problem.upper[0] - problem.lower[0] < 2 * math.pi else ("inner", "outer")
    )
    fits = np.all([oracle.margins[name] >= keep for name in (*names, "top", "bottom")], axis=0).reshape(k, n)
    wrist = d.wrist_rad + c.residual_rad + d.path_tolerance_rad + reserve_rad
    spare = wrist + oracle.widening.reshape(k, n)
    roll = np.unwrap(oracle.q[:, 3].reshape(k, n), axis=1)
    return fits.all(axis=1) & _some_turn(roll, oracle.lo[3] + spare, oracle.hi[3] - spare)


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
