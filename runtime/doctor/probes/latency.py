"""How late a loop wakes beside a process that has much to do."""

import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from cutgate.runtime.doctor.examined import Examined
from cutgate.runtime.doctor.facts import Delays, Unknown
from cutgate.runtime.doctor.probes.files import delays, session_in

CYCLE_S: Final = 0.02
CYCLES: Final = 50
"""A second of them."""
UNTIL_S: Final = 3.0
"""A loop that is so late is not waited for any longer."""
BUSY: Final = f"import time\nend = time.monotonic() + {UNTIL_S}\nwhile time.monotonic() < end: pass"
"""What the verification process is beside a session's loop: arithmetic. It ends by itself."""


@contextmanager
def busy() -> Iterator[None]:
    """A process beside this one that uses all of a core."""
    command = [sys.executable, "-I", "-S", "-c", BUSY]
    with subprocess.Popen(  # noqa: S603 - our own words
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield
        finally:
            process.kill()


def loop_delays(examined: Examined) -> Delays | Unknown:
    """A second of cycles, as a session's loop keeps them; beside a session that runs, none."""
    if (session := session_in(examined.log_directory)) is not None:
        why = f"a session runs in {examined.log_directory} (process {session}): it is left its processor"
        return Unknown(why, "look again after it")
    poller = select.poll()
    with busy():
        return lateness(time.monotonic, lambda wait_s: poller.poll(1000 * wait_s))


def lateness(clock: Callable[[], float], wait: Callable[[float], object]) -> Delays:
    """How late each cycle begins.

    Args:
        clock: monotonic seconds.
        wait: returns after so many seconds, or later.
    """
    late_s: list[float] = []
    began_s = clock()
    due_s = began_s + CYCLE_S
    while len(late_s) < CYCLES and (not late_s or clock() < began_s + UNTIL_S):
        wait(max(0.0, due_s - clock()))
        now_s = clock()
        late_s.append(max(0.0, now_s - due_s))
        # Who has stood still is late once: the cycles in between are not made up for.
        due_s = max(due_s, now_s) + CYCLE_S if now_s - due_s > CYCLE_S else due_s + CYCLE_S
    return delays(late_s)
