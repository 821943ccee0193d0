"""A headless Chromium of this machine that opens one page from its file and lets nothing pass: no request, no error.

``CUTGATE_CHROMIUM`` names the program, else it is ``chromium`` on PATH. Playwright brings no browser of its own here.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Literal
from urllib.parse import urlsplit

from playwright.sync_api import Browser, ConsoleMessage, Page, Playwright, Request

PROGRAM: Final = "CUTGATE_CHROMIUM"
ABSENT: Final = f"no chromium on PATH, and {PROGRAM} names none: what a page does in a browser is not tested"
LOCAL: Final = frozenset({"file", "data", "blob"})
"""Schemes that leave nothing and fetch nothing from elsewhere."""
FLAGS: Final = (
    "--no-sandbox",  # it could not start as root otherwise; all it opens is our own page
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # three dimensions in software, where there is no graphics processor
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
WITHOUT_WEBGL: Final = ("--disable-webgl", "--disable-webgl2", "--disable-software-rasterizer")
DESKTOP: Final = (1280, 800)
NARROW: Final = (390, 844)
PAPER: Final = (794, 1123)
"""A4 at the 96 pixels an inch of CSS, without margins."""


def program() -> str | None:
    """The browser's program; None where there is none."""
    return os.environ.get(PROGRAM) or shutil.which("chromium")


@contextmanager
def launched(driver: Playwright, *flags: str) -> Iterator[Browser]:
    """The browser, with a new profile that is removed afterwards.

    Args:
        driver: of this process, which can have but one.
        flags: in addition to FLAGS.

    Raises:
        FileNotFoundError: there is no such program.
    """
    path = program()
    if path is None:
        raise FileNotFoundError(ABSENT)
    browser = driver.chromium.launch(executable_path=path, args=[*FLAGS, *flags])
    try:
        yield browser
    finally:
        browser.close()


@contextmanager
def opened(
    browser: Browser,
    file: Path,
    size: tuple[int, int] = DESKTOP,
    *,
    scheme: Literal["light", "dark"] = "light",
    script: bool = True,
) -> Iterator[Page]:
    """A page from its file, without a network.

    Args:
        browser: from ``launched``.
        file: the page.
        size: width and height of the window, pixels.
        scheme: which colours the reader prefers.
        script: whether scripts run.

    Raises:
        AssertionError: on leaving, if the page reported an error or asked for anything that is not in it.
    """
    wrong: list[str] = []
    context = browser.new_context(
        offline=True,
        viewport={"width": size[0], "height": size[1]},
        color_scheme=scheme,
        reduced_motion="reduce",
        java_script_enabled=script,
    )

    def said(message: ConsoleMessage) -> None:
        if message.type == "error":  # software graphics always warn
            wrong.append(f"console: {message.text}")

    def asked(request: Request) -> None:
        if urlsplit(request.url).scheme not in LOCAL:
            wrong.append(f"request: {request.url}")

    try:
        page = context.new_page()
        page.on("console", said)
        page.on("pageerror", lambda error: wrong.append(f"page: {error}"))
        page.on("request", asked)
        page.goto(file.absolute().as_uri())
        yield page
    finally:
        context.close()
    assert not wrong, "\n".join(wrong)
