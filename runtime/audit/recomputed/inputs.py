"""What a session decided on, read from its log: typed records, and the attachments as the bytes they are."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path as FilePath
from typing import Final, NamedTuple

from pydantic import ValidationError

from cutgate.config.load import (
    BYTES_PER_MB,
    DEFAULT_LIMIT,
    InputError,
    Loaded,
    robot_from_bytes,
    site_from_bytes,
)
from cutgate.config.model import Robot, Site
from cutgate.config.records import calibration_record, limits_record, tool_record
from cutgate.protocol.records import Path, RecordError
from cutgate.runtime.audit import names, records
from cutgate.runtime.audit.container.stored import StoredAttachment
from cutgate.runtime.audit.inspect import Log
from cutgate.runtime.plan.load import plan_from_bytes, registration_from_bytes
from cutgate.runtime.plan.prepare import IDENTITY_REGISTRATION, prepare, widened, with_branch
from cutgate.runtime.plan.registration import Registration, checked
from cutgate.runtime.plan.toolpath.languages import language_of
from cutgate.runtime.plan.toolpath.model import PLAIN, Reading, of_words
from cutgate.runtime.verification.plausibility import Placed
from cutgate.runtime.verification.problem import Problem
from cutgate.runtime.verification.recorded import problem_from_records


class ReplayError(Exception):
    """The log does not hold what a replay needs."""


class ReplayInputs(NamedTuple):
    """The bytes that the session decided on."""

    path: bytes
    limits: bytes
    calibration: bytes
    tool: bytes
    robot: Robot
    widened: Robot
    """The same, with the path tolerances that it was verified with."""
    site: Site
    registration_digest: bytes
    placed: Placed | None
    size_max: int
    """Bytes of the largest attachment that is read: what the site allowed its input files."""
    closely: bool
    """Whether every segment is bounded closely, as the session's verifier did."""

    @property
    def problem(self) -> Problem:
        """What was to be verified.

        Raises:
            ReplayError: these pose no problem.
        """
        try:
            problem = problem_from_records(self.path, self.limits, self.calibration, self.tool, self.widened)
            return replace(problem, closely=self.closely)
        except (RecordError, ValueError) as error:
            raise no_problem(error) from None


def no_problem(error: Exception) -> ReplayError:
    """What is raised where the inputs cannot be verified at all."""
    return ReplayError(f"the attachments pose no problem that can be verified: {error}")


def inputs_of(log: Log) -> ReplayInputs:
    """The inputs of a log's session.

    Raises:
        ReplayError: one is missing, larger than its site allowed, or cannot be read.
    """
    size_max = DEFAULT_LIMIT

    def needed(name: str) -> bytes:
        data = attachment(log, name, size_max)
        if data is None:
            raise ReplayError(f"attachment {name} is missing: the verdict cannot be computed again")
        return data

    try:
        robot = robot_from_bytes(names.ROBOT, needed(names.ROBOT))
        settings = attachment(log, names.SITE, size_max)
        site = Site() if settings is None else site_from_bytes(names.SITE, settings, recorded=True)
    except InputError as error:
        raise ReplayError(f"attachment {error}") from None
    size_max = max(size_max, site.files.file_size_limit_mb * BYTES_PER_MB)
    file = _by_stem(log, names.REGISTRATION, size_max)
    registration = None if file is None else _registration(*file)
    plan = _by_stem(log, names.PLAN, size_max)
    return ReplayInputs(
        path=needed(names.PATH),
        limits=needed(names.LIMITS),
        calibration=needed(names.CALIBRATION),
        tool=needed(names.TOOL),
        robot=robot,
        widened=robot if plan is None else _widened(robot, *plan, _reading(log)),
        site=site,
        registration_digest=_digest(log, file, registration),
        placed=None if registration is None else _placed(registration, site),
        size_max=size_max,
        closely=_verifier(log) in BOUND_CLOSELY,
    )


def _reading(log: Log) -> Reading:
    """How the session read its tool path.

    Raises:
        ReplayError: record 0 says it in a way that is not known.
    """
    for opened in typed(log, records.AuditOpen)[:1]:
        for option in opened.simulation:
            if option.name == names.READING:
                try:
                    return of_words(option.value)
                except ValueError as error:
                    raise ReplayError(f"record 0: {error}") from None
    return PLAIN


def _widened(robot: Robot, path: FilePath, data: bytes, reading: Reading) -> Robot:
    """The robot that the path was verified for; a plan leaves it as it is, and so does what cannot be read (`derivation`)."""
    language = language_of(path)
    if language is None or not language.declared:
        return robot
    try:
        return widened(robot, plan_from_bytes(path, data, reading=reading).cut)
    except (InputError, ValueError) as error:
        raise ReplayError(f"attachment {path}: {error}") from None


def _registration(path: FilePath, data: bytes) -> Registration:
    try:
        return registration_from_bytes(path, data)
    except InputError as error:
        raise ReplayError(f"attachment {error}") from None


BOUND_CLOSELY: Final = ("cutgate 0.1.0",)
"""Verifiers that bounded every segment closely: their numbers are other ones, within the same promise."""

FILES_DIGEST: Final = ("cutgate 0.1.0",)
"""Verifiers whose sessions know a registration by its file's SHA-256."""


def _digest(log: Log, file: tuple[FilePath, bytes] | None, registration: Registration | None) -> bytes:
    """What the session knows its registration by."""
    if file is None or registration is None:
        return sha256(IDENTITY_REGISTRATION).digest()
    return sha256(file[1]).digest() if _verifier(log) in FILES_DIGEST else registration.digest


def _verifier(log: Log) -> str | None:
    """Who decided, as record 0 says."""
    return next((opened.verifier for opened in typed(log, records.AuditOpen)[:1]), None)


def _placed(registration: Registration, site: Site) -> Placed:
    return Placed(
        registration.matrix,
        registration.residual_rms_mm,
        site.registration_max_residual_mm,
        checked(registration, site),
    )


# ---------------------------------------------------------------- what must follow from what


def derivation(log: Log, inputs: ReplayInputs, opened: records.AuditOpen) -> Iterator[str]:
    """Whether the uploaded path is the one that plan, registration and robot give.

    Raises:
        ReplayError: there is no plan, or record 0 has no date.
    """
    plan, registration = (_by_stem(log, stem, inputs.size_max) for stem in (names.PLAN, names.REGISTRATION))
    if plan is None:
        raise ReplayError(f"attachment {names.PLAN} is missing: the path cannot be made again")
    try:
        uploaded = Path.parse(inputs.path)
        path, data = plan
        wanted = plan_from_bytes(path, data, reading=_reading(log))
        prepared = prepare(
            Loaded(wanted, data, path),
            None if registration is None else _loaded(*registration),
            inputs.robot,
            now=_after(opened.utc),
            clock_skew_s=inputs.site.clock_skew_s,
            feed_mm_s=uploaded.feed_mm_s if wanted.feed_mm_s is None else None,
        )
    except (InputError, RecordError) as error:
        yield f"plan, registration and robot give no path: {error}"
        return
    made = with_branch(prepared.path, uploaded.q0_turns, uploaded.roll_turns)
    if made.body() != inputs.path:
        yield "the uploaded path is not the one that plan, registration and robot give"


def _loaded(path: FilePath, data: bytes) -> Loaded[Registration]:
    return Loaded(registration_from_bytes(path, data), data, path)


def _after(utc: records.Time) -> datetime:
    """The whole second after a time."""
    try:
        return datetime.fromtimestamp(utc.sec + 1, UTC)
    except (ValueError, OverflowError, OSError):
        raise ReplayError(f"record 0 was written at {utc.sec} s since 1970, which is no date") from None


def approved(log: Log, inputs: ReplayInputs) -> Iterator[str]:
    """What the controller reported must equal what robot.toml approves."""
    wanted = {
        names.LIMITS: limits_record(inputs.robot).body(),
        names.CALIBRATION: calibration_record(inputs.robot).body(),
        names.TOOL: tool_record(inputs.robot).body(),
    }
    for name, body in wanted.items():
        if attachment(log, name, inputs.size_max) != body:
            yield f"attachment {name} is not what {names.ROBOT} approves"


# ---------------------------------------------------------------- reading


def typed(log: Log, model: type[records.Kind]) -> list[records.Kind]:
    """All records of one kind, in file order.

    Raises:
        ReplayError: one cannot be read.
    """
    return [model_of(model, data) for _, data in log.each(model.TOPIC)]


def model_of(model: type[records.Kind], data: bytes) -> records.Kind:
    """One record from its JSON.

    Raises:
        ReplayError: it cannot be read.
    """
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        what = error.errors()[0]
        place = ".".join(map(str, what["loc"]))
        raise ReplayError(f"a record of {model.TOPIC} cannot be read: {place}: {what['msg']}") from None


def attachment(log: Log, name: str, size_max: int) -> bytes | None:
    """The attachment's bytes, or None where there is none of this name.

    Raises:
        ReplayError: it is larger than ``size_max``.
    """
    entry = log.scan.attachment(name)
    return None if entry is None else _bytes_of(entry, size_max)


def _by_stem(log: Log, stem: str, size_max: int) -> tuple[FilePath, bytes] | None:
    """The attachment of this name whatever its ending, with its name."""
    for entry in log.scan.attachments:
        if FilePath(entry.name).stem == stem:
            return FilePath(entry.name), _bytes_of(entry, size_max)
    return None


def _bytes_of(entry: StoredAttachment, size_max: int) -> bytes:
    if not entry.size <= size_max:
        raise ReplayError(
            f"attachment {entry.name} has {entry.size} bytes, the site reads files of at most {size_max}"
        )
    return entry.data
