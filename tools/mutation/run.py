"""Mutation testing: ``python -m tools.mutation.run [--jobs N] [--sample N] [--match TEXT] [--changed] [--record] [MODULE]...``.

Leaves with 1 if a mutant lives that ``survivors.toml`` does not list, or if it lists one that is dead or no mutant.
"""

import argparse
import hashlib
import os
import signal
import sys
import time
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

from tools.mutation.forked import Trial, UnfitError, Verdict
from tools.mutation.modules import OWN_TESTS, ROOT
from tools.mutation.mutants import Mutant, mutants
from tools.mutation.page import page
from tools.mutation.results import Result, changed, load, store

PAGE: Final = ROOT / "docs" / "mutation.md"
LIST: Final = Path(__file__).parent / "survivors.toml"
Known = Mapping[tuple[str, str], str]


def listed() -> dict[tuple[str, str], str]:
    """Module and mutant of the survivors that are known, with the reason."""
    entries = tomllib.loads(LIST.read_text(encoding="utf-8")).get("survivor", [])
    return {(entry["module"], entry["mutant"]): entry["reason"] for entry in entries}


def summary(verdicts: Sequence[Verdict]) -> str:
    """Mutants, killed, and how, on one line."""
    ends = ", ".join(f"{verdicts.count(end)} {end.name.lower()}" for end in Verdict if end in verdicts)
    return f"{len(verdicts)} mutants, {sum(verdict.killed for verdict in verdicts)} killed ({ends})"


def complaints(module: str, verdicts: Mapping[str, Verdict], known: Known) -> list[str]:
    """Where the verdicts on a module's mutants and the list differ."""
    said = []
    for name, verdict in verdicts.items():
        if not verdict.killed and (module, name) not in known:
            said.append(
                f"NEW survivor {module} {name} ({verdict.value}): add a test, or list it with its reason"
            )
        if verdict.killed and (module, name) in known:
            said.append(f"STALE survivor {module} {name} ({verdict.value}): take it from the list")
    return said


def strangers(module: str, known: Known) -> list[str]:
    """What is listed of a module and is no mutant of it."""
    names = {mutant.name for mutant in all_mutants(module)}
    return [
        f"STALE survivor {module} {name}: there is no such mutant"
        for other, name in known
        if other == module and name not in names
    ]


@cache
def all_mutants(module: str) -> list[Mutant]:
    """Every mutant of one of our modules."""
    return mutants(_source(module))


def _source(module: str) -> str:
    return (ROOT / module).read_text(encoding="utf-8")


def sample(found: Mapping[str, Sequence[Mutant]], size: int) -> dict[str, list[Mutant]]:
    """So many, spread over everything: the same as long as no module changes, others when one does."""
    turn = hashlib.sha256("".join(_source(module) for module in found).encode()).hexdigest()

    def shuffled(pair: tuple[str, Mutant]) -> str:
        return hashlib.sha256(f"{pair[0]} {pair[1].name} {turn}".encode()).hexdigest()

    pairs = [(module, mutant) for module, those in found.items() for mutant in those]
    chosen = sorted(pairs, key=shuffled)[:size]
    return {module: [mutant for other, mutant in chosen if other == module] for module in found}


def main(words: Sequence[str]) -> int:
    """Run the mutants; print a line a module and every complaint."""
    parser = _parser()
    asked = parser.parse_args(words)
    if asked.record and (asked.sample or asked.match):
        parser.error("--record: figures are of all of a module's mutants; leave --sample and --match out")
    results = load()
    found = {
        module: [mutant for mutant in all_mutants(module) if asked.match in mutant.name]
        for module in asked.modules or (changed(results) if asked.changed else OWN_TESTS)
    }
    if asked.sample:
        found = sample(found, asked.sample)
    known, wrong = listed(), 0
    began_s = time.monotonic()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(os.EX_TEMPFAIL))  # so that no folder stays behind
    try:
        for module, those in found.items():
            verdicts = Trial(ROOT / "cutgate" / module, ROOT, OWN_TESTS[module], asked.jobs).verdicts(those)
            _say(f"{module}: {summary(verdicts)}, {time.monotonic() - began_s:.0f} s after the beginning")
            by_name = dict(zip([mutant.name for mutant in those], verdicts, strict=True))
            said = [*strangers(module, known), *complaints(module, by_name, known)]
            wrong += len(said)
            if asked.record and not said:
                results[module] = Result.of(module, verdicts, [mutant.kind for mutant in those])
                store(results)
                PAGE.write_text(page(load(), known), encoding="utf-8")
            shown = [f"{verdict.name} {module} {name}" for name, verdict in by_name.items() if asked.verdicts]
            _say("\n".join([*shown, *said, ""]), end="")
    except UnfitError as error:
        _say(str(error))
        return 1
    if wrong:
        return 1
    _say("every mutant is killed or listed with its reason")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tools.mutation.run", description=__doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE", help=", ".join(OWN_TESTS))
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="processes at a time"
    )
    parser.add_argument("--sample", type=int, default=0, metavar="N", help="only N mutants")
    parser.add_argument("--match", default="", metavar="TEXT", help="only mutants whose name has this in it")
    parser.add_argument("--verdicts", action="store_true", help="print what became of each mutant")
    parser.add_argument(
        "--changed", action="store_true", help="only modules that have changed since they were recorded"
    )
    parser.add_argument(
        "--record", action="store_true", help="record each module's figures, and write docs/mutation.md"
    )
    return parser


def _say(text: str, end: str = "\n") -> None:
    print(text, end=end, flush=True)  # noqa: T201 - a report


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
