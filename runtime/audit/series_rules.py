"""What can be found in a folder of logs: what each finding makes of the whole, and what is to be done then."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from cutgate.config.refusal import FileProblem
from cutgate.runtime.audit.inspect import Status

WORST: Final = (Status.TAMPERED, Status.UNREADABLE, Status.INCOMPLETE, Status.OK)
"""Of several judgements the first of these is that of all."""


def worst(statuses: Iterable[Status]) -> Status:
    """The judgement of all together; OK of none."""
    return min(statuses, key=WORST.index, default=Status.OK)


class Rule(NamedTuple):
    """What a finding makes of the folder at least, and what to do."""

    status: Status
    remedy: str


_BACKUP: Final = "put it back from a backup or an archive; if there is none, keep all that is here and find out who took it"
_KEEP: Final = "keep all that is here as it is and find out who changed it; compare it with a backup"

RULES: Final[dict[str, Rule]] = {
    "epoch-missing": Rule(Status.TAMPERED, _BACKUP),
    "log-missing": Rule(Status.TAMPERED, _BACKUP),
    "head-log-missing": Rule(Status.TAMPERED, _BACKUP),
    "begins-late": Rule(
        Status.INCOMPLETE, "put the earlier logs beside these, or what `audit archive` left of them"
    ),
    "begins-anew": Rule(Status.TAMPERED, _KEEP),
    "doubled": Rule(Status.TAMPERED, "keep the one that the next session names, and move the other out of the folder"),
    "copy": Rule(Status.TAMPERED, "move the copy out of the folder"),
    "foreign": Rule(Status.TAMPERED, "move it to the folder that it belongs to"),
    "not-a-log": Rule(Status.OK, "they are passed over; move them elsewhere if they are in the way"),
    "before-record-0": Rule(
        Status.INCOMPLETE, "nothing, if power failed or the program ended as a session began: it had enabled nothing; else compare it with a backup"
    ),
    "named-unreadable": Rule(Status.TAMPERED, _BACKUP),
    "link-differs": Rule(Status.TAMPERED, _KEEP),
    "link-unknown": Rule(Status.INCOMPLETE, "compare that log with a backup"),
    "renamed": Rule(Status.TAMPERED, "give it the name back that the sessions and HEAD know it by"),
    "cut-off": Rule(Status.TAMPERED, "put the log back from a backup: it was whole when the next session began"),
    "closed-called-crashed": Rule(
        Status.INCOMPLETE, "nothing, if power failed just as that session ended; else find out who closed it since"
    ),
    "previous-noted": Rule(Status.INCOMPLETE, "compare that log with a backup"),
    "clock-back": Rule(Status.TAMPERED, _KEEP),
    "certificate-missing": Rule(Status.TAMPERED, _KEEP),
    "certificate-wrong": Rule(Status.TAMPERED, _KEEP),
    "enrolled": Rule(Status.OK, "ask who enrolled the key, and pin it once that is certain"),
    "key-differs": Rule(Status.TAMPERED, "ask the site for its key again; if it is the right one, these logs are not the site's"),
    "key-not-certified": Rule(Status.TAMPERED, "pin the key of the new enrolment, once it is certain who enrolled it"),
    "key-not-reached": Rule(Status.INCOMPLETE, "put the logs in between beside these, or pin a key of one of these epochs"),
    "old-form": Rule(Status.INCOMPLETE, "nothing: logs of before the first enrolment carry no signature"),
    "old-form-late": Rule(Status.TAMPERED, _KEEP),
    "witness-missing": Rule(Status.TAMPERED, _BACKUP),
    "witness-unknown": Rule(
        Status.INCOMPLETE, "look for it in the folder that the controller's sessions were logged in before; else a session was taken away"
    ),
    "witness-differs": Rule(Status.TAMPERED, _KEEP),
    "head-missing": Rule(Status.INCOMPLETE, "put HEAD beside the logs: without it the last ones may lack unnoticed"),
    "head-unreadable": Rule(Status.TAMPERED, "restore HEAD from a backup"),
    "head-foreign": Rule(Status.TAMPERED, "restore the HEAD that belongs to these logs"),
    "head-old": Rule(Status.TAMPERED, "restore the HEAD of the last session; docs/audit.md says how a folder goes on after a restored backup"),
    "head-differs": Rule(Status.TAMPERED, _KEEP),
    "running": Rule(Status.OK, "ask again once it has ended"),
    "crashed-last": Rule(Status.INCOMPLETE, "nothing: the next session names what is left of it"),
    "recovered-copy": Rule(Status.OK, "nothing: its original counts"),
    "archived": Rule(
        Status.OK, "verify them there: whoever has a log and its signature can leave such a stub in its place"
    ),
    "archive-unfinished": Rule(Status.INCOMPLETE, "run `audit archive` once more, it goes on where it stopped; or remove the stub, if the log was put back"),
    "stub-wrong": Rule(Status.TAMPERED, "put the archived log itself back in its place"),
    "codes-wrong": Rule(Status.TAMPERED, "see what `audit verify LOG --key FILE` says of it"),
    "cosigner-not-checked": Rule(Status.INCOMPLETE, "verify them where they are, with --cosigner"),
    "codes-not-checked": Rule(Status.INCOMPLETE, "name the key of one of these sessions with --key"),
    "replay-differs": Rule(Status.TAMPERED, "see what `audit replay LOG` says of it"),
    "unreadable": Rule(Status.UNREADABLE, "make it readable and ask again"),
    "anchor-missing": Rule(Status.TAMPERED, "check where the anchor comes from; if it was of these sessions, find out who changed them"),
    "no-logs": Rule(Status.UNREADABLE, "name the folder that sessions write their logs to"),
}  # fmt: skip
"""Of each code. What is missing at the beginning makes a folder INCOMPLETE, what contradicts makes it TAMPERED, and
what is merely to be known leaves it OK."""


@dataclass(frozen=True, slots=True)
class SeriesFinding:
    """One thing to be known of a folder.

    Attributes:
        code: of ``RULES``.
        file: the file that it is at.
        what: the thing.
        value: what was found; empty where the bound says it all.
        bound: what it must be.
    """

    code: str
    file: str
    what: str
    value: str
    bound: str

    @property
    def status(self) -> Status:
        """What it makes of the folder at least."""
        return RULES[self.code].status

    @property
    def remedy(self) -> str:
        """What to do."""
        return RULES[self.code].remedy

    def __str__(self) -> str:
        """In one line: file, thing, value, bound, remedy."""
        return str(FileProblem(self.file, self.what, self.value, self.bound, self.remedy))
