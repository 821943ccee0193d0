"""Mutation testing: ``python -m mutation.run [--sample N] [--match TEXT] [MODULE]...``; 1 if a mutant survives that is not listed.

Each mutant is put in the module's place in a forked process, which runs the module's own tests. A mutant that fails
them, or takes far longer than the module does, is killed. ``survivors.toml`` lists those that live, each with its reason.
"""

import argparse
import hashlib
import importlib.abc
import importlib.util
import os
import signal
import sys
import time
import tomllib
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import cantools  # noqa: F401 - loaded once, before the processes are forked
import cryptography.hazmat.primitives.cmac  # noqa: F401 - likewise
import hypothesis
import isotp  # noqa: F401 - likewise
import numpy  # noqa: F401, ICN001 - likewise
import pytest

from mutation.modules import OWN_TESTS, ROOT
from mutation.mutants import Mutant, mutants

LIST: Final = Path(__file__).parent / "survivors.toml"
SLOWER: Final = 10
"""A mutant that takes this many times as long as the module itself, and ten seconds, hangs."""
LOOK_S: Final = 0.05


class InPlace(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module from a source that is given."""

    def __init__(self, module: str, source: str) -> None:
        self.name = module.removesuffix(".py").replace("/", ".")
        self.code = compile(source, str(ROOT / module), "exec")

    def find_spec(self, fullname: str, _path: Any, _target: ModuleType | None = None) -> ModuleSpec | None:
        """Answer for this module only."""
        return importlib.util.spec_from_loader(fullname, self) if fullname == self.name else None

    def exec_module(self, module: ModuleType) -> None:
        """Run the given source."""
        exec(self.code, module.__dict__)  # noqa: S102 - that is what this module is for


def survives(module: str, source: str, timeout_s: float) -> bool:
    """Whether the module's own tests pass on this source."""
    child = os.fork()
    if child == 0:
        _test(module, source)
    ends_s = time.monotonic() + timeout_s
    while time.monotonic() < ends_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status) == 0
        time.sleep(LOOK_S)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def _test(module: str, source: str) -> None:
    """Run the tests in this process and end it with their exit code."""
    code = 1
    try:
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        phases = [hypothesis.Phase.explicit, hypothesis.Phase.generate]
        hypothesis.settings.register_profile("mutation", database=None, derandomize=True, phases=phases)
        hypothesis.settings.load_profile("mutation")
        sys.dont_write_bytecode = True
        sys.meta_path.insert(0, InPlace(module, source))
        code = int(pytest.main(["-x", "-q", "--assert=plain", "-p", "no:cacheprovider", *OWN_TESTS[module]]))
    finally:
        os._exit(code)


def listed() -> dict[tuple[str, str], str]:
    """Module and mutant of the survivors that are known, with the reason."""
    entries = tomllib.loads(LIST.read_text(encoding="utf-8")).get("survivor", [])
    return {(entry["module"], entry["mutant"]): entry["reason"] for entry in entries}


def sample(found: Sequence[tuple[str, Mutant]], size: int) -> list[tuple[str, Mutant]]:
    """Always the same few, spread over everything."""

    def shuffled(pair: tuple[str, Mutant]) -> str:
        return hashlib.sha256(f"{pair[0]} {pair[1].name}".encode()).hexdigest()

    return sorted(sorted(found, key=shuffled)[:size], key=lambda pair: list(OWN_TESTS).index(pair[0]))


def main(words: Sequence[str]) -> int:
    """Run the mutants; print each survivor and a line a module."""
    parser = argparse.ArgumentParser(prog="python -m mutation.run", description=__doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE", help=", ".join(OWN_TESTS))
    parser.add_argument("--sample", type=int, default=0, metavar="N", help="only N mutants, always the same")
    parser.add_argument("--match", default="", metavar="TEXT", help="only mutants whose name has this in it")
    asked = parser.parse_args(words)
    os.chdir(ROOT)
    sources = {module: (ROOT / module).read_text(encoding="utf-8") for module in asked.modules or OWN_TESTS}
    found = [(module, mutant) for module, source in sources.items() for mutant in mutants(source)]
    found = [pair for pair in found if asked.match in pair[1].name]
    if asked.sample:
        found = sample(found, asked.sample)
    known, new = listed(), 0
    for module, source in sources.items():
        mine = [mutant for name, mutant in found if name == module]
        began_s = time.monotonic()
        if mine and not survives(module, source, timeout_s=600.0):
            print(f"{module}: its own tests fail without any mutant", flush=True)  # noqa: T201
            return 1
        timeout_s = 10.0 + SLOWER * (time.monotonic() - began_s)
        alive = 0
        for mutant in mine:
            if survives(module, mutant.source, timeout_s):
                fresh = (module, mutant.name) not in known
                alive, new = alive + 1, new + fresh
                print(f"{'NEW ' if fresh else ''}survivor {module} {mutant.name}", flush=True)  # noqa: T201
        if mine:
            print(f"{module}: {len(mine)} mutants, {len(mine) - alive} killed", flush=True)  # noqa: T201
    return int(new > 0)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
