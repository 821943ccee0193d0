"""A layout for Lichtblick: which panels show which topics. As data, beside this module; here is what reads it."""

from importlib.resources import files
from typing import Final

LAYOUT: Final = "lichtblick-layout.json"


def layout_bytes() -> bytes:
    """The layout's file."""
    return (files("cutgate.runtime.commands.foxglove") / LAYOUT).read_bytes()
