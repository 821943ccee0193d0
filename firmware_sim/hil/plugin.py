"""pytest plugin: hardware-in-the-loop tests of controllers and runtime (docs/hil.md).

pytest loads this module in every project of an environment that has cutgate: it imports nothing but pytest, and does
nothing for a test that asks for none of its fixtures.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from cutgate.firmware_sim.fault_language import Fault
    from cutgate.firmware_sim.hil.child import HilProcess
    from cutgate.firmware_sim.hil.inputs import HilFiles
    from cutgate.firmware_sim.hil.rig import HilBus, HilClock, HilOperator, HilRig, HilSession
    from cutgate.firmware_sim.hil.virtual import VirtualRig

_RIGS = pytest.StashKey["list[HilRig | VirtualRig]"]()
_ROW = "cutgate_matrix_row"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of what is kept."""
    group = parser.getgroup("cutgate", "hardware in the loop (cutgate)")
    group.addoption(
        "--cutgate-artefacts",
        type=Path,
        metavar="DIR",
        help="where logs and frames of failed tests are copied to",
    )
    group.addoption(
        "--cutgate-matrix",
        type=Path,
        metavar="FILE",
        help="write which faults were tried to this .html or .md file",
    )


def pytest_configure(config: pytest.Config) -> None:
    """The markers, and a page that collects its rows where one is wanted."""
    config.addinivalue_line(
        "markers",
        "cutgate_faults(*lines): faults of the simulated controller and of its messages (docs/hil.md)",
    )
    config.addinivalue_line(
        "markers",
        "cutgate_wire(bitrate, fd=None, queue=10): the bus of this test models the wire at this rate (docs/bus.md)",
    )
    config.addinivalue_line(
        "markers",
        "cutgate_expect(*names, may=()): one of these must be found by the health check; those of may are allowed",
    )
    path = config.getoption("--cutgate-matrix")
    if path is not None and not hasattr(config, "workerinput"):
        if path.suffix not in {".html", ".md"}:
            raise pytest.UsageError(f"--cutgate-matrix is {str(path)!r}, must end in .html or .md")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        except OSError as error:
            raise pytest.UsageError(
                f"--cutgate-matrix {str(path)!r} cannot be written ({error.strerror}); name another file"
            ) from None
        config.pluginmanager.register(_Matrix(path), "cutgate-matrix")


class _Matrix:
    """Collects rows from every worker and writes the page at the end."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._rows: dict[str, dict[str, Any]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """The last report of a test counts; a later phase that failed makes it failed."""
        row = dict(report.user_properties).get(_ROW)
        if isinstance(row, dict):
            earlier = self._rows.get(report.nodeid, {}).get("outcome")
            failed = report.failed or earlier == "failed"
            self._rows[report.nodeid] = {**row, "outcome": "failed" if failed else earlier or report.outcome}

    def pytest_sessionfinish(self) -> None:
        """Write it whole, over what stood there."""
        from cutgate.firmware_sim.hil.matrix import MatrixRow, page  # noqa: PLC0415 - only where it is used

        rows = [
            MatrixRow(row["test"], tuple(row["faults"]), row["ended"], tuple(row["health"]), row["outcome"])
            for row in self._rows.values()
        ]
        self._path.write_text(page(rows, self._path.suffix), encoding="utf-8")


# ---------------------------------------------------------------- a test's bus, controller and session


@pytest.fixture
def cutgate_files(tmp_path: Path) -> HilFiles:
    """What sessions read: a short plan, its registration, robot, site and a new key. Override it to bring your own."""
    from cutgate.firmware_sim.hil.inputs import write_files  # noqa: PLC0415

    folder = tmp_path / "cutgate-files"
    folder.mkdir()
    return write_files(folder)


@pytest.fixture
def cutgate_faults(request: pytest.FixtureRequest) -> tuple[Fault, ...]:
    """The faults of this test's markers; ``cutgate_controller`` has them without being told."""
    from cutgate.config.refusal import InputError  # noqa: PLC0415
    from cutgate.firmware_sim.fault_language import parse_fault  # noqa: PLC0415

    lines = [line for marker in request.node.iter_markers("cutgate_faults") for line in reversed(marker.args)]
    try:
        return tuple(parse_fault(line, "cutgate_faults") for line in reversed(lines))
    except InputError as error:
        pytest.fail(str(error), pytrace=False)


@pytest.fixture
def cutgate_rig(
    request: pytest.FixtureRequest, tmp_path: Path, cutgate_files: HilFiles, cutgate_faults: tuple[Fault, ...]
) -> Iterator[HilRig]:
    """Everything that this test starts; ended, judged and kept after it."""
    from cutgate.firmware_sim.hil.rig import HilRig  # noqa: PLC0415

    folder = tmp_path / "cutgate"
    folder.mkdir()
    options = [part for name, value in _wire(request.node).items() for part in (f"--{name}", value)]
    rig = HilRig(folder, cutgate_files, cutgate_faults, options)
    _judged_later(request.node, rig)
    try:
        yield rig
    finally:
        rig.close()


@pytest.fixture
def cutgate_bus(cutgate_rig: HilRig) -> HilBus:
    """A virtual bus of its own, the hub a process: ``interface``, ``channel``, ``open()`` for one more node."""
    return cutgate_rig.bus


@pytest.fixture
def cutgate_controller(cutgate_rig: HilRig) -> Callable[..., HilProcess]:
    """Starts the simulated controller: ``cutgate_controller(*faults, time_scale=30, joints=None, fd=False)``."""
    return cutgate_rig.controller


@pytest.fixture
def cutgate_runtime(cutgate_rig: HilRig) -> Callable[..., HilSession]:
    """Starts our runtime: ``cutgate_runtime(files=None, fd=False, more=())``."""
    return cutgate_rig.session


@pytest.fixture
def cutgate_session(cutgate_rig: HilRig) -> HilSession:
    """A session of our runtime, begun, with whatever controller is or comes on the bus."""
    return cutgate_rig.session()


@pytest.fixture
def cutgate_operator(cutgate_rig: HilRig) -> HilOperator:
    """Types at both terminals: ``type("stop")``, ``type("release")``, ``cut()`` for hold and start."""
    return cutgate_rig.operator


@pytest.fixture
def cutgate_clock() -> HilClock:
    """Real time: ``now_s()``, ``until(condition)``; ``cutgate_virtual`` has virtual time's."""
    from cutgate.firmware_sim.hil.rig import HilClock  # noqa: PLC0415

    return HilClock()


@pytest.fixture
def cutgate_virtual(
    request: pytest.FixtureRequest, tmp_path: Path, cutgate_files: HilFiles, cutgate_faults: tuple[Fault, ...]
) -> Iterator[VirtualRig]:
    """A bus and a clock in virtual time, everybody on it in this process: ``controller()``, ``open()``, ``run(s)``."""
    from cutgate.firmware_sim.hil.virtual import VirtualRig  # noqa: PLC0415

    folder = tmp_path / "cutgate-virtual"
    folder.mkdir()
    rig = VirtualRig(folder, cutgate_files, cutgate_faults, **_timed(_wire(request.node)))
    _judged_later(request.node, rig)
    try:
        yield rig
    finally:
        rig.close()


# ---------------------------------------------------------------- after a test


def _judged_later(item: pytest.Item, rig: HilRig | VirtualRig) -> None:
    """After the test it is closed and judged; a marker that nobody understands is told before anything is started."""
    _expectations(item)
    item.stash.setdefault(_RIGS, []).append(rig)


def _wire(item: pytest.Item) -> dict[str, str]:
    """Bit rates and queue of the nearest marker, as ``cutgate bus serve`` takes them; empty without one."""
    marker = item.get_closest_marker("cutgate_wire")
    if marker is None:
        return {}
    options = {**dict(zip(("bitrate", "fd", "queue"), marker.args, strict=False)), **marker.kwargs}
    if "bitrate" not in options or not options.keys() <= {"bitrate", "fd", "queue"} or len(marker.args) > 3:
        pytest.fail('cutgate_wire takes bitrate, fd and queue, for example cutgate_wire("1M")', pytrace=False)
    return {name: str(value) for name, value in options.items() if value is not None}


def _timed(wire: dict[str, str]) -> dict[str, Any]:
    """The same for a bus in virtual time."""
    from argparse import ArgumentTypeError  # noqa: PLC0415

    from cutgate.firmware_sim.bus.medium.bits import Rates  # noqa: PLC0415
    from cutgate.firmware_sim.bus.medium.medium import QUEUE_FRAMES  # noqa: PLC0415
    from cutgate.firmware_sim.bus.serve import queue_frames, rate_bit_s  # noqa: PLC0415

    if not wire:
        return {}
    try:
        data = rate_bit_s(wire["fd"]) if "fd" in wire else None
        rates = Rates(rate_bit_s(wire["bitrate"]), data)
        return {"rates": rates, "queue_frames": queue_frames(wire.get("queue", str(QUEUE_FRAMES)))}
    except ArgumentTypeError as error:
        pytest.fail(f"cutgate_wire: {error}", pytrace=False)


def _expectations(item: pytest.Item) -> list[Any]:
    from cutgate.firmware_sim.hil.health import Expectation  # noqa: PLC0415

    try:
        return [
            Expectation(marker.args, tuple(marker.kwargs.get("may", ())))
            for marker in item.iter_markers("cutgate_expect")
        ]
    except ValueError as error:
        pytest.fail(str(error), pytrace=False)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """End what the test has started, judge it, and keep it where the test or its health has failed."""
    try:
        returned = yield
    except (pytest.skip.Exception, pytest.exit.Exception, KeyboardInterrupt):
        raise  # what was started is ended with its fixture
    except BaseException:
        _conclude(item, failed=True)
        raise
    trouble = _conclude(item, failed=False)
    if trouble:
        pytest.fail("health check:\n" + "\n".join(f"  {line}" for line in trouble), pytrace=False)
    return returned


def _conclude(item: pytest.Item, *, failed: bool) -> list[str]:
    """What the health check says; empty for a test that has no rig, or no session."""
    rigs = item.stash.get(_RIGS, [])
    if not rigs:
        return []
    from cutgate.firmware_sim.hil.health import unexpected  # noqa: PLC0415
    from cutgate.firmware_sim.hil.kept import artefacts  # noqa: PLC0415
    from cutgate.firmware_sim.hil.matrix import MatrixRow  # noqa: PLC0415

    for rig in rigs:
        rig.close()
    judged = [rig for rig in rigs if rig.sessions]
    findings = [finding for rig in judged for finding in rig.findings]
    trouble = unexpected(findings, _expectations(item)) if judged else []
    if judged:
        found = tuple(dict.fromkeys(finding.name for finding in findings))
        used = tuple(dict.fromkeys(str(fault) for rig in judged for fault in rig.faults_used))
        row = MatrixRow(item.nodeid, used, ", ".join(rig.summary for rig in judged), found, "")
        item.user_properties.append((_ROW, row.as_dict()))
    if failed or trouble:
        directory = item.config.getoption("--cutgate-artefacts")
        lines = [line for rig in rigs for line in artefacts(rig.folder, rig.logs, directory, item.nodeid)]
        item.add_report_section("call", "cutgate artefacts", "\n".join(lines))
    return trouble
