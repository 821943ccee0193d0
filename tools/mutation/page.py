"""The page about the last whole run: ``make mutation WRITE=docs/mutation.md``."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from tools.mutation.forked import ASLEEP_S, HANGS_S, SLOWER, Verdict
from tools.mutation.modules import OWN_TESTS
from tools.mutation.mutants import OPERATORS, Mutant


@dataclass(frozen=True)
class Score:
    """What became of one module's mutants."""

    module: str
    mutants: Sequence[Mutant]
    verdicts: Sequence[Verdict]

    def count(self, verdict: Verdict) -> int:
        """How many ended so."""
        return self.verdicts.count(verdict)

    @property
    def killed(self) -> int:
        """How many the tests found."""
        return sum(verdict.killed for verdict in self.verdicts)

    def __str__(self) -> str:
        """Mutants, killed, and how, on one line."""
        ends = ", ".join(f"{self.count(end)} {end.name.lower()}" for end in Verdict if self.count(end))
        return f"{len(self.mutants)} mutants, {self.killed} killed ({ends})"


Known = Mapping[tuple[str, str], str]


def page(scores: Sequence[Score], known: Known, took_s: float, jobs: int) -> str:
    """The whole page; without scores it says that no whole run is recorded."""
    took = (
        f"The run took {took_s / 60:.1f} minutes with {jobs} processes at a time on {os.cpu_count()} cores."
    )
    figures = [*_figures(scores), took, "", *_operators(scores)] if scores else [NO_RUN, "", *_operators(())]
    return "\n".join([*HEAD, "", *figures, *_survivors(known), ""])


def about(known: Known) -> list[str]:
    """Every line of the page that no run changes."""
    return [*HEAD, *_survivors(known)]


NO_RUN = "No whole run is recorded here yet: `make mutation WRITE=docs/mutation.md` writes its figures."
HEAD = f"""\
# Mutation testing

Each module that decides is guarded by test files of its own. `make mutation` makes every small mistake of the kinds
below in every one of these modules, one at a time, and runs the module's own tests on it: one must fail. A mutant that
lives is a rule that no test states.

- `make mutation` runs all of them, on all cores. It leaves with 1 if a mutant lives that
  [survivors.toml](../tools/mutation/survivors.toml) does not list, and if that names one that is dead or no mutant any more.
- `make mutation MODULES=protocol/e2e.py`, `SAMPLE=100` and `JOBS=1` run less, or slower.
- `make mutation WRITE=docs/mutation.md` writes this page as well.
- `make test-all` runs a sample of each module; which mutants are in it changes with the modules.

What kills: a test that fails, in set-up, call or tear-down (*failed*); a module that cannot be imported, or tests that
cannot be collected with it (*import*); a test that takes {HANGS_S:g} s and {SLOWER} times its own time on the processor, or
waits {ASLEEP_S} s for something that does not come (*hangs*; a queue for the processor is no waiting, so a busy machine kills
no mutant). A process that ends in any other way fails the run.

Only tests that can tell are run: a mistake inside a function concerns the tests that enter that function, which is
recorded with each test running alone; the function gets its new code in a process forked after the tests were
collected. A mistake in tables, classes, defaults, or in a function that has run before the first test, is imported anew
with all of the module's tests, and so is every mutant that lived the short way. Without a mutant all tests must pass,
together and each alone. hypothesis runs with a fixed seed and without its deadline.
""".splitlines()


def _figures(scores: Sequence[Score]) -> Iterator[str]:
    yield "| module | own tests | mutants | killed | failed | import | hangs | listed |"
    yield "|---|---|---|---|---|---|---|---|"
    ends = (Verdict.FAILED, Verdict.UNIMPORTABLE, Verdict.HANGS)
    columns = []
    for score in scores:
        numbers = [
            len(score.mutants),
            score.killed,
            *map(score.count, ends),
            len(score.mutants) - score.killed,
        ]
        columns.append(numbers)
        tests = ", ".join(f"`{name.rpartition('/')[2]}`" for name in OWN_TESTS[score.module])
        yield f"| `{score.module}` | {tests} | {' | '.join(map(str, numbers))} |"
    yield f"| all | | {' | '.join(str(sum(column)) for column in zip(*columns, strict=True))} |"
    yield ""


def _operators(scores: Sequence[Score]) -> Iterator[str]:
    yield f"| mistake | what is done |{' mutants |' if scores else ''}"
    yield f"|---|---|{'---|' if scores else ''}"
    made = Counter(mutant.kind for score in scores for mutant in score.mutants)
    for name, operator in OPERATORS.items():
        done = " ".join((operator.__doc__ or "").replace("``", "`").split())
        yield f"| {name} | {done} |{f' {made[name]} |' if scores else ''}"
    yield ""
    yield "Strings, annotations and assertions are left alone: the first are for people, the others for the type checker."
    yield ""


def _survivors(known: Known) -> Iterator[str]:
    yield "## What lives, and why it may"
    yield ""
    yield "| module | mutant | reason |"
    yield "|---|---|---|"
    for (module, name), reason in known.items():
        yield f"| `{module}` | `{_cell(name)}` | {_cell(reason)} |"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
