"""The paper's Table 1: the arm of its Figure 2 and the reconstructed zigzag."""

import math

import numpy as np

from cutgate.runtime.verification.problem import Arm, Deadband
from tests.runtime.verification.cases import DEG, WIDE, axis, problem, wrist_path

LENGTH, EXTENT, STROKES, DEADBAND = 17501.0, 225.0, 25, 25.0

TABLE_1 = [
    # rho mm, phi deg, evaluations, smallest clearance mm
    (765.299, 90.0, 97, 55.000),
    (274.514, 90.0, 83, 66.500),
    (500.0, 90.0, 47, 291.968),
    (546.458, 0.0, 65, 96.519),
]


def zigzag(rho, phi_deg):
    """The reconstructed zigzag of Table 1: 25 equal strokes, 17501 mm, 225 mm across."""
    k = np.arange(STROKES + 1)
    width = math.sqrt(LENGTH**2 - EXTENT**2) / STROKES
    x, y = -width / 2 * (-1.0) ** k, -EXTENT / 2 + k * EXTENT / STROKES
    c, s = math.cos(phi_deg * DEG), math.sin(phi_deg * DEG)
    return np.stack((c * x - s * y + rho, s * x + c * y, np.full(len(k), 100.0)), axis=1)


def annulus(centres, **changes):
    """The Figure 2 arm: unlimited joints, annulus 100..1000 mm, level tool."""
    tips, axes = wrist_path(centres, axis(90 * DEG, 0.3))
    values = {
        "arm": Arm(550.0, 450.0, "right"),
        "lower": np.array([-WIDE, 0.0, -1e4, -WIDE, 0.0]),
        "upper": np.array([WIDE, math.pi, 1e4, WIDE, math.pi]),
        "speed": np.full(5, 1e9),
        "deadband": Deadband(DEADBAND, 2 * DEG),
    }
    return problem(tips, axes, **(values | changes))
