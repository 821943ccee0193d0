"""``cutgate audit prove`` and ``check-proof``: one record of a signed log, shown to who has no log."""

import json as json_format
from datetime import UTC, datetime
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from typer.core import TyperCommand

from cutgate.config.durable import create_durably
from cutgate.config.load import InputError, read_bytes
from cutgate.config.screen import printable
from cutgate.runtime.audit.proving import prove
from cutgate.runtime.audit.records import NANOSECONDS
from cutgate.runtime.audit.signing.log_key import PublicLogKey, fingerprint_of
from cutgate.runtime.audit.signing.proof import PROOF_MAX, ProofError, RecordProof, why_false
from cutgate.runtime.commands.audit_trust import PublicKeyOption, beside, trust_of
from cutgate.runtime.commands.screen import echo, messages, working

SCHEMA: Final = "cutgate.proof-check/1"
OWN_KEY: Final = "whose key it is: no key was pinned (--public-key), and whoever made the proof may have made the key as well"
NOT_CHECKED: Final = (
    "the rest of the log: that it is whole and sound, and what its other records say (cutgate audit verify)",
    "whether what the record says was decided rightly (cutgate audit replay), or happened",
    "whether the log is the session's only one, and its key was never copied",
)
"""What no proof shows."""


class ProofOutcome(IntEnum):
    """What came of a proof; its number is the exit code of ``cutgate audit check-proof``."""

    PROVEN = 0
    NOT_PROVEN = 2
    UNREADABLE = 3


class CheckProofCommand(TyperCommand):
    """A usage error of ``audit check-proof`` says UNREADABLE by its exit code: 2 would mean that it is not proven."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Parse the arguments; a mistake in them is said and ends the command."""
        try:
            return super().make_context(info_name, args, parent, **extra)
        except typer.TyperException as error:
            echo(printable(f"cutgate audit check-proof: {error.format_message()}"), err=True)
            raise typer.Exit(ProofOutcome.UNREADABLE) from None


def prove_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A session's log (.mcap) that is signed.")],
    *,
    record: Annotated[int, typer.Option("--record", min=0, metavar="N", help="The record's number, from 0.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="Must not exist yet.")],
    public_key: PublicKeyOption = None,
) -> None:
    """Write the proof that one record is in a signed log, for who has no log. Never overwrites.

    With --public-key it holds the certificates from that key to the log's; the logs of the sessions between must lie
    beside the log. Exit code: 0, or 2 for refused input.
    """
    trust = beside(trust_of(public_key, None), log)
    with working(f"reading {log}"):
        proof = prove(log, record, trust)
    try:
        data = proof.encode()
    except ProofError as error:
        raise InputError(log, f"record {record}", None, str(error)) from None
    _write(out, data)
    told = (
        f"{out}: proof of record {record} ({proof.record.topic}), {len(data)} bytes, by a checkpoint of "
        f"{proof.named.size} records; signed by the key {fingerprint_of(proof.public)}{_from(proof)}"
    )
    messages().print(printable(told), soft_wrap=True)


def check_proof(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Written by `audit prove`.")],
    *,
    public_key: PublicKeyOption = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """Check the proof that a record is in a signed log, and show the record. No log is needed.

    Exit code: 0 proven, 2 not proven, 3 unreadable, no such file, or a usage error.
    """
    try:
        pinned = trust_of(public_key, None).pinned
        proof = _read(file)
    except InputError as error:
        echo(str(error), err=True)
        if json:
            _document(file, ProofOutcome.UNREADABLE, reason=str(error))
        raise typer.Exit(ProofOutcome.UNREADABLE) from None
    reason = why_false(proof, pinned)
    outcome = ProofOutcome.NOT_PROVEN if reason else ProofOutcome.PROVEN
    if json:
        _document(file, outcome, reason=reason, **({} if reason else _found(proof, pinned)))
    elif reason:
        echo(printable(f"NOT PROVEN: {file}: {reason}"))
    else:
        _tell(file, proof, pinned)
    raise typer.Exit(outcome)


def add_to(app: typer.Typer) -> None:
    """Adds both commands to those of ``audit``."""
    app.command("prove")(prove_command)
    app.command("check-proof", cls=CheckProofCommand)(check_proof)


def _read(file: Path) -> RecordProof:
    try:
        return RecordProof.parse(read_bytes(file, PROOF_MAX, "it is no proof; name another file"))
    except ProofError as error:
        raise InputError(file, "", None, str(error), "make it anew with `cutgate audit prove`") from None


def _write(out: Path, data: bytes) -> None:
    try:
        create_durably(out, data, ours=False)
    except FileExistsError:
        raise InputError(out, "--out", None, "exists already", "name another file") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(out, "--out", None, f"cannot be written: {reason}", "name another file") from None


def _tell(file: Path, proof: RecordProof, pinned: PublicLogKey | None) -> None:
    record, named = proof.record, proof.named
    echo(printable(f"PROVEN: {file}: record {proof.index} is in the log {proof.log_id}"))
    echo(f"  {printable(record.topic)}, {_utc(record.log_time)}")
    echo(f"  {printable(_text(record.data))}")
    echo(f"  checkpoint of {named.size} records, root {named.hash.hex()}")
    echo(f"  signed by the key {fingerprint_of(proof.public)}{_from(proof)}")
    if pinned is not None:
        echo(f"  the pinned key {pinned.fingerprint} (epoch {pinned.epoch}) vouches for it")
    echo("not checked:")
    for line in _not_checked(pinned):
        echo(f"  {line}")


def _found(proof: RecordProof, pinned: PublicLogKey | None) -> dict[str, Any]:
    record, named = proof.record, proof.named
    return {
        "log_id": proof.log_id,
        "record": {
            "index": proof.index,
            "topic": record.topic,
            "schema": record.schema_name,
            "utc": _utc(record.log_time),
            "data": _text(record.data),
        },
        "checkpoint": {"size": named.size, "root": named.hash.hex()},
        "key": {
            "public_key": proof.public.hex(),
            "fingerprint": fingerprint_of(proof.public),
            "certified_from_epoch": proof.keys[0].epoch if proof.keys else None,
            "epoch": proof.keys[-1].epoch if proof.keys else None,
        },
        "pinned": None if pinned is None else {"fingerprint": pinned.fingerprint, "epoch": pinned.epoch},
        "not_checked": list(_not_checked(pinned)),
    }


def _document(file: Path, outcome: ProofOutcome, *, reason: str, **found: Any) -> None:
    told = {"schema": SCHEMA, "file": str(file), "outcome": outcome.name, "reason": reason, **found}
    echo(json_format.dumps(told, allow_nan=False, indent=2))


def _not_checked(pinned: PublicLogKey | None) -> tuple[str, ...]:
    return NOT_CHECKED if pinned is not None else (OWN_KEY, *NOT_CHECKED)


def _from(proof: RecordProof) -> str:
    """Of which epoch its key is, and from which one on each is certified; empty where it holds no certificates."""
    if not proof.keys:
        return ""
    first, last = proof.keys[0], proof.keys[-1]
    return f" of epoch {last.epoch}, certified from epoch {first.epoch} on"


def _text(data: bytes) -> str:
    return data.decode("utf-8", "backslashreplace")


def _utc(time_ns: int) -> str:
    second, rest = divmod(time_ns, NANOSECONDS)
    return f"{datetime.fromtimestamp(second, UTC):%Y-%m-%d %H:%M:%S}.{rest:09d} UTC"
