"""``python -m cutgate.firmware_sim sim ...`` and ``... bus ...``: what ``cutgate sim`` and ``bus`` run."""

import sys

from cutgate.config.interpreter import own_code_only


def main(arguments: list[str]) -> int:
    """Run one of the two; returns its exit code."""
    from cutgate.firmware_sim import command  # noqa: PLC0415 - not before it is known where from
    from cutgate.firmware_sim.bus import serve  # noqa: PLC0415

    if arguments[:1] == ["bus"]:
        return serve.main(arguments[1:])
    return command.main(arguments[1:] if arguments[:1] == ["sim"] else arguments)


if __name__ == "__main__":
    own_code_only()
    from cutgate.config.terminal import open_standard_streams  # not before it is known where from

    open_standard_streams()
    sys.exit(main(sys.argv[1:]))
