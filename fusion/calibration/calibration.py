"""A calibration: K_B's pose in K_A's frame, and the bone lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair
from fusion.support.read_only import ReadOnlyArrays

if TYPE_CHECKING:
    from fusion.registration.rigid_fit import Registration

FEWEST_PAIRS = 15
"""Half a second: a calibration on fewer pairs is not trusted."""
GOOD_TURN_DEG, USABLE_TURN_DEG = 2.0, 4.0
"""Largest standard deviations of good and usable rotations: 2° are 17 mm at half a metre."""
POSE_TURN = np.radians(2.3)
"""Of a start-up pose seen in part: largest standard deviation of R without the trackers' turn of the person,
radians."""
VIEWS_APART = {"azure_kinect": 0.05, "kinect_v1": 0.12, "kinect_v2": 0.12, "blazepose": 0.1}
"""Of a pose seen in part, and of movement: by body, the largest median distance of the views, metres. Kinects
v2 reach 0.11 at one moment, and 0.13 to 0.17 0.3 s apart."""
MOVEMENT_TURN, MOVEMENT_SHIFT = np.radians(1.5), 0.06
"""Of movement: largest standard deviations of R, radians, and of t, metres at the person, without lasting
errors of the trackers."""
MOVEMENT_SAME, MOVEMENT_GAIN = np.radians(3.0), 10.0
"""Of movement: largest angle between fits that are one solution, radians; log likelihood by which the best
one must beat the others."""


@dataclass(frozen=True, eq=False)
class Calibration(ReadOnlyArrays):
    """R, t and the bone lengths.

    Attributes:
        body: The body both sensors report.
        a_from_b: R and t. The method ``paper`` renews t in every frame.
        bone_lengths: (J,) metres, by the joint at the bone's far end; 0 at the root.
        how: A short description of the data it was measured on.
        registration: How well the two views agreed; None if the calibration was loaded without it.
        provisional: Whether it only serves until the start-up pose. It then has no data, or a few frames of
            any pose.
        depth_errors: (2,) metres, by how much A and B show joints too far away; ``duplex`` subtracts them.
        person: Whose bones they are: 0 who was calibrated, then 1, 2, … of those who came later.
        placed: Whether the place of B is known, however roughly; where it is not, S* is of A alone.
    """

    body: Body
    a_from_b: RigidTransform
    bone_lengths: NDArray[np.float64]
    how: str
    registration: Registration | None = None
    provisional: bool = False
    depth_errors: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    person: int = 0
    placed: bool = True

    def by_joints(self, a_from_b: RigidTransform, how: str, registration: Registration) -> Calibration:
        """The calibration with R and t of another fit to joints. t then contains the views' depth errors."""
        found = replace(self, a_from_b=a_from_b, how=how, registration=registration, placed=True)
        return replace(found, depth_errors=np.zeros(2)) if self.depth_errors.any() else found

    @property
    def axes_angle(self) -> float:
        """Radians between the two optical axes."""
        return float(np.arccos(np.clip(self.a_from_b.rotation[2, 2], -1.0, 1.0)))

    def angle_about(self, up: NDArray[np.float64]) -> float:
        """Radians between the directions in which the sensors look, about the vertical.

        The axes of tilted sensors have another angle: of two that face each other and look down by 20°, 140°.

        Args:
            up: (3,) unit vector against gravity, in K_A's frame.
        """
        floor = np.eye(3) - np.outer(up, up)
        a, b = floor[:, 2], floor @ self.a_from_b.rotation[:, 2]
        return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def nominal_calibration(body: Body) -> Calibration:
    """A provisional calibration without data: K_B at K_A, an adult's proportions."""
    how = "none yet: an adult's proportions"
    nowhere = RigidTransform.identity()
    return Calibration(body, nowhere, body.nominal_lengths, how, provisional=True, placed=False)


def calibrate(body: Body, pairs: Sequence[SkeletonPair], how: str, *, frontal: bool = False) -> Calibration:
    """Registration (eq. (12)) and bone lengths (eq. (13)) from the given pairs.

    Args:
        frontal: See :func:`fusion.registration.rigid_fit.register`.

    Raises:
        BodyError: A skeleton is of another body.
        CalibrationError: See :func:`fusion.registration.rigid_fit.register`.
    """
    from fusion.calibration.bone_lengths import measure_bone_lengths
    from fusion.registration.rigid_fit import register

    for pair in pairs:
        pair.require(body)
    registration = register(pairs, frontal=frontal)
    lengths = measure_bone_lengths(body, pairs, registration.a_from_b)
    return Calibration(body, registration.a_from_b, lengths, how, registration)
