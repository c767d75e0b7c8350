"""A person with the back turned to the sensor, reported mirrored: sides exchanged, facing the sensor.

A Kinect v2's tracker assumes that the person faces it. Joints stay where depth shows them; their labels are
exchanged, and what depth hardly shows is placed by the wrong belief: feet point to the sensor. The tracker
changes over while the person passes through profile, smoothly: left and right joints pass through each other
within some tenths of a second, the legs often later than the trunk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from devices.simulated.person.anatomy import Array
from fusion.body import Body


@dataclass(frozen=True)
class Mirroring:
    """How often, and how, a tracker reports a person mirrored. The default never does.

    The Kinect v2's values are those of five real walks of three people, judged by
    ``python -m tests.campaigns.facing``: by the cosine between the person's front and the direction to the
    sensor 0 % of the frames are mirrored above 0, 2 % at −0.1, 16 % at −0.4, 63 % at −0.6, 93 % at −0.8 and
    99 % at −1. No recording with turned backs is at hand for the Azure Kinect: its share is assumed.

    Attributes:
        back: Share of frames mirrored with the back turned.
        centre, width: Cosine at which the share is half of that, and the width of the logistic step.
        seconds: Time constant with which the share is reached.
        crossing_seconds: How long a change-over takes.
        legs_later: The legs follow the trunk by up to this many seconds, uniformly drawn.
        believed: Share of a joint's offset to the front of the one before it that is turned to the back, for
            feet, face, thumb, hand, wrist, elbow and knee.
    """

    back: float = 0.0
    centre: float = -0.55
    width: float = 0.10
    seconds: float = 0.12
    crossing_seconds: float = 0.25
    legs_later: float = 0.5
    believed: tuple[float, float, float, float, float, float, float] = (0.9, 0.9, 0.6, 0.3, 0.5, 0.35, 0.1)

    def share(self, cosine: float) -> float:
        """Share of frames mirrored at this cosine between the person's front and the way to the sensor."""
        return float(self.back / (1.0 + np.exp((cosine - self.centre) / self.width)))


_BELIEVED_NAMES = ("foot", "nose eye ear", "thumb", "hand", "wrist", "elbow", "knee")


class MirroringTracker:
    """Exchanges one tracker's labels frame after frame.

    Args:
        body: Its joints.
        mirroring: How.
        frame_seconds: Between two frames.
        random: Its own generator; every frame draws as many values.
    """

    def __init__(
        self, body: Body, mirroring: Mirroring, frame_seconds: float, random: np.random.Generator
    ) -> None:
        self._body, self._mirroring, self._dt, self._random = body, mirroring, frame_seconds, random
        plain = [name.replace("_", "").lower() for name in body.joints]
        self._believed = np.zeros(len(body))
        for share, parts in zip(mirroring.believed, _BELIEVED_NAMES, strict=True):
            self._believed[[any(part in name for part in parts.split()) for name in plain]] = share
        self._legs = np.array([any(part in name for part in ("knee", "ankle", "foot")) for name in plain])
        self._mirrored = False
        self._crossed = np.zeros(2)  # how far the trunk's and the legs' labels are exchanged, 0 to 1
        self._legs_wait = 0.0

    def apply(
        self, at: Array, states: NDArray[np.uint8], front: Array, cosine: float
    ) -> tuple[Array, NDArray[np.uint8]]:
        """The frame as the tracker labels it.

        Args:
            at, states: (J, 3), (J,) with the right labels.
            front: (3,) horizontal unit vector in which the person faces.
            cosine: Between that and the direction to the sensor.
        """
        m = self._mirroring
        if m.back <= 0.0:
            return at, states
        chance, delay = self._random.random(2)
        share = m.share(cosine)
        rate = 1.0 - np.exp(-self._dt / m.seconds)
        if chance < rate * (1.0 - share if self._mirrored else share):
            self._mirrored = not self._mirrored
            self._legs_wait = delay * m.legs_later
        self._legs_wait -= self._dt
        step = self._dt / max(m.crossing_seconds, self._dt)
        target = float(self._mirrored)
        self._crossed[0] += np.clip(target - self._crossed[0], -step, step)
        if self._legs_wait <= 0.0:
            self._crossed[1] += np.clip(target - self._crossed[1], -step, step)
        trunk, legs = self._crossed**2 * (3.0 - 2.0 * self._crossed)
        if max(trunk, legs) == 0.0:
            return at, states
        weight = np.where(self._legs, legs, trunk)
        turned = self._turn_believed(at, front, weight)
        blended = turned + weight[:, None] * (turned[self._body.mirror] - turned)
        return blended, np.where(weight > 0.5, states[self._body.mirror], states)

    def _turn_believed(self, at: Array, front: Array, weight: Array) -> Array:
        """(J, 3) the joints with the offsets to the front that the tracker believes."""
        turned = at.copy()
        for joint in self._body.order[1:]:
            parent = self._body.parents[joint]
            offset = at[joint] - at[parent]
            ahead = offset @ front
            turned[joint] = (
                turned[parent] + offset - 2.0 * weight[joint] * self._believed[joint] * ahead * front
            )
        return turned
