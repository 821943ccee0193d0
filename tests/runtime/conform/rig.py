"""A tester and a simulated controller, joined by a bus in memory, turned one after the other in virtual time."""

from pathlib import Path

from cutgate.config.load import load_robot
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.firmware_sim import memory
from cutgate.firmware_sim.loop import Options, Process
from cutgate.firmware_sim.state import Controller, Holdings, Identity
from cutgate.protocol import records
from cutgate.protocol.codes import fingerprint
from cutgate.protocol.endpoint import Endpoint
from cutgate.protocol.port import Port
from cutgate.protocol.records import Side
from cutgate.runtime.conform.bench import Bench
from cutgate.runtime.conform.cases import Case
from cutgate.runtime.conform.suite import CaseVerdict, Result, SuiteOutcome, run
from cutgate.runtime.conform.table import cases
from tests.runtime.session.pair import KEY, Generator
from tests.runtime.session.wire import CONTROLLER, RUNTIME, Clock, Wire

ROBOT = Path(__file__).parents[3] / "examples" / "robot.toml"
CYCLE_S = 0.005
TIMING = records.Timing(
    heartbeat_ms=20,
    timeout_ms=100,
    permit_lifetime_s=10,
    start_lifetime_ms=500,
    start_tolerance_um=500,
    start_tolerance_mdeg=200,
    approach_clearance_um=10_000,
    approach_speed_percent=25,
)


class Rig:
    """A bench and a controller; ``wait`` is one turn of virtual time, in which the controller turns."""

    def __init__(self, directory: Path, *, key: bytes = KEY) -> None:
        self.clock = Clock()
        self.wire = Wire(self.clock)
        self.said: list[str] = []
        robot = load_robot(ROBOT).value
        self.approved = (
            limits_record(robot).body(),
            calibration_record(robot).body(),
            tool_record(robot).body(),
        )
        memory_file = directory / "memory.json"
        endpoint = Endpoint(Side.CONTROLLER, key, heartbeat_s=0.02, timeout_s=0.1, transfer_timeout_s=2.0)
        random = Generator("controller")
        self.process = Process(
            Controller.powered_up(
                Identity("SIM-1", fingerprint(key)),
                Holdings(*self.approved),
                memory.load(memory_file, now_us=0),
                random(16),
            ),
            Port(self.wire.nodes[CONTROLLER], endpoint),  # type: ignore[arg-type]
            memory_file,
            options=Options(announce_s=0.05),
            say=self.said.append,
            clock=self.clock,
            random=random,
        )
        self.controller_runs = True
        self.bench = Bench(
            self.wire.nodes[RUNTIME],  # type: ignore[arg-type]
            KEY,
            TIMING,
            reply_s=0.5,
            clock=self.clock,
            wait=self._run_cycle,
            random=Generator("tester"),
        )

    def _run_cycle(self, _limit_s: float) -> None:
        self.clock.now_s += CYCLE_S
        if self.controller_runs:
            self.process.run_cycle()

    def run(self, *names: str) -> SuiteOutcome:
        """The suite, or the cases of these names."""
        return run(self.bench, self.cases(*names))

    def cases(self, *names: str) -> tuple[Case, ...]:
        return tuple(c for c in cases(self.approved) if not names or c.name in names)

    def close(self) -> None:
        for node in self.wire.nodes.values():
            node.shutdown()


def failing(outcome: SuiteOutcome) -> dict[str, str]:
    """Names of the cases that did not pass, and what came."""
    return {r.case.name: r.came for r in outcome.results if r.verdict is not CaseVerdict.PASS}


def by_name(outcome: SuiteOutcome) -> dict[str, Result]:
    return {r.case.name: r for r in outcome.results}
