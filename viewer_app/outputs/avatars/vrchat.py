"""VRChat's OSC trackers: eight points of the body and the head, over UDP.

https://docs.vrchat.com/docs/osc-trackers. Unity's axes, metres, Euler angles in degrees that are applied in
the order z, x, y. ``head`` relates this space to that of VRChat. Without a person nothing is sent.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fusion.body import Body
from viewer_app.outputs.avatars.osc import bundled
from viewer_app.outputs.avatars.unity_pose import UnitySkeleton

# slot: (bone whose rotation it has, bone at whose beginning it is)
TRACKERS = {
    "1": ("Hips", "Hips"),
    "2": ("LeftFoot", "LeftFoot"),
    "3": ("RightFoot", "RightFoot"),
    "4": ("LeftUpperLeg", "LeftLowerLeg"),
    "5": ("RightUpperLeg", "RightLowerLeg"),
    "6": ("Chest", "Chest"),
    "7": ("LeftUpperArm", "LeftLowerArm"),
    "8": ("RightUpperArm", "RightLowerArm"),
    "head": ("Head", "Head"),
}
"""What each tracker follows: feet at the ankles, upper legs at the knees, upper arms at the elbows."""


class VRChatEncoder:
    """Frames of S* as datagrams."""

    def __init__(self, body: Body) -> None:
        self.skeleton = UnitySkeleton(body)
        names = self.skeleton.names
        self._turns = np.array([names.index(turn) for turn, _ in TRACKERS.values()])
        self._places = np.array([names.index(place) for _, place in TRACKERS.values()])

    def encode(self, positions: NDArray[np.float64], time_ns: int) -> list[bytes]:
        """The datagrams of (J, 3) joints in K_A's frame; none without a person."""
        pose = self.skeleton.update(positions, time_ns)
        if pose is None:
            return []
        places = pose.positions[self._places].tolist()
        turns = euler_degrees(pose.rotations[self._turns]).tolist()
        at = "/tracking/trackers"
        return bundled(
            message
            for slot, place, turn in zip(TRACKERS, places, turns, strict=True)
            for message in ((f"{at}/{slot}/position", place), (f"{at}/{slot}/rotation", turn))
        )


def euler_degrees(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 3) angles about x, y, z in degrees, of R = R_y R_x R_z, from quaternions (N, 4) x, y, z, w."""
    angles = Rotation.from_quat(q).as_euler("YXZ", degrees=True, suppress_warnings=True)
    return np.asarray(angles[:, [1, 0, 2]])
