"""The arm in the scene: a frame for each link, which joints move, and what stands still in these frames. Pure."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cutgate.protocol import records
from cutgate.protocol.arrays import Floats
from cutgate.runtime.audit.records import Time
from cutgate.runtime.commands.foxglove.schemas import (
    FoxgloveFrameTransform,
    FoxgloveFrameTransforms,
    FoxgloveQuaternion,
    FoxgloveSceneUpdate,
)
from cutgate.runtime.commands.foxglove.shapes import (
    UNTURNED,
    about_z,
    about_z_then_y,
    colour,
    cylinder,
    entity,
    of_matrix,
    sphere,
    vector,
)

ROBOT: Final = "robot"
BONE: Final = "bone"
COLUMN, UPPER, FOREARM, WRIST, TOOL = "column", "upper_arm", "forearm", "wrist", "tool"
FRAMES: Final = (ROBOT, COLUMN, UPPER, FOREARM, WRIST, TOOL, BONE)
LINK_MM: Final = 40.0
TOOL_MM: Final = 6.0
"""How thick they are drawn; the true arm's shape is not known here."""
_LINK: Final = colour("#8a97a8", 0.6)
_TOOL: Final = colour("#30363d")


@dataclass(frozen=True, eq=False)
class ShownArm:
    """The true arm.

    Attributes:
        upper_mm, forearm_mm: true links.
        tool_mm: wrist centre to tip.
        offset: true less reported joints, shape (5,).
        tilt: lean of the slide toward x and y, ratio, shape (2,).
        heights_mm: lower and upper end of the slide.
        bounds: least and largest reported joints, rad and mm, shape (2, 5).
    """

    upper_mm: float
    forearm_mm: float
    tool_mm: float
    offset: Floats
    tilt: Floats
    heights_mm: tuple[float, float]
    bounds: Floats

    @classmethod
    def of(cls, limits: bytes, calibration: bytes, tool: bytes) -> "ShownArm":
        """From the controller's records.

        Raises:
            cutgate.protocol.records.RecordError: they are none.
        """
        found, bounds = records.Calibration.parse(calibration), records.Limits.parse(limits)
        return cls(
            found.upper_mm + found.upper_link_error_mm,
            found.forearm_mm + found.forearm_link_error_mm,
            records.Tool.parse(tool).length_mm,
            found.joint_offset,
            found.slide_tilt,
            (float(bounds.q_min[2]), float(bounds.q_max[2])),
            np.stack((bounds.q_min, bounds.q_max)),
        )

    def transforms(self, joints: Floats, at: Time) -> FoxgloveFrameTransforms:
        """Each link's frame in the one before, by reported joints, rad and mm, shape (5,).

        The tool's frame has its origin at the tip, and z along the tool toward the wrist.
        """
        q = (joints + self.offset).tolist()
        height = q[2] * np.array([*self.tilt, 1.0])
        chain: tuple[tuple[str, str, Floats, FoxgloveQuaternion], ...] = (
            (ROBOT, COLUMN, height, UNTURNED),
            (COLUMN, UPPER, np.zeros(3), about_z(q[0])),
            (UPPER, FOREARM, np.array([self.upper_mm, 0.0, 0.0]), about_z(q[1])),
            (FOREARM, WRIST, np.array([self.forearm_mm, 0.0, 0.0]), about_z_then_y(q[3], q[4])),
            (WRIST, TOOL, np.array([0.0, 0.0, -self.tool_mm]), UNTURNED),
        )
        links = (_transform(parent, child, way, turned, at) for parent, child, way, turned in chain)
        return FoxgloveFrameTransforms(transforms=tuple(links))

    def drawn(self, at: Time) -> FoxgloveSceneUpdate:
        """What stands still in these frames: a cylinder for each link, a ball for each axis."""
        origin, upper, forearm = (
            np.zeros(3),
            np.array([self.upper_mm, 0.0, 0.0]),
            np.array([self.forearm_mm, 0.0, 0.0]),
        )
        low, high = (height * np.array([*self.tilt, 1.0]) for height in self.heights_mm)
        tool = np.array([0.0, 0.0, self.tool_mm])
        ball = sphere(origin, 1.3 * LINK_MM, _LINK)
        links = (
            entity("arm/slide", ROBOT, at, cylinders=(cylinder(low, high, LINK_MM, _LINK),)),
            entity(
                "arm/upper", UPPER, at, cylinders=(cylinder(origin, upper, LINK_MM, _LINK),), spheres=(ball,)
            ),
            entity(
                "arm/forearm",
                FOREARM,
                at,
                cylinders=(cylinder(origin, forearm, LINK_MM, _LINK),),
                spheres=(ball,),
            ),
            entity("arm/tool", TOOL, at, cylinders=(cylinder(origin, tool, TOOL_MM, _TOOL),)),
        )
        return FoxgloveSceneUpdate(deletions=(), entities=links)


def bone_transform(place: Floats, at: Time) -> FoxgloveFrameTransforms:
    """Where the bone's frame lies in the robot's, by the registration, shape (4, 4), mm."""
    found = _transform(ROBOT, BONE, place[:3, 3], of_matrix(place[:3, :3]), at)
    return FoxgloveFrameTransforms(transforms=(found,))


def _transform(
    parent: str, child: str, translation_mm: Floats, rotation: FoxgloveQuaternion, at: Time
) -> FoxgloveFrameTransform:
    return FoxgloveFrameTransform(
        timestamp=at,
        parent_frame_id=parent,
        child_frame_id=child,
        translation=vector(translation_mm),
        rotation=rotation,
    )
