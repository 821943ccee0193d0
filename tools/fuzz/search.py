"""Coverage-guided search through one family: ``python -m tools.fuzz.search FAMILY [libFuzzer options]``; needs atheris.

Inputs are kept in ``tools/fuzz/corpus/FAMILY`` from run to run; an input that breaks a promise ends the search with a
traceback and is written beside it.
"""

import importlib
import sys
from hashlib import sha256
from pathlib import Path

import atheris

CORPUS = Path(__file__).parent / "corpus"
OURS = ["cutgate", "tools"]


def main() -> None:
    """Search until an option says stop."""
    name, *options = sys.argv[1:]
    with atheris.instrument_imports(include=OURS, enable_loader_override=False):
        family = importlib.import_module(f"tools.fuzz.{name}").FAMILY
    corpus = CORPUS / name
    corpus.mkdir(parents=True, exist_ok=True)
    for seed in family.seeds:
        (corpus / sha256(seed).hexdigest()[:16]).write_bytes(seed)
    prefix = f"-artifact_prefix={CORPUS}/finding-{name}-"
    atheris.Setup(
        [sys.argv[0], str(corpus), prefix, "-max_len=70000", "-rss_limit_mb=1024", *options], family.check
    )
    atheris.Fuzz()


if __name__ == "__main__":
    main()
