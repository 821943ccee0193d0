"""One browser for the tests of a file; they are skipped, saying so, where the machine has none."""

import pytest
from playwright.sync_api import sync_playwright

from tests.browser.chromium import ABSENT, WITHOUT_WEBGL, launched, program


@pytest.fixture(scope="module")
def driver():
    if program() is None:
        pytest.skip(ABSENT)
    with sync_playwright() as started:
        yield started


@pytest.fixture(scope="module")
def browser(driver):
    """Chromium with three dimensions, drawn in software."""
    with launched(driver) as started:
        yield started


@pytest.fixture(scope="module")
def flat_browser(driver):
    """Chromium without three dimensions, as where the graphics driver is not trusted."""
    with launched(driver, *WITHOUT_WEBGL) as started:
        yield started
