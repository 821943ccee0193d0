"""Small files of the kernel."""

import os
from pathlib import Path
from typing import Final

TEXT_MAX: Final = 1 << 18
"""Bytes."""


def read_text(path: Path) -> str | None:
    """A file of the kernel's, of a long one the beginning; None where it cannot be read."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        data = b""
        while len(data) < TEXT_MAX and (
            part := os.read(descriptor, TEXT_MAX)
        ):  # the kernel hands over a page at a time
            data += part
        return data.decode("utf-8", "replace").strip()
    except OSError:
        return None
    finally:
        os.close(descriptor)


def number(text: str | None) -> int | None:
    """A whole number, decimal or with 0x; None for anything else."""
    try:
        return int(text, 0) if text is not None and len(text) <= 20 else None
    except ValueError:
        return None
