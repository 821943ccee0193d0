"""What the files of a site say as the records of the wire: what a controller must report, and what it is asked for.

The approved values of ``robot.toml`` are quantised as the wire does: limits inward, residuals outward, everything else to the nearest 1e-6 of its unit.
The controller's own records must equal these.
"""

import math
from collections.abc import Sequence

from cutgate.config.model import Robot, Site
from cutgate.protocol.records import Calibration, Limits, Timing, Tool


def limits_record(robot: Robot) -> Limits:
    """Position, speed and acceleration limits.

    Raises:
        cutgate.protocol.records.RecordError: a value too large for the wire.
    """
    limits = robot.limits
    pairs = (limits.q0_deg, limits.q1_deg, limits.q2_mm, limits.q3_deg, limits.q4_deg)
    return Limits.quantised(
        q_min_deg=[low for low, _ in pairs],
        q_max_deg=[high for _, high in pairs],
        speed_deg_s=_in_degrees(limits.speed),
        acceleration_deg_s2=None if limits.acceleration is None else _in_degrees(limits.acceleration),
    )


def calibration_record(robot: Robot) -> Calibration:
    """Nominal links, their errors, joint offsets, slide tilt and residuals.

    Raises:
        cutgate.protocol.records.RecordError: a value too large for the wire.
    """
    found = robot.calibration
    return Calibration.quantised(
        upper_link_mm=robot.arm.upper_link_mm,
        forearm_link_mm=robot.arm.forearm_link_mm,
        upper_link_error_mm=found.upper_link_error_mm,
        forearm_link_error_mm=found.forearm_link_error_mm,
        joint_offset_deg=found.joint_offset_deg,
        slide_tilt_mrad=found.slide_tilt_mrad,
        residual_mm=found.residual_mm,
        residual_deg=found.residual_deg,
    )


def tool_record(robot: Robot, tool_length_mm: float | None = None) -> Tool:
    """The mounted tool, or one of ``tool_length_mm`` in its place (off-line verification).

    Raises:
        cutgate.protocol.records.RecordError: not finite or too large for the wire.
    """
    return Tool.quantised(length_mm=robot.tool.length_mm if tool_length_mm is None else tool_length_mm)


def timing_record(site: Site) -> Timing:
    """What OPEN asks for; ``config.model`` lets no tolerance through that is finer than the wire."""
    return Timing(
        heartbeat_ms=site.timing.heartbeat_ms,
        timeout_ms=site.timing.timeout_ms,
        permit_lifetime_s=site.permit.permit_lifetime_s,
        start_lifetime_ms=site.start.start_lifetime_ms,
        start_tolerance_um=round(site.start.start_tolerance_mm * 1000),
        start_tolerance_mdeg=round(site.start.start_tolerance_deg * 1000),
        approach_clearance_um=round(site.approach.approach_clearance_mm * 1000),
        approach_speed_percent=site.approach.approach_speed_percent,
    )


def _in_degrees(values: Sequence[float]) -> list[float]:
    """Rotary joints from rad to deg; the slide stays in mm."""
    return [value if joint == 2 else math.degrees(value) for joint, value in enumerate(values)]
