"""The bounds of free text that docs/audit.md states are those that are enforced."""

from pathlib import Path

from pydantic import TypeAdapter

from cutgate.config.model import Text
from cutgate.config.terminal import LINE_BYTES_MAX
from cutgate.runtime.commands.run import OPERATOR_MAX
from cutgate.runtime.plan.registration import POINT_NAME_MAX
from cutgate.runtime.review.report.redact import NAMES_MAX

AUDIT = (Path(__file__).parents[2] / "docs" / "audit.md").read_text(encoding="utf-8")
PRIVACY = AUDIT[AUDIT.index("### Privacy") : AUDIT.index("## Two sessions side by side")]


def test_the_bounds_of_free_text_are_those_that_are_enforced():
    ids = TypeAdapter(Text).json_schema()["maxLength"]
    for row in (
        f"| `--operator` | {OPERATOR_MAX} printable characters |",
        f"| a line typed during a session (`confirm ...`) | {LINE_BYTES_MAX} bytes |",
        f"| `id` and `ct_id` of plan and registration, `implant` of a plan | {ids} characters each |",
        f"| name of a check point | {POINT_NAME_MAX} characters |",
    ):
        assert row in PRIVACY
    assert f"than {NAMES_MAX} names" in " ".join(PRIVACY.split())
