"""Notices recorded skeletons whose unit or axes are not those of this program."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError, SensorFrame
from fusion.body import Body
from fusion.skeleton import FARTHEST

_MILLIMETRES = 400.0
"""A median distance above this is of millimetres, else of centimetres: people stand 1 to 5 m away."""
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
