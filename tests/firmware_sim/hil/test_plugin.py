"""The plugin as its users have it: tests of tests, with real processes where a session is in them."""

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from importlib.metadata import entry_points

import pytest

from cutgate.config.key import new_key_file
from cutgate.firmware_sim.hil.inputs import write_files
from cutgate.firmware_sim.hil.rig import HilRig
from cutgate.runtime.commands.negative_suite.items import NAMES

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.processes

SESSIONS = """
    import pytest

    def test_a_cut_is_completed(cutgate_bus, cutgate_controller, cutgate_session, cutgate_operator, cutgate_clock):
        listener = cutgate_bus.open()
        cutgate_controller()
        cutgate_operator.cut()
        assert cutgate_session.ended() == 0
        assert cutgate_session.cause == "NONE"
        assert listener.recv(1) is not None
        cutgate_clock.until(lambda: cutgate_bus.candump.stat().st_size > 1000)

    @pytest.mark.cutgate_faults("lose ControllerHeartbeat @cutting p=1")
    @pytest.mark.cutgate_expect("HEARTBEAT_LOST")
    def test_a_lost_heartbeat_stops(cutgate_controller, cutgate_session, cutgate_operator):
        cutgate_controller(time_scale=1)
        cutgate_operator.start()
        assert cutgate_session.ended() == 3

    def test_health_fails_it(cutgate_controller, cutgate_session, cutgate_operator):
        cutgate_controller("drift@cutting", time_scale=1)
        cutgate_operator.start()
        cutgate_session.ended()
"""


def test_sessions_are_judged_kept_where_they_fail_and_told_in_the_matrix(pytester, within):
    pytester.makepyfile(test_it=SESSIONS)
    options = ["--cutgate-artefacts", "kept", "--cutgate-matrix", "matrix.md", "--junitxml", "junit.xml"]
    done = within(*options)
    done.assert_outcomes(passed=2, failed=1)
    done.stdout.fnmatch_lines(
        ["health check:", "  TRACKING_DEVIATION: *", "*cutgate artefacts*", "*kept*test_health_fails_it*"]
    )
    (folder,) = (pytester.path / "kept").iterdir()
    kept = {path.name for path in folder.rglob("*") if path.is_file()}
    assert {"bus.candump.log", "logs-report.html", "0-controller.txt", "1-runtime.txt"} < kept
    assert any(name.endswith(".mcap") for name in kept)
    assert not any(name.endswith(".key") for name in kept)
    rows = (pytester.path / "matrix.md").read_text(encoding="utf-8").splitlines()[-3:]
    assert [row.split(" | ")[1:] for row in rows] == [
        ["none", "completed", "", "passed |"],
        ["lose ControllerHeartbeat @cutting p=1", r"stopped HEARTBEAT\_LOST", r"HEARTBEAT\_LOST", "passed |"],
        ["drift@cutting", r"stopped TRACKING\_DEVIATION", r"TRACKING\_DEVIATION", "failed |"],
    ]
    cases = ET.parse(pytester.path / "junit.xml").getroot().iter("testcase")
    assert {case.get("name"): case.find("failure") is None for case in cases} == {
        "test_a_cut_is_completed": True,
        "test_a_lost_heartbeat_stops": True,
        "test_health_fails_it": False,
    }


@pytest.mark.parametrize(
    ("marker", "text"),
    [
        ("cutgate_expect('HEARTBEAT')", "*cutgate_expect: 'HEARTBEAT' is not known; use NONE, *"),
        ("cutgate_faults('lose Heartbeat')", "*cutgate_faults: *message must be one of ControllerFault*"),
    ],
)
def test_a_marker_that_nobody_understands_is_refused_before_anything_is_started(
    pytester, within, marker, text
):
    pytester.makepyfile(f"import pytest\n@pytest.mark.{marker}\ndef test(cutgate_session): pass")
    done = within()
    done.assert_outcomes(errors=1)
    done.stdout.fnmatch_lines([text])


def test_faults_are_those_of_all_markers_in_their_order(pytester, within):
    pytester.makepyfile(
        """
        import pytest
        pytestmark = pytest.mark.cutgate_faults("hang@open")

        @pytest.mark.cutgate_faults("lose any", "repeat any x2")
        def test_it(cutgate_faults):
            assert list(map(str, cutgate_faults)) == ["hang@open", "lose any", "repeat any x2"]
        """
    )
    within("--strict-markers").assert_outcomes(passed=1)


def test_a_test_that_asks_for_nothing_gets_nothing(pytester, within):
    pytester.makepyfile("def test(): pass")
    for options in ((), ("-p", "no:cutgate")):
        done = within(*options)
        done.assert_outcomes(passed=1)
    within("-p", "no:cutgate", "--cutgate-matrix", "m.md").stderr.fnmatch_lines(["*unrecognized arguments*"])


def test_a_matrix_is_a_page_or_a_table(pytester, within):
    done = within("--cutgate-matrix", "matrix.pdf")
    done.stderr.fnmatch_lines(["*--cutgate-matrix is 'matrix.pdf', must end in .html or .md"])


@pytest.mark.parametrize(
    "plugin", [entry.value for entry in entry_points(group="pytest11") if entry.name.startswith("cutgate")]
)
def test_whoever_has_cutgate_installed_pays_nothing_for_a_plugin(plugin):
    asked = f"import sys, pytest, json; before = set(sys.modules); import {plugin}; "
    asked += "print(json.dumps(sorted(set(sys.modules) - before)))"
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    parts = plugin.split(".")
    packages = {".".join(parts[:many]) for many in range(1, len(parts) + 1)}
    assert set(json.loads(done.stdout)) <= packages


def test_there_are_three_plugins():
    names = {entry.name for entry in entry_points(group="pytest11") if entry.name.startswith("cutgate")}
    assert names == {"cutgate", "cutgate_conform", "cutgate_session"}


# ---------------------------------------------------------------- the negative suite

CASES = """
    import pytest
    from cutgate.runtime.conform.suite import CaseVerdict, Result
    from cutgate.runtime.conform.table import cases

    CASES = cases()

    class Suite:
        def judge(self, name):
            number = [case.name for case in CASES].index(name)
            found = [(CaseVerdict.PASS, "as it must"), (CaseVerdict.FAIL, "ACCEPTED"), (CaseVerdict.NOT_RUN, "not run: it moved")]
            return None if number == 3 else Result(CASES[number], *found[min(number, 2)])

    @pytest.fixture(scope="session")
    def cutgate_conform_suite():
        return Suite()

    def test_conforms(cutgate_conform_case):
        cutgate_conform_case()
"""


def test_each_case_is_an_item_that_passes_fails_or_is_skipped_with_its_reason(pytester, within):
    pytester.makepyfile(CASES)
    done = within("-rs", "--junitxml", "junit.xml")
    done.assert_outcomes(passed=1, failed=1, skipped=len(NAMES) - 2)
    done.stdout.fnmatch_lines(
        [f"FAIL: {NAMES[1]} (docs/protocol.md*", "  sent *", "  expected *", "  came      ACCEPTED"]
    )
    done.stdout.fnmatch_lines(["SKIPPED*NOT RUN: it moved"])
    done.stdout.fnmatch_lines(
        ["SKIPPED*NOT RUN: needs the approved robot file; name it with --cutgate-robot"]
    )
    named = [case.get("name") for case in ET.parse(pytester.path / "junit.xml").getroot().iter("testcase")]
    assert named == [f"test_conforms[{name}]" for name in NAMES]


CONFORM = [
    "--pyargs",
    "cutgate.runtime.commands.negative_suite.tests",
    "-p",
    "no:cacheprovider",
    "-k",
    "wrong",
]


def test_a_controller_is_named_whole_and_its_plant_is_disconnected(pytester, within):
    done = within(*CONFORM, "--cutgate-interface", "cutgate", "-x")
    done.stdout.fnmatch_lines(
        ["*--cutgate-channel, --cutgate-key, --cutgate-plant-disconnected is not given*"]
    )


def test_a_bus_that_is_not_there_is_said_in_a_line(pytester, within):
    new_key_file(pytester.path / "site.key", bytes(range(32)))
    named = [
        "--cutgate-interface",
        "cutgate",
        "--cutgate-channel",
        "./none.sock",
        "--cutgate-key",
        "site.key",
    ]
    done = within(*CONFORM, *named, "--cutgate-plant-disconnected", "-x")
    done.stdout.fnmatch_lines(["*no hub is serving there: start one with `cutgate bus serve`*"])
    done.stdout.no_fnmatch_line("*Traceback*")


TARGET = """
    import pytest
    from cutgate.runtime.commands.negative_suite.items import ConformTarget
    from cutgate.firmware_sim.hil.inputs import write_files
    from cutgate.firmware_sim.hil.rig import HilRig

    @pytest.fixture(scope="session")
    def cutgate_conform_target(tmp_path_factory):
        folder = tmp_path_factory.mktemp("target")
        files = write_files(folder)
        rig = HilRig(folder, files, ())
        rig.controller(time_scale=1)
        yield ConformTarget(rig.bus.interface, rig.bus.channel, files.key, robot=files.robot, site=files.site)
        rig.close()
"""


@pytest.mark.slow
def test_cases_are_played_with_the_controller_that_options_name(pytester, within, tmp_path):
    (tmp_path / "target").mkdir()
    files = write_files(tmp_path / "target")
    rig = HilRig(tmp_path / "target", files, ())
    try:
        rig.controller(time_scale=1)
        named = ["--cutgate-interface", rig.bus.interface, "--cutgate-channel", rig.bus.channel]
        named += ["--cutgate-key", files.key, "--cutgate-site", files.site, "--cutgate-plant-disconnected"]
        chosen = [*CONFORM[:-1], "version or approved or nothing", *named]
        done = within(*chosen, "-rs")
        done.assert_outcomes(passed=3, skipped=1, deselected=len(NAMES) - 4)
        done.stdout.fnmatch_lines(
            ["SKIPPED*NOT RUN: needs the approved robot file; name it with --cutgate-robot"]
        )
        approved = [*CONFORM[:-1], "approved", *named, "--cutgate-robot", files.robot]
        within(*approved).assert_outcomes(passed=1, deselected=len(NAMES) - 1)
        done = pytester.runpytest_subprocess(*chosen, "-n", "2")
        done.stdout.fnmatch_lines(
            ["*several workers would speak to one controller; run these tests with -n 0*"]
        )
        assert "passed" not in done.parseoutcomes()
    finally:
        rig.close()


@pytest.mark.slow
def test_each_worker_has_a_controller_of_its_own(pytester):
    pytester.makeconftest(TARGET)
    pytester.makepyfile(test_sessions=SESSIONS.split("    def test_health", maxsplit=1)[0])
    pytester.makepyfile(test_mine="def test_conforms(cutgate_conform_case): cutgate_conform_case()")
    chosen = "version or approved or nothing or completed or heartbeat_stops"
    done = pytester.runpytest_subprocess(
        "-p", "no:cacheprovider", "-n", "2", "-k", chosen, "--cutgate-matrix", "m.md"
    )
    done.assert_outcomes(passed=6)
    assert "2 tests with sessions, 1 different faults, 0 tests failed." in (pytester.path / "m.md").read_text(
        "utf-8"
    )


WIRED = """
    import pytest

    @pytest.mark.cutgate_wire("1M", queue=10)
    def test_a_cut_survives_errors_of_the_wire(
        cutgate_bus, cutgate_controller, cutgate_session, cutgate_operator
    ):
        cutgate_bus.open()  # somebody acknowledges, whoever else is there
        cutgate_controller()
        for skip in (0, 50, 100):
            assert cutgate_bus.inject("bit", skip=skip) == "to come: 1 x bit"
        cutgate_operator.cut()
        assert cutgate_session.ended() == 0
        counts = cutgate_bus.counts()
        assert (counts["bitrate_bit_s"], counts["error_frames"]) == (1_000_000, 3)
        with pytest.raises(ValueError, match="sender is 99"):
            cutgate_bus.inject("bit", sender=99)

    @pytest.mark.cutgate_wire(fd="5M")
    def test_a_marker_without_a_bit_rate(cutgate_bus):
        pass

    def test_at_once_there_is_no_wire(cutgate_bus):
        assert cutgate_bus.counts()["paced"] is False
"""


def test_a_bus_can_be_one_that_models_the_wire(pytester, within):
    pytester.makepyfile(WIRED)
    done = within()
    done.assert_outcomes(passed=2, errors=1)
    done.stdout.fnmatch_lines(["*cutgate_wire takes bitrate, fd and queue, for example*"])
