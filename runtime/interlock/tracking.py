"""Watches the moving arm against the verified path: every sample of joints, every progress frame.

Pure: no clock, the time is passed in. A place is a time on the verified course: the seconds from the start joints at
the path's feed and, on the joint lines, at the bound part of the joint speeds. A fault-free arm gains at most one
second of the course in one of the plant, and never goes back. Hence, with frames at most the heartbeat's time-out
late:

1. A sample was measured between two places: no earlier than the sample before it and than the last progress allows,
   no further on than the arm can have come since any frame before. The joints must lie within tolerance of some
   place in between.
2. Progress never goes back, is never further on than that, and never further back than the last sample allows.
3. Samples and progress come at least every two time-outs: as many losses as the counters allow, and the latest frame.
4. The end is reported no sooner than it can be reached.

What is off the path is seen with the first sample that shows it. What moves along the path too fast is seen once it
has gained one time-out on the course.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cutgate.protocol.frames import FRACTION_MAX, ROTATION_DEG, SLIDE_MM
from cutgate.runtime.interlock.state import Timing

Floats = NDArray[np.float64]

CHORD_RAD: Final = math.radians(ROTATION_DEG / 2.0)
CHORD_MM: Final = SLIDE_MM / 2.0
"""A course's joints are so near to the exact ones between its knots: as near as a joints frame is rounded."""
CLOCKS: Final = 1.001
"""How much faster the controller's clock may run."""
MISSING_TIMEOUTS: Final = 2.0
_ROTARY: Final = (0, 1, 3, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Where the arm is when: joint line, straight in, the cut, straight out, joint line; from start joints to there.

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
        """Times and joints of the part of the course between two times, shapes (k,) and (k, 5), k >= 2."""
        first = int(np.searchsorted(self.times_s, earliest_s, "right"))
        after = int(np.searchsorted(self.times_s, latest_s, "left"))
        times = np.concatenate(([earliest_s], self.times_s[first:after], [latest_s]))
        ends = self.joints_at(earliest_s)[None], self.joints_at(latest_s)[None]
        return times, np.concatenate((ends[0], self.joints[first:after], ends[1]))

    def name(self, time_s: float) -> str:
        """The place in words."""
        if time_s < self.poses_s[0]:
            return "the entry" if time_s >= self.times_s[1] else "the approach"
        if time_s > self.poses_s[-1]:
            return "the exit" if time_s <= self.times_s[-2] else "the retract"
        segment = int(np.searchsorted(self.poses_s, time_s, "right")) - 1
        segment = min(max(segment, 0), self.segments - 1)
        start_s, end_s = self.time_of(segment, 0.0), self.time_of(segment, 1.0)
        fraction = (time_s - start_s) / (end_s - start_s) if end_s > start_s else 0.0
        return f"segment {segment}, fraction {fraction:.3f}"


@dataclass(frozen=True, slots=True)
class Bounds:
    """What is tolerated.

    Attributes:
        near_mm: wrist centre off the path, by a bound that holds at every elbow angle.
        near_rad: each turning joint.
        start_mm, start_rad: more than that on the way from the start joints to the entry.
        latency_s: age of a frame.
        rate: seconds of the course in one of this side's clock.
    """

    near_mm: float
    near_rad: float
    start_mm: float
    start_rad: float
    latency_s: float
    rate: float

    @classmethod
    def of(cls, timing: Timing, scale: float, links_mm: tuple[float, float]) -> "Bounds":
        """The site's tolerances, and what joints frames and the course are rounded by."""
        turned_mm = 2.0 * CHORD_RAD * (links_mm[0] + 2.0 * links_mm[1])
        return cls(
            near_mm=timing.tracking_tolerance_mm + math.hypot(turned_mm, 2.0 * CHORD_MM),
            near_rad=math.radians(timing.tracking_tolerance_deg) + 2.0 * CHORD_RAD,
            start_mm=timing.start_tolerance_mm,
            start_rad=math.radians(timing.start_tolerance_deg),
            latency_s=timing.timeout_ms / 1000,
            rate=CLOCKS * scale,
        )

    @property
    def missing_s(self) -> float:
        """How long nothing may come."""
        return MISSING_TIMEOUTS * self.latency_s


@dataclass(frozen=True, slots=True)
class Seen:
    """A frame that came at ``at_s``: the arm was no earlier on the course than ``earliest_s``."""

    earliest_s: float
    at_s: float

    def behind_s(self, now_s: float, bounds: Bounds) -> float:
        """The same for a frame of another kind that comes now, which may have been sent before this one."""
        return self.earliest_s - bounds.rate * max(0.0, bounds.latency_s - (now_s - self.at_s))


@dataclass(frozen=True, slots=True, eq=False)
class Watch:
    """What has been seen since the start. Each look returns the next watch and what deviates, "" if nothing does."""

    course: Course
    bounds: Bounds
    sampled: Seen
    progressed: Seen
    lead_s: float
    """The least, over all frames, of the place at the latest less what the arm may gain in the time until then."""
    progress: tuple[int, int] = (0, 0)

    @classmethod
    def begin(cls, course: Course, timing: Timing, scale: float, now_s: float) -> "Watch":
        """The start leaves now; the arm stands at the start joints."""
        bounds = Bounds.of(timing, scale, course.links_mm)
        return cls(course, bounds, Seen(0.0, now_s), Seen(0.0, now_s), -bounds.rate * now_s)

    def reach_s(self, now_s: float) -> float:
        """The furthest place of a frame that comes now.

        For any frame before: it was sent at most the latency before it came, and this one no later than now.
        """
        return min(
            self.lead_s + self.bounds.rate * (now_s + self.bounds.latency_s), self.course.end_s
        )  # keeps a NaN

    def _lead(self, latest_s: float, now_s: float) -> float:
        return min(self.lead_s, latest_s - self.bounds.rate * now_s)

    # ------------------------------------------------------------ joints

    def sample(self, joints: Floats, now_s: float) -> tuple["Watch", str]:
        """Measured joints, rad and mm, shape (5,), that came now."""
        bounds = self.bounds
        earliest_s = max(0.0, self.sampled.earliest_s, self.progressed.behind_s(now_s, bounds))
        latest_s = self.reach_s(now_s)
        if not earliest_s <= latest_s:
            return self, (
                f"measured joints and progress do not belong together: the joints were last at "
                f"{self.course.name(self.sampled.earliest_s)}, the progress is {self._progress}"
            )
        found = _nearest(self.course, bounds, joints, (earliest_s, latest_s))
        if not found.off <= 1.0:
            return self, (
                f"measured joints are {found.off_mm:.3f} mm and {math.degrees(found.off_rad):.3f} deg off the verified "
                f"path near {self.course.name(found.time_s)}, at most {found.near_mm:.3f} mm and "
                f"{math.degrees(found.near_rad):.3f} deg"
            )
        lead_s = self._lead(found.latest_s, now_s)
        return replace(self, sampled=Seen(found.earliest_s, now_s), lead_s=lead_s), ""

    # ------------------------------------------------------------ progress

    @property
    def _progress(self) -> str:
        segment, fraction = self.progress
        return f"segment {segment}, fraction {fraction / FRACTION_MAX:.3f}"

    def report(self, segment: int, fraction: int, now_s: float) -> tuple["Watch", str]:
        """Progress that came now; ``fraction`` in counts of 1/65535."""
        course, bounds = self.course, self.bounds
        if not 0 <= segment < course.segments:
            return self, f"progress is segment {segment}, the path has segments 0 to {course.segments - 1}"
        said = f"progress is segment {segment}, fraction {fraction / FRACTION_MAX:.3f}"
        if not (segment, fraction) >= self.progress:
            return self, f"{said}, after {self._progress}: it never goes back"
        earliest_s, latest_s = self._interval(segment, fraction)
        if not earliest_s <= self.reach_s(now_s):
            return self, f"{said}, at most {course.name(self.reach_s(now_s))} can have been reached"
        if not latest_s >= self.sampled.behind_s(now_s, bounds):
            return self, f"{said}, but the measured joints were at {course.name(self.sampled.earliest_s)}"
        progressed, lead_s = Seen(earliest_s, now_s), self._lead(latest_s, now_s)
        return replace(self, progressed=progressed, progress=(segment, fraction), lead_s=lead_s), ""

    def _interval(self, segment: int, fraction: int) -> tuple[float, float]:
        """When the arm is where progress says; it stands at its ends before and after the cut."""
        course = self.course
        earliest_s, latest_s = (
            course.time_of(segment, (fraction + half) / FRACTION_MAX) for half in (-0.5, 0.5)
        )
        before = (segment, fraction) == (0, 0)
        after = (segment, fraction) == (course.segments - 1, FRACTION_MAX)
        return 0.0 if before else earliest_s, course.end_s if after else latest_s

    def finished(self, now_s: float) -> str:
        """The controller says that the arm is back."""
        if self.reach_s(now_s) >= self.course.end_s:
            return ""
        return f"the controller reports the end, at most {self.course.name(self.reach_s(now_s))} can have been reached"

    # ------------------------------------------------------------ silence

    def overdue(self, now_s: float, cutting_since_s: float | None) -> str:
        """What has been missing for too long; progress is due from ``cutting_since_s`` on, None before."""
        for what, since_s in (
            ("measured joints", self.sampled.at_s),
            ("progress", None if cutting_since_s is None else max(self.progressed.at_s, cutting_since_s)),
        ):
            if since_s is not None and not now_s - since_s <= self.bounds.missing_s:
                return (
                    f"no {what} for {(now_s - since_s) * 1000:.0f} ms near {self.course.name(self.sampled.earliest_s)}, "
                    f"at most {self.bounds.missing_s * 1000:.0f} ms"
                )
        return ""


# ---------------------------------------------------------------- the nearest place


@dataclass(frozen=True, slots=True)
class _Found:
    """The nearest place of those tried, how far off it is, and between which places the tolerance reaches."""

    time_s: float
    off: float
    off_mm: float
    off_rad: float
    near_mm: float
    near_rad: float
    earliest_s: float
    latest_s: float


def _nearest(course: Course, bounds: Bounds, joints: Floats, between_s: tuple[float, float]) -> _Found:
    """The nearest place of a part of the course.

    On each chord the place with the least sum of squares is tried, differences over tolerance; what is admitted is
    admitted by a real place. Wrist centre: |a0 d0| + |a1 (d0 + d1)| beside the slide bounds it at every elbow angle.
    """
    times, knots = course.between(*between_s)
    early = times[:-1] < course.times_s[1]
    near_mm = bounds.near_mm + np.where(early, bounds.start_mm, 0.0)
    near_rad = bounds.near_rad + np.where(early, bounds.start_rad, 0.0)
    a0, a1 = course.links_mm

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
    return _Found(
        time_s=float(times[at] + t[at] * seconds[at]),
        off=float(off[at]),
        off_mm=float(off_mm[at] * near_mm[at]),
        off_rad=float(off_rad[at] * near_rad[at]),
        near_mm=float(near_mm[at]),
        near_rad=float(near_rad[at]),
        earliest_s=float(
            np.min(times[:-1] + np.maximum(t - slack, 0.0) * seconds, initial=np.inf, where=within)
        ),
        latest_s=float(
            np.max(times[:-1] + np.minimum(t + slack, 1.0) * seconds, initial=-np.inf, where=within)
        ),
    )
