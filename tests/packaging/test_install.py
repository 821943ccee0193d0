"""What make installs is what is locked: against an index full of newer releases, with an old pip and the newest."""

import re

import pytest

from tests.packaging.machine import ROOT, environment, false_wheel, run
from tests.packaging.test_lock import locked

pytestmark = [pytest.mark.slow, pytest.mark.processes, pytest.mark.timeout(600)]

PIPS = {"of Python 3.11": "pip==23.2.1", "newest": "pip"}
HOSTILE = """[global]
constraint = {constraint}
user = true
no-binary = :all:
"""


@pytest.fixture(scope="module")
def index(tmp_path_factory):
    """Every locked package, and a newer release of each."""
    folder = tmp_path_factory.mktemp("index")
    program = environment(tmp_path_factory.mktemp("fetch")) / "python"
    options = ["--quiet", "--no-deps", "--only-binary", ":all:", "--dest", folder]
    run([program, "-m", "pip", "download", *options, "--require-hashes", "-r", ROOT / "requirements-dev.txt"])
    for name in locked("requirements-dev.txt"):
        false_wheel(folder, name)
    return folder


@pytest.mark.parametrize("pip", PIPS)
def test_newer_releases_and_the_users_own_settings_of_pip_change_nothing(pip, index, tmp_path):
    programs = environment(tmp_path / "venv")
    run([programs / "python", "-m", "pip", "install", "--quiet", "--upgrade", PIPS[pip]])
    (tmp_path / "constraint.txt").write_text("numpy<1\n", encoding="utf-8")
    settings = tmp_path / "pip.conf"
    settings.write_text(HOSTILE.format(constraint=tmp_path / "constraint.txt"), encoding="utf-8")
    own = {"PIP_CONFIG_FILE": str(settings), "PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(index)}
    run(
        ["make", "install", f"VENV={tmp_path / 'venv'}"],
        env={**own, "PIP_TARGET": str(tmp_path / "elsewhere")},
    )
    listed = run(
        [programs / "python", "-m", "pip", "list", "--format", "freeze"], env={"PIP_CONFIG_FILE": "/dev/null"}
    )
    versions = dict(re.findall(r"^([\w.-]+)==(.+)$", listed.stdout, re.MULTILINE))
    for name, version in locked("requirements-dev.txt").items():
        assert versions.pop(next(key for key in versions if key.lower().replace("_", "-") == name)) == str(
            version
        )
    assert versions.keys() <= {"pip", "cutgate", "setuptools"}
    run([programs / "python", "-m", "pip", "check"], env={"PIP_CONFIG_FILE": "/dev/null"})
    assert not (tmp_path / "elsewhere").exists()
