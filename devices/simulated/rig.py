"""The poses and clocks of the two simulated sensors."""

from dataclasses import dataclass

import numpy as np

from devices.sensor import DeviceError
from fusion.rigid import RigidTransform
from fusion.support.types import Array

OfSensors = float | tuple[float, float]
"""One value of both sensors, or those of A and B."""


@dataclass(frozen=True)
class Rig:
    """Two sensors on a circle about the world's origin, both looking at the person.

    Sensor A stands to the right of a person of heading zero, B to the left, and the person faces the
    middle between them.
    """

    angle_deg: float = 90.0  # angle between the two lines of sight, seen from above, 0 to 180 degrees
    distance: OfSensors = 2.6  # distance of the sensors from the origin, along the floor, metres
    height: OfSensors = 1.1  # height of the sensors above the floor, metres
    tilt_deg: OfSensors = 4.0  # downward tilt of the sensors, degrees
    roll_deg: OfSensors = 0.0  # about the line of sight, degrees; positive: clockwise from behind
    frame_seconds: float = 1.0 / 30.0  # frame interval of each sensor
    skew_seconds: float = 0.00096  # delay of B's captures after A's

    def __post_init__(self) -> None:
        if not 0.0 <= self.angle_deg <= 180.0:
            raise DeviceError(f"The sensors' angle must be from 0 to 180 degrees; got {self.angle_deg:g}.")
        near = min(_of_sensor(self.distance, which) for which in (0, 1))
        if not (near > 0.5 and self.frame_seconds > 0.0):
            raise DeviceError(
                f"A rig needs distance > 0.5 m and frame_seconds > 0; got "
                f"{self.distance}, {self.frame_seconds}."
            )

    def world_from_sensor(self, which: int) -> RigidTransform:
        """The pose of sensor A (0) or B (1). World axes: x left of the person, y down, z backwards."""
        # Sensor A stands on the person's right, at negative x, and is turned towards the person's left.
        yaw = np.radians(self.angle_deg) * (0.5 if which == 0 else -0.5)
        distance, height, tilt = (
            _of_sensor(value, which) for value in (self.distance, self.height, self.tilt_deg)
        )
        tilt = np.radians(tilt)
        turned = np.array(
            [[np.cos(yaw), 0.0, np.sin(yaw)], [0.0, 1.0, 0.0], [-np.sin(yaw), 0.0, np.cos(yaw)]]
        )
        down = np.array(
            [[1.0, 0.0, 0.0], [0.0, np.cos(tilt), np.sin(tilt)], [0.0, -np.sin(tilt), np.cos(tilt)]]
        )
        ahead = turned @ (0.0, 0.0, 1.0)
        return RigidTransform.of(turned @ down @ self.rolled(which), -distance * ahead - (0.0, height, 0.0))

    def rolled(self, which: int) -> Array:
        """(3, 3) from the frame of a sensor to that of the same sensor without roll."""
        roll = np.radians(_of_sensor(self.roll_deg, which))
        return np.array(
            [[np.cos(roll), -np.sin(roll), 0.0], [np.sin(roll), np.cos(roll), 0.0], [0.0, 0.0, 1.0]]
        )

    @property
    def a_from_b(self) -> RigidTransform:
        """The true pose of K_B in K_A's frame, which registration estimates."""
        return self.world_from_sensor(0).inverse() @ self.world_from_sensor(1)

    def captured_at(self, which: int, frame: int) -> float:
        """Returns the true capture time of frame number ``frame``, in seconds."""
        return frame * self.frame_seconds + (self.skew_seconds if which == 1 else 0.0)

    def stamp(self, which: int, frame: int) -> int:
        """The capture time of a frame as the sensor states it, integer nanoseconds."""
        return round(self.captured_at(which, frame) * 1e9)


def _of_sensor(value: OfSensors, which: int) -> float:
    return value[which] if isinstance(value, tuple) else value
