"""A path on its way in: its blocks, then the check of every pose, in parts so that heartbeats go on meanwhile.

No bus, no clock. :meth:`Upload.add` takes block after block and gives the path with the last one; then
:meth:`Upload.begin_check`, and :meth:`Upload.continue_check` once a cycle until it gives a verdict. Whatever voids
the transfers voids this as well: :meth:`Upload.void`.
"""

from typing import Final, NamedTuple

from cutgate.firmware_sim.approach import Ends, own_ends
from cutgate.firmware_sim.kinematics import KinematicsError, calibrated_arm
from cutgate.firmware_sim.path_check import PathCheck
from cutgate.firmware_sim.state import Holdings, PathChecked
from cutgate.protocol.records import Assembly, Calibration, Limits, PathBlock, PathCodes, Tool
from cutgate.protocol.states import Refusal

CHECK_POSES_PER_CYCLE: Final = 512
MALFORMED: Final = PathChecked(b"", Refusal.PATH_MALFORMED, 0, None)
"""What the table hears of blocks that make no path."""


class CheckedPath(NamedTuple):
    """A verdict on a path.

    Attributes:
        event: what the table hears.
        lines: what the person at the controller reads, in order; none where there is nothing to say.
    """

    event: PathChecked
    lines: tuple[str, ...]


class Upload:
    """The path that is coming in, or is being checked.

    Args:
        hold_roll_rad: the q3 held by a path of vertical axis throughout, where the robot declares one.

    Attributes:
        check: the check under way, None without one.
    """

    def __init__(self, hold_roll_rad: float | None = None) -> None:
        self._hold_roll_rad = hold_roll_rad
        self.void()

    def void(self) -> None:
        """Nothing has come, nothing is checked: a path is of one session, from its first block."""
        self._assembly = Assembly()
        self.check: PathCheck | None = None

    def add(self, block: PathBlock) -> PathCodes | None:
        """Store one block; the first one of a path begins anew.

        Returns:
            The path, once it is whole.

        Raises:
            RecordError: the block is not the next one, or the whole is no path.
        """
        if block.index == 0:
            self._assembly = Assembly()
        self._assembly = self._assembly.add(block)
        return PathCodes.parse(self._assembly.data) if self._assembly.complete else None

    def begin_check(self, path: PathCodes, holdings: Holdings) -> None:
        """Check the whole path, as :meth:`add` gave it, against what the controller holds."""
        self._body = self._assembly.data
        self.check = PathCheck(
            path,
            Limits.parse(holdings.limits),
            Calibration.parse(holdings.calibration),
            Tool.parse(holdings.tool),
            hold_roll_rad=self._hold_roll_rad,
        )

    def continue_check(self, holdings: Holdings, clearance_um: int) -> CheckedPath | None:
        """A part of the check.

        Args:
            holdings: what the controller holds now; entry and exit are inside these limits.
            clearance_um: the least standoff of entry and exit from every tip, as the session has agreed.

        Returns:
            The verdict, once; None while there is more to check, or nothing.
        """
        check = self.check
        if check is None or not check.step(CHECK_POSES_PER_CYCLE):
            return None
        self.check = None
        refusal, pose, detail = check.run()
        if refusal is not Refusal.ACCEPTED:
            line = f"path refused: {refusal.name} at pose {pose}: {detail}"
            return CheckedPath(PathChecked(self._body, refusal, pose, None), (line,))
        try:
            ends = self._own_ends(check, holdings, clearance_um)
        except KinematicsError as error:
            return CheckedPath(PathChecked(self._body, refusal, pose, None), (f"no approach: {error}",))
        return CheckedPath(PathChecked(self._body, refusal, pose, ends), ())

    def _own_ends(self, check: PathCheck, holdings: Holdings, clearance_um: int) -> Ends:
        """Entry and exit of an accepted path. Raises KinematicsError where the arm cannot reach them."""
        path, first, last = check.path, check.first_joints, check.last_joints
        assert first is not None and last is not None  # noqa: S101, PT018 - an accepted path has both
        arm = calibrated_arm(
            Calibration.parse(holdings.calibration),
            tool_mm=path.tool_length_mm,
            elbow=path.elbow,
            hold_roll_rad=self._hold_roll_rad,
        )
        limits = Limits.parse(holdings.limits)
        return own_ends(path, arm, limits, first, last, clearance_um=clearance_um)
