"""Entry point of ``cutgate``: nothing of weight is imported before Ctrl-C means something.

The imports take half a second. Nothing is open in it yet, so whoever interrupts it is told so and the program ends there.
"""

import os
import sys

from cutgate.config.exits import INTERRUPTED, STOPPED
from cutgate.config.interpreter import own_code_only

FORCING = ("FORCE_COLOR", "PY_COLORS", "GITHUB_ACTIONS", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
"""What makes libraries write for a terminal where there is none; whether there is one is decided in one place of ours."""


def main() -> None:
    """The ``cutgate`` program."""
    own_code_only()
    for name in FORCING:
        os.environ.pop(name, None)
    import signal  # noqa: PLC0415 - not before it is known where from

    from cutgate.config.screen import ended  # noqa: PLC0415
    from cutgate.config.terminal import open_standard_streams  # noqa: PLC0415

    open_standard_streams()
    code = STOPPED if sys.argv[1:2] == ["run"] else INTERRUPTED

    def leave(_number: int, _frame: object) -> None:
        os.write(2, b"cutgate: interrupted before it began\n")
        os._exit(code)

    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:  # not where it is ignored, as behind nohup
        signal.signal(signal.SIGINT, leave)
    from cutgate.runtime.commands.app import COMMANDS, execute, load  # noqa: PLC0415 - takes its time

    if sys.argv[1:2] and sys.argv[1] in COMMANDS:
        load(sys.argv[1])
    signal.signal(signal.SIGINT, before)
    left = execute()
    sys.exit(ended(code if left == INTERRUPTED else left))


if __name__ == "__main__":
    main()
