"""A simulation is opted into, and every screen, record and report says so."""

import json

import pytest

from cutgate.runtime.commands.app import execute
from tests.system.harness import FAST, SITE

pytestmark = pytest.mark.processes

SPEED = "speed of the plant, times the clock's"


@pytest.fixture
def silent(rig):
    """A site that says nothing of a simulation."""
    text = SITE.replace("[controller]\nsimulated = true\n", "")
    assert "simulated" not in text
    (rig.folder / "site.toml").write_text(text, encoding="utf-8")
    return rig


def test_a_simulation_that_nobody_allowed_is_refused_in_words_with_the_remedy(silent):
    run, sim = silent.run(json=True), silent.sim(scale=50)
    assert run.exit() == 1
    document = json.loads(run.document)
    assert (document["outcome"], document["simulation"]) == ("not_admitted", None)
    for text in (f"{SPEED}: 50", "simulated = true under [controller] in site.toml", "--allow-simulated"):
        assert text in document["reason"]
    assert silent.at_rest(sim) == "INHIBITED"
    (opened,) = silent.log().of("/audit/open")
    assert "simulated controller" not in {option["name"] for option in opened["simulation"]}


def test_a_controller_whose_plant_keeps_the_clock_s_time_needs_no_word(silent):
    sim, run = silent.permitted()
    run.say("quit")
    assert run.exit() == 3
    assert silent.at_rest(sim) == "INHIBITED"
    assert "simulation" not in run.told


@pytest.mark.parametrize(
    ("site", "option", "by"),
    [
        ("silent", ["--allow-simulated"], "--allow-simulated"),
        ("rig", [], "site.toml"),
        ("rig", ["--allow-simulated"], "--allow-simulated and site.toml"),
    ],
    ids=["option", "site", "both"],
)
def test_a_simulation_that_was_allowed_is_on_every_screen_record_and_report(
    request, capsys, site, option, by
):
    rig = request.getfixturevalue(site)
    run, sim = rig.run(json=True, more=option), rig.sim(scale=FAST)
    run.line(f"simulation: a simulated controller is allowed by {by}")
    run.line(f"simulation only: its plant runs {FAST} times as fast as the clock")
    run.line("permitted:")
    rig.begin(sim, run)
    assert run.exit() == 0
    document = json.loads(run.document)
    assert document["simulation"] == {"allowed_by": by, "time_scale": float(FAST)}
    (opened,) = rig.log().of("/audit/open")
    assert {"name": "simulated controller", "value": f"allowed by {by}"} in opened["simulation"]
    capsys.readouterr()
    assert execute(["audit", "show", str(rig.logs()[-1])]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert f"simulated controller allowed by {by}" in shown


def test_the_last_lines_for_a_person_say_who_allowed_it(rig):
    run, sim = rig.run(), rig.sim(scale=FAST)
    run.line("permitted:")
    run.say("quit")
    assert run.exit() == 3
    assert f"simulation: allowed by site.toml; the plant runs {FAST} times as fast" in run.document
    assert rig.at_rest(sim) == "INHIBITED"
