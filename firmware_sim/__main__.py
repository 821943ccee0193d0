"""``python -m firmware_sim sim ...`` and ``python -m firmware_sim bus ...``: what ``cutgate sim`` and ``bus`` run."""

import sys

from firmware_sim import command
from firmware_sim.bus import __main__ as bus


def main(arguments: list[str]) -> int:
    """Run one of the two; returns its exit code."""
    if arguments[:1] == ["bus"]:
        return bus.main(arguments[1:])
    return command.main(arguments[1:] if arguments[:1] == ["sim"] else arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
