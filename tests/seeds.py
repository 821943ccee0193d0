"""Seeds of random tests: some for every run, as many again and more for `make test-all`."""

import pytest


def seeds(often: int, rarely: int) -> list[object]:
    """0 to often - 1 in each run, the next ``rarely`` ones only among the slow tests."""
    slow = [pytest.param(seed, marks=pytest.mark.slow) for seed in range(often, often + rarely)]
    return [*range(often), *slow]
