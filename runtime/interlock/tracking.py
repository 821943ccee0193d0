"""The tracking monitor: the moving arm against the verified path, every sample of joints and every progress frame.

Pure: no clock, the time is passed in; the table asks it in each step while the arm may move. A place is a time on the
reference trajectory: the seconds from the start joints at the path's feed and, on the joint lines, at the bound part of
the joint speeds. A fault-free arm gains at most one second of the trajectory in one of the plant, and never goes back.
Frames are at most the heartbeat's time-out late, a sample as old as is proved of it. Hence:

1. A sample was measured between two places: no earlier than the sample before it and than the last progress allows,
   no further on than the arm can have come since any frame before. The joints must lie within tolerance of some
   place in between.
2. Progress never goes back, is never further on than that, and never further back than the last sample allows.
3. Samples and progress come at least every two time-outs: as many losses as the counters allow, and the latest frame.
   A sample older than that when it comes is none.
4. The end is reported no sooner than it can be reached.

What is off the path is seen with the first sample that shows it. What moves along the path too fast is seen once it
has gained one time-out on the trajectory.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from cutgate.protocol.arrays import Floats
from cutgate.protocol.frames import FRACTION_MAX, ROTATION_DEG, SLIDE_MM
from cutgate.protocol.records import Timing
from cutgate.runtime.interlock.permissive import Permissive

CHORD_RAD: Final = math.radians(ROTATION_DEG / 2.0)
CHORD_MM: Final = SLIDE_MM / 2.0
"""A trajectory's joints are so near to the exact ones between its knots: as near as a joints frame is rounded."""
CLOCKS: Final = 1.001
"""How much faster the controller's clock may run."""
MISSING_TIMEOUTS: Final = 2.0
REMEDY: Final = "find out why the arm is not where it was verified, before the next session"
_ROTARY: Final = (0, 1, 3, 4)
Leg = Literal["approach", "entry", "cut", "exit", "retract"]
"""A joint line, straight in, the cut, straight out, a joint line."""


@dataclass(frozen=True, eq=False)
class ReferenceTrajectory:
    """Where the arm is when: joint line, straight in, the cut, straight out, joint line; from start joints to there.

    Equal to itself alone: what was verified is one object, and arrays do not say whether they are equal.

    Attributes:
        times_s: when the arm is at each knot at the earliest, shape (m,), ascending from 0.
        joints: reported joints there, rad and mm, shape (m, 5); linear in between to CHORD_RAD and CHORD_MM.
        poses_s: when it is at each pose of the path, shape (n,).
        links_mm: true upper link and forearm.
    """

    times_s: Floats
    joints: Floats
    poses_s: Floats
    links_mm: tuple[float, float]

    @property
    def end_s(self) -> float:
        """When the arm is back."""
        return float(self.times_s[-1])

    @property
    def segments(self) -> int:
        """How many segments the cut has."""
        return len(self.poses_s) - 1

    def time_of(self, segment: int, fraction: float) -> float:
        """When the arm is at a fraction of a segment of the cut; the cut's ends for fractions beyond them."""
        start_s, end_s = float(self.poses_s[segment]), float(self.poses_s[segment + 1])
        return start_s + min(max(fraction, 0.0), 1.0) * (end_s - start_s)

    def joints_at(self, time_s: float) -> Floats:
        """Joints at a time in 0..end_s, shape (5,)."""
        at = min(max(int(np.searchsorted(self.times_s, time_s, "right")) - 1, 0), len(self.times_s) - 2)
        start_s, end_s = self.times_s[at], self.times_s[at + 1]
        part = (time_s - start_s) / (end_s - start_s) if end_s > start_s else 0.0
        out: Floats = self.joints[at] + part * (self.joints[at + 1] - self.joints[at])
        return out

    def between(self, earliest_s: float, latest_s: float) -> tuple[Floats, Floats]:
        """Times and joints of the part of the trajectory between two times, shapes (k,) and (k, 5), k >= 2."""
        first = int(np.searchsorted(self.times_s, earliest_s, "right"))
        after = int(np.searchsorted(self.times_s, latest_s, "left"))
        times = np.concatenate(([earliest_s], self.times_s[first:after], [latest_s]))
        ends = self.joints_at(earliest_s)[None], self.joints_at(latest_s)[None]
        return times, np.concatenate((ends[0], self.joints[first:after], ends[1]))

    def name(self, time_s: float) -> str:
        """The place in words."""
        leg, segment, fraction = self.place(time_s)
        return f"the {leg}" if leg != "cut" else f"segment {segment}, fraction {fraction:.3f}"

    def place(self, time_s: float) -> tuple[Leg, int | None, float | None]:
        """The place: its leg, and on the cut segment and fraction."""
        if time_s < self.poses_s[0]:
            return ("entry" if time_s >= self.times_s[1] else "approach"), None, None
        if time_s > self.poses_s[-1]:
            return ("exit" if time_s <= self.times_s[-2] else "retract"), None, None
        segment = min(int(np.searchsorted(self.poses_s, time_s, "right")), self.segments) - 1
        start_s, end_s = self.poses_s[segment : segment + 2]
        return "cut", segment, float((time_s - start_s) / (end_s - start_s)) if end_s > start_s else 0.0


@dataclass(frozen=True)
class TrackingTolerance:
    """How far the moving arm may be off the reference trajectory, from the site's configuration."""

    wrist_mm: float
    joint_deg: float


@dataclass(frozen=True)
class Bounds:
    """What is tolerated.

    Attributes:
        near_mm: wrist centre off the path, by a bound that holds at every elbow angle.
        near_rad: each turning joint.
        start_mm, start_rad: more than that on the way from the start joints to the entry.
        latency_s: age of a frame.
        rate: seconds of the trajectory in one of this side's clock.
    """

    near_mm: float
    near_rad: float
    start_mm: float
    start_rad: float
    latency_s: float
    rate: float

    @classmethod
    def of(
        cls, timing: Timing, tolerance: TrackingTolerance, scale: float, links_mm: tuple[float, float]
    ) -> "Bounds":
        """The site's tolerances, and what joints frames and the trajectory are rounded by."""
        turned_mm = 2.0 * CHORD_RAD * (links_mm[0] + 2.0 * links_mm[1])
        return cls(
            near_mm=tolerance.wrist_mm + math.hypot(turned_mm, 2.0 * CHORD_MM),
            near_rad=math.radians(tolerance.joint_deg) + 2.0 * CHORD_RAD,
            start_mm=timing.start_tolerance_mm,
            start_rad=math.radians(timing.start_tolerance_deg),
            latency_s=timing.timeout_s,
            rate=CLOCKS * scale,
        )

    @property
    def missing_s(self) -> float:
        """How long nothing may come, and how old what comes may be."""
        return MISSING_TIMEOUTS * self.latency_s


@dataclass(frozen=True)
class FrameSeen:
    """A frame that came at ``at_s``: the arm was no earlier on the trajectory than ``earliest_s``."""

    earliest_s: float
    at_s: float

    def behind_s(self, sent_s: float, bounds: Bounds) -> float:
        """The same for a frame of another kind that comes later, but may have been sent as early as ``sent_s``."""
        return self.earliest_s - bounds.rate * max(0.0, self.at_s - sent_s)


@dataclass(frozen=True)
class Deviation:
    """What must stop the arm: in one sentence, and the rules it breaks with their values and bounds."""

    reason: str
    judged: tuple[Permissive, ...]
    nearest: "Nearest | None" = field(default=None, compare=False)
    """Where the deviating joints are nearest to the path; for the log alone."""


@dataclass(frozen=True, eq=False)
class Nearest:
    """The place of those tried that is nearest to measured joints, how far off it is, and between which places they reach.

    Attributes:
        joints: as measured, rad and mm, shape (5,).
        time_s: the place.
        off: how far off, in tolerances; the greater of the following two.
        off_mm, off_rad: wrist centre and the turning joint that is furthest off, in tolerances.
        near_mm, near_rad: the tolerances there.
        earliest_s, latest_s: places between which the joints lie within tolerance; infinite where there are none.
    """

    joints: Floats
    time_s: float
    off: float
    off_mm: float
    off_rad: float
    near_mm: float
    near_rad: float
    earliest_s: float
    latest_s: float


@dataclass(frozen=True)
class TrackingMonitor:
    """What has been seen since the start. Each look returns the next monitor and what deviates, None if nothing does."""

    trajectory: ReferenceTrajectory
    bounds: Bounds
    sampled: FrameSeen
    progressed: FrameSeen
    heard_s: float
    """When joints came last that were young enough to say where the arm is."""
    lead_s: float
    """The least, over all frames, of the place at the latest less what the arm may gain until it was sent."""
    progress: tuple[int, int] = (0, 0)
    nearest: Nearest | None = field(default=None, compare=False)
    """What the last sample was held against; for the log alone, nothing is decided by it."""

    @classmethod
    def begin(
        cls,
        trajectory: ReferenceTrajectory,
        timing: Timing,
        tolerance: TrackingTolerance,
        scale: float,
        now_s: float,
    ) -> "TrackingMonitor":
        """The start leaves now; the arm stands at the start joints."""
        bounds = Bounds.of(timing, tolerance, scale, trajectory.links_mm)
        seen, lead_s = FrameSeen(0.0, now_s), -bounds.rate * (now_s - bounds.latency_s)
        return cls(trajectory, bounds, seen, seen, now_s, lead_s)

    def reach_s(self, now_s: float) -> float:
        """The furthest place of a frame that comes now: for any frame before, what the arm gained since that was sent."""
        return min(self.lead_s + self.bounds.rate * now_s, self.trajectory.end_s)  # keeps a NaN

    def _lead(self, latest_s: float, sent_s: float) -> float:
        return min(self.lead_s, latest_s - self.bounds.rate * sent_s)

    # ------------------------------------------------------------ joints

    def sample(
        self, joints: Floats, measured_s: float, now_s: float
    ) -> tuple["TrackingMonitor", Deviation | None]:
        """Joints, rad and mm, shape (5,), that came now and were measured at ``measured_s`` at the earliest."""
        bounds, trajectory = self.bounds, self.trajectory
        sent_s = min(measured_s, now_s - bounds.latency_s)
        earliest_s = max(0.0, self.sampled.earliest_s, self.progressed.behind_s(sent_s, bounds))
        latest_s = self.reach_s(now_s)
        if not earliest_s <= latest_s:
            where = trajectory.name(self.sampled.earliest_s)
            return self, _breaks(
                f"measured joints and progress do not belong together: the joints were last at {where}, the progress "
                f"is {self._progress}",
                name="measured joints and progress",
                text=f"joints at {where}, progress {self._progress}",
                bound=f"at one place, at most {bounds.latency_s * 1000:g} ms apart",
            )
        found = _nearest(trajectory, bounds, joints, (earliest_s, latest_s))
        if not found.off <= 1.0:
            return self, _off(found, f"near {trajectory.name(found.time_s)}")
        lead_s, young = self._lead(found.latest_s, sent_s), now_s - measured_s <= bounds.missing_s
        heard_s = now_s if young else self.heard_s  # off the path it would count at any age
        sampled = FrameSeen(found.earliest_s, now_s)
        return replace(self, sampled=sampled, heard_s=heard_s, lead_s=lead_s, nearest=found), None

    # ------------------------------------------------------------ progress

    @property
    def _progress(self) -> str:
        return _place(*self.progress)

    def report(self, segment: int, fraction: int, now_s: float) -> tuple["TrackingMonitor", Deviation | None]:
        """Progress that came now; ``fraction`` in counts of 1/65535."""
        trajectory, bounds = self.trajectory, self.bounds
        sent_s, text = now_s - bounds.latency_s, _place(segment, fraction)
        if not 0 <= segment < trajectory.segments:
            return self, _breaks(
                f"progress is segment {segment}, the path has segments 0 to {trajectory.segments - 1}",
                name="segment of the progress",
                value=float(segment),
                bound=f"0 to {trajectory.segments - 1}",
            )
        if not (segment, fraction) >= self.progress:
            return self, _breaks(
                f"progress is {text}, after {self._progress}: it never goes back",
                name="progress, beside the one before",
                text=text,
                bound=f"never before {self._progress}",
            )
        earliest_s, latest_s = self._interval(segment, fraction)
        if not earliest_s <= self.reach_s(now_s):
            furthest = trajectory.name(self.reach_s(now_s))
            return self, _breaks(
                f"progress is {text}, at most {furthest} can have been reached",
                name="progress, beside the time",
                text=text,
                bound=f"at most {furthest}",
            )
        if not latest_s >= self.sampled.behind_s(sent_s, bounds):
            where = trajectory.name(self.sampled.earliest_s)
            return self, _breaks(
                f"progress is {text}, but the measured joints were at {where}",
                name="progress, beside the measured joints",
                text=text,
                bound=f"at most {bounds.latency_s * 1000:g} ms behind {where}",
            )
        progressed, lead_s = FrameSeen(earliest_s, now_s), self._lead(latest_s, sent_s)
        return replace(self, progressed=progressed, progress=(segment, fraction), lead_s=lead_s), None

    def _interval(self, segment: int, fraction: int) -> tuple[float, float]:
        """When the arm is where progress says; it stands at its ends before and after the cut."""
        trajectory = self.trajectory
        earliest_s, latest_s = (
            trajectory.time_of(segment, (fraction + half) / FRACTION_MAX) for half in (-0.5, 0.5)
        )
        before = (segment, fraction) == (0, 0)
        after = (segment, fraction) == (trajectory.segments - 1, FRACTION_MAX)
        return 0.0 if before else earliest_s, trajectory.end_s if after else latest_s

    def finished(self, now_s: float) -> Deviation | None:
        """The controller says that the arm is back."""
        if self.reach_s(now_s) >= self.trajectory.end_s:
            return None
        furthest = self.trajectory.name(self.reach_s(now_s))
        return _breaks(
            f"the controller reports the end, at most {furthest} can have been reached",
            name="end of the retract, beside the time",
            text="reported",
            bound=f"at most {furthest}",
        )

    # ------------------------------------------------------------ silence

    def overdue(self, now_s: float, cutting_since_s: float | None) -> Deviation | None:
        """What has been missing for too long; progress is due from ``cutting_since_s`` on, None before."""
        for what, since_s in (
            ("measured joints", self.heard_s),
            ("progress", None if cutting_since_s is None else max(self.progressed.at_s, cutting_since_s)),
        ):
            if since_s is not None and not now_s - since_s <= self.bounds.missing_s:
                near = self.trajectory.name(self.sampled.earliest_s)
                return _breaks(
                    f"no {what} for {(now_s - since_s) * 1000:.0f} ms near {near}, "
                    f"at most {self.bounds.missing_s * 1000:.0f} ms",
                    name=f"silence of the {what}",
                    value=now_s - since_s,
                    bound=f"<= {self.bounds.missing_s:g} s",
                )
        return None


def _place(segment: int, fraction: int) -> str:
    return f"segment {segment}, fraction {fraction / FRACTION_MAX:.3f}"


def _breaks(
    reason: str, *, name: str, bound: str, value: float | None = None, text: str | None = None
) -> Deviation:
    """One rule that does not hold."""
    return Deviation(reason, (Permissive(name, False, value, text, bound, REMEDY),))


# ---------------------------------------------------------------- the nearest place


def _off(found: Nearest, near: str) -> Deviation:
    """Off the verified path: by how much, beside which tolerances."""
    near_mm, near_deg = found.near_mm, math.degrees(found.near_rad)
    off_mm, off_deg = found.off_mm * near_mm, found.off_rad * near_deg

    def rule(what: str, off: float, value: float, bound: str) -> Permissive:
        return Permissive(
            f"{what} to the verified path", off <= 1.0, value, None, f"<= {bound} {near}", REMEDY
        )

    return Deviation(
        f"measured joints are {off_mm:.3f} mm and {off_deg:.3f} deg off the verified path {near}, at most "
        f"{near_mm:.3f} mm and {near_deg:.3f} deg",
        (
            rule("measured wrist centre", found.off_mm, off_mm, f"{near_mm:.3f} mm"),
            rule("measured joints", found.off_rad, off_deg, f"{near_deg:.3f} deg"),
        ),
        found,
    )


def _nearest(
    trajectory: ReferenceTrajectory, bounds: Bounds, joints: Floats, between_s: tuple[float, float]
) -> Nearest:
    """The nearest place of a part of the trajectory.

    On each chord the place with the least sum of squares is tried, differences over tolerance; what is admitted is
    admitted by a real place. Wrist centre: |a0 d0| + |a1 (d0 + d1)| beside the slide bounds it at every elbow angle.
    """
    times, knots = trajectory.between(*between_s)
    early = times[:-1] < trajectory.times_s[1]
    near_mm = bounds.near_mm + np.where(early, bounds.start_mm, 0.0)
    near_rad = bounds.near_rad + np.where(early, bounds.start_rad, 0.0)
    a0, a1 = trajectory.links_mm

    def scaled(d: Floats) -> Floats:
        wrist = np.stack((a0 * d[:, 0], a1 * (d[:, 0] + d[:, 1]), d[:, 2]), axis=1) / near_mm[:, None]
        return np.concatenate((wrist, d[:, _ROTARY] / near_rad[:, None]), axis=1)

    chord, rest = scaled(knots[1:] - knots[:-1]), scaled(joints - knots[:-1])
    square = np.einsum("ij,ij->i", chord, chord)
    square = np.where(square > 0.0, square, np.inf)
    t = np.clip(np.einsum("ij,ij->i", rest, chord) / square, 0.0, 1.0)
    left = rest - t[:, None] * chord
    off_mm = np.hypot(np.abs(left[:, 0]) + np.abs(left[:, 1]), left[:, 2])
    off_rad = np.abs(left[:, 3:]).max(axis=1)
    off = np.maximum(off_mm, off_rad)
    at = int(np.argmin(off))  # NaN is the least, and lies within nothing
    seconds = times[1:] - times[:-1]
    slack = 1.0 / np.sqrt(square)  # one tolerance further along the chord is within tolerance as well
    within = off <= 1.0
    return Nearest(
        joints=joints,
        time_s=float(times[at] + t[at] * seconds[at]),
        off=float(off[at]),
        off_mm=float(off_mm[at]),
        off_rad=float(off_rad[at]),
        near_mm=float(near_mm[at]),
        near_rad=float(near_rad[at]),
        earliest_s=float(
            np.min(times[:-1] + np.maximum(t - slack, 0.0) * seconds, initial=np.inf, where=within)
        ),
        latest_s=float(
            np.max(times[:-1] + np.minimum(t + slack, 1.0) * seconds, initial=-np.inf, where=within)
        ),
    )
