"""``cutgate register``: landmarks that were touched in both frames to a registration."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.text import Text

from cutgate.config.constants import CONSTANTS
from cutgate.config.durable import create_durably, replace_durably
from cutgate.config.load import InputError, read_settings
from cutgate.config.screen import printable
from cutgate.runtime.commands.screen import echo, messages, output
from cutgate.runtime.commands.tables import Fitting
from cutgate.runtime.commands.verdict_view import BAD, GOOD
from cutgate.runtime.plan.load import registration_from_bytes
from cutgate.runtime.plan.registrations.foreign import NAME_MAX
from cutgate.runtime.plan.registrations.from_landmarks import Registered, registered, registration_of
from cutgate.runtime.plan.registrations.landmarks_csv import read_landmarks

FLAT_MM: Final = 5.0
"""Landmarks that lie nearer to a plane hardly tell a mirror image from what is right."""


def register_command(
    landmarks: Annotated[
        Path,
        typer.Argument(
            metavar="LANDMARKS",
            help="CSV in mm: id,ct_x,ct_y,ct_z,robot_x,robot_y,robot_z and, if some are held out, use (fit or check).",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="The registration (.json) to write.")],
    *,
    name: Annotated[
        str | None, typer.Option("--id", help="Its id; the landmarks' file name if left out.")
    ] = None,
    ct_id: Annotated[str | None, typer.Option(help="The CT of the landmarks; as the plan's ct_id.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write in the place of a file that exists.")] = False,
) -> None:
    """Register the bone: fit CT to robot coordinates by landmarks touched with the probe, and write the registration.

    Landmarks of use check are held out of the fit and become its check points.
    Exit code: 0 written, 2 refused input.
    """
    _check_names(landmarks, out)
    _check_text("--id", landmarks.stem if name is None else name, "say --id with a name of such a length")
    _check_text("--ct-id", ct_id, "say the plan's ct_id, or leave the option out")
    found = registered(landmarks, read_landmarks(landmarks, read_settings(landmarks)))
    now = datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
    data = registration_of(found, landmarks.stem if name is None else name, ct_id, now)
    registration_from_bytes(out, data)  # what is written is read again by the same rules
    _write(out, data, force=force)
    _tell(found)
    echo(f"written: {printable(str(out))}, taken at {now}", err=True)


def _check_names(landmarks: Path, out: Path) -> None:
    for path, suffix, what in ((landmarks, ".csv", "landmarks"), (out, ".json", "a registration")):
        if path.suffix.lower() != suffix:
            raise InputError(
                path, "extension", path.suffix or "missing", f"{suffix} for {what}", "name another file"
            )


def _check_text(option: str, text: str | None, remedy: str) -> None:
    """Refuses by the option what the registration would refuse by a key of a file that is not there yet."""
    if text is not None and not (1 <= len(text) <= NAME_MAX):
        raise InputError(option, "", f"{len(text)} characters", f"1 to {NAME_MAX} characters", remedy)


def _write(out: Path, data: bytes, *, force: bool) -> None:
    try:
        if force:
            replace_durably(out, data)
        else:
            create_durably(out, data, ours=False)
    except FileExistsError:
        remedy = "name another file, or say --force to write in its place"
        raise InputError(out, "", None, "exists already", remedy) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(out, "", None, f"cannot be written: {reason}", "name another file") from None


def _tell(found: Registered) -> None:
    """The residual of each landmark, the fit's, and what it cannot show."""
    console, tolerance_mm = output(), CONSTANTS["check_point_tolerance_mm"].default
    rows: list[list[str | Text]] = []
    off: list[str] = []
    for one, residual in zip(found.landmarks, found.residuals_mm.tolist(), strict=True):
        far = one.held_out and not (residual <= tolerance_mm)
        off += [one.id] if far else []
        style = "" if not one.held_out else BAD if far else GOOD
        rows.append(
            [printable(one.id), "check" if one.held_out else "fit", Text(f"{residual:.3f}", style=style)]
        )
    console.print(Fitting(("landmark", "use", "residual mm"), rows, ("residual mm",)))
    fit, held_out = found.fit, sum(one.held_out for one in found.landmarks)
    console.print()
    console.print(
        f"{len(rows) - held_out} landmarks fitted, residual {fit.rms_mm:.3f} mm rms; {held_out} held out"
    )
    if off:
        names = printable(", ".join(off))
        console.print(
            Text(
                f"off by more than the {tolerance_mm:g} mm that a site allows if it says nothing: {names}",
                style=BAD,
            )
        )
    warnings = messages()
    if not held_out:
        warnings.print(
            "no landmark is held out: nothing but the fit itself says that it is right", soft_wrap=True
        )
    if fit.flatness_mm < FLAT_MM:
        text = (
            f"the fitted landmarks lie within {fit.flatness_mm:.3g} mm rms of a plane: whether an axis is reversed does not "
            "show by them; hold out a landmark off that plane"
        )
        warnings.print(text, soft_wrap=True)


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("register")(register_command)
