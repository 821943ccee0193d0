"""The keys of one session in a file: what a reviewer needs to check its codes, and nothing that moves an arm.

One JSON document with the SHA-256 of the rest of it: a damaged key would accuse a sound log. From these keys neither the
pre-shared key follows nor those of another session, and the controller accepts each session's once.
"""

import json
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from cutgate.config.durable import create_durably
from cutgate.config.key import key_of, missing_key
from cutgate.config.load import InputError, parse_json, validate
from cutgate.config.ours import read_ours
from cutgate.protocol.codes import CodeKeys

SCHEMA: Final = "cutgate.session-keys/1"
BYTES_MAX: Final = 4096
"""Ours take under 1000."""
WHAT: Final = (
    "keys of one session that has ended, to check the codes in its log (cutgate audit verify LOG --key FILE); "
    "they open no session and move no arm"
)
_REMEDY: Final = "make it anew, where the pre-shared key is, with: cutgate key session LOG --key FILE -o FILE"

_Digest = Annotated[str, StringConstraints(pattern=r"\A[0-9a-f]{64}\z")]
_Half = Annotated[str, StringConstraints(pattern=r"\A[0-9a-f]{32}\z")]


@dataclass(frozen=True)
class SessionKeys:
    """What a reviewer holds of one session.

    Attributes:
        log_id: of the session's log, hex.
        open_code: of the OPEN that opened it, 16 bytes, which is no session's key to make.
        codes: its keys.
    """

    log_id: str
    open_code: bytes
    codes: CodeKeys


class _File(BaseModel):
    """The file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    kind: Literal["cutgate.session-keys/1"] = Field(SCHEMA, alias="schema")
    what: str
    log_id: _Half
    session: _Digest
    open_code: _Half
    keys: dict[str, str]
    """In hex; a refusal of one must not show it."""
    sha256: str = ""

    @classmethod
    def of(cls, keys: SessionKeys) -> Self:
        """As it is written."""
        made = cls(
            what=WHAT,
            log_id=keys.log_id,
            session=keys.codes.digest.hex(),
            open_code=keys.open_code.hex(),
            keys={name: key.hex() for name, key in keys.codes.keys.items()},
        )
        return made.model_copy(update={"sha256": made.digest})

    @property
    def document(self) -> dict[str, Any]:
        """As JSON."""
        return self.model_dump(by_alias=True)

    @property
    def digest(self) -> str:
        """SHA-256 of the rest, hex."""
        rest = {name: value for name, value in self.document.items() if name != "sha256"}
        return sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def new_session_key_file(path: Path, keys: SessionKeys) -> None:
    """Write the file, mode 0600 whatever the umask, and make it durable. Never overwrites.

    Raises:
        InputError: the file exists or cannot be written; then none is left there.
    """
    text = json.dumps(_File.of(keys).document, indent=1)
    try:
        create_durably(path, text.encode("ascii") + b"\n")
    except FileExistsError:
        remedy = "name another file or remove it"
        raise InputError(path, "", None, "exists and is never overwritten", remedy) from None
    except OSError as error:
        remedy = "name a file in a folder that exists and has room"
        raise InputError(path, "", None, f"cannot be written ({error.strerror})", remedy) from None


def load_review_key(path: Path) -> bytes | SessionKeys:
    """What a log's codes are to be checked with: the pre-shared key, 32 bytes, or one session's keys, by its content.

    Raises:
        InputError: missing, a link, another's, open to others, or neither of the two.
    """
    try:
        data = read_ours(path, BYTES_MAX, secret=True)
    except FileNotFoundError:
        raise missing_key(path) from None
    return _session_keys(path, data) if data.lstrip().startswith(b"{") else key_of(path, data)


def _session_keys(path: Path, data: bytes) -> SessionKeys:
    file = validate(path, _File, parse_json(path, data), SCHEMA)
    if file.sha256 != file.digest:
        raise InputError(path, "sha256", file.sha256, f"{file.digest}, of the rest of the file", _REMEDY)
    try:
        codes = CodeKeys(
            bytes.fromhex(file.session), {name: bytes.fromhex(key) for name, key in file.keys.items()}
        )
    except ValueError as error:
        raise InputError(path, "keys", None, str(error), _REMEDY) from None
    return SessionKeys(file.log_id, bytes.fromhex(file.open_code), codes)
