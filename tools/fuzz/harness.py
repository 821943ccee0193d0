"""What the families share: a property over bytes, examples to mutate, and the words for saying what was refused."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

T = TypeVar("T")


class BrokenPromiseError(Exception):
    """A parser let something through, or let something out, that it promises not to."""


@dataclass(frozen=True)
class Family:
    """Parsers that are fuzzed together.

    Attributes:
        check: raises for bytes that break a promise: an exception that is not documented, or `BrokenPromiseError`.
        seeds: inputs worth changing: sound ones, so that a change reaches what lies behind the first check.
    """

    check: Callable[[bytes], None]
    seeds: tuple[bytes, ...]


def attempt(refusal: type[Exception], parse: Callable[..., T], *arguments: Any) -> T | None:
    """What was parsed, or None where it was refused as documented; any other exception passes."""
    try:
        return parse(*arguments)
    except refusal as error:
        expect(bool(str(error)), f"{parse} refuses with a reason")
        return None


def expect(holds: bool, promise: str) -> None:
    """Raise `BrokenPromiseError` unless it holds; never optimised away as an assertion is."""
    if not holds:
        raise BrokenPromiseError(promise)


def choose(data: bytes, options: tuple[T, ...]) -> tuple[T, bytes]:
    """The first byte chooses one of these; the rest is for it."""
    return options[(data[0] if data else 0) % len(options)], data[1:]
