"""The proof of an admissible verdict as data, and the function that checks it without searching.

A certificate says into which intervals the path is cut, in which joint branch, and what every boundary, speed
and acceleration keeps on every one of them. `recheck` evaluates each interval once, by the same bounds as the
search, and needs no search, no branch choice and no refinement: whatever the cuts are, the bounds hold, so a
wrong certificate can fail and cannot deceive. Slide and pitch are closed form and need no interval.

Rules of `recheck`, in order; the first four end it, of the others everything that is lacking is said:

1. All numbers of the problem are finite and usable (`defects`).
2. The certificate is for as many poses as the path has.
3. It is for the joint branch that the problem asks for, if it asks for one.
4. Its cuts lie inside the path's segments, in order.
5. The path starts inside the planar workspace, with the shoulder inside its limits in the certificate's turn; on which side of
   the column the wrist centre passes is known on every interval; a declared roll is held in the certificate's turn.
6. Shoulder and roll are proven to stay where a joints frame can carry them.
7. Of every boundary, speed and acceleration that applies: proven >= stated >= needed. What is stated applies.

Example:
    ``stroke`` is that of `problem`.

    >>> from dataclasses import replace
    >>> from cutgate.runtime.verification.certified import verify
    >>> proof = certify(stroke, verify(stroke))
    >>> recheck(stroke, Certificate.parse(proof.body()))
    ()
    >>> moved = replace(stroke, tips_mm=stroke.tips_mm + (0.0, 0.0, 300.0))
    >>> recheck(moved, proof)
    ('top: 191.435935 mm is stated, -108.564065 mm is proven, 5.000000 mm is needed',)
"""

from __future__ import annotations

import math
import struct
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.protocol.arrays import Floats, Ints
from cutgate.protocol.parameters import ROTATION_DEG_GOES
from cutgate.runtime.kinematics.arm import turns
from cutgate.runtime.verification.bounds.bisection import survey
from cutgate.runtime.verification.bounds.chain import BLOCK, Chain, build, cut
from cutgate.runtime.verification.bounds.enclosures import (
    ACCELERATION,
    COLUMNS,
    Q0_MAX,
    Q0_MIN,
    ROLL_MAX,
    ROLL_MIN,
    SPEED,
    Scope,
    lower_bounds,
)
from cutgate.runtime.verification.bounds.first_look import FirstLook, Looks, extremes_of
from cutgate.runtime.verification.bounds.geometry import MIRRORED, Geometry, Segments, canonical
from cutgate.runtime.verification.bounds.look import TouchesError
from cutgate.runtime.verification.bounds.minima import Aim, Minima
from cutgate.runtime.verification.branch import GOES_RAD, Candidate, candidates, confined, goes
from cutgate.runtime.verification.defects import defects
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.quantities import azimuth_defined, held_roll, rates, slide_and_pitch
from cutgate.runtime.verification.verdict import ARM_BOUNDARIES, BOUNDARIES, Verdict
from cutgate.runtime.workspace.planar import SIDES

RATES: Final = tuple(f"{quantity} {joint}" for quantity in ("speed", "acceleration") for joint in range(5))
NAMES: Final = (*BOUNDARIES, *RATES)
"""What a certificate may state a bound for: boundaries in mm or rad, largest joint speeds and accelerations."""

MAGIC: Final = b"cutgate.proof/1\0"
NO_GAP: Final = 1e18
"""The search for a proof stops at the deadbands; how far above them the bounds lie does not matter."""

_HEAD: Final = struct.Struct("<16shhIII")
_CUT_BYTES: Final = 12


class CertificateError(ValueError):
    """Bytes that are no certificate."""


@dataclass(frozen=True, slots=True)
class Certificate:
    """What proves that a path is admissible.

    Attributes:
        q0_turns: the joint branch of the proof.
        roll_turns: likewise.
        poses: of the path.
        bounds: what every interval keeps, by name (`NAMES`): clearances at least, in mm and rad, speeds and
            accelerations at most; a name that does not apply to this path is absent.
        cut_segment: segment of each cut, ascending, shape (k,); the intervals are what lies between.
        cut_fraction: place in it, shape (k,).
    """

    q0_turns: int
    roll_turns: int
    poses: int
    bounds: dict[str, float]
    cut_segment: Ints
    cut_fraction: Floats

    def body(self) -> bytes:
        """Canonical bytes: 32 and 8 a bound, then 4 + 8 a cut. Most segments need none."""
        mask = sum(1 << i for i, name in enumerate(NAMES) if name in self.bounds)
        head = _HEAD.pack(MAGIC, self.q0_turns, self.roll_turns, self.poses, len(self.cut_segment), mask)
        stated = struct.pack(f"<{len(self.bounds)}d", *(self.bounds[n] for n in NAMES if n in self.bounds))
        return (
            head
            + stated
            + self.cut_segment.astype("<u4").tobytes()
            + self.cut_fraction.astype("<f8").tobytes()
        )

    @classmethod
    def parse(cls, body: bytes) -> Certificate:
        """Read what `body` wrote.

        Raises:
            CertificateError: wrong magic, length or bounds; whether the proof holds is for `recheck` to say.
        """
        if len(body) < _HEAD.size or not body.startswith(MAGIC):
            raise CertificateError(f"{len(body)} bytes do not begin as a certificate, {MAGIC!r}")
        _, q0_turns, roll_turns, poses, cuts, mask = _HEAD.unpack_from(body)
        names = [name for i, name in enumerate(NAMES) if mask >> i & 1]
        size = _HEAD.size + 8 * len(names) + _CUT_BYTES * cuts
        if mask >> len(NAMES) or len(body) != size:
            raise CertificateError(f"a certificate of {len(body)} bytes, its header says {size}")
        stated = struct.unpack_from(f"<{len(names)}d", body, _HEAD.size)
        if not all(map(math.isfinite, stated)):
            raise CertificateError("a bound of the certificate is not finite")
        at = _HEAD.size + 8 * len(names)
        segment = np.frombuffer(body, "<u4", cuts, at).astype(np.int64)
        fraction = np.frombuffer(body, "<f8", cuts, at + 4 * cuts).astype(np.float64)
        return cls(q0_turns, roll_turns, poses, dict(zip(names, stated, strict=True)), segment, fraction)


def certify(problem: Problem, verdict: Verdict) -> Certificate | None:
    """Search for intervals that prove an admissible verdict of the certified method at its deadbands.

    They are fewer than those of the verdict's survey, which encloses every clearance to a hundredth.

    Returns:
        None where the verdict is inadmissible: its worst places then speak for themselves.
    """
    if not (verdict.admissible and verdict.branch):
        return None
    geometry, segments = canonical(problem)
    branch = (verdict.branch.q0_turns, verdict.branch.roll_turns)
    found = _at_a_look(problem, geometry, segments, branch)
    if found is not None and found.keeps:
        return found.certificate(np.zeros(0, dtype=np.int64), np.zeros(0))
    chain = build(geometry, segments)
    proof = _Proof(problem, geometry, segments, chain, branch)
    searched = survey(geometry, segments, chain, proof.scope, proof.aim)
    pieces = cut(geometry, segments, searched.cut_segment, searched.cut_fraction)
    return _Proven.of(proof, pieces).certificate(searched.cut_segment, searched.cut_fraction)


def recheck(problem: Problem, certificate: Certificate) -> tuple[str, ...]:
    """Check a whole proof, interval by interval.

    Args:
        problem: what the certificate is said to prove admissible; its own branch, if any, must be the proof's.
        certificate: the proof.

    Returns:
        Sentences that say why it proves nothing; empty if the path is admissible.
    """
    wrong = defects(problem)
    if wrong:
        return wrong
    branch = (certificate.q0_turns, certificate.roll_turns)
    if certificate.poses != len(problem.tips_mm):
        return (f"the certificate is for {certificate.poses} poses, the path has {len(problem.tips_mm)}",)
    if problem.branch not in {None, branch}:
        return (f"the certificate is for the turns {branch}, the path for {problem.branch}",)
    geometry, segments = canonical(problem)
    found = _at_a_look(problem, geometry, segments, branch)
    if found is not None and not found.reasons(certificate.bounds):
        return ()
    try:
        pieces = cut(geometry, segments, certificate.cut_segment, certificate.cut_fraction)
    except ValueError as error:
        return (str(error),)
    proof = _Proof(problem, geometry, segments, pieces, branch)
    closely = _Proven.of(proof, pieces)
    if found is not None:  # either holds
        closely = _Proven(proof, np.maximum(closely.least, found.least))
    return closely.reasons(certificate.bounds)


def _at_a_look(
    problem: Problem, geometry: Geometry, segments: Segments, branch: tuple[int, int]
) -> _Proven | None:
    """What one look at each segment proves; None where it is not enough to tell inside from outside."""
    path = FirstLook.of(geometry, segments, accelerations=problem.acceleration is not None)
    if path is None:
        return None
    proof = _Proof(problem, geometry, segments, path, branch)
    with suppress(TouchesError):
        return _Proven(proof, Looks(path, proof.scope, proof.aim, Minima(), None).whole)
    return None


@dataclass(frozen=True, slots=True)
class _Proven:
    """A proof and what every interval keeps of each column, shape (COLUMNS,)."""

    proof: _Proof
    least: Floats

    @classmethod
    def of(cls, proof: _Proof, pieces: Chain) -> _Proven:
        """By bounding each interval once."""
        return cls(proof, proof.least(pieces))

    @property
    def keeps(self) -> bool:
        """Whether it is all that is needed."""
        kept = all(bound >= self.proof.needed(name) for name, bound in self.proof.named(self.least).items())
        return kept and not self.proof.unfit_start() and not self.proof.out_of_frame(self.least)

    def certificate(self, cut_segment: Ints, cut_fraction: Floats) -> Certificate:
        """It as data."""
        proof = self.proof
        stated = {name: _stated(bound, proof.needed(name)) for name, bound in proof.named(self.least).items()}
        return Certificate(*proof.turns, len(proof.problem.tips_mm), stated, cut_segment, cut_fraction)

    def reasons(self, stated: dict[str, float]) -> tuple[str, ...]:
        """Why it does not prove what is stated."""
        proof = self.proof
        return (
            *proof.unfit_start(),
            *proof.out_of_frame(self.least),
            *_compared(proof, proof.named(self.least), stated),
        )


def _compared(proof: _Proof, proven: dict[str, float], stated: dict[str, float]) -> tuple[str, ...]:
    """Every bound that is needed must be stated and proven, and what is stated must apply."""
    out = []
    for name, bound in proven.items():
        claim, needed = stated.get(name), proof.needed(name)
        if claim is None:
            out.append(f"{name}: the certificate states nothing, {_shown(name, needed)} is needed")
        elif not (bound >= claim >= needed):
            least, need = _shown(name, bound), _shown(name, needed)
            out.append(f"{name}: {_shown(name, claim)} is stated, {least} is proven, {need} is needed")
    out += [f"{name}: stated, but does not apply to this path" for name in stated if name not in proven]
    return tuple(out)


def _shown(name: str, value: float) -> str:
    """A bound for people: mm or deg as in a verdict, rates as positive numbers."""
    if not math.isfinite(value):
        return "nothing"
    if name in ARM_BOUNDARIES:
        return f"{value:.6f} mm"
    if name in BOUNDARIES:
        return f"{math.degrees(value):.6f} deg"
    unit = ("mm" if name.endswith("2") else "rad") + ("/s" if name.startswith("speed") else "/s2")
    return f"at most {-value:.6g} {unit}"


def _stated(proven: float, needed: float) -> float:
    """A little less than was proven: another machine's last digits must not matter."""
    return max(proven - 1e-9 * max(1.0, abs(proven)), min(proven, needed))


class _Proof:
    """What has to be bounded for a path in a joint branch, and what the bounds must be; small is bad throughout."""

    def __init__(
        self,
        problem: Problem,
        geometry: Geometry,
        segments: Segments,
        path: Chain | FirstLook,
        branch: tuple[int, int],
    ) -> None:
        self.problem = problem
        self.geometry = geometry
        self.segments = segments
        self.path = path
        self.limits = limits = extremes_of(geometry, segments, path)
        self.turns = branch
        self.held = held_roll(problem, limits)
        self.full = geometry.workspace.full_revolution
        self.q0 = _candidate(geometry, 0, path.start[0], branch[0])
        self.roll = _candidate(geometry, 3, path.start[1], branch[1])
        self.target = self._target()
        self.scope = Scope(
            np.isfinite(self.target),
            reachable=not geometry.workspace.empty,
            winding_known=path.winding_known,
            roll_defined=path.winding_known and azimuth_defined(limits),
            shoulder_shift=self.q0.shift if self.full else None,
            alone=True,
        )
        nothing = np.zeros(COLUMNS)  # fine: what a verdict admits is true and can be decided, however close
        self.aim = Aim(np.full(COLUMNS, NO_GAP), nothing, nothing, self.target, nothing)

    def _target(self) -> Floats:
        """What each column must keep; infinite where it is not asked for."""
        g, target = self.geometry, np.full(COLUMNS, np.inf)
        target[: len(SIDES)] = g.arm_mm
        for _, first, limits in rates(self.problem):
            target[first : first + 5] = -limits
        least, most = goes(g, 3)
        target[ROLL_MIN] = max(g.lower[3] + g.wrist_rad, least) - self.roll.shift
        target[ROLL_MAX] = self.roll.shift - min(g.upper[3] - g.wrist_rad, most)
        if not confined(g, 0):
            least, most = goes(g, 0)
            target[Q0_MIN], target[Q0_MAX] = least - self.q0.shift, self.q0.shift - most
        if self.held is not None:
            target[[ROLL_MIN, ROLL_MAX, SPEED + 3, ACCELERATION + 3]] = np.inf
        return target

    def least(self, pieces: Chain) -> Floats:
        """Bound every column over these intervals, each looked at once; shape (COLUMNS,)."""
        out = np.full(COLUMNS, np.inf)
        for start in range(0, len(pieces), BLOCK):
            parts = pieces.intervals(start, min(start + BLOCK, len(pieces)), COLUMNS)
            bounds, _, _ = lower_bounds(self.geometry, self.segments, self.scope, parts, self.target)
            out = np.minimum(out, bounds.min(axis=0))
        return out

    def named(self, least: Floats) -> dict[str, float]:
        """The bounds by the names of the arm as it was given; a side that the path never comes near is absent."""
        g = self.geometry
        values = {name: v.certified for name, v in slide_and_pitch(g, self.limits, self.held).items()}
        values |= {name: float(least[i]) for i, name in enumerate(SIDES)}
        if self.held is None:
            values["roll_min"] = float(least[ROLL_MIN] + self.roll.shift - g.lower[3])
            values["roll_max"] = float(least[ROLL_MAX] - self.roll.shift + g.upper[3])
        else:
            true = g.side * self.held + g.offset[3]
            values["roll_min"], values["roll_max"] = float(true - g.lower[3]), float(g.upper[3] - true)
        if g.side < 0.0:
            values = {MIRRORED.get(name, name): value for name, value in values.items()}
        for quantity, first, _ in rates(self.problem):
            values |= {f"{quantity} {joint}": float(least[first + joint]) for joint in range(5)}
        return {name: value for name, value in values.items() if value != math.inf}

    def needed(self, name: str) -> float:
        """What a bound must be at least."""
        if name in ARM_BOUNDARIES:
            return self.geometry.arm_mm
        if name in BOUNDARIES:
            return self.geometry.wrist_rad
        limited = {
            f"{q} {joint}": float(x) for q, _, limits in rates(self.problem) for joint, x in enumerate(limits)
        }
        return -limited[name]

    def unfit_start(self) -> tuple[str, ...]:
        """What no distance says: where the path starts. From there left and right keep the shoulder in its limits."""
        out = []
        if not self.path.starts_inside:
            out.append("the path starts outside the planar workspace")
        if not self.path.winding_known:
            out.append("the intervals leave open on which side of the column the wrist centre passes")
        if not self.q0.fits:
            out.append(f"the shoulder does not start within its limits in turn {self.turns[0]}")
        if self.held is not None and self.turns[1] != int(turns(np.array(self.held))):
            out.append(f"the roll is not held in turn {self.turns[1]}")
        return tuple(out)

    def out_of_frame(self, least: Floats) -> tuple[str, ...]:
        """Joints of which it is not proven that a joints frame can carry them, whatever their limits."""
        g, found = self.geometry, []
        for joint, column, shift in ((0, Q0_MIN, self.q0.shift), (3, ROLL_MIN, self.roll.shift)):
            bounds = least[column : column + 2]
            if joint == 3 and self.held is not None:
                inside = abs(self.held) <= GOES_RAD
            else:
                low, high = goes(g, joint)
                inside = confined(g, joint) or bool(bounds[0] + shift >= low and bounds[1] - shift >= -high)
            if not inside:
                found.append(
                    f"q{joint} is not proven to stay within +-{ROTATION_DEG_GOES} deg, what a joints frame carries "
                    "with one revolution to spare"
                )
        return tuple(found)


def _candidate(geometry: Geometry, joint: int, start: float, asked: int) -> Candidate:
    """The turn asked for; it fits if the first pose lies within the limits."""
    if not math.isfinite(start):
        return Candidate(0.0, asked, fits=False, margin=-math.inf)
    return candidates(geometry, joint, start, (start, start), asked)[0]
