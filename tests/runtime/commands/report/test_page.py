"""The page: it holds to its own policy, every tag is closed, what a log says is text, and the answers come first."""

import base64
import json
import re
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path

import pytest

from cutgate.runtime.audit.records import AuditDecision, AuditOpen, AuditOperator
from cutgate.runtime.commands.app import execute
from tests.runtime.audit.build import forge, session_log

VOID = {"meta", "input", "br", "hr", "link", "img"}
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\x1b[31m\u202egnp&\u0000"
PAGE_MAX = 2_000_000


def report(out, *arguments):
    assert execute(["audit", "report", *map(str, arguments), "-o", str(out)]) == 0
    return out.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def pages(logs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    asked = {name: (log,) for name, log in logs.items()} | {"two": (logs["refused"], logs["cut"])}
    return {name: report(folder / f"{name}.html", *which) for name, which in asked.items()}


class Parsed(HTMLParser):
    """Open tags, ids, links and the text of each element with an id."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.links, self.text, self.within = [], [], [], {}, []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        own = dict(attrs)
        assert not [name for name in own if name.startswith("on") or name == "style"]
        if "id" in own:
            self.ids.append(own["id"])
        if "href" in own:
            self.links.append(own["href"])
        if tag not in VOID:
            self.open.append((tag, own.get("id")))

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open, tag
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        for _, name in self.open:
            if name:
                self.text[name] = self.text.get(name, "") + data


def document_of(text):
    return json.loads(
        re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL).group(1)
    )


@pytest.mark.parametrize("name", ["cut", "refused", "stopped", "two"])
def test_a_page_is_whole_small_and_loads_nothing(pages, name):
    text = pages[name]
    found = Parsed(text)
    assert not found.open
    assert len(found.ids) == len(set(found.ids)), "no name twice"
    assert {link.removeprefix("#") for link in found.links} <= set(found.ids), "every link leads somewhere"
    assert len(text.encode()) < PAGE_MAX
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text).group(1)
    for kind in ("script", "style"):
        (own,) = re.findall(rf"<{kind}>(.*?)</{kind}>", text, flags=re.DOTALL)
        assert f"{kind}-src {_hash(own)};" in policy
    assert policy.startswith("default-src 'none';")
    assert "unsafe" not in policy
    without = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r"<(?:img|iframe|link|object|embed)|src=|@import|url\(", without)


def _hash(text):
    return f"'sha256-{base64.b64encode(sha256(text.encode()).digest()).decode()}'"


@pytest.mark.parametrize(
    ("name", "allowed", "stopped"),
    [
        ("cut", "The start left at", "Nothing: it came to its end."),
        ("refused", "No: no permit left, so that nothing could move.", "Nothing moved"),
        ("stopped", "The start left at", "The operator said stop."),
    ],
)
def test_the_three_questions_are_answered_at_the_top(pages, name, allowed, stopped):
    found = Parsed(pages[name])
    assert allowed in found.text["allowed"]
    assert stopped in found.text["stopped"]
    assert "required" in found.text["close"]
    assert all(found.text[part] in found.text["top"] for part in ("allowed", "stopped", "close"))


def test_two_sessions_are_told_apart_and_held_against_each_other(pages):
    found = Parsed(pages["two"])
    assert "REFUSED" in found.text["top"]
    assert "cut to its end" in found.text["top"]
    assert "DIFFERENT" in found.text["differences"]
    first, second = document_of(pages["two"])["sessions"]
    assert not {one["card"] for one in first["moments"]} & {one["card"] for one in second["moments"]}


def test_what_the_script_draws_is_there(pages):
    (cut,) = document_of(pages["cut"])["sessions"]
    assert {plot["id"] for plot in cut["plots"]} >= {
        "along",
        "clearance",
        "deviation",
        "ranges",
        "bus",
        "loop",
    }
    for plot in cut["plots"]:
        assert all(len(series["values"]) == len(plot["x"]) > 1 for series in plot["series"])
    assert len(cut["arm"]["points"]) == 12 * len(cut["arm"]["t"])
    assert cut["place"]
    assert set(cut["frames"]) == {one["card"] for one in cut["moments"]}
    assert any("CUTTING" in str(span) for lane in cut["lanes"] for span in lane.get("spans", []))
    assert len(cut["records"]["rows"]) > 50


def hostile(record):
    if isinstance(record, AuditOpen):
        return record.model_copy(
            update={"operator": HOSTILE, "account": HOSTILE, "host": HOSTILE, "software": HOSTILE}
        )
    if isinstance(record, AuditDecision):
        return record.model_copy(update={"reason": HOSTILE, "event": HOSTILE, "first_out": HOSTILE})
    if isinstance(record, AuditOperator):
        return record.model_copy(update={"word": HOSTILE, "reason": HOSTILE})
    return record


def test_what_a_log_says_is_text(tmp_path):
    log = session_log(tmp_path).log
    log.write_bytes(forge(log.read_bytes(), hostile))
    text = report(tmp_path / "page.html", log)
    assert "gnp" in text
    found = Parsed(text)
    assert not found.open
    shown = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert "<img" not in shown
    assert "alert(1)</script>" not in shown
    assert not set(shown) & {"\x1b", "\x00", "\u202e"}
    document_of(text)


def test_a_log_of_version_0_1_0_is_reported(tmp_path):
    earlier = sorted((Path(__file__).parents[3] / "compat/0.1.0/sessions").glob("*.mcap"))
    for log in earlier:
        found = Parsed(report(tmp_path / "page.html", log))
        assert "INCOMPLETE (unsigned, old form)" in found.text["top"]


def test_what_is_no_log_or_no_page_is_refused(tmp_path, capsys):
    log = session_log(tmp_path).log
    (tmp_path / "none.mcap").write_bytes(b"none")
    for arguments, words in (
        ([tmp_path / "none.mcap", "-o", tmp_path / "a.html"], "name a session's .mcap file"),
        ([log, "-o", tmp_path / "a.pdf"], ".html"),
        ([log, "-o", tmp_path / "nowhere" / "a.html"], "cannot be written"),
    ):
        assert execute(["audit", "report", *map(str, arguments)]) == 2
        assert words in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "a.html").exists()


def test_a_tampered_log_is_told_first(tmp_path):
    log = session_log(tmp_path).log
    data = bytearray(log.read_bytes())
    at = data.index(b"admissible")
    data[at] ^= 1
    log.write_bytes(data)
    found = Parsed(report(tmp_path / "page.html", log))
    assert found.text["top"].lstrip().startswith("The log was TAMPERED with")
