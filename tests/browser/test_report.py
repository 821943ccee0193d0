"""The report page in a browser: first screen, three dimensions, slider, filter, links, paper, night, narrow, no WebGL."""

from contextlib import ExitStack

import pytest
from playwright.sync_api import expect

from cutgate.runtime.commands.app import execute
from tests.browser.chromium import ABSENT, DESKTOP, NARROW, WITHOUT_WEBGL, launched, opened, program
from tests.runtime.commands.report.sessions import logs_of

DRAWN = """() => {
  const canvas = document.querySelector("#view3d canvas");
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const draw = copy.getContext("2d");
  draw.drawImage(canvas, 0, 0);
  const pixels = draw.getImageData(0, 0, copy.width, copy.height).data;
  let other = 0;
  for (let k = 4; k < pixels.length; k += 4)
    other += pixels[k] !== pixels[0] || pixels[k + 1] !== pixels[1] || pixels[k + 2] !== pixels[2];
  return other;
}"""
CONTRAST = """() => {
  const light = (colour) => {
    const part = colour.match(/[\\d.]+/g).slice(0, 3).map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * part[0] + 0.7152 * part[1] + 0.0722 * part[2];
  };
  const behind = (element) => {
    for (let one = element; one; one = one.parentElement) {
      const colour = getComputedStyle(one).backgroundColor;
      if (colour !== "rgba(0, 0, 0, 0)") return colour;
    }
    return "rgb(255, 255, 255)";
  };
  let least = 21;
  for (const element of document.querySelectorAll("h1, h2, h3, p, dt, dd, td, th, button, label, figcaption, summary")) {
    if (!element.offsetParent || !element.textContent.trim()) continue;
    const [a, b] = [light(getComputedStyle(element).color), light(behind(element))];
    least = Math.min(least, (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05));
  }
  return least;
}"""

pytestmark = [
    pytest.mark.processes,
    pytest.mark.browser,
    pytest.mark.skipif(program() is None, reason=ABSENT),
]


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder, logs = tmp_path_factory.mktemp("pages"), logs_of(tmp_path_factory)
    asked = {name: [log] for name, log in logs.items()} | {"two": [logs["refused"], logs["cut"]]}
    for name, which in asked.items():
        assert execute(["audit", "report", *map(str, which), "-o", str(folder / f"{name}.html")]) == 0
    return folder


@pytest.fixture
def visit(browser, pages):
    """Opens a page; fails in the end if it has complained, or asked for anything."""
    with ExitStack() as open_pages:
        yield lambda name, *size, **options: open_pages.enter_context(
            opened(browser, pages / f"{name}.html", *size, **options)
        )


@pytest.mark.parametrize("name", ["cut", "refused", "stopped"])
def test_the_first_screen_answers_the_three_questions(visit, name):
    page = visit(name)
    for part in ("allowed", "stopped", "close"):
        box = page.locator(f"#{part}").bounding_box()
        assert box["y"] + box["height"] <= DESKTOP[1]
        assert box["x"] + box["width"] <= DESKTOP[0]


@pytest.mark.parametrize("name", ["cut", "refused", "stopped"])
def test_the_first_printed_page_answers_them_too(visit, name):
    """A4 has 297 mm less margins of 10 mm: 1047 px at the 96 to an inch that print has."""
    page = visit(name, (718, 1047))
    page.emulate_media(media="print")
    for part in ("allowed", "stopped", "close"):
        box = page.locator(f"#{part}").bounding_box()
        assert box["y"] + box["height"] <= 1047
        assert box["x"] + box["width"] <= 718
    assert page.pdf(format="A4").startswith(b"%PDF")


@pytest.mark.parametrize("name", ["cut", "refused", "stopped", "two"])
def test_path_workspace_and_arm_are_drawn(visit, name):
    page = visit(name)
    assert page.evaluate(DRAWN) > 3000
    page.get_by_role("button", name="The path").click()
    assert page.evaluate(DRAWN) > 3000


def test_the_slider_moves_arm_and_numbers_together(visit):
    page = visit("cut")
    before, picture = page.locator("#readout").inner_text(), page.evaluate(f"({DRAWN})()")
    page.locator("#moment").focus()
    page.keyboard.press("End")
    page.keyboard.press("PageDown")
    page.keyboard.press("PageDown")
    page.keyboard.press("PageDown")
    after = page.locator("#readout").inner_text()
    assert after != before
    assert page.evaluate(f"({DRAWN})()") != picture
    now = page.locator("#now").get_attribute("d")
    page.keyboard.press("Home")
    assert page.locator("#now").get_attribute("d") != now


def test_a_decision_leads_to_its_moment_and_its_frames(visit):
    page = visit("cut")
    page.locator("#moments button", has_text="start").click()
    at = page.locator("#readout").inner_text()
    page.locator("#moments button").last.click()
    assert page.locator("#readout").inner_text() != at
    card = page.locator(".card .frames details").first
    card.locator("summary").click()
    assert card.locator("pre").inner_text().strip()


def test_records_are_filtered_by_words_and_topic(visit):
    page = visit("cut")
    whole = page.locator("#rows tr").count()
    page.keyboard.press("/")
    page.keyboard.type("start")
    few = page.locator("#rows tr")
    assert 0 < few.count() < whole
    assert all("start" in text.lower() for text in few.all_inner_texts())
    page.locator("#filter").fill("")
    page.locator("#topic").select_option("/audit/permit")
    assert {row.split("\t")[2] for row in few.all_inner_texts()} == {"/audit/permit"}


def test_links_lead_to_their_places(visit):
    page = visit("cut")
    for link in page.locator("header a").all():
        target = link.get_attribute("href")
        link.click()
        assert page.locator(target).is_visible()


def test_of_two_sessions_the_chosen_one_is_played(visit):
    page = visit("two")
    first = page.locator("#readout").inner_text()
    page.locator("#session").select_option("1")
    assert page.locator("#readout").inner_text() != first
    assert page.evaluate(DRAWN) > 3000


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everything_can_be_read_by_day_and_by_night(visit, scheme):
    page = visit("stopped", scheme=scheme)
    assert page.evaluate(CONTRAST) >= 4.5


def test_a_narrow_screen_scrolls_in_one_direction(visit):
    page = visit("stopped", NARROW)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_it_plays_and_stands_still_again(visit):
    page = visit("cut")
    begun = page.locator("#moment").input_value()
    page.keyboard.press("Space")
    assert page.locator("#playing").inner_text() == "Pause"
    expect(page.locator("#moment")).not_to_have_value(begun)
    page.keyboard.press("Space")
    assert page.locator("#playing").inner_text() == "Play"


def test_two_openings_look_the_same(visit):
    assert visit("cut").screenshot() == visit("cut").screenshot()


def test_without_scripts_the_pictures_tell_it(visit):
    page = visit("cut", script=False)
    assert page.locator("#place svg.view").count() == 4
    assert page.locator("#play").is_hidden()


def test_without_webgl_everything_else_works(driver, pages):
    with launched(driver, *WITHOUT_WEBGL) as browser, opened(browser, pages / "cut.html") as page:
        assert page.locator("#no3d").is_visible()
        assert page.locator("#plots figure").count() >= 6
        assert page.locator("#rows tr").count() > 10
