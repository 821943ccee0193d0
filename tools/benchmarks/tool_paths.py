"""What real tool paths are read as: ``python tools/benchmarks/tool_paths.py [--write FILE]``.

Third parties' files, not ours to ship: those that are not there are left out.
"""

import sys
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from measure import machine
from pages import Rows, document, show

from cutgate.config.load import InputError, load_robot
from cutgate.config.model import Robot
from cutgate.protocol.records import Path as WirePath
from cutgate.runtime.commands.tool_path_view import travelled
from cutgate.runtime.plan.load import DEFAULT_POSE_LIMIT, plans_from_bytes
from cutgate.runtime.plan.model import Plan
from cutgate.runtime.plan.prepare import widened
from cutgate.runtime.plan.toolpath.model import PLAIN, Cut, Reading
from cutgate.runtime.verification import certified
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.recorded import off_line_problem

sys.path.insert(0, str(Path(__file__).parents[2]))
from tests.tool_paths import REAL

FILES = {
    "boss.apt": Reading(cutcom_is_tool_centre=True),
    "interface-glue.apt": Reading(cutcom_is_tool_centre=True),
    "impeller-7bl-xyzac.ngc": Reading(rotary="xyzac"),
    "impeller-blade.csv": PLAIN,
    "impeller-op1.csv": PLAIN,
    "cam-nisley.ngc": PLAIN,
}
TOOLS_MM = (100.0, 200.0, 300.0)
FEED_MM_S = 10.0


@cache
def robot() -> Robot:
    """The example's, which holds its roll where the tool is vertical."""
    found = load_robot("example").value
    wrist = found.wrist.model_copy(update={"hold_roll_when_vertical": True})
    return found.model_copy(update={"wrist": wrist})


def _plans(name: str) -> tuple[Plan, ...]:
    return plans_from_bytes(Path(name), (REAL / name).read_bytes(), DEFAULT_POSE_LIMIT, FILES[name])


def _there() -> Iterator[str]:
    return (name for name in FILES if (REAL / name).exists())


def readings() -> Rows:
    """Each file as it is read: moves are straight segments, arcs and turns of machine axes replaced; lengths of the tip."""
    yield (
        "file", "kB", "read in", "MB/s", "parts", "cutting", "mm cut", "positioning", "mm positioned",
        "x", "y", "z, mm",
    )  # fmt: skip
    for name in _there():
        size = (REAL / name).stat().st_size
        began = time.perf_counter()
        try:
            plans = _plans(name)
        except InputError as error:
            refusal = str(error).partition(": ")[2].partition(";")[0].partition(":")[0]
            yield (name, f"{size / 1e3:.0f}", f"refused: {refusal}", *[""] * 9)
            continue
        seconds = time.perf_counter() - began
        both = [travelled(_problem(plan, TOOLS_MM[0]), _cut(plan)) for plan in plans]
        tips = np.concatenate([plan.tips_mm for plan in plans])
        box = [
            f"{low:.2f} to {high:.2f}" for low, high in zip(tips.min(axis=0), tips.max(axis=0), strict=True)
        ]
        yield (
            name, f"{size / 1e3:.0f}", f"{seconds * 1e3:.0f} ms", f"{size / seconds / 1e6:.1f}", str(len(plans)),
            str(sum(cut.segments for cut, _ in both)), f"{sum(cut.tip_length_mm for cut, _ in both):.1f}",
            str(sum(other.segments for _, other in both)), f"{sum(other.tip_length_mm for _, other in both):.1f}",
            *box,
        )  # fmt: skip


def verdicts() -> Rows:
    """The middle of each part's box 600 mm before the shoulder's axis, the wrist at half height there; the example's robot.

    It holds its roll where the tool is vertical. For a tool of each length: mm of the wrist's path in the moves that cut,
    the verdict, and the time it took.
    """
    yield ("file", "part", *(f"tool of {tool:.0f} mm" for tool in TOOLS_MM))
    for name in _there():
        try:
            plans = _plans(name)
        except InputError:
            continue
        for part, plan in enumerate(plans, start=1):
            yield (name, f"{part} of {len(plans)}", *(_judged(plan, tool) for tool in TOOLS_MM))


def _judged(plan: Plan, tool_mm: float) -> str:
    problem = _problem(plan, tool_mm)
    began = time.perf_counter()
    verdict = certified.verify(problem)
    elapsed_ms = (time.perf_counter() - began) * 1e3
    violated = [name for name, found in verdict.boundaries.items() if found.violated]
    told = "admissible" if verdict.admissible else f"inadmissible ({', '.join(violated) or 'speed'})"
    return f"{travelled(problem, _cut(plan))[0].wrist_length_mm:.0f} mm, {told}, {elapsed_ms:.0f} ms"


def _problem(plan: Plan, tool_mm: float) -> Problem:
    """The path where its middle is before the arm."""
    middle = (plan.tips_mm.min(axis=0) + plan.tips_mm.max(axis=0)) / 2.0
    height = float(np.mean(robot().limits.q2_mm)) - tool_mm * float(plan.axes[:, 2].mean())
    tips = plan.tips_mm - middle + (600.0, 0.0, height)
    feeds = _cut(plan).feed_range_mm_s
    path = WirePath.quantised(
        tips,
        plan.axes,
        feed_mm_s=feeds[0] if feeds else FEED_MM_S,
        tool_length_mm=tool_mm,
        elbow=robot().elbow,
    )
    return off_line_problem(path, widened(robot(), plan.cut))


def _cut(plan: Plan) -> Cut:
    assert plan.cut is not None  # a tool path's
    return plan.cut


SECTIONS = {"Read": readings, "Verified": verdicts}


def main() -> None:
    """Print the page as it comes, and write it where asked."""
    about = f"By `make bench` on {machine()}. The files are other people's and are not shipped; compared with independent readers in tests/runtime/plan/toolpath."
    show(document("Real tool paths", about, SECTIONS), __doc__.splitlines()[0] if __doc__ else None)


if __name__ == "__main__":
    main()
