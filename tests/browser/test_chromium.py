"""The guard itself: whatever a page may not do is told, and what it may do is not."""

import pytest

from tests.browser import chromium as machine
from tests.browser.chromium import opened

pytestmark = [pytest.mark.processes, pytest.mark.browser]

PIXEL = "data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw=="


def page_of(folder, body):
    file = folder / "page.html"
    file.write_text(f"<!DOCTYPE html><title>t</title><body>{body}</body>", encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("<script>console.error('broken')</script>", "console: broken"),
        ("<script>nothing.at.all</script>", "page: nothing is not defined"),
        ("<img src='http://192.0.2.1/x.png'>", "request: http://192.0.2.1/x.png"),
        ("<script>fetch('https://192.0.2.1/x').catch(() => 0)</script>", "request: https://192.0.2.1/x"),
    ],
)
def test_an_error_or_a_request_is_told(browser, tmp_path, body, told):
    with pytest.raises(AssertionError, match=told), opened(browser, page_of(tmp_path, body)) as page:
        page.wait_for_load_state("networkidle")


def test_a_page_that_holds_all_it_shows_passes(browser, tmp_path):
    body = f"<p>x</p><img src='{PIXEL}'><script>console.warn('software')</script>"
    with opened(browser, page_of(tmp_path, body)) as page:
        assert page.text_content("p") == "x"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_reader_prefers_what_was_asked_for(browser, tmp_path, scheme):
    with opened(browser, page_of(tmp_path, ""), (390, 844), scheme=scheme) as page:
        assert page.evaluate(f"matchMedia('(prefers-color-scheme: {scheme})').matches")
        assert page.evaluate("[innerWidth, innerHeight]") == [390, 844]


def test_three_dimensions_are_there_or_not_as_asked_for(browser, flat_browser, tmp_path):
    ask = "document.createElement('canvas').getContext('webgl2') !== null"
    for started, there in ((browser, True), (flat_browser, False)):
        with opened(started, page_of(tmp_path, "")) as page:
            assert page.evaluate(ask) is there


def test_the_program_is_the_one_that_is_named(monkeypatch):
    monkeypatch.setenv(machine.PROGRAM, "/a/browser")
    assert machine.program() == "/a/browser"
    monkeypatch.delenv(machine.PROGRAM)
    monkeypatch.setenv("PATH", "")
    assert machine.program() is None
