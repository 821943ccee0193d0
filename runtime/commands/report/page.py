"""The report as one page that loads nothing: words that need no script, and a script that plays the session.

Its policy names script and style by their hashes and allows nothing else. What a log says is text in it, never markup.
"""

import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any, Final

from cutgate import __version__
from cutgate.config.screen import printable
from cutgate.runtime.commands.page_policy import page_policy
from cutgate.runtime.commands.report.session import ReportedSession
from cutgate.runtime.commands.verify_page import SCALE_STYLE, legend, pictures
from cutgate.runtime.review.report import cards, differing, integrity, timeline
from cutgate.runtime.review.report.answers import Answers, Fact
from cutgate.runtime.review.report.markup import Markup, joined, tag
from cutgate.runtime.review.report.redact import Redaction

SCHEMA: Final = "cutgate.report/1"
REDACTED: Final = "Names of persons, bones, files and sessions are left out of this page."
_SCRIPTS: Final = ("report/vendor/drawing.js", "report/view3d.js", "report/page.js")
_STYLES: Final = ("report/vendor/uplot.css", "verify_page.css", "report/page.css")
_SIGNS: Final = {True: "\N{HEAVY CHECK MARK} ", False: "\N{HEAVY BALLOT X} ", None: ""}
_QUESTIONS: Final = (
    ("allowed", "Was it allowed, and why?"),
    ("stopped", "What stopped it, where, and what was done then?"),
    ("close", "How close did it come?"),
)


def page(
    sessions: Sequence[ReportedSession],
    difference: Mapping[str, Any] | None = None,
    redaction: Redaction | None = None,
) -> str:
    """The page as HTML.

    Args:
        sessions: one, or two that are held against each other.
        difference: of the two, as ``audit diff --json`` has it.
        redaction: what is left out of every text; None for nothing.
    """
    shown = redaction.page if redaction else str
    script = "\n".join(map(_file, _SCRIPTS))
    style = "\n".join((*map(_file, _STYLES), SCALE_STYLE))
    policy = page_policy(script, style, images=True)
    names = " and ".join(session.document["name"] for session in sessions)
    document = {"schema": SCHEMA, "sessions": [session.document for session in sessions]}
    text = json.dumps(_shown(document), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return "".join(
        (
            '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            tag("title", f"cutgate report: {names}"),
            f"<style>{style}</style></head>",
            f'<body class="{"two" if len(sessions) > 1 else "one"}">\n',
            tag("p", REDACTED, id="redacted") if redaction else "",
            shown(_top(sessions)),
            shown(
                tag("section", tag("h2", "What differs"), differing.section(difference), id="differences")
                if difference
                else ""
            ),
            "<main>",
            _PLAYER,
            *(shown(_session(one, number, several=len(sessions) > 1)) for number, one in enumerate(sessions)),
            _RECORDS,
            "</main>",
            _footer(sessions),
            f'<script type="application/json" id="data">{text.replace("<", chr(92) + "u003c")}</script>\n',
            f"<script>{script}</script></body></html>\n",
        )
    )


def _shown(value: Any) -> Any:
    """The same without a control character in any text: the script shows it as it stands."""
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, Mapping):
        return {key: _shown(one) for key, one in value.items()}
    return [_shown(one) for one in value] if isinstance(value, list) else value


def _file(name: str) -> str:
    return (files("cutgate.runtime.commands") / name).read_text(encoding="utf-8")


# ---------------------------------------------------------------- the first screen


def _top(sessions: Sequence[ReportedSession]) -> Markup:
    several = len(sessions) > 1
    return tag(
        "header", *(_answers(one, number, several=several) for number, one in enumerate(sessions)), id="top"
    )


def _answers(session: ReportedSession, number: int, *, several: bool) -> Markup:
    found = session.answers
    name = tag("p", session.document["name"], class_="small") if several else ""
    return tag(
        "section",
        tag("p", found.warning, class_="warning") if found.warning else "",
        name,
        tag("h1", _SIGNS[found.good], found.outcome),
        tag("dl", *(_fact(one, number) for one in found.facts), class_="facts"),
        tag("div", *(_answer(found, key, title, number) for key, title in _QUESTIONS), class_="answers"),
        class_=f"session-top {'good' if found.good else 'bad'}",
    )


def _fact(fact: Fact, number: int) -> Markup:
    told = joined((_SIGNS[fact.good], fact.text))
    shown = tag("a", told, href=f"#{fact.place}{number or ''}") if fact.place else told
    tone = {True: "good", False: "bad", None: "plain"}[fact.good]
    return tag("div", tag("dt", fact.name), tag("dd", shown, class_=tone))


def _answer(found: Answers, key: str, title: str, number: int) -> Markup:
    return tag(
        "section",
        tag("h2", title),
        *(tag("p", line) for line in getattr(found, key)),
        id=f"{key}{number or ''}",
    )


# ---------------------------------------------------------------- what is told of a session


def _session(session: ReportedSession, number: int, *, several: bool) -> Markup:
    after = number or ""
    name = f" ({session.document['name']})" if several else ""
    parts = (
        ("place", "Where the path lies", _place(session, f"path{after}-")),
        ("decisions", "Decisions", cards.section(session.told, list(session.cards))),
        ("timeline", "Time line", tag("div", timeline.section(session.told, session.cards), class_="wide")),
        ("integrity", "Can this log be believed?", _integrity(session)),
    )
    return joined(
        tag("section", tag("h2", f"{title}{name}"), part, id=f"{key}{after}") for key, title, part in parts
    )


def _place(session: ReportedSession, prefix: str) -> Markup:
    notes = joined(tag("p", note, class_="small") for note in session.missing)
    decision = session.known.decision
    if decision is None:
        return joined((tag("p", "Nothing of it can be drawn."), notes))
    scene = decision.scene
    return joined(
        (
            tag("p", scene.verdict),
            tag("div", Markup(pictures(scene, prefix)), class_="views"),
            Markup(legend(scene)),
            notes,
        )
    )


def _integrity(session: ReportedSession) -> Markup:
    report = session.log.report
    steps = integrity.steps_of(report, session.replay)
    return tag("div", integrity.section(report, session.replay, steps), class_="wide")


_PLAYER: Final = Markup(
    '<section id="play" class="needs-script" hidden><h2>The session, played</h2>'
    '<p id="choice"><label for="session">Session </label><select id="session"></select></p>'
    '<div class="stage"><div><div id="view3d"></div><p id="no3d" hidden></p>'
    '<div class="controls" id="looks"><button type="button" id="whole">Whole workspace</button>'
    '<button type="button" id="near">The path</button></div></div>'
    '<div class="wide"><table id="readout"></table></div></div>'
    '<div class="controls"><button type="button" id="playing">Play</button>'
    '<label for="moment">Moment</label><input type="range" id="moment" min="0" value="0"></div>'
    '<div class="controls" id="moments"></div>'
    '<svg id="lanes" role="img" aria-label="States of both sides along time"></svg><div id="plots"></div></section>\n'
)
_RECORDS: Final = Markup(
    '<section id="recordtable" class="needs-script" hidden><h2>Records</h2><div class="controls">'
    '<label for="filter">Words </label><input type="search" id="filter"><label for="topic">Topic </label>'
    '<select id="topic"></select><span id="count" role="status"></span></div>'
    '<div id="found" tabindex="0"><table><thead><tr id="columns"></tr></thead><tbody id="rows"></tbody></table></div></section>\n'
)


def _footer(sessions: Sequence[ReportedSession]) -> Markup:
    lines = [
        f"Made by cutgate {__version__}. To ask again: cutgate audit verify LOG; cutgate audit replay LOG; cutgate audit show LOG.",
        *(f"{one.document['name']}: messages on the bus are from {one.source}." for one in sessions),
    ]
    licences = "\n\n".join(_file(f"report/vendor/LICENSE.{name}") for name in ("three", "uplot"))
    drawn = tag(
        "details", tag("summary", "Drawn with three.js and uPlot: their licences"), tag("pre", licences)
    )
    return tag("footer", *(tag("p", line, class_="small") for line in lines), drawn)
