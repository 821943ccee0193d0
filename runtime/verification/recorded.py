"""The verification problem from the bytes on the wire, for ``verify``, ``run`` and ``replay`` alike."""

import math

from cutgate.config.model import Robot
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.protocol import records
from cutgate.runtime.verification.problem import Arm, ArmCalibration, Deadband, Problem


def off_line_problem(path: records.Path, robot: Robot) -> Problem:
    """The problem that a path poses with the approved limits and calibration and the path's own tool, any joint branch.

    Raises:
        cutgate.protocol.records.RecordError: as `problem_from_records`.
    """
    limits, calibration = limits_record(robot).body(), calibration_record(robot).body()
    tool = tool_record(robot, path.tool_length_mm).body()
    return problem_from_records(path.body(), limits, calibration, tool, robot, any_branch=True)


def problem_from_records(
    path: bytes,
    limits: bytes,
    calibration: bytes,
    tool: bytes,
    robot: Robot,
    *,
    any_branch: bool = False,
) -> Problem:
    """The problem that the controller's records and the uploaded path pose.

    Args:
        path: canonical bytes of the path record.
        limits: canonical bytes of the limits record.
        calibration: canonical bytes of the calibration record.
        tool: canonical bytes of the tool record.
        robot: deadband and wrist settings; everything else comes from the records.
        any_branch: try every joint branch instead of the path's own; the verdict names the best.

    Raises:
        cutgate.protocol.records.RecordError: malformed records, records that no robot can have, another elbow than the
            robot's, or a path for another tool than the mounted one.
    """
    cut, bounds = records.Path.parse(path), records.Limits.parse(limits)
    found, mounted = records.Calibration.parse(calibration), records.Tool.parse(tool)
    problems = [*bounds.problems(), *found.problems(), *mounted.problems()]
    if cut.elbow != robot.elbow:
        problems.append(f"the path is for the {cut.elbow} elbow, must be for the robot's {robot.elbow} elbow")
    if cut.tool_length_u != mounted.length_u:
        problems.append(
            f"the path is for a tool of {cut.tool_length_mm} mm, must be for {mounted.length_mm} mm"
        )
    if problems:
        raise records.RecordError("; ".join(problems))
    return Problem(
        tips_mm=cut.tips_mm,
        axes=cut.axes,
        feed_mm_s=cut.feed_mm_s,
        tool_length_mm=mounted.length_mm,
        arm=Arm(found.upper_mm, found.forearm_mm, cut.elbow),
        lower=bounds.q_min,
        upper=bounds.q_max,
        speed=bounds.speed,
        acceleration=bounds.acceleration,
        calibration=ArmCalibration(
            upper_link_error_mm=found.upper_link_error_mm,
            forearm_link_error_mm=found.forearm_link_error_mm,
            joint_offset=found.joint_offset,
            slide_tilt=found.slide_tilt,
            residual_mm=found.residual_mm,
            residual_rad=found.residual_rad,
        ),
        hold_roll=math.radians(robot.wrist.hold_roll_deg) if robot.wrist.hold_roll_when_vertical else None,
        deadband=Deadband(
            arm_mm=robot.deadband.arm_mm,
            wrist_rad=math.radians(robot.deadband.wrist_deg),
            path_tolerance_mm=robot.deadband.path_tolerance_mm,
            path_tolerance_rad=math.radians(robot.deadband.path_tolerance_deg),
        ),
        branch=None if any_branch else (cut.q0_turns, cut.roll_turns),
    )
