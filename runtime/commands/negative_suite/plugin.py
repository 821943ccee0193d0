"""pytest plugin: the negative suite, one item a case, in front of a controller that tests or options name (docs/hil.md).

pytest loads this module in every project of an environment that has cutgate: it imports nothing but pytest, and does
nothing for a test that asks for none of its fixtures.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from cutgate.runtime.commands.negative_suite.items import ConformCase, ConformSuite, ConformTarget

_CASE = "cutgate_conform_case"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options that name the controller under test."""
    group = parser.getgroup("cutgate", "hardware in the loop (cutgate)")
    group.addoption(
        "--cutgate-interface", metavar="NAME", help="python-can interface of the controller under test"
    )
    group.addoption("--cutgate-channel", metavar="NAME", help="its channel")
    group.addoption("--cutgate-key", type=Path, metavar="FILE", help="its pre-shared key")
    group.addoption(
        "--cutgate-robot", type=Path, metavar="FILE", help="the approved robot file, which it must report"
    )
    group.addoption(
        "--cutgate-site", type=Path, metavar="FILE", help="site file: heartbeat, time-out, reply time"
    )
    group.addoption("--cutgate-fd", action="store_true", help="bulk records in CAN FD frames")
    group.addoption(
        "--cutgate-plant-disconnected", action="store_true", help="you say: its axes and cutter have no power"
    )


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One item for each case of the negative suite."""
    if _CASE in metafunc.fixturenames:
        from cutgate.runtime.commands.negative_suite.items import NAMES  # noqa: PLC0415

        metafunc.parametrize(_CASE, NAMES, indirect=True, scope="function")


@pytest.fixture(scope="session")
def cutgate_conform_target(request: pytest.FixtureRequest) -> ConformTarget:
    """The controller under test, as the options name it. Override it to bring your own.

    It fails where an option is missing, or where several workers would speak to one controller.
    """
    from cutgate.runtime.commands.negative_suite.items import ConformTarget  # noqa: PLC0415

    option = request.config.getoption
    needed = ("--cutgate-interface", "--cutgate-channel", "--cutgate-key", "--cutgate-plant-disconnected")
    missing = [name for name in needed if not option(name)]
    if missing:
        pytest.fail(
            f"the controller under test: {', '.join(missing)} is not given; name it, and disconnect its plant first "
            "(docs/controllers.md)",
            pytrace=False,
        )
    if getattr(request.config, "workerinput", {}).get("workercount", 1) > 1:
        raise pytest.UsageError(
            "several workers would speak to one controller; run these tests with -n 0 or -n 1"
        )
    return ConformTarget(
        option("--cutgate-interface"),
        option("--cutgate-channel"),
        option("--cutgate-key"),
        robot=option("--cutgate-robot"),
        site=option("--cutgate-site"),
        fd=option("--cutgate-fd"),
    )


@pytest.fixture(scope="session")
def cutgate_conform_suite(cutgate_conform_target: ConformTarget) -> Iterator[ConformSuite]:
    """The suite in front of that controller, for all cases of this process."""
    from cutgate.config.refusal import InputError  # noqa: PLC0415
    from cutgate.runtime.commands.negative_suite.items import in_front_of  # noqa: PLC0415

    try:
        with in_front_of(cutgate_conform_target) as suite:
            yield suite
    except InputError as error:
        pytest.fail(str(error), pytrace=False)


@pytest.fixture
def cutgate_conform_case(request: pytest.FixtureRequest, cutgate_conform_suite: ConformSuite) -> ConformCase:
    """One case of the negative suite; a test calls it."""
    from cutgate.runtime.commands.negative_suite.items import ConformCase  # noqa: PLC0415

    return ConformCase(cutgate_conform_suite, request.param)
