"""VMC, the Virtual Motion Capture protocol: an avatar's bones as OSC over UDP.

https://protocol.vmc.info. A frame is one or two bundles: ``/VMC/Ext/OK``, ``/VMC/Ext/T``,
``/VMC/Ext/Root/Pos`` and a ``/VMC/Ext/Bone/Pos`` per bone, with position and rotation relative to the bone
above. Without a person only the first two are sent, and an avatar keeps its pose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from viewer_app.outputs.osc import Address, OscMessage, UdpSender, filled, split_bundles
from viewer_app.outputs.output import LiveOutput
from viewer_app.outputs.unity_pose import UnitySkeleton
from viewer_app.outputs.vrm import Avatar
from viewer_app.sinks.queued_sink import QueuedFrame

_HERE = (1, 3, 0)  # loaded; calibrated; in the normal calibration mode


class VmcEncoder:
    """Frames of S* as datagrams.

    Without an avatar the positions are those of S*, so a receiver that applies them shows S* itself. With an
    avatar they are the avatar's own; Hips alone move, scaled by the leg lengths of both.

    Args:
        body: The body of S*.
        avatar: The avatar's proportions; None for the person's.
    """

    def __init__(self, body: Body, avatar: Avatar | None = None) -> None:
        self.skeleton = UnitySkeleton(body)
        self._avatar = avatar
        time, root = OscMessage("/VMC/Ext/T", (None,)), ("root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        self._with_person = split_bundles(
            [
                OscMessage("/VMC/Ext/OK", (*_HERE, 1)),
                time,
                OscMessage("/VMC/Ext/Root/Pos", root),
                *(OscMessage("/VMC/Ext/Bone/Pos", (name, *[None] * 7)) for name in self.skeleton.names),
            ]
        )
        self._without = split_bundles([OscMessage("/VMC/Ext/OK", (*_HERE, 0)), time])
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
        if pose is None:
            return filled(self._without, np.array([seconds]))
        bones = pose.local
        if self._avatar is not None:
            scale = self._avatar.hips[1] / pose.leg
            bones[:, :3] = self._rest
            bones[0, :3] = scale * pose.positions[0] - self._avatar.above_hips
        return filled(self._with_person, np.concatenate([[seconds], bones.ravel()]))


class VmcOutput(LiveOutput):
    """Sends S* to a VMC receiver.

    Raises:
        UsageError: The host is unknown.
    """

    def __init__(self, address: Address, body: Body, avatar: Avatar | None = None) -> None:
        super().__init__(f"VMC to {address}")
        self._encoder = VmcEncoder(body, avatar)
        self._udp = UdpSender(address, "--vmc")
        self.start()

    def send_frame(self, frame: QueuedFrame) -> int:
        """Sends one or two datagrams."""
        return self._udp.send(self._encoder.encode(frame.fused.positions, frame.time_ns))

    def shut(self) -> None:
        """Closes the socket."""
        self._udp.close()
