"""The table of checks that need nothing but the interpreter: they are made even where a package is missing."""

from typing import Any, Final

from cutgate.runtime.doctor.checks import Probed
from cutgate.runtime.doctor.judges.installation import (
    judge_files,
    judge_packages,
    judge_python,
    judge_sources,
)
from cutgate.runtime.doctor.probes.installation import code_sources, packages, program_files, python_version

DISTRIBUTION: Final = "cutgate"

INSTALLATION: Final[tuple[Probed[str, Any], ...]] = (
    Probed("Python", "as cutgate's metadata asks", python_version, judge_python),
    Probed("packages", "as cutgate's metadata asks", packages, judge_packages),
    Probed("program files", "all readable", program_files, judge_files),
    Probed("code", "from the installation", code_sources, judge_sources),
)
