"""``python tools/benchmarks/timed.py runtime|controller FILE ARGUMENTS``: the program itself, with its turns timed.

At its end the number of turns that began in a session, and the longest of them by clock and by CPU, are written to the file as JSON.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

from cutgate.firmware_sim.__main__ import main as controller_side
from cutgate.firmware_sim.loop import Process
from cutgate.runtime.commands.app import execute
from cutgate.runtime.session.loop import Session

PROGRAMS = {"runtime": (Session, execute), "controller": (Process, controller_side)}


def timed(loop: type[Any], told: dict[str, Any]) -> None:
    """From now on every cycle of this loop is timed."""
    run_cycle = loop.run_cycle

    def longer(self: Any, *arguments: Any) -> None:
        port = self.port if isinstance(self, Process) else self._port
        in_session, began_s, cpu_s = port.endpoint.link.is_open, time.perf_counter(), time.thread_time()
        run_cycle(self, *arguments)
        if in_session:
            told["turns"] += 1
            told["longest_s"] = max(told["longest_s"], time.perf_counter() - began_s)
            told["cpu_s"] = max(told["cpu_s"], time.thread_time() - cpu_s)

    loop.run_cycle = longer


def main(side: str, file: str, *arguments: str) -> int:
    """Be one of the two programs."""
    told: dict[str, Any] = {"turns": 0, "longest_s": 0.0, "cpu_s": 0.0}
    loop, program = PROGRAMS[side]
    timed(loop, told)
    try:
        return program(list(arguments))
    finally:
        Path(file).write_text(json.dumps(told), encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
