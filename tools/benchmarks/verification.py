"""How fast the certified verification is, as ratios in one run: ``python benchmarks/verification.py [--write FILE]``.

Markdown tables on stdout; with ``--write`` in a file as well.
"""

import time
from collections.abc import Callable
from dataclasses import replace

from measure import RUNS, a_command, in_a_child, machine, seconds
from pages import Rows, document, show
from paths import TABLE_1, TABLE_2, finer, hip_stem, level_pocket, prepared, zigzag
from rivals import AlongThePath, bisection, dense, inverse_kinematics, optimal_cover

from cutgate.runtime.verification import certificate, certified, stocco
from cutgate.runtime.verification.decide import decide
from cutgate.runtime.verification.placing import guidance
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.verdict import Verdict


def table_1() -> Rows:
    """Evaluations of a distance at the four placements of the paper's Table 1.

    `certified` also brackets each boundary to 0.01 mm or deg and follows roll and speeds; the others only decide. Its
    proof looks at each stroke once, as it knows the arcs and not the distance alone. The fewest are what no method
    that knows the distance only where it looks can undercut.
    """
    yield (
        "placement",
        "paper",
        "`stocco`",
        "bound, eq. (15)",
        "`certified`",
        "its proof",
        "adaptive bisection",
        "fewest at 2 deadbands",
        "fewest at the deadband",
    )
    for number, (rho, phi, printed) in enumerate(TABLE_1, 1):
        problem = zigzag(rho, phi)
        march = stocco.verify(problem).evaluations
        d, keep = AlongThePath(problem), problem.deadband.arm_mm
        counts = (
            printed,
            march.arm,
            march.worst_case,
            certified.verify(problem).evaluations.arm,
            len(problem.tips_mm) - 1 + len(_proved(problem).cut_segment),
            bisection(d, keep, 0.0, d.length),
            optimal_cover(d, 2 * keep),
            optimal_cover(d, keep),
        )
        yield (f"{number}: rho {rho:g} mm, phi {phi:g} deg", *map(str, counts))


def table_2() -> Rows:
    """Largest number of evaluations, deadband 5 mm, as the paper prints it and by its equation (15).

    Beside it the plan of about this length that is shipped, and what the published march takes on it. Where the tool
    axis turns, the march goes along a bound for the wrist centre's path, longer than the path of the tip.
    """
    yield ("path length", "paper", "eq. (15)", "shipped plan", "its length", "its bound", "`stocco`")
    for length, printed, name, registration in TABLE_2:
        march = stocco.verify(prepared(registration, name)[1])
        own = (name, f"{march.tip_length_mm:.1f} mm", march.evaluations.worst_case, march.evaluations.arm)
        yield (f"{length:g} mm", str(printed), str(stocco.worst_case(length, 5.0)), *map(str, own))


def start_up() -> Rows:
    """Processor time of whole commands, user and system, the least of a few runs: each loads only what it needs."""
    yield ("command", "processor time")
    stem = ("hip-stem", "--robot", "example")
    for words in (
        ("--version",),
        ("--help",),
        ("verify", "--help"),
        ("verify", *stem, "--registration", "registration-second"),
        ("verify", *stem, "--registration", "registration-first"),
        ("run", "--help"),
        ("audit", "--help"),
    ):
        yield (f"`cutgate {' '.join(words)}`", f"{a_command(*words):.2f} s")


def against_sampling() -> Rows:
    """Certified for every point, against inverse kinematics in numpy at samples, which prove nothing between."""
    yield (
        "path, 2000 poses",
        "certified",
        "sampled at 1 mm",
        "certified / 1 mm",
        "sampled at 0.1 mm",
        "certified / 0.1 mm",
        "evaluations",
    )
    for name, problem in (
        ("hip stem, axis turning", hip_stem()),
        ("level pocket, axis constant", level_pocket()),
    ):
        verdict = certified.verify(problem)
        if not verdict.admissible:
            raise ValueError(f"{name} is inadmissible: {verdict.reasons}")
        own, coarse, fine = seconds(*_works(problem))
        yield (
            f"{name}, {verdict.tip_length_mm:.0f} mm",
            f"{own * 1e3:.1f} ms",
            f"{coarse * 1e3:.1f} ms",
            f"{own / coarse:.2f}",
            f"{fine * 1e3:.1f} ms",
            f"{own / fine:.2f}",
            f"{verdict.evaluations.arm}",
        )


def _works(problem: Problem) -> tuple[Callable[[], object], ...]:
    return lambda: certified.verify(problem), lambda: dense(problem, 1.0), lambda: dense(problem, 0.1)


def answer_alone() -> Rows:
    """Admissible or not, and nothing else. K: the joints at each pose by numpy, once. Many in a row, medians."""
    yield (
        "path",
        "poses",
        "answer alone",
        "K",
        "answer / K",
        "certified",
        "certified / K",
        "open segments",
    )
    for name, problem in (("hip stem", hip_stem()), ("level pocket", level_pocket())):
        found = decide(problem)
        if not found.admissible:
            raise ValueError(f"{name} is inadmissible")
        alone, k = (
            took / MANY for took in seconds(*(_many(work, problem) for work in (decide, inverse_kinematics)))
        )
        own = seconds(_many(certified.verify, problem))[0] / MANY
        yield (
            name,
            f"{len(problem.tips_mm)}",
            f"{alone * 1e3:.3f} ms",
            f"{k * 1e3:.3f} ms",
            f"{alone / k:.2f}",
            f"{own * 1e3:.2f} ms",
            f"{own / k:.1f}",
            f"{found.open_segments}",
        )


MANY = 50


def _many(work: Callable[[Problem], object], problem: Problem) -> Callable[[], object]:
    return lambda: [work(problem) for _ in range(MANY)]


def growth() -> Rows:
    """The hip stem cut finer, each size in a process of its own: best of a few runs, and the peak memory of the whole process."""
    yield ("poses", "certified", "a segment", "answer alone", "a segment", "peak memory", "verdict")
    for poses in (1_000, 10_000, 100_000, 1_000_000):
        (took, alone, count, admissible), peak = in_a_child(_grown, poses)
        yield (
            f"{count}",
            f"{took * 1e3:.1f} ms",
            f"{took / (count - 1) * 1e6:.2f} us",
            f"{alone * 1e3:.2f} ms",
            f"{alone / (count - 1) * 1e6:.2f} us",
            f"{peak:.0f} MiB",
            "admissible" if admissible else "inadmissible",
        )


def _grown(poses: int) -> tuple[float, float, int, bool]:
    whole = hip_stem()
    if poses < len(whole.tips_mm):
        problem = _first(whole, poses)
    else:
        problem = _first(finer(whole, -(-poses // (len(whole.tips_mm) - 1))), poses)
    took, alone = [], []
    for _ in range(2 if poses > 100_000 else RUNS):
        began = time.perf_counter()
        verdict = certified.verify(problem)
        took.append(time.perf_counter() - began)
        began = time.perf_counter()
        admissible = decide(problem).admissible
        alone.append(time.perf_counter() - began)
        if admissible is not verdict.admissible:
            raise ValueError(f"the answer alone is another one for {poses} poses")
    return min(took), min(alone), len(problem.tips_mm), verdict.admissible


def _first(problem: Problem, poses: int) -> Problem:
    return replace(problem, tips_mm=problem.tips_mm[:poses], axes=problem.axes[:poses])


def beside_the_verdict() -> Rows:
    """What else is done with a path of 2000 poses, median seconds."""
    yield ("work, hip stem", "time", "result")
    for name, work in BESIDE.items():
        result = work()
        yield (name, f"{seconds(work)[0] * 1e3:.0f} ms", result)


def guided() -> str:
    """The move that cures the example's first placement, verified."""
    ready, problem = prepared("first")
    found = guidance.guide(problem, certified.verify(problem), ready.quantise)
    if found is None or found.translation_mm is None:
        return "no move found"
    x, y, z = found.translation_mm
    return f"move by ({x:.1f}, {y:.1f}, {z:.1f}) mm, {'verified' if found.verified else 'NOT verified'}"


def proofs() -> Rows:
    """The certificate of an admissible verdict: found by a search, checked interval by interval without one."""
    yield (
        "path",
        "poses",
        "cuts",
        "bytes",
        "bytes a pose",
        "verdict",
        "search for the proof",
        "check",
        "check / search",
    )
    paths = {
        "hip stem": hip_stem(),
        "hip stem cut finer": finer(hip_stem(), 50),
        "level pocket": level_pocket(),
        **{f"Table 1, placement {n}": zigzag(rho, phi) for n, (rho, phi, _) in enumerate(TABLE_1, 1)},
    }
    for name, problem in paths.items():
        verdict, proof = certified.verify(problem), _proved(problem)
        if certificate.recheck(problem, proof):
            raise ValueError(f"the proof of {name} does not hold")
        own, search, check = _proof_seconds(problem, verdict, proof)
        poses, size = len(problem.tips_mm), len(proof.body())
        yield (
            name,
            str(poses),
            str(len(proof.cut_segment)),
            str(size),
            f"{size / poses:.2f}",
            f"{own * 1e3:.1f} ms",
            f"{search * 1e3:.1f} ms",
            f"{check * 1e3:.1f} ms",
            f"{check / search:.2f}",
        )


def _proved(problem: Problem) -> certificate.Certificate:
    verdict = certified.verify(problem)
    proof = certificate.certify(problem, verdict)
    if proof is None:
        raise ValueError(f"an inadmissible path has no proof: {verdict.reasons}")
    return proof


def _proof_seconds(problem: Problem, verdict: Verdict, proof: certificate.Certificate) -> list[float]:
    return seconds(
        lambda: certified.verify(problem),
        lambda: certificate.certify(problem, verdict),
        lambda: certificate.recheck(problem, proof),
    )


BESIDE: dict[str, Callable[[], str]] = {
    "guidance": guided,
}
"""One line a work: what it is called, and a function without arguments that says its result in a few words."""

SECTIONS: dict[str, Callable[[], Rows]] = {
    "Growth with the number of poses": growth,
    "The answer alone": answer_alone,
    "Start-up": start_up,
    "Against dense sampling": against_sampling,
    "Beside the verdict": beside_the_verdict,
    "The proof as data": proofs,
    "Table 1 of the paper": table_1,
    "Table 2 of the paper": table_2,
}
"""Growth first: a child starts from the small process that this one still is."""


def main() -> None:
    """Print the page as it comes, and write it where asked."""
    about = f"By `make bench` on {machine()}. Medians of {RUNS} runs taken in turn; compare the ratios, not the times."
    show(document("Benchmarks", about, SECTIONS), __doc__.splitlines()[0] if __doc__ else None)


if __name__ == "__main__":
    main()
