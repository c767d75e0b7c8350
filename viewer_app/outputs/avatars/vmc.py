"""VMC, the Virtual Motion Capture protocol: an avatar's bones as OSC over UDP.

https://protocol.vmc.info. A frame is one or two bundles: ``/VMC/Ext/OK``, ``/VMC/Ext/T``,
``/VMC/Ext/Root/Pos`` and a ``/VMC/Ext/Bone/Pos`` per bone, with position and rotation relative to the bone
above. Without a person only the first two are sent, and an avatar keeps its pose.
"""

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from viewer_app.outputs.avatars.osc import Message, bundled
from viewer_app.outputs.avatars.unity_pose import UnitySkeleton
from viewer_app.outputs.avatars.vrm import Avatar

_HERE = (1, 3, 0)  # loaded; calibrated; in the normal calibration mode
_ROOT = ["root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


class VmcEncoder:
    """Frames of S* as datagrams.

    Without an avatar the positions are those of the person's T-pose, so a receiver that applies them shows
    the person's proportions. With an avatar they are the avatar's own. Hips alone move, scaled by the leg
    lengths of both.
    """

    def __init__(self, body: Body, avatar: Avatar | None = None) -> None:
        self.skeleton = UnitySkeleton(body)
        self._avatar = avatar
        if avatar is not None:
            zero = np.zeros(3)
            self._rest = np.array([avatar.translations.get(name, zero) for name in self.skeleton.names])

    def encode(self, positions: NDArray[np.float64], time_ns: int) -> list[bytes]:
        """The datagrams of one frame.

        Args:
            positions: (J, 3) metres, S* in K_A's frame; NaN without a person.
            time_ns: Since the first frame.
        """
        seconds = time_ns * 1e-9
        pose = self.skeleton.update(positions, time_ns)
        state: list[Message] = [("/VMC/Ext/OK", [*_HERE, int(pose is not None)]), ("/VMC/Ext/T", [seconds])]
        if pose is None:
            return bundled(state)
        bones = pose.local
        if self._avatar is not None:
            scale = self._avatar.hips[1] / pose.leg
            bones[:, :3] = self._rest
            bones[0, :3] = scale * pose.positions[0] - self._avatar.above_hips
        named = zip(self.skeleton.names, bones.tolist(), strict=True)
        places: list[Message] = [("/VMC/Ext/Bone/Pos", [name, *bone]) for name, bone in named]
        return bundled([*state, ("/VMC/Ext/Root/Pos", _ROOT), *places])
