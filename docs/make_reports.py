"""Takes the pictures of the report page into ``docs/pictures``: ``python -m docs.make_reports [FOLDER]``.

The sessions are real ones: those of ``cutgate demo``, and one more that the operator's emergency stop ends half-way
through the same cut. The pages are opened in the Chromium of this machine (``CUTGATE_CHROMIUM``, else ``chromium`` on
PATH), without a network; one that reports an error makes no picture. Times and names differ from run to run.
"""
# ruff: noqa: INP001, S603

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Final, Literal

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from cutgate.protocol.frames import Progress
from cutgate.runtime.commands.audit_report import write_report
from tests.browser.chromium import DESKTOP, NARROW, PAPER, launched, opened
from tests.system.harness import ROOT, Rig

FOLDER: Final = Path(__file__).parent / "pictures"
LARGEST: Final = 250_000
"""Bytes of a picture."""
COLOURS: Final = 192
"""Of a picture's palette: text and lines look the same, the file is a third."""
TIME_SCALE: Final = 30.0
STOPPED_AT: Final = 1200
"""Segment of the cut, of 1999, in which the emergency stop is pressed."""
Action = Callable[[Page], object]


@dataclass(frozen=True)
class Shot:
    """A picture: of which page, how wide, and what is done before it is taken.

    Attributes:
        page: name of a report.
        size: of the window, pixels.
        scheme: colours.
        before: what is done on the page.
        part: selector of what is taken; empty: what fits the window.
    """

    page: str
    size: tuple[int, int] = DESKTOP
    scheme: Literal["light", "dark"] = "light"
    before: Action = lambda _page: None
    part: str = ""


def _to(share: float, look: str = "") -> Action:
    """Move the slider to this share of the session, and the view to its path or the whole workspace."""

    def move(page: Page) -> None:
        page.evaluate(
            "share => { const moment = document.getElementById('moment');"
            " moment.value = share * Number(moment.max); moment.dispatchEvent(new Event('input')); }",
            share,
        )
        if look:
            page.click(f"#{look}")

    return move


def _on_paper(page: Page) -> None:
    """As a printer has it."""
    page.emulate_media(media="print")
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")


SHOTS: Final = {
    "report-admitted.png": Shot("admitted"),
    "report-admitted-session.png": Shot("admitted", before=_to(0.6, "near"), part="#play"),
    "report-dark.png": Shot("stopped", scheme="dark", before=_to(0.6, "whole"), part="#play"),
    "report-refused.png": Shot("refused"),
    "report-stopped.png": Shot("stopped"),
    "report-decision.png": Shot("stopped", part="#decisions .card.bad:last-of-type"),
    "report-two.png": Shot("two"),
    "report-narrow.png": Shot("stopped", NARROW),
    "report-print.png": Shot("stopped", PAPER, before=_on_paper),
}
"""By the picture's name."""


def _demo(folder: Path) -> list[Path]:
    """The demo's logs: the refused session and the one that cut to its end."""
    command = [sys.executable, "-m", "cutgate.runtime.cli", "demo", "--out", str(folder)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
    return sorted((folder / "logs").glob("*.mcap"))


def _stopped(folder: Path) -> Path:
    """The log of a cut that the operator's emergency stop has ended."""
    examples = ROOT / "examples"
    folder.mkdir()
    shutil.copy(examples / "registration-second.json", folder)
    with Rig(folder) as rig:
        sim, run = rig.cutting(
            scale=TIME_SCALE,
            plan=examples / "hip-stem.plan.json",
            registration="registration-second.json",
        )
        rig.bus.single(Progress, lambda progress: progress.segment >= STOPPED_AT)
        sim.say("estop")
        run.exit()
        return rig.logs()[-1]


def pages(folder: Path) -> dict[str, Path]:
    """Play the sessions and write their reports; files by the name of the report."""
    refused, admitted = _demo(folder / "demo")
    stopped = _stopped(folder / "stopped")
    made = {}
    for name, logs in {
        "admitted": [admitted],
        "refused": [refused],
        "stopped": [stopped],
        "two": [refused, admitted],
    }.items():
        made[name] = folder / f"{name}.html"
        write_report(logs, made[name])
    return made


def small(picture: bytes) -> bytes:
    """The picture with a palette, as PNG."""
    out = BytesIO()
    with Image.open(BytesIO(picture)) as opened_picture:
        opened_picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(
            out, "PNG", optimize=True
        )
    return out.getvalue()


def main(folder: Path = FOLDER) -> None:
    """Take every picture.

    Raises:
        ValueError: a picture is larger than the repository should carry.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as own, sync_playwright() as driver, launched(driver) as browser:
        made = pages(Path(own))
        for name, shot in SHOTS.items():
            with opened(browser, made[shot.page], shot.size, scheme=shot.scheme) as page:
                shot.before(page)
                taken = page.locator(shot.part).screenshot() if shot.part else page.screenshot()
            data = small(taken)
            if len(data) > LARGEST:
                raise ValueError(f"{name}: {len(data)} bytes, more than {LARGEST}")
            (folder / name).write_bytes(data)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
