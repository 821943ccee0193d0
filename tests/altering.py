"""Change one field, however deep, of nested frozen dataclasses: the difference between a case and its twin."""

from dataclasses import replace
from typing import Any


def altered(value: Any, path: str, new: Any) -> Any:
    """``value`` with the field named by the dotted ``path`` replaced, everything else equal."""
    head, _, rest = path.partition(".")
    return replace(value, **{head: altered(getattr(value, head), rest, new) if rest else new})
