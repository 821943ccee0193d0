"""Which kind of file it is that a person names, by its extension and schema, read as that kind and told in a few words."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from cutgate.config.load import (
    BYTES_PER_MB,
    SETTINGS_LIMIT,
    InputError,
    parse_json,
    parse_toml,
    read_bytes,
    robot_from_bytes,
    site_from_bytes,
)
from cutgate.config.model import FilesSettings
from cutgate.config.refusal import quoted
from cutgate.runtime.plan.load import new_registration, plans_from_bytes
from cutgate.runtime.plan.toolpath.languages import EXTENSIONS

_LARGER: Final = "raise file_size_limit_mb in a site.toml and name it with --site, or part the path"
_FOREIGN: Final = "it holds something else, or is of another version"


def described(path: Path, limits: FilesSettings) -> str:
    """What the file is, in a few words, once it is read as a session would read it.

    Args:
        path: robot, site, registration or plan, or a tool path.
        limits: largest size and longest path.

    Raises:
        InputError: neither of these, or one that is refused; names file, key or line, value and bound.
    """
    suffix = path.suffix.lower()
    if suffix not in (".toml", ".json", *EXTENSIONS):
        bound = f"one of .toml, .json, {', '.join(EXTENSIONS)}"
        raise InputError(path, "extension", suffix or "missing", bound, "name a file of cutgate's own kinds")
    if suffix == ".toml":
        data = read_bytes(path, SETTINGS_LIMIT, "it holds something else; name another file")
        return _SETTINGS[_schema(path, parse_toml(path, data), *_SETTINGS)](path, data)
    data = read_bytes(path, limits.file_size_limit_mb * BYTES_PER_MB, _LARGER)
    # What is larger than a registration may be can only be a plan, and is parsed once.
    if suffix == ".json" and len(data) <= SETTINGS_LIMIT:
        kind = _schema(path, parse_json(path, data), _REGISTRATION, _PLAN)
        if kind == _REGISTRATION:
            return f"registration {new_registration(path, data).id}"
    return _plan(path, data, limits.pose_limit)


def _schema(path: Path, document: Any, *known: str) -> str:
    """The document's schema, one of those known."""
    names = " or ".join(f'"{name}"' for name in known)
    if not isinstance(document, dict):
        raise InputError(
            path, "", type(document).__name__, "an object with keys", f"start with schema {names}"
        )
    found = document.get("schema", "")
    if found not in known:
        value = quoted(found) if "schema" in document else "missing"
        raise InputError(path, "schema", value, names, _FOREIGN)
    return str(found)


def _robot(path: Path, data: bytes) -> str:
    robot = robot_from_bytes(path, data)
    return f"robot {robot.name}, {robot.elbow} elbow"


def _site(path: Path, data: bytes) -> str:
    site = site_from_bytes(path, data)
    return f"site, heartbeat {site.timing.heartbeat_ms} ms"


def _plan(path: Path, data: bytes, pose_limit: int) -> str:
    plans = plans_from_bytes(path, data, pose_limit)
    poses = sum(len(plan.tips_mm) for plan in plans)
    kind = "plan" if path.suffix.lower() == ".json" else "tool path"
    tools = f", {len(plans)} tools" if len(plans) > 1 else ""
    return f"{kind} {plans[0].id}, {poses} poses{tools}"


_SETTINGS: Final[dict[str, Callable[[Path, bytes], str]]] = {
    "cutgate.robot/1": _robot,
    "cutgate.site/1": _site,
}
_PLAN: Final = "cutgate.plan/1"
_REGISTRATION: Final = "cutgate.registration/1"
