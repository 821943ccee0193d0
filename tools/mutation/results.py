"""What became of each module's mutants when they were last run, so that only what has changed is run again."""

import hashlib
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from tools.mutation.forked import Verdict
from tools.mutation.modules import OWN_TESTS, ROOT

FILE: Final = Path(__file__).parent / "results.json"


@dataclass(frozen=True)
class Result:
    """Of one module's whole run: the digest of module and own tests, and how many mutants ended how, of which kind."""

    digest: str
    ends: Mapping[str, int]
    kinds: Mapping[str, int]

    @property
    def mutants(self) -> int:
        """How many there were."""
        return sum(self.ends.values())

    @property
    def alive(self) -> int:
        """How many no test found."""
        return self.ends.get(Verdict.ALIVE.name, 0)

    @classmethod
    def of(cls, module: str, verdicts: list[Verdict], kinds: list[str]) -> "Result":
        """Of a run of every mutant of the module."""
        ends = Counter(verdict.name for verdict in verdicts)
        return cls(digest_of(module), dict(sorted(ends.items())), dict(sorted(Counter(kinds).items())))


def digest_of(module: str) -> str:
    """SHA-256 over the module and its own tests, shortened: what a result is about."""
    whole = hashlib.sha256()
    for path in (module, *OWN_TESTS[module]):
        whole.update((ROOT / path).read_bytes())
    return whole.hexdigest()[:16]


def load(file: Path = FILE) -> dict[str, Result]:
    """The recorded results of the modules there are."""
    if not file.is_file():
        return {}
    found = json.loads(file.read_text(encoding="utf-8"))
    return {module: Result(**found[module]) for module in OWN_TESTS if module in found}


def store(results: Mapping[str, Result], file: Path = FILE) -> None:
    """Write them, one module a line."""
    lines = [f"{json.dumps(module)}: {json.dumps(asdict(results[module]))}" for module in sorted(results)]
    file.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def changed(results: Mapping[str, Result]) -> list[str]:
    """The modules that have no result, or one of another source or other tests."""
    return [
        module for module in OWN_TESTS if module not in results or results[module].digest != digest_of(module)
    ]
