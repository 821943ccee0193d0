"""Entry point of ``cutgate``: nothing of weight is imported before Ctrl-C means something.

The imports take a second. Nothing is open in it yet, so whoever interrupts it is told so and the program ends there.
"""

import os
import signal
import sys
from typing import Any, Final

INTERRUPTED: Final = 130
STOPPED: Final = 3
"""What ``run`` ends with whenever it is interrupted."""


def main() -> None:
    """The ``cutgate`` program."""
    code = STOPPED if sys.argv[1:2] == ["run"] else INTERRUPTED

    def leave(_number: int, _frame: Any) -> None:
        os.write(2, b"cutgate: interrupted before it began\n")
        os._exit(code)

    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:  # not where it is ignored, as behind nohup
        signal.signal(signal.SIGINT, leave)
    from runtime.commands.app import execute  # noqa: PLC0415 - takes a second

    signal.signal(signal.SIGINT, before)
    ended = execute()
    sys.exit(code if ended == INTERRUPTED else ended)


if __name__ == "__main__":
    main()
