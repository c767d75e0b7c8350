"""Mirroring: the tracker reports a person whose back is turned as facing the sensor, with sides exchanged.

The tracker of a Kinect v2 assumes that the person faces it. Joints stay where the depth image shows them, but
their labels are exchanged. Joints that depth hardly shows follow the wrong facing: feet point to the sensor.
The tracker changes its labels smoothly while the person turns through profile. Left and right joints move
through each other within some tenths of a second, the legs often later than the trunk.

Shoulders and hips also face the sensor more than the person does: a person in profile is reported at 55° to
70°. Arms and legs follow in part, so that two views of a standing person put the sensors too close together.
From behind, the axis of shoulders and hips is either right, with exchanged labels, or folded: a person at
150° is reported at 30° rather than at −30°.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.joint_kinds import by_joint, of_kind
from fusion.support.types import Array

_TURNED = {
    "spine": 0.0, "head": 0.0, "girdle": 0.0, "elbow": 0.35, "wrist": 0.5, "hand": 0.3, "tip": 0.3,
    "thumb": 0.6, "knee": 0.1, "ankle": 0.0, "foot": 0.9, "face": 0.9,
}  # fmt: skip
"""Share of a joint's offset from its parent, along the front, that is turned to the back, by kind."""
_FOLLOWS = {
    "spine": 0.0, "head": 0.0, "girdle": 1.0, "elbow": 0.65, "wrist": 0.4, "hand": 0.4, "tip": 0.4,
    "thumb": 0.4, "knee": 0.5, "ankle": 0.4, "foot": 0.4, "face": 0.0,
}  # fmt: skip
_HIPS_FOLLOW = 1.5
"""Share of the shoulders' turn towards the sensor by which left and right of a kind of joint turn: medians
over two views of five real people who stand or step, 45° and 90° apart; of hands and feet that of the next
joint."""
_SIDES = "Left", "Right"
_TRUE, _REPORTED = np.radians((0.0, 40.0, 80.0, 120.0, 180.0)), np.radians((0.0, 33.0, 56.0, 68.0, 80.0))
"""Angle between the person's front and the sensor, and the one that shoulders and hips show."""


@dataclass(frozen=True)
class Mirroring:
    """The frequency and form of mirroring. The default has no mirroring.

    The values for the Kinect v2 were measured on five real walks of three people with
    ``python -m tests.experiments.facing``. The share of mirrored frames depends on the cosine between the
    person's front and the direction to the sensor: 0 % above 0, 2 % at −0.1, 16 % at −0.4, 63 % at −0.6,
    93 % at −0.8 and 99 % at −1. The share for the Azure Kinect is an upper
    bound: three real ones around a man in a T-pose who turned never reported him mirrored.

    The angles that shoulders and hips show were measured on the straight parts of the same walks, the first
    on people who stand.
    """

    back: float = 0.0  # share of mirrored frames when the back is turned
    centre: float = -0.55  # cosine at which the share is half of ``back``
    width: float = 0.10  # of the logistic step
    seconds: float = 0.12  # time constant with which the share is reached
    crossing_seconds: float = 0.25  # duration of a change of labels
    legs_later: float = 0.5  # largest delay of the legs after the trunk, seconds; drawn uniformly
    faces_sensor: float = 0.0
    """How much of the angle by which shoulders and hips face the sensor more than the person does, and of the
    folding from behind, is applied; 0 to 1."""
    heading_sd: float = 0.0
    """Standard deviation of the heading of shoulders and hips, radians, where ``faces_sensor`` is above 0."""
    folded: float = 0.5  # share of changes to mirrored labels after which the axis is folded

    def share(self, cosine: float) -> float:
        """Returns the share of mirrored frames; ``cosine`` is between front and direction to the sensor."""
        return float(self.back / (1.0 + np.exp((cosine - self.centre) / self.width)))


class MirroringTracker:
    """Applies mirroring to the frames of one tracker.

    Args:
        random: A separate generator; every frame draws the same number of values.
    """

    def __init__(
        self, body: Body, mirroring: Mirroring, frame_seconds: float, random: np.random.Generator
    ) -> None:
        self._body, self._mirroring, self._dt, self._random = body, mirroring, frame_seconds, random
        self._turned = by_joint(body, _TURNED)
        self._legs = of_kind(body, "knee", "ankle", "foot")
        hips, shoulders = ([body.joint(f"{name}{side}") for side in _SIDES] for name in ("Hip", "Shoulder"))
        self._follows = by_joint(body, _FOLLOWS)
        self._follows[hips] = _HIPS_FOLLOW
        self._girdles = np.zeros(len(body))
        self._girdles[[*hips, *shoulders]] = 1.0
        # Coefficients of the waves of the angle to the sensor: the error lasts as long as the pose.
        self._heading_error = random.standard_normal(4) / np.sqrt(2.0)
        self._folded = False
        self._mirrored = False
        self._crossed = np.zeros(2)  # progress of the exchange of the trunk's and the legs' labels, 0 to 1
        self._legs_wait = 0.0

    def apply(
        self, at: Array, states: NDArray[np.uint8], front: Array, angle: float, told: bool = False
    ) -> tuple[Array, NDArray[np.uint8]]:
        """Returns the frame with the labels of the tracker.

        Args:
            at, states: (J, 3) positions and (J,) states with correct labels.
            front: (3,) horizontal unit vector of the direction that the person faces.
            angle: From the direction to the sensor to ``front``, radians about the sensor's y axis.
            told: Whether to mirror the person whatever the chance.
        """
        m = self._mirroring
        chance, delay, folds = self._random.random(3)
        share = m.share(np.cos(angle))
        rate = 1.0 - np.exp(-self._dt / m.seconds)
        if chance < rate * (1.0 - share if self._mirrored else share):
            self._mirrored = not self._mirrored
            self._legs_wait = delay * m.legs_later
            self._folded = bool(folds < m.folded) and self._mirrored
        if told:
            self._mirrored, self._legs_wait = True, 0.0
        self._legs_wait -= self._dt
        step = self._dt / max(m.crossing_seconds, self._dt)
        target = float(self._mirrored)
        self._crossed[0] += np.clip(target - self._crossed[0], -step, step)
        if self._legs_wait <= 0.0:
            self._crossed[1] += np.clip(target - self._crossed[1], -step, step)
        trunk, legs = self._crossed**2 * (3.0 - 2.0 * self._crossed)
        at = self._turn_pairs(at, angle, trunk)
        if max(trunk, legs) == 0.0:
            return at, states
        weight = np.where(self._legs, legs, trunk)
        turned = self._turn_offsets(at, front, weight)
        blended = turned + weight[:, None] * (turned[self._body.mirror] - turned)
        return blended, np.where(weight > 0.5, states[self._body.mirror], states)

    def _turn_pairs(self, at: Array, angle: float, mirrored: float) -> Array:
        """Returns (J, 3) the joints, each pair of left and right at the angle that the tracker reports."""
        m = self._mirroring
        if m.faces_sensor == 0.0:
            return at
        seen = np.sign(angle) * (np.interp(abs(angle), _TRUE, _REPORTED) - abs(angle))
        folded = 2.0 * np.sign(angle) * (np.pi - abs(angle)) if self._folded else 0.0
        waves = np.cos(angle), np.sin(angle), np.cos(2.0 * angle), np.sin(2.0 * angle)
        of_girdles = m.faces_sensor * mirrored * folded + m.heading_sd * float(self._heading_error @ waves)
        turn = m.faces_sensor * (1.0 - mirrored) * seen * self._follows + of_girdles * self._girdles
        less, sine = np.cos(turn) - 1.0, np.sin(turn)
        x, y, z = 0.5 * (at - at[self._body.mirror]).T
        return np.asarray(at + np.stack((less * x + sine * z, 0.0 * y, less * z - sine * x), axis=1))

    def _turn_offsets(self, at: Array, front: Array, weight: Array) -> Array:
        """Returns (J, 3) the joints with their offsets along the front turned as the tracker assumes."""
        turned = at.copy()
        for joint in self._body.order[1:]:
            parent = self._body.parents[joint]
            offset = at[joint] - at[parent]
            share = 2.0 * weight[joint] * self._turned[joint]
            turned[joint] = turned[parent] + offset - share * (offset @ front) * front
        return turned
