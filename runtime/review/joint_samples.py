"""The joint samples and the progress in a log's frames, as they came; for telling only, nothing is decided by it. Pure."""

from cutgate.protocol.arrays import Floats
from cutgate.protocol.e2e import intact
from cutgate.protocol.frames import (
    DATA_IDS,
    IDS,
    Frame,
    FrameError,
    Joint4,
    Joints01,
    Joints23,
    Progress,
    decode_frame,
    joint_values,
)

_KINDS = (Joints01, Joints23, Joint4, Progress)
_WANTED = frozenset(IDS[kind] for kind in _KINDS)


class JointSamples:
    """Joints, once the three frames of one counter have come in their order, and progress; of the session of a tag alone.

    Attributes:
        tag: of the session; 0 before one is known, to which no frame belongs.
    """

    def __init__(self) -> None:
        self.tag = 0
        self._parts: dict[type[Frame], tuple[int, Frame]] = {}

    def take(self, can_id: int, data: bytes) -> Floats | Progress | None:
        """A frame that was received, with an identifier of 11 bits and data.

        Returns:
            The joints that it completes, rad and mm, shape (5,); or the progress that it is; None for any other.
        """
        if can_id not in _WANTED or not self.tag or not intact(data, DATA_IDS[can_id], self.tag):
            return None
        try:
            frame = decode_frame(can_id, data)
        except FrameError:  # it is data
            return None
        if isinstance(frame, Progress):
            return frame
        self._parts[type(frame)] = (data[2], frame)
        first, second = self._parts.get(Joints01), self._parts.get(Joints23)
        if not isinstance(frame, Joint4) or first is None or second is None:
            return None
        if not first[0] == second[0] == data[2]:
            return None
        assert isinstance(first[1], Joints01) and isinstance(second[1], Joints23)  # noqa: S101, PT018 - by its key
        return joint_values(first[1], second[1], frame)
