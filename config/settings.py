"""Every setting of a site with its value, where that comes from, its bounds, unit and effect. Pure.

Nothing of it is written down here: all of it is asked of the model (``cutgate.config.model``).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from pydantic import BaseModel

from cutgate.config.constants import grouped
from cutgate.config.model import Site

_NOT_SETTINGS: Final = frozenset({"schema_"})


class Source(StrEnum):
    """Where a value comes from."""

    DEFAULT = "default"
    SITE = "site.toml"


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting.

    Attributes:
        table: of ``site.toml``; empty for what stands before all tables.
        name: within its table.
        value: as ``site.toml`` has it, None where none is set.
        source: where the value comes from.
        bounds: what it may be, in words, without the unit.
        unit: empty where it has none.
        effect: what it does.
    """

    table: str
    name: str
    value: Any
    source: Source
    bounds: str
    unit: str
    effect: str

    @property
    def key(self) -> str:
        """The dotted key, as a refusal names it."""
        return f"{self.table}.{self.name}" if self.table else self.name


def settings(site: Site) -> tuple[Setting, ...]:
    """Every setting, in the order in which ``site.toml`` may have them: what belongs to no table first."""
    tables = [(name, value) for name, value in site if isinstance(value, BaseModel)]
    return (*_of_table("", site), *(one for name, table in tables for one in _of_table(name, table)))


def _of_table(table: str, values: BaseModel) -> Iterator[Setting]:
    described = values.model_json_schema()["properties"]
    for name, value in values:
        if name in _NOT_SETTINGS or isinstance(value, BaseModel):
            continue
        source = Source.SITE if name in values.model_fields_set else Source.DEFAULT
        about = described[name]
        yield Setting(table, name, value, source, _bounds(about), about["unit"], about["description"])


def _bounds(described: dict[str, Any]) -> str:
    """What the JSON schema of a setting says of its bounds, in words; one that may be null may be left out."""
    kind = next((one for one in described.get("anyOf", ()) if one["type"] != "null"), described)
    match kind["type"]:
        case "boolean":
            return "true or false"
        case "string":
            signs = "printable ASCII" if "pattern" in kind else "characters"
            return f"{kind['minLength']} to {kind['maxLength']} {signs}"
        case _:
            above = kind.get("exclusiveMinimum")
            low = f"over {grouped(above)}" if above is not None else grouped(kind["minimum"])
            step = f" in steps of {grouped(described['step'])}" if described["step"] else ""
            return f"{low} to {grouped(kind['maximum'])}{step}"
