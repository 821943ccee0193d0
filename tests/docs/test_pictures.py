"""The documentation's pictures: drawn by one script, present where a page shows them, small."""

import re
from pathlib import Path

from PIL import Image

from docs.make_pictures import PICTURES, main
from docs.make_reports import SHOTS

DOCS = Path(__file__).parents[2] / "docs"
LARGEST = 200_000


def test_the_script_draws_every_picture_small_and_not_blank(tmp_path):
    main(tmp_path / "new")
    drawn = sorted((tmp_path / "new").iterdir())
    assert [file.name for file in drawn] == sorted(PICTURES)
    for file in drawn:
        assert 5_000 < file.stat().st_size < LARGEST
        with Image.open(file) as picture:
            assert picture.format == "PNG"
            assert picture.size[0] == 990


def test_the_committed_pictures_are_those_of_the_scripts_and_the_map_of_reach():
    committed = {file.name for file in (DOCS / "pictures").iterdir()}
    assert committed == {*PICTURES, *SHOTS, "reach-hip-stem.png"}
    assert all(file.stat().st_size < LARGEST for file in (DOCS / "pictures").iterdir())


def test_every_picture_a_page_shows_is_there_and_described():
    shown = [
        (page.name, words, page.parent / target)
        for page in DOCS.glob("*.md")
        for words, target in re.findall(r"!\[([^\]]*)\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    ]
    assert len(shown) >= 2
    for page, words, target in shown:
        assert target.is_file(), page
        assert len(words) > 10, page
