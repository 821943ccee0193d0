"""What a reviewer brings to a log: a public key and anchors, as options; and the certificates beside the log."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import typer

from cutgate.config.load import InputError, read_bytes
from cutgate.runtime.audit.folder import STUB_SUFFIX
from cutgate.runtime.audit.log_keys import key_in_log
from cutgate.runtime.audit.signing.checkpoint import HASH_BYTES
from cutgate.runtime.audit.signing.log_key import FILE_MAX, PublicLogKey
from cutgate.runtime.audit.signing.note import NoteError, VerifierKey
from cutgate.runtime.audit.stub import key_in_stub
from cutgate.runtime.audit.trust import Trust

LOGS_MAX: Final = 100_000
"""Logs of a folder that are looked into for certificates."""

PublicKeyOption = Annotated[
    Path | None,
    typer.Option(
        "--public-key", metavar="FILE", help="Believe this log key and those it certifies, none else."
    ),
]
AnchorOption = Annotated[
    list[str] | None,
    typer.Option(
        "--anchor", metavar="HEX", help="A root or head that the log must have, from elsewhere; repeatable."
    ),
]


CosignerOption = Annotated[
    list[str] | None,
    typer.Option(
        "--cosigner",
        metavar="KEY",
        help="NAME+ID+BASE64 of a witness that must have cosigned the log; repeatable.",
    ),
]


class Certificates(NamedTuple):
    """The keys that logs of one series name, by epoch; and where there are two of one epoch, in which logs."""

    keys: Mapping[int, PublicLogKey]
    doubled: Mapping[int, str]


def trust_of(public_key: Path | None, anchors: list[str] | None, cosigners: list[str] | None = None) -> Trust:
    """What the options say; certificates come with the log (``beside``).

    Raises:
        InputError: the file holds no public log key, an anchor is none, or a witness's key is none.
    """
    pinned = None if public_key is None else _pinned(public_key)
    return Trust(pinned, None, tuple(map(_anchor, anchors or ())), tuple(map(_cosigner, cosigners or ())))


def beside(trust: Trust, log: Path, known: dict[Path, Certificates] | None = None) -> Trust:
    """With the certificates in the logs beside this one, where a key is pinned.

    Args:
        trust: what the options say.
        log: the log, or a folder, which has its certificates in it.
        known: of each folder that was looked into for this trust; added to.
    """
    if trust.pinned is None or log.is_dir():
        return trust
    known = {} if known is None else known
    if log.parent not in known:
        known[log.parent] = certificates(log.parent, trust.pinned.series)
    found = known[log.parent]
    return replace(trust, certified=found.keys, doubled=found.doubled)


def certificates(folder: Path, series: bytes) -> Certificates:
    """The keys that the logs of a folder name, and what archived ones left. None is believed by that."""
    found: dict[int, tuple[PublicLogKey, str]] = {}
    doubled: dict[int, str] = {}
    for path in sorted((*folder.glob("*.mcap"), *folder.glob(f"*{STUB_SUFFIX}")))[:LOGS_MAX]:
        key = key_in_stub(path) if path.suffix == STUB_SUFFIX else key_in_log(path)
        if key is None or key.series != series:
            continue
        first, log = found.setdefault(key.epoch, (key, path.name))
        if first != key:  # a copy has the same one
            doubled.setdefault(key.epoch, f"{log} and {path.name}")
    return Certificates({epoch: key for epoch, (key, _) in found.items() if epoch not in doubled}, doubled)


def _pinned(path: Path) -> PublicLogKey:
    remedy = "name the .pub file of a log key"
    data = read_bytes(path, FILE_MAX, remedy)
    try:
        return PublicLogKey.parse(data)
    except ValueError as error:
        raise InputError(path, "", None, f"no public log key: {error}", remedy) from None


def _cosigner(text: str) -> VerifierKey:
    try:
        return VerifierKey.parse(text)
    except NoteError as error:
        raise InputError("--cosigner", "", text[:80], str(error), "copy the witness's key whole") from None


def _anchor(text: str) -> bytes:
    try:
        data = bytes.fromhex(text)
    except ValueError:
        data = b""
    if len(data) != HASH_BYTES:
        raise InputError("--anchor", "", text[:80], f"{2 * HASH_BYTES} hexadecimal digits", "copy it whole")
    return data
