"""The poses and clocks of the two simulated sensors."""

from dataclasses import dataclass

import numpy as np

from devices.sensor import DeviceError
from devices.simulated.streams import Streams
from fusion.rigid import RigidTransform

OfSensors = float | tuple[float, float]
"""One value of both sensors, or those of A and B."""
_DELAYS = 6.0**0.5  # range of a uniform delay, over the standard deviation of the difference of two


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
    roll_deg: OfSensors = (
        0.0  # turn about the line of sight, degrees; positive: clockwise, seen from behind it
    )
    frame_seconds: float = 1.0 / 30.0  # frame interval of each sensor
    skew_seconds: float = 0.00096  # delay of B's captures after A's
    clock_offset_seconds: float = 0.0  # B's clock minus A's clock
    drift_ppm: float = 0.0  # drift of B's clock against A's, parts per million; positive: B's clock is faster
    jitter_seconds: float = 0.0
    """Standard deviation of the time between two stamps of a sensor. A stamp is late by a uniform share of
    time, as where a program takes it when a frame arrives. Eight real recordings of a Kinect v2 have 11 to
    15 ms, with 11 to 22 % of the intervals above 45 ms and 16 to 30 % below 25 ms; 12.7 ms here have 20 % and
    27 %. A sensor that stamps frames itself has none."""
    dropped: float = 0.0  # share of dropped frames, independent for each sensor

    def __post_init__(self) -> None:
        if not 0.0 <= self.angle_deg <= 180.0:
            raise DeviceError(f"The sensors' angle must be from 0 to 180 degrees; got {self.angle_deg:g}.")
        near = min(_of_sensor(self.distance, which) for which in (0, 1))
        if not (near > 0.5 and self.frame_seconds > 0.0 and 0.0 <= self.dropped < 1.0):
            raise DeviceError(
                f"A rig needs distance > 0.5 m, frame_seconds > 0 and 0 <= dropped < 1; got "
                f"{self.distance}, {self.frame_seconds}, {self.dropped}."
            )
        if not 0.0 <= _DELAYS * self.jitter_seconds < self.frame_seconds:
            most = self.frame_seconds / _DELAYS
            raise DeviceError(
                f"jitter_seconds must be below {most:.4f} s, so that stamps rise; got {self.jitter_seconds}."
            )

    def world_from_sensor(self, which: int) -> RigidTransform:
        """The pose of sensor A (0) or B (1). World axes: x left of the person, y down, z backwards."""
        # Sensor A stands on the person's right, at negative x, and is turned towards the person's left.
        yaw = np.radians(self.angle_deg) * (0.5 if which == 0 else -0.5)
        distance, height, tilt, roll = (
            _of_sensor(value, which) for value in (self.distance, self.height, self.tilt_deg, self.roll_deg)
        )
        tilt, roll = np.radians(tilt), np.radians(roll)
        turned = np.array(
            [[np.cos(yaw), 0.0, np.sin(yaw)], [0.0, 1.0, 0.0], [-np.sin(yaw), 0.0, np.cos(yaw)]]
        )
        down = np.array(
            [[1.0, 0.0, 0.0], [0.0, np.cos(tilt), np.sin(tilt)], [0.0, -np.sin(tilt), np.cos(tilt)]]
        )
        rolled = np.array(
            [[np.cos(roll), -np.sin(roll), 0.0], [np.sin(roll), np.cos(roll), 0.0], [0.0, 0.0, 1.0]]
        )
        ahead = turned @ (0.0, 0.0, 1.0)
        return RigidTransform.of(turned @ down @ rolled, -distance * ahead - (0.0, height, 0.0))

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

    def stamp(self, which: int, frame: int, seed: int) -> int:
        """Returns the time that a sensor states for a frame, integer nanoseconds; late by its jitter."""
        seconds = self.captured_at(which, frame)
        if self.jitter_seconds > 0.0:
            late = Streams(seed, which).named("stamps", frame).random()
            seconds += _DELAYS * self.jitter_seconds * late
        return self.clock(which, seconds)


def _of_sensor(value: OfSensors, which: int) -> float:
    return value[which] if isinstance(value, tuple) else value
