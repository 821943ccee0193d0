"""The digest that a permit binds of how it was decided: the site's files, and the options that loosen a check."""

from collections.abc import Iterable
from hashlib import sha256
from typing import Final

ALLOW_SIMULATED: Final = "--allow-simulated"
SIMULATED: Final = "simulated controller"
"""Name of record 0's option that says who allowed a simulation."""

_DOMAIN: Final = b"cutgate/configuration/1"
_NO_FILE: Final = bytes(32)


def configuration_digest(robot: bytes, site: bytes | None, *, allow_simulated: bool) -> bytes:
    """SHA-256, 32 bytes, over the digests of robot.toml and site.toml, in this order, and the options.

    Args:
        robot: SHA-256 of the file.
        site: likewise; 32 zero bytes stand where there is none.
        allow_simulated: whether the option was given.
    """
    options = ALLOW_SIMULATED.encode() if allow_simulated else b""
    return sha256(_DOMAIN + robot + (_NO_FILE if site is None else site) + options).digest()


def allowed_by_option(options: Iterable[tuple[str, str]]) -> bool:
    """Whether record 0's options, name and value, say that the simulation was allowed on the command line."""
    return any(name == SIMULATED and ALLOW_SIMULATED in value for name, value in options)
