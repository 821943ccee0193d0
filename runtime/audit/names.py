"""Names of what a replay reads: attachments, of which input files keep the ending of their kind, and an option of record 0."""

from typing import Final

PATH: Final = "path.bin"
LIMITS: Final = "limits.bin"
CALIBRATION: Final = "calibration.bin"
TOOL: Final = "tool.bin"
"""Canonical records, as they crossed the bus."""
ROBOT: Final = "robot.toml"
SITE: Final = "site.toml"
PLAN: Final = "plan"
"""With the file's ending: ``plan.json``, ``plan.csv``."""
REGISTRATION: Final = "registration"
"""With the file's ending."""
REGISTRATION_SOURCE: Final = "registration-source"
"""The file of another program that ``registration.json`` was made of, with its ending; a replay needs the latter alone."""
PROOF: Final = "proof.bin"
"""The certificate of an admissible verdict."""
DBC: Final = "cutgate.dbc"

READING: Final = "tool path"
"""Record 0's option that says how a tool path was read."""
