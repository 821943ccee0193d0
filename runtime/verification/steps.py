"""Work in steps, for whoever has other things to do in between."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")
Steps = Generator[None, None, T]
"""What is done between two of its values is short; what it returns is the answer."""


def finished(steps: Steps[T]) -> T:
    """Take all steps; what came of them."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            answer: T = end.value
            return answer
