"""Another program in place of the verification process, and code planted where the operator stands: nothing is permitted."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cutgate.protocol import records
from cutgate.protocol.frames import CONTROL_IDS
from cutgate.protocol.records import Side
from cutgate.runtime.audit.inspect import Status
from tests.system.children import Script
from tests.system.harness import registration

pytestmark = pytest.mark.processes

RUN_S = 60.0
SCRIPT = Path(sys.executable).with_name("cutgate")
TALK = """
import json, os, signal, socket, sys
line = socket.socket(fileno=os.dup(1))
def request():
    data = b""
    while len(data) < 4 or len(data) < 4 + int.from_bytes(data[:4], "big"):
        data += line.recv(65536)
    return json.loads(data[4:])
def say(message):
    body = message if isinstance(message, bytes) else json.dumps(message).encode()
    line.sendall(len(body).to_bytes(4, "big") + body)
def claim():
    from hashlib import sha256
    asked, path = request(), open(0, "rb", closefd=False).read()
    digest = lambda name: sha256(bytes.fromhex(asked[name])).hexdigest()
    joints = asked["start_joints_u"]
    bound = dict(entry_um=500, exit_um=500, entry_joints_u=joints, exit_joints_u=joints, speed_percent=25)
    return dict(
        kind="claim", request=asked["number"], admissible=True, path=sha256(path).hexdigest(),
        limits=digest("limits"), calibration=digest("calibration"), tool=digest("tool"),
        start_joints_u=joints, approach=bound,
    )
"""
"""What a false verifier needs to speak as ours does."""
LIES = {
    "says admissible": (
        "say(claim()); signal.pause()",
        "said ADMISSIBLE, this side's own check says INADMISSIBLE",
    ),
    "says it for another path": (
        "c = claim(); c['path'] = c['limits']; say(c); signal.pause()",
        "answered for another path",
    ),
    "says it with a forged proof": (
        "say({**claim(), 'proof': 'cutgate.proof/1'}); signal.pause()",
        "proof: Extra inputs are not permitted",
    ),
    "says more than any message holds": (
        "request(); say(bytes(20_000))",
        "a message of 20000 bytes is announced",
    ),
    "never ends": ("request()\nwhile True: line.sendall(b'\\xff' * 65536)", "a message of 4294967295 bytes"),
    "ends in the middle": (
        "request(); line.sendall(b'\\0\\0\\1\\0{'); sys.exit('no room')",
        "the verification process ended",
    ),
    "sends a pickle": (
        (
            "import pickle; request()\n"
            "class Bomb:\n    def __reduce__(self): return os.mkdir, ('went-off',)\n"
            "say(pickle.dumps(Bomb()))"
        ),
        "the verification process's answer is none: Invalid JSON",
    ),
    "nests deeply": ("request(); say(b'[' * 16_000)", "recursion limit exceeded"),
}


@pytest.fixture
def far(rig):
    """A registration with which the path is out of reach."""
    (rig.folder / "far.json").write_text(json.dumps(registration("far", (350, 0, 0))), encoding="utf-8")
    return rig


@pytest.mark.parametrize("how", LIES)
def test_whatever_a_false_verifier_does_nothing_is_permitted_and_it_is_told(far, monkeypatch, how):
    program, said = LIES[how]
    monkeypatch.chdir(far.folder)
    run, sim = far.run(registration="far.json", script=Script(verifier=TALK + program)), far.sim()
    assert run.exit() == 3
    assert said in run.told
    assert "verification failed: the verification process" in run.told
    sent = {envelope.type for envelope in far.bus.records(CONTROL_IDS[Side.RUNTIME])}
    assert records.Permit.TYPE not in sent
    assert far.at_rest(sim).startswith("FAULT (INTERNAL_ERROR)")
    log = far.log()
    assert log.report.status is Status.OK
    assert log.of("/audit/permit") == []
    assert any(said in (entry.get("detail") or "") for entry in log.of("/audit/fault"))
    assert not (far.folder / "went-off").exists()


def test_a_search_for_guidance_that_does_not_end_holds_up_neither_the_verdict_nor_who_wants_to_leave(far):
    program = (
        "c = claim(); c.update(admissible=False, approach=None); say(c)\n"
        "import signal; signal.pthread_sigmask(signal.SIG_SETMASK, range(1, 32)); signal.pause()"
    )
    run, sim = far.run(registration="far.json", script=Script(verifier=TALK + program)), far.sim()
    run.line("looking for the smallest move of the bone")
    assert far.at_rest(sim) == "INHIBITED"  # told of the refusal already
    run.signal(signal.SIGINT)
    assert run.exit() == 1
    assert "INADMISSIBLE: " in run.document
    assert "no move of the bone is shown" in run.told
    log = far.log()
    assert log.report.status is Status.OK
    assert [entry["verdict"] for entry in log.of("/audit/verdict")] == ["inadmissible"]
    (entry,) = log.of("/audit/guidance")
    assert "document" not in entry


# ---------------------------------------------------------------- code in the working directory

PLANTED = """
import importlib, os, sys
here = os.path.dirname(os.path.abspath(__file__))
here = os.path.dirname(here) if os.path.basename(__file__) == "__init__.py" else here
with open(os.path.join(here, "marker.txt"), "a") as marker:
    marker.write(__name__ + "\\n")
sys.path[:] = [folder for folder in sys.path if os.path.abspath(folder or ".") != here]
del sys.modules[__name__]
class Admits:
    def find_spec(self, name, path=None, target=None):
        if name == "cutgate.runtime.session.prover":
            from dataclasses import replace
            from cutgate.runtime.verification import certified
            verify = certified.verify
            certified.verify = lambda problem: replace(verify(problem), admissible=True)
sys.meta_path.insert(0, Admits())
sys.modules[__name__] = importlib.import_module(__name__)
"""
"""Says that it was imported, makes the verifier say ADMISSIBLE, then lets the real module take its place."""
FOLDERS = ("multiprocessing", "numpy", "json", "concurrent", "pydantic", "can", "rich", "typer")
FILES = ("pickle", "socket", "struct", "subprocess", "selectors", "queue")


@pytest.fixture
def planted(rig):
    """A folder beside the plan, on a stick perhaps, with modules named like those that are imported."""
    folder = rig.folder / "stick"
    folder.mkdir()
    for name in FOLDERS:
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(PLANTED, encoding="utf-8")
    for name in FILES:
        (folder / f"{name}.py").write_text(PLANTED, encoding="utf-8")
    return folder


@pytest.mark.parametrize("how", ["working directory", "PYTHONPATH"])
def test_code_planted_where_the_operator_stands_is_not_run_and_an_inadmissible_path_stays_one(
    far, planted, how
):
    if not SCRIPT.exists():
        pytest.skip("the cutgate script is not installed")
    sim = far.sim()
    here = far.folder
    environment = os.environ | ({"PYTHONPATH": str(planted)} if how == "PYTHONPATH" else {})
    done = subprocess.run(
        [
            SCRIPT, "run", here / "plan.json", "--registration", here / "far.json",
            "--robot", Path(__file__).parents[2] / "examples" / "robot.toml",
            "--key", here / "site.key", "--site", here / "site.toml", "--log-dir", here / "logs",
            *far._where,
        ],
        cwd=planted, env=environment, capture_output=True, text=True, stdin=subprocess.DEVNULL,
        timeout=RUN_S, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "INADMISSIBLE" in done.stdout
    assert not (planted / "marker.txt").exists()
    sent = {envelope.type for envelope in far.bus.records(CONTROL_IDS[Side.RUNTIME])}
    assert records.Permit.TYPE not in sent
    assert far.at_rest(sim) == "INHIBITED"
    assert far.log().of("/audit/permit") == []
