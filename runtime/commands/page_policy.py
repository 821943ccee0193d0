"""What a page of ours may load and run: its own script and style, known by their hashes, and nothing else. Pure."""

import base64
from hashlib import sha256


def page_policy(script: str, style: str, *, images: bool = False) -> str:
    """The page's Content-Security-Policy.

    Args:
        script: the text of its one script.
        style: of its one style.
        images: it makes pictures of its own, which it holds as data.
    """
    own = "img-src data: blob:; " if images else ""
    return (
        f"default-src 'none'; script-src {_source(script)}; style-src {_source(style)}; {own}"
        "base-uri 'none'; form-action 'none'"
    )


def _source(text: str) -> str:
    return f"'sha256-{base64.b64encode(sha256(text.encode()).digest()).decode()}'"
