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


def _main() -> int:
    try:
        return main(sys.argv[1:])
    except SystemExit as told:  # after a help text, or about an option
        return int(told.code or 0)


if __name__ == "__main__":
    own_code_only()
    from cutgate.config.screen import ended  # not before it is known where from
    from cutgate.config.terminal import open_standard_streams

    open_standard_streams()
    sys.exit(ended(_main()))
