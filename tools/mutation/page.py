"""The page about the figures that are recorded: ``make mutation RECORD=1``."""

from collections import Counter
from collections.abc import Iterator, Mapping

from tools.mutation.forked import ASLEEP_S, HANGS_S, SLOWER, Verdict
from tools.mutation.modules import OWN_TESTS
from tools.mutation.mutants import OPERATORS
from tools.mutation.results import Result

Known = Mapping[tuple[str, str], str]


def page(results: Mapping[str, Result], known: Known) -> str:
    """The whole page."""
    return "\n".join([*HEAD, "", *_figures(results), *_operators(results), *_survivors(known), ""])


def about(known: Known) -> list[str]:
    """Every line of the page that no run changes."""
    return [*HEAD, *_survivors(known)]


HEAD = f"""\
# Mutation testing

Each module that decides is guarded by test files of its own, which cover it to the last branch. `make mutation` makes every small mistake of the kinds
below in every one of these modules, one at a time, and runs the module's own tests on it: one must fail. A mutant that
lives is a rule that no test states.

- `make mutation` runs all of them, on all cores. It leaves with 1 if a mutant lives that
  [survivors.toml](../tools/mutation/survivors.toml) does not list, and if that names one that is dead or no mutant any more.
- `make mutation MODULES=protocol/e2e.py`, `SAMPLE=100` and `JOBS=1` run less, or slower.
- `make mutation CHANGED=1` runs the modules whose source or own tests have changed since their figures were recorded.
- `make mutation RECORD=1` records the figures of each module that is run, and writes this page.
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

Why not mutmut: version 3.8.1 makes its mistakes in the bodies of functions alone. In five of these modules (e2e, permit, records,
cycle, rules) it made 430, of which 24 lived: four in texts, two that are equivalent, and 18 in functions that run
when a table is built, before the mistake is switched on; the same 18 are killed here. Of the 333 that are made here in these
five modules 121 stand in tables, classes and defaults, and the tables are what decides.

Not mutated: the mathematics of the verification, which is held to independent references instead
([verification.md](verification.md)): `certified.py` and `certificate.py`, `bounds/`, `placing/` and `plausibility.py`; `firmware_sim/plant.py`;
of the virtual bus what has sockets and programs (`hub.py`, `client.py`, `wire.py`, `serve.py` and what they use);
of the audit log `inspect.py`, `second_reading.py`, `replay.py`, `directory.py` and `records.py`.
""".splitlines()


def _figures(results: Mapping[str, Result]) -> Iterator[str]:
    yield "| module | own tests | mutants | killed | failed | import | hangs | listed |"
    yield "|---|---|---|---|---|---|---|---|"
    ends = (Verdict.FAILED, Verdict.UNIMPORTABLE, Verdict.HANGS)
    columns = []
    for module in OWN_TESTS:
        tests = ", ".join(f"`{name.rpartition('/')[2]}`" for name in OWN_TESTS[module])
        if module not in results:
            yield f"| `{module}` | {tests} | not run yet | | | | | |"
            continue
        result = results[module]
        counts = [result.ends.get(end.name, 0) for end in ends]
        numbers = [result.mutants, result.mutants - result.alive, *counts, result.alive]
        columns.append(numbers)
        yield f"| `{module}` | {tests} | {' | '.join(map(str, numbers))} |"
    yield f"| all | | {' | '.join(str(sum(column)) for column in zip(*columns, strict=True))} |"
    yield ""


def _operators(results: Mapping[str, Result]) -> Iterator[str]:
    yield "| mistake | what is done | mutants |"
    yield "|---|---|---|"
    made = Counter[str]()
    for result in results.values():
        made.update(result.kinds)
    for name, operator in OPERATORS.items():
        done = " ".join((operator.__doc__ or "").replace("``", "`").split())
        yield f"| {name} | {done} | {made[name]} |"
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
