"""The negative suite as tests: ``pytest --pyargs cutgate.runtime.commands.negative_suite.tests --cutgate-interface ...``."""

from collections.abc import Callable

from cutgate.runtime.conform.suite import Result


def test_conforms(cutgate_conform_case: Callable[[], Result]) -> None:
    """One item a case; a case after a halt is skipped with the reason."""
    cutgate_conform_case()
