"""Notices recorded skeletons whose units or axes are not those of this program."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError, SensorFrame
from fusion.body import Body
from fusion.skeleton import FARTHEST

_MILLIMETRES = 400.0
"""A median distance above this is of millimetres, else of centimetres: people stand 1 to 5 m away."""
_SHORTEST_US, _LONGEST_US = 2_000.0, 5_000_000.0
"""Sensors give 5 to 120 frames per second; in milliseconds or nanoseconds the numbers are far outside."""
_FEWEST_TIMES = 3
_UPSIDE_DOWN_M = 0.3
_ALMOST_ALWAYS = 0.9
_SAMPLES = 200


def check_metres_forward(name: object, xyz: NDArray[np.float64]) -> None:
    """Refuses positions in another unit, or with a z axis that points backward.

    Args:
        name: Of the recording, for the message.
        xyz: (N, 3) positions of joints as the file has them; NaN where there is none.

    Raises:
        DeviceError: Most joints are farther away than any sensor sees, or behind the sensor.
    """
    known = xyz[np.isfinite(xyz).all(axis=1)]
    if len(known) == 0:
        return
    distance = float(np.median(np.abs(known).max(axis=1)))
    if distance > FARTHEST:
        unit = "millimetres" if distance > _MILLIMETRES else "centimetres"
        raise DeviceError(
            f"{name}: the joints are {distance:.0f} m away (median). Positions must be metres; are these "
            f"{unit}?"
        )
    if np.median(known[:, 2]) < 0.0:
        raise DeviceError(
            f"{name}: most joints have a negative z. The z axis must point forward, towards the person."
        )


def check_microseconds(name: object, times_us: NDArray[np.int64]) -> None:
    """Refuses capture times in another unit.

    Args:
        name: Of the recording, for the message.
        times_us: (T,) capture times in order, as the file has them.

    Raises:
        DeviceError: The median interval is no sensor's.
    """
    if len(times_us) < _FEWEST_TIMES:
        return
    interval = float(np.median(np.diff(times_us)))
    if not _SHORTEST_US <= interval <= _LONGEST_US:
        unit = "milliseconds" if interval < _SHORTEST_US else "nanoseconds"
        raise DeviceError(
            f"{name}: the frames are {interval:g} µs apart (median). time_us must be microseconds; are these "
            f"{unit}?"
        )


def upside_down(name: str, body: Body, frames: Sequence[SensorFrame]) -> list[str]:
    """A warning, if the person's head is below the feet in almost every frame."""
    people = [
        skeleton.positions
        for frame in frames[:: max(1, len(frames) // _SAMPLES)]
        for skeleton in frame.people.values()
    ]
    if not people:
        return []
    y = np.stack(people)[:, :, 1]
    below = y[:, body.joint("head")] - np.minimum(
        y[:, body.joint("ankle left")], y[:, body.joint("ankle right")]
    )
    known = below[np.isfinite(below)]
    if len(known) == 0 or np.mean(known > _UPSIDE_DOWN_M) <= _ALMOST_ALWAYS:
        return []
    return [
        f"{name}: the head is below the feet in almost every frame. The y axis must point down; if it points "
        "up, change the sign of y."
    ]
