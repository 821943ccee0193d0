"""Reading input files: once, bounded, and refused with file, key, value, bound and remedy.

Everything that reads a file a person wrote raises ``InputError`` and nothing else; the command line turns it
into exit code 2. A file is read once: parsing, digest and the log's attachment all use those same bytes.
"""

import hashlib
import json
import math
import os
import re
import stat
import tomllib
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, BinaryIO, Final, Generic, TypeVar, cast, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from cutgate.config.constants import CONSTANTS
from cutgate.config.model import RECORDED, REMOVED, RULE, Robot, Site
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.config.refusal import FileProblem, quoted, shown
from cutgate.config.refusal import InputError as InputError  # noqa: PLC0414 - for whoever reads files
from cutgate.protocol.records import Calibration, Limits, Tool

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)

BYTES_PER_MB: Final = 1_000_000
DEFAULT_LIMIT: Final = int(CONSTANTS["file_size_limit_mb"].default) * BYTES_PER_MB
"""Of plans and tool paths, bytes."""
SETTINGS_LIMIT: Final = 100_000
"""Of robot, site and registration files, bytes: far more than any holds, and little to parse whatever it says."""
KEYS_MAX: Final = 100
"""Of one document's uppermost level: each unknown one becomes a line of the refusal."""
DOTS_MAX: Final = 100
"""In one line of TOML: a key of n dotted parts takes memory and time that grow with n * n, and no key is longer
than its line."""
_WORDS: Final = re.compile(r'"(?:[^"\\]|\\.)*+"|[-+.\w]++')
"""Strings, and whatever stands in JSON without quotation marks."""
DIGITS_MAX: Final = 309
"""Of an integer: the largest double has so many."""
_TOML_NAMES: Final = frozenset({"inf", "nan"})
"""What TOML calls these; whoever writes one is told with the key."""
_MANY_DIGITS: Final = re.compile(rf"[0-9_]{{{DIGITS_MAX + 1},}}")
NEWLINE: Final = "\n"
_ERROR_CHARACTERS: Final = 200
_DOUBLE: Final = "write a number a double can hold"
_FOREIGN: Final = "it holds something else; name another file"


@dataclass(frozen=True, slots=True)
class Loaded(Generic[T]):
    """A file's content and the very bytes it was parsed from."""

    value: T
    data: bytes
    path: Path

    @property
    def sha256(self) -> bytes:
        """SHA-256 of the file's bytes, 32 bytes."""
        return hashlib.sha256(self.data).digest()


@dataclass(frozen=True, slots=True)
class Shipped:
    """Files of one kind that come with the program, each known by a name of its own.

    Attributes:
        folder: where they lie.
        begin: what their names begin with.
        ending: what follows the name in the folder.
        kind: one of them, for messages.
    """

    folder: Path
    begin: str
    ending: str
    kind: str

    @property
    def names(self) -> dict[str, Path]:
        """The file of every name, in the names' order."""
        files = sorted(self.folder.glob(f"{self.begin}*{self.ending}"))
        return {file.name.removesuffix(self.ending): file for file in files}

    def file(self, path: str | os.PathLike[str]) -> Path:
        """The file that a person names: one that exists, or else the shipped one of that name.

        A file that exists is never hidden by a shipped one; a folder hides none.

        Raises:
            InputError: neither; lists the names.
        """
        names, exists = self.names, os.path.lexists(path)
        folder = os.path.isdir(path)  # noqa: PTH112 - Path's raises where it may not look
        if str(path) in names and (folder or not exists):
            return names[str(path)]
        if exists:
            return Path(path)
        remedy = f"check the name, or name {self.kind}: {', '.join(names)}"
        raise InputError(path, "", None, "no such file", remedy)


SHIPPED: Final = Path(str(resources.files("cutgate")))
"""The program's own files, installed or in a checkout."""
EXAMPLES: Final = SHIPPED / "examples"
PRESETS: Final = Shipped(SHIPPED / "config" / "presets", "", ".toml", "a preset")


def read_bytes(
    path: str | os.PathLike[str],
    limit: int = DEFAULT_LIMIT,
    remedy: str = "raise file_size_limit_mb in a site.toml (--site of run and verify), or part the path",
) -> bytes:
    """The whole file as it was when opened, read once; one that is too large is not read at all.

    Args:
        path: a regular file.
        limit: largest accepted size, bytes.
        remedy: what to do about a larger one.

    Raises:
        InputError: missing, not a regular file, unreadable, or larger than ``limit``.
    """
    with open_input(path) as file:
        size = os.fstat(file.fileno()).st_size
        check_size(path, size, limit, remedy)
        try:
            # read() takes all the memory that it is asked for: never more than the file has, however large the limit.
            return file.read(size)
        except OSError as error:
            raise unreadable(path, error) from None


def open_input(path: str | os.PathLike[str]) -> BinaryIO:
    """A regular file, opened to be read.

    Raises:
        InputError: missing, not a regular file, or unreadable.
    """
    try:
        file = open(path, "rb", opener=_without_waiting)  # noqa: SIM115 - the caller closes it
    except FileNotFoundError:
        raise InputError(path, "", None, "no such file", "check the name") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise unreadable(path, error) from None
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise InputError(path, "", None, "not a regular file", "name a file")
    return file


def unreadable(path: object, error: Exception) -> InputError:
    """The refusal of a file that the system does not let be read."""
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return InputError(path, "", None, f"cannot be read ({reason})", "check name and permissions")


def check_size(path: object, size: int, limit: int = SETTINGS_LIMIT, remedy: str = _FOREIGN) -> None:
    """Refuses a file, or what is to be parsed as one, that is larger than its kind may be.

    Raises:
        InputError: more than ``limit`` bytes.
    """
    if not (size <= limit):
        raise InputError(path, "size", f"{size} bytes", f"<= {limit} bytes", remedy)


def _without_waiting(path: str, flags: int) -> int:
    """Opens without blocking, so that a named pipe without a writer is refused instead of waited for."""
    return os.open(path, flags | os.O_NONBLOCK)


def decode(path: object, data: bytes) -> str:
    """The file's text, without the byte-order mark that editors of Windows begin it with.

    Raises:
        InputError: not UTF-8; names line and byte.
    """
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        raise InputError(
            path, "line 1", "a byte-order mark of UTF-16", "UTF-8 text", "save the file as UTF-8"
        )
    try:
        return data.removeprefix(BOM_UTF8).decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            path, f"line {line}", f"byte 0x{data[error.start]:02x}", "UTF-8 text", "save the file as UTF-8"
        ) from None


def parse_toml(path: object, data: bytes) -> dict[str, Any]:
    """The TOML document.

    Raises:
        InputError: too large, not UTF-8 or not TOML; names line and column.
    """
    check_size(path, len(data))
    text = decode(path, data)
    for number, line in enumerate(text.split("\n"), start=1):
        if not (line.count(".") <= DOTS_MAX):
            found, bound = f"a line of {line.count('.')} dots", f"<= {DOTS_MAX} dots"
            raise InputError(
                path, f"line {number}", found, bound, "no key has so many parts; shorten the line"
            )

    def fraction(token: str) -> float:
        value = float(token)
        if not math.isfinite(value) and token.lstrip("+-") not in _TOML_NAMES:
            raise _no_number(path, text, text.find(token), token, _DOUBLE)
        return value

    try:
        return tomllib.loads(text, parse_float=fraction)
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            path, "", None, f"not valid TOML: {_shortened(str(error))}", "correct the file"
        ) from None
    except (RecursionError, ValueError) as error:
        # Nesting without end, or more digits than Python makes a number of.
        if many := _MANY_DIGITS.search(text):
            raise _no_number(path, text, many.start(), many.group(), _DOUBLE) from None
        raise InputError(
            path, "", None, f"not usable TOML: {shown(str(error))}", "correct the file"
        ) from None


def _no_number(path: object, text: str, start: int, token: str, remedy: str) -> InputError:
    place = f"line {text.count(NEWLINE, 0, start) + 1} column {start - text.rfind(NEWLINE, 0, start)}"
    return InputError(path, place, shown(token), "a finite number", remedy)


def _shortened(text: str) -> str:
    """An error's text without its middle, where it quotes a key of thousands of characters; it ends with the place."""
    half = _ERROR_CHARACTERS // 2
    return text if len(text) <= _ERROR_CHARACTERS else f"{text[:half]} ... {text[-half:]}"


@dataclass(frozen=True, slots=True)
class _Numbers:
    """What stands for a number in a JSON text, as a number that a double can hold, or refused with its place."""

    path: object
    text: str

    def constant(self, token: str) -> float:
        raise self._refused(token, "JSON has no NaN and no Infinity")

    def fraction(self, token: str) -> float:
        value = float(token)
        if not math.isfinite(value):
            raise self._refused(token, _DOUBLE)
        return value

    def integer(self, token: str) -> int:
        if not (len(token.lstrip("-")) <= DIGITS_MAX and math.isfinite(float(token))):
            raise self._refused(token, _DOUBLE)
        return int(token)

    def _refused(self, token: str, remedy: str) -> InputError:
        """The first of this spelling outside of strings; where it runs into what follows, the first at all."""
        alone = (one.start() for one in _WORDS.finditer(self.text) if one.group() == token)
        start = next(alone, self.text.find(token))
        return _no_number(self.path, self.text, start, token, remedy)


def parse_json(path: object, data: bytes) -> Any:
    """The JSON document; NaN, Infinity, numbers beyond a double and duplicate keys are refused.

    Raises:
        InputError: names line and column, or the key.
    """

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        document = dict(pairs)
        if len(document) < len(pairs):
            key = next(key for key, times in Counter(key for key, _ in pairs).items() if times > 1)
            raise InputError(path, shown(key), "given twice", "given once", "remove one of the two")
        return document

    if data.startswith(BOM_UTF8):  # RFC 8259, 8.1: JSON has none
        remedy = "save the file as UTF-8 without it"
        raise InputError(path, "line 1", "a byte-order mark", "the beginning of the document", remedy)
    numbers = _Numbers(path, decode(path, data))
    try:
        return json.loads(
            numbers.text,
            parse_constant=numbers.constant,
            parse_float=numbers.fraction,
            parse_int=numbers.integer,
            object_pairs_hook=unique,
        )
    except json.JSONDecodeError as error:
        place = f"line {error.lineno} column {error.colno}"
        raise InputError(path, place, None, f"not valid JSON: {error.msg}", "correct the file") from None
    except RecursionError as error:
        raise InputError(
            path, "", None, f"not usable JSON: {shown(str(error))}", "correct the file"
        ) from None


def validate(path: object, model: type[M], document: object, schema: str, *, context: str | None = None) -> M:
    """The document as ``model``, which has a ``schema`` key; ``context`` is for its validators.

    Raises:
        InputError: lists every problem; a wrong or missing schema alone, because nothing else means much then.
    """
    if not isinstance(document, dict):
        raise InputError(path, "", shown(document), "an object with keys", f'start with schema "{schema}"')
    if not (len(document) <= KEYS_MAX):
        raise InputError(path, "keys", f"{len(document)} keys", f"<= {KEYS_MAX} keys", _FOREIGN)
    if document.get("schema") != schema:
        found = quoted(document["schema"]) if "schema" in document else "missing"
        raise InputError(path, "schema", found, f'"{schema}"', "this file is of another kind or version")
    try:
        return model.model_validate(document, context=context)
    except ValidationError as error:
        details = error.errors(include_url=False)
        raise InputError.of([_problem(str(path), item, model) for item in details]) from None


def read_settings(path: str | os.PathLike[str]) -> bytes:
    """The whole of a robot, site or registration file.

    Raises:
        InputError: see ``read_bytes``.
    """
    return read_bytes(path, SETTINGS_LIMIT, _FOREIGN)


def load_robot(path: str | os.PathLike[str]) -> Loaded[Robot]:
    """The robot's description: a file (``robot.toml``), or else the preset of that name.

    Raises:
        InputError: no such file or preset; lists every problem of the file.
    """
    file = PRESETS.file(path)
    data = read_settings(file)
    return Loaded(robot_from_bytes(path, data), data, file)


def robot_from_bytes(path: object, data: bytes) -> Robot:
    """The robot in ``data``; ``path`` serves for messages.

    Raises:
        InputError: lists every problem, those of the quantised records included.
    """
    robot = validate(path, Robot, parse_toml(path, data), "cutgate.robot/1")
    builders: dict[str, Callable[[Robot], Limits | Calibration | Tool]] = {
        "limits": limits_record,
        "calibration": calibration_record,
        "tool": tool_record,
    }
    for key, build in builders.items():
        faults = build(robot).problems()
        if faults:
            bound = "what a controller can report, in steps of 1e-6"
            raise InputError.of([FileProblem(str(path), key, fault, bound, "") for fault in faults])
    return robot


def load_site(path: str | os.PathLike[str]) -> Loaded[Site]:
    """The site's settings (``site.toml``).

    Raises:
        InputError: lists every problem of the file.
    """
    data = read_settings(path)
    return Loaded(site_from_bytes(path, data), data, Path(path))


def site_from_bytes(path: object, data: bytes, *, recorded: bool = False) -> Site:
    """The site in ``data``; ``path`` serves for messages.

    Args:
        path: see above.
        data: the file's content.
        recorded: it stands in a log: what the version that wrote it allowed is read.

    Raises:
        InputError: lists every problem.
    """
    document = parse_toml(path, data)
    removed = _take_removed(document)
    if removed and not recorded:
        raise InputError.of([_removed(str(path), key, value) for key, value in removed])
    return validate(path, Site, document, "cutgate.site/1", context=RECORDED if recorded else None)


def _take_removed(document: dict[str, Any]) -> list[tuple[str, Any]]:
    """Take the settings that this version has no more out of the document; their keys and values."""
    taken = []
    for key in REMOVED:
        table, name = key.split(".")
        if isinstance(document.get(table), dict) and name in document[table]:
            taken.append((key, document[table].pop(name)))
    if document.get("link") == {}:  # whose lines were deleted, as they were told
        del document["link"]
    return taken


def _removed(file: str, key: str, value: object) -> FileProblem:
    bound = f"left out: {REMOVED[key]} has no such setting, and it never had an effect"
    return FileProblem(file, key, shown(value), bound, "delete this line")


_COMPARISONS: Final = {"greater_than_equal": (">=", "ge"), "greater_than": (">", "gt"),
                       "less_than_equal": ("<=", "le"), "less_than": ("<", "lt")}  # fmt: skip


def _problem(file: str, item: ErrorDetails, model: type[BaseModel]) -> FileProblem:
    """One pydantic error in this program's words."""
    context = item.get("ctx", {})
    kind = item["type"]
    key = ".".join(shown(str(part)) for part in item["loc"])
    value = quoted(item["input"])
    if kind in _COMPARISONS:
        sign, limit = _COMPARISONS[kind]
        return FileProblem(file, key, value, f"{sign} {context[limit]}", f"correct {key}")
    if kind == "missing":
        return FileProblem(file, key, "missing", "given", f"add {key}")
    if kind == "extra_forbidden":
        known = ", ".join(_known_keys(model, item["loc"][:-1]))
        return FileProblem(file, key, value, f"one of the known keys here ({known})", "remove or correct it")
    if kind == RULE:
        found = context["found"]
        return FileProblem(
            file, context["key"] or key, shown(found) or value, context["bound"], context["remedy"]
        )
    remedy = _remedy_of_type(kind, item["input"]) or f"correct {key}"
    return FileProblem(file, key, value, _readable(item["msg"]), remedy)


def _remedy_of_type(kind: str, value: object) -> str:
    """What to do about a value of another type than is asked for; empty where that is not known."""
    match kind, value:
        case "float_type" | "int_type", str():
            return "write the number without quotes"
        case "bool_type", str():
            return "write true or false, without quotes"
        case "bool_type", _:
            return "write true or false"
        case "int_type", float():
            return "write a whole number, without a decimal point"
        case "string_type", bool() | int() | float():
            return "write it in quotes"
    return ""


def _readable(message: str) -> str:
    """Pydantic's message as the end of "must be ..."."""
    if message.startswith("Input should be a valid dictionary"):
        return "a table of keys"
    message = message.replace("valid tuple", "list").replace("Tuple", "List").replace(" after validation", "")
    subject, should, rest = message.partition(" should ")
    if not should:
        return message
    rest = rest.removeprefix("be ")
    return (
        rest
        if subject == "Input"
        else f"a {subject.lower()} that should {rest}".replace("should have", "has")
    )


def _known_keys(model: type[BaseModel], place: tuple[int | str, ...]) -> list[str]:
    """The keys the model accepts at ``place``."""
    current = model
    for part in place:
        inner = get_args(current)[0] if isinstance(part, int) else current.model_fields[part].annotation
        current = cast("type[BaseModel]", inner)
    return [field.alias or name for name, field in current.model_fields.items()]
