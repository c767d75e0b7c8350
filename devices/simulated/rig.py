"""The poses and clocks of the two simulated sensors."""

from dataclasses import dataclass

import numpy as np

from devices.sensor import DeviceError
from fusion.rigid import RigidTransform


@dataclass(frozen=True)
class Rig:
    """Two sensors on a circle about the world's origin, both looking at the person.

    Sensor A stands to the right of a person of heading zero, B to the left, and the person faces the
    middle between them.
    """

    angle_deg: float = 90.0  # angle between the two lines of sight, seen from above, 0 to 180 degrees
    distance: float = 2.6  # distance of the sensors from the origin, along the floor, metres
    height: float = 1.1  # height of the sensors above the floor, metres
    tilt_deg: float = 4.0  # downward tilt of the sensors, degrees
    frame_seconds: float = 1.0 / 30.0  # frame interval of each sensor
    skew_seconds: float = 0.00096  # delay of B's captures after A's
    clock_offset_seconds: float = 0.0  # B's clock minus A's clock
    drift_ppm: float = 0.0  # drift of B's clock against A's, parts per million; positive: B's clock is faster
    dropped: float = 0.0  # share of dropped frames, independent for each sensor

    def __post_init__(self) -> None:
        if not 0.0 <= self.angle_deg <= 180.0:
            raise DeviceError(f"The sensors' angle must be from 0 to 180 degrees; got {self.angle_deg:g}.")
        if not (self.distance > 0.5 and self.frame_seconds > 0.0 and 0.0 <= self.dropped < 1.0):
            raise DeviceError(
                f"A rig needs distance > 0.5 m, frame_seconds > 0 and 0 <= dropped < 1; got "
                f"{self.distance}, {self.frame_seconds}, {self.dropped}."
            )

    def world_from_sensor(self, which: int) -> RigidTransform:
        """The pose of sensor A (0) or B (1). World axes: x left of the person, y down, z backwards."""
        # Sensor A stands on the person's right, at negative x, and is turned towards the person's left.
        yaw = np.radians(self.angle_deg) * (0.5 if which == 0 else -0.5)
        tilt = np.radians(self.tilt_deg)
        turned = np.array(
            [[np.cos(yaw), 0.0, np.sin(yaw)], [0.0, 1.0, 0.0], [-np.sin(yaw), 0.0, np.cos(yaw)]]
        )
        down = np.array(
            [[1.0, 0.0, 0.0], [0.0, np.cos(tilt), np.sin(tilt)], [0.0, -np.sin(tilt), np.cos(tilt)]]
        )
        ahead = turned @ (0.0, 0.0, 1.0)
        return RigidTransform.of(turned @ down, -self.distance * ahead - (0.0, self.height, 0.0))

    @property
    def a_from_b(self) -> RigidTransform:
        """The true pose of K_B in K_A's frame, which registration estimates."""
        return self.world_from_sensor(0).inverse() @ self.world_from_sensor(1)

    def captured_at(self, which: int, frame: int) -> float:
        """Returns the true capture time of frame number ``frame``, in seconds."""
        return frame * self.frame_seconds + (self.skew_seconds if which == 1 else 0.0)

    def clock(self, which: int, seconds: float) -> int:
        """Returns the reading of the sensor's clock at a true time, integer nanoseconds."""
        if which == 1:
            seconds = seconds * (1.0 + 1e-6 * self.drift_ppm) + self.clock_offset_seconds
        return round(seconds * 1e9)
