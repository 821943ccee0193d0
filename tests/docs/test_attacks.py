"""The page of attacks is made by its script, and current."""

from docs.make_attacks import PAGE, page
from tests.runtime.audit.attacks import ATTACKS


def test_the_page_is_the_scripts():
    assert page() == PAGE.read_text(encoding="utf-8"), "run: python -m docs.make_attacks"


def test_every_attack_has_its_line():
    text = PAGE.read_text(encoding="utf-8")
    for rows in ATTACKS.values():
        for row in rows:
            assert f"| {row.what}" in text
