"""The page shows what the rows do now."""

from docs.make_error_matrix import PAGE, page


def test_the_page_is_what_the_rows_show(played):
    assert PAGE.read_text(encoding="utf-8") == page(played), "run make docs"
