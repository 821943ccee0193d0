"""What left that enables, held against what had been proved, authorised and acknowledged before it.

    ledger = Ledger(configuration)
    for record in the log, in its order:
        differences += ledger.verdict(...), ledger.approach(...), ledger.decision(...), ...

Rules. A permit, start or reset leaves only after the record that authorised it, of the same kind and the same token.
A permit or start leaves only on a verdict and an approach that are admissible as recorded and as recomputed. A permit
binds the digests of its verdict and of the attached files, and the approach that was verified, and no warning is left
unconfirmed. A start leaves only under the permit that left last, and once one is acknowledged. No decision lets go, and
none lets a moving arm go on, while one of its permissives does not hold.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any, Final

from cutgate.protocol import records as wire
from cutgate.runtime.audit import names, records
from cutgate.runtime.audit.recomputed.approach import bound_differences
from cutgate.runtime.audit.signed import canonical, signed
from cutgate.runtime.interlock.phases import MOVING, STOPPING

TRACKED: Final = ("joints measured", "progress reported", "heartbeat", "time passed")
"""On these the tracking monitor holds the moving arm against the verified path; the decision names what it showed."""
DIGESTS: Final = ("path", "limits", "calibration", "tool", "registration")
"""What a permit binds of its verdict."""


@dataclass
class Ledger:
    """What has been proved, authorised and acknowledged up to a record.

    Args:
        configuration: the digest of the files and options that are attached.
    """

    configuration: bytes
    _verdict: tuple[records.AuditVerdict, str] | None = None
    """The latest recorded verdict, and what was recomputed for it."""
    _approach: tuple[records.AuditApproach, str] | None = None
    """The same for the approach recorded after it."""
    _authorised: set[tuple[str, int | None]] = field(default_factory=set)
    _permit: bytes | None = None
    """Digest of the permit that left last, which a start names."""
    _permitted: bool = False
    _to_confirm: set[str] = field(default_factory=set)
    """Warnings of the latest verdict, as recomputed, that keep from a permit."""
    _confirmed: set[str] = field(default_factory=set)
    """What the operator has confirmed since."""

    @property
    def enabling(self) -> bool:
        """Whether a permit or start was ever authorised."""
        return any(kind != "reset" for kind, _ in self._authorised)

    def verdict(self, recorded: records.AuditVerdict, recomputed: dict[str, Any]) -> None:
        """A verdict, and its document as it must be: the approach before it and what was confirmed are void."""
        self._verdict = (recorded, recomputed["verdict"])
        self._approach, self._confirmed = None, set()
        self._to_confirm = {one["code"] for one in recomputed.get("warnings", ()) if one["confirm"]}

    def approach(self, recorded: records.AuditApproach, recomputed: str) -> None:
        """An approach, and its verdict as it must be."""
        self._approach = (recorded, recomputed)

    def operator(self, command: records.AuditOperator) -> None:
        """A command of the operator."""
        if command.word == "confirm" and command.accepted and command.what is not None:
            self._confirmed.add(command.what)

    def permit(self, record: records.AuditPermit) -> Iterator[str]:
        """One record of a permit, start or reset; what is wrong with it."""
        if record.stage == "authorised":
            self._authorised.add((record.kind, record.token))
        elif record.stage == "acknowledged":
            self._permitted |= record.kind == "permit"
        elif record.stage == "sent":
            yield from self._sent(record)

    def _sent(self, record: records.AuditPermit) -> Iterator[str]:
        if (record.kind, record.token) not in self._authorised:
            yield f"a {record.kind} left without a record that authorised it"
        if record.kind != "reset":
            yield from self._on_verdict(record)
            yield from self._on_approach(record)
        try:
            if record.kind == "permit":
                yield from self._sent_permit(record, signed(wire.Permit, record))
            elif record.kind == "start":
                yield from self._sent_start(record, signed(wire.Start, record))
        except ValueError as error:
            yield f"the {record.kind}'s record cannot be read: {error}"

    def _on_verdict(self, record: records.AuditPermit) -> Iterator[str]:
        if self._verdict is None:
            yield f"a {record.kind} left without a verdict"
            return
        verdict, recomputed = self._verdict
        if not (verdict.verdict == "admissible" and recomputed == "admissible"):
            yield (
                f"a {record.kind} left; the verdict is recorded as {verdict.verdict} and recomputed as {recomputed}"
            )
        if record.kind == "permit":
            for name in DIGESTS:
                if getattr(record, f"{name}_sha256") != getattr(verdict, f"{name}_sha256"):
                    yield f"the permit's {name} digest is not the verdict's"

    def _on_approach(self, record: records.AuditPermit) -> Iterator[str]:
        if self._approach is None:
            yield f"a {record.kind} left without a verified approach"
            return
        approach, recomputed = self._approach
        if not (approach.verdict == "admissible" and recomputed == "admissible"):
            yield (
                f"a {record.kind} left; the approach is recorded as {approach.verdict} and recomputed as {recomputed}"
            )

    def _sent_permit(self, record: records.AuditPermit, signed: wire.Permit) -> Iterator[str]:
        self._permit = sha256(canonical(record)).digest()
        for code in sorted(self._to_confirm - self._confirmed):
            yield f"a permit left although the warning {code} was not confirmed"
        if self._verdict is not None and signed.verifier_version != self._verdict[0].verifier:
            yield (
                f"the permit names the verifier {signed.verifier_version}, its verdict {self._verdict[0].verifier}"
            )
        for name in (*DIGESTS, "configuration"):
            if getattr(record, f"{name}_sha256") != getattr(signed, f"{name}_digest").hex():
                yield f"the permit's {name} digest is not the one that was signed"
        if signed.configuration_digest != self.configuration:
            yield (
                f"the permit's configuration is not that of {names.ROBOT}, {names.SITE} and the options as they are "
                "attached"
            )
        if self._approach is not None:
            yield from bound_differences(signed, self._approach[0])
        yield from _log_differences(record, signed)

    def _sent_start(self, record: records.AuditPermit, signed: wire.Start) -> Iterator[str]:
        yield from _log_differences(record, signed)
        if not self._permitted:
            yield "a start left without an acknowledged permit"
        if signed.permit_digest != self._permit:
            yield "a start left for another permit than the one that had left"


def decision_differences(decision: records.AuditDecision) -> Iterator[str]:
    """What a decision let go, or let go on, although a permissive of its own did not hold."""
    failing = [permissive.name for permissive in decision.permissives if not permissive.holds]
    if decision.disposition == "sent":
        for name in failing:
            yield f"decision {decision.sequence} sent although this did not hold: {name}"
    if decision.from_state in MOVING and decision.event in TRACKED and decision.to_state not in STOPPING:
        for name in failing:
            yield f"decision {decision.sequence} let the arm go on although this did not hold: {name}"


def _log_differences(record: records.AuditPermit, signed: wire.Permit | wire.Start) -> Iterator[str]:
    """The tree that a record says it names must be the one that was signed."""
    named = (record.log_size or 0, record.log_root or bytes(32).hex())
    if named != (signed.log.size, signed.log.root.hex()):
        yield f"the {record.kind}'s log is not the one that was signed"
