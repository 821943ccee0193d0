"""What a page may load and run: its own script and style, known by their hashes, and nothing else."""

import base64
import hashlib
import re


def holds_to_its_own(text, links=frozenset()):
    """Asserts the policy of a page, and that nothing in it asks for more than these links within it."""
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text).group(1)
    for kind in ("script", "style"):
        (own,) = re.findall(rf"<{kind}>(.*?)</{kind}>", text, flags=re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(own.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}';" in policy
    assert policy.startswith("default-src 'none';")
    assert "unsafe" not in policy
    assert not re.search(r"https?:|src=|@import|url\(|style=| on[a-z]+=", text)
    assert set(re.findall(r'href="([^"]*)"', text)) == set(links)
    assert text.count("href=") == len(re.findall(r'href="', text))
