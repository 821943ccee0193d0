"""What is looked at: a site's settings, and what the command line names."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cutgate.config.bus import SOCKETCAN_CHANNEL
from cutgate.config.model import Site

SOCKETCAN: Final = "socketcan"


@dataclass(frozen=True, slots=True)
class Examined:
    """What a session here would use.

    Attributes:
        site: its settings.
        key: the key file, None where none is named.
        interface: python-can's name.
        channel: of the interface.
        log_directory: where its log would go.
    """

    site: Site
    key: Path | None
    interface: str = SOCKETCAN
    channel: str = SOCKETCAN_CHANNEL
    log_directory: Path = Path("cutgate-logs")

    @property
    def in_kernel(self) -> bool:
        """The bus is one of the kernel's interfaces."""
        return self.interface == SOCKETCAN
