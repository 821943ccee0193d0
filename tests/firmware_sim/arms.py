"""Arms and paths for the tests of the simulated controller."""

import math

import numpy as np

from cutgate.protocol.records import Calibration, Limits, Path, Tool

TOOL_MM = 160.0
TOOL = Tool.quantised(length_mm=TOOL_MM)
LIMITS = Limits.quantised(
    q_min_deg=[-80, 0, 50, -170, 0],
    q_max_deg=[80, 145, 450, 170, 110],
    speed_deg_s=[57, 57, 200, 114, 114],
)
LEFT_LIMITS = Limits.quantised(
    q_min_deg=[-80, -145, 50, -170, 0],
    q_max_deg=[80, 0, 450, 170, 110],
    speed_deg_s=[57, 57, 200, 114, 114],
)
WIDE = Limits.quantised(
    q_min_deg=[-3000, 0, -1000, -3000, 0],
    q_max_deg=[3000, 180, 1000, 3000, 180],
    speed_deg_s=[57, 57, 200, 114, 114],
)
NOMINAL = Calibration.quantised(upper_link_mm=450, forearm_link_mm=450)
CALIBRATED = Calibration.quantised(
    upper_link_mm=450,
    forearm_link_mm=430,
    upper_link_error_mm=1.5,
    forearm_link_error_mm=-0.75,
    joint_offset_deg=[0.5, -0.4, 0.8, 0.3, -0.2],
    slide_tilt_mrad=[3.0, -5.0],
)


def tilted(polar_deg, azimuth_deg=0.0):
    """Unit tool axes, (n, 3)."""
    polar, azimuth = np.broadcast_arrays(np.radians(polar_deg), np.radians(azimuth_deg))
    return np.stack(
        (np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)), axis=-1
    ).reshape(-1, 3)


def line_path(start, end, *, poses=21, polar=(30, 40), azimuth=(0, 20), feed=10.0, **header):
    """A straight line with a turning axis."""
    s = np.linspace(0.0, 1.0, poses)
    tips = np.outer(1 - s, start) + np.outer(s, end)
    axes = tilted(polar[0] + s * (polar[1] - polar[0]), azimuth[0] + s * (azimuth[1] - azimuth[0]))
    options = {"elbow": "right", "tool_length_mm": TOOL_MM, **header}
    return Path.quantised(tips, axes, feed_mm_s=feed, **options)


PATH = line_path((500.0, 0.0, 100.0), (450.0, 120.0, 60.0))


def pocket(*, poses=2000, length_mm=5000.0):
    """Circles downward with a turning axis, about as long as a hip-stem cavity's path."""
    s = np.linspace(0.0, 1.0, poses)
    turn = math.tau * 25.0 * s
    round_mm = length_mm / (math.tau * 25.0)
    tips = np.column_stack((550 + round_mm * np.cos(turn), 60 + round_mm * np.sin(turn), 150 - 100 * s))
    axes = tilted(30 + 8 * np.sin(turn / 7), 25 * np.sin(turn / 9))
    return Path.quantised(tips, axes, feed_mm_s=10.0, tool_length_mm=TOOL_MM, elbow="right")
