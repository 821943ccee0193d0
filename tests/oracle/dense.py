"""Dense reference: own inverse kinematics and own distances, by brute force, for both elbows.

Takes any object with the attributes of a verification problem and imports nothing of the packages
under test. Boundaries are sampled through forward kinematics of the joint rectangle's sides, so the
clipped-arc formulas are not used here either.
"""

import math

import numpy as np


class Dense:
    """All margins of a path at many sampled poses."""

    def __init__(self, problem, per_segment=200):
        c, arm = problem.calibration, problem.arm
        self.problem = problem
        self.sign = 1.0 if arm.elbow == "right" else -1.0
        self.a0 = arm.upper_mm + c.upper_link_error_mm
        self.a1 = arm.forearm_mm + c.forearm_link_error_mm
        self.lo = np.array(problem.lower) + c.joint_offset
        self.hi = np.array(problem.upper) + c.joint_offset
        bent = (0.0, math.pi) if self.sign > 0 else (-math.pi, 0.0)
        self.q1 = (max(self.lo[1], bent[0]), min(self.hi[1], bent[1]))
        n = len(problem.tips_mm) - 1
        self.segment = np.repeat(np.arange(n), per_segment)
        self.s = np.tile(np.linspace(0.0, 1.0, per_segment), n)
        self.margins = self._margins(*self.poses(self.segment, self.s))

    def poses(self, segment, s):
        """Tip and axis: the axis by Rodrigues' rotation about the common normal."""
        p, u = self.problem.tips_mm, self.problem.axes
        tip = p[segment] * (1 - s)[:, None] + p[segment + 1] * s[:, None]
        first, second = u[segment], u[segment + 1]
        normal = np.cross(first, second)
        length = np.linalg.norm(normal, axis=1)
        angle = s * np.arctan2(length, (first * second).sum(axis=1))
        normal = normal / np.where(length > 0, length, 1.0)[:, None]
        axis = first * np.cos(angle)[:, None] + np.cross(normal, first) * np.sin(angle)[:, None]
        return tip, axis / np.linalg.norm(axis, axis=1)[:, None]

    def joints(self, tip, axis):
        """True joints by the law of cosines; NaN out of reach; also the planar wrist centre."""
        c = self.problem.calibration
        w = tip + self.problem.tool_length_mm * axis
        xy = w[:, :2] - w[:, 2:] * np.asarray(c.slide_tilt)
        square = (xy**2).sum(axis=1)
        with np.errstate(invalid="ignore"):
            q1 = self.sign * np.arccos((square - self.a0**2 - self.a1**2) / (2 * self.a0 * self.a1))
        elbow = np.arctan2(self.a1 * np.sin(q1), self.a0 + self.a1 * np.cos(q1))
        q0 = np.arctan2(xy[:, 1], xy[:, 0]) - elbow
        q3 = np.arctan2(axis[:, 1], axis[:, 0]) - q0 - q1
        q4 = np.arctan2(np.hypot(axis[:, 0], axis[:, 1]), axis[:, 2])
        return xy, np.stack((q0, q1, w[:, 2], q3, q4), axis=1)

    def place(self, q0, q1):
        """Forward kinematics in the plane."""
        return np.stack(
            (
                self.a0 * np.cos(q0) + self.a1 * np.cos(q0 + q1),
                self.a0 * np.sin(q0) + self.a1 * np.sin(q0 + q1),
            ),
            axis=-1,
        )

    def side_distance(self, xy, name):
        """Distance to one side of the joint rectangle by sampling, refined around the best sample."""
        inner, outer = (self.q1[1], self.q1[0]) if self.sign > 0 else (self.q1[0], self.q1[1])
        if name in {"inner", "outer"}:
            fixed = inner if name == "inner" else outer
            low, high = self.lo[0], self.lo[0] + min(self.hi[0] - self.lo[0], 2 * math.pi)

            def curve(t):
                return self.place(t, np.full_like(t, fixed))
        else:
            fixed = self.hi[0] if name == "left" else self.lo[0]
            low, high = self.q1

            def curve(t):
                return self.place(np.full_like(t, fixed), t)

        step = (high - low) / 64
        centre = np.full(len(xy), (low + high) / 2)
        half = 32
        for _ in range(9):
            t = np.clip(centre[:, None] + np.arange(-half, half + 1) * step, low, high)
            d = np.linalg.norm(curve(t) - xy[:, None, :], axis=2)
            centre = t[np.arange(len(xy)), d.argmin(axis=1)]
            best = d.min(axis=1)
            half, step = 6, step / 5
        return best

    def _margins(self, tip, axis):
        xy, q = self.joints(tip, axis)
        lo, hi = self.lo, self.hi
        planar = np.stack([self.side_distance(xy, n) for n in ("inner", "outer", "left", "right")], axis=1)
        self.unsigned = {"left": planar[:, 2], "right": planar[:, 3]}
        bounding = 2 if hi[0] - lo[0] >= 2 * math.pi else 4
        turn = np.mod(q[:, 0] - lo[0], 2 * math.pi)
        self.inside = (q[:, 1] >= self.q1[0]) & (q[:, 1] <= self.q1[1]) & (turn <= hi[0] - lo[0])
        nearest = planar[:, :bounding].argmin(axis=1)
        signed = planar.copy()
        rows = np.flatnonzero(~self.inside)
        signed[rows, nearest[rows]] *= -1
        self.q = q
        self.q0, self.q3 = np.unwrap(q[:, 0]), np.unwrap(q[:, 3])
        singular = np.degrees(np.minimum(q[:, 4], math.pi - q[:, 4]))
        out = dict(zip(("inner", "outer", "left", "right"), signed.T, strict=True))
        out |= {"top": hi[2] - q[:, 2], "bottom": q[:, 2] - lo[2], "wrist_singularity": singular}
        out |= {"pitch_min": np.degrees(q[:, 4] - lo[4]), "pitch_max": np.degrees(hi[4] - q[:, 4])}
        self.widening = self._widening(q)
        return out

    def _widening(self, q):
        c, d = self.problem.calibration, self.problem.deadband
        e, mm = c.residual_rad + d.path_tolerance_rad, c.residual_mm + d.path_tolerance_mm
        with np.errstate(invalid="ignore"):
            return np.arcsin(np.sin(e) / np.sin(q[:, 4])) - e + mm / (self.a1 * np.abs(np.sin(q[:, 1])))

    def lifted(self, joint, turns):
        """A joint followed continuously; its turns count the reported joint at the first pose."""
        followed = self.q0 if joint == 0 else self.q3
        first = followed[0] - self.problem.calibration.joint_offset[joint]
        wrapped = -((-first + math.pi) % (2 * math.pi) - math.pi)
        return followed + (wrapped + 2 * math.pi * turns - first)

    def lifted_sides(self, q0_turns):
        """Left and right of a shoulder of a turn or more: they count within half a turn of their limit."""
        q0 = self.lifted(0, q0_turns)
        out = {}
        for name, beyond in (("left", q0 - self.hi[0]), ("right", self.lo[0] - q0)):
            signed = np.where(beyond <= 0, self.unsigned[name], -self.unsigned[name])
            out[name] = np.where(np.abs(beyond) <= math.pi, signed, np.inf)
        return out

    def roll(self, roll_turns):
        """Roll margins in deg for a branch."""
        lifted = self.lifted(3, roll_turns)
        return {
            "roll_min": np.degrees(lifted - self.widening - self.lo[3]),
            "roll_max": np.degrees(self.hi[3] - lifted - self.widening),
        }
