"""Simulated sensors in separate programs that see the same person: the scene follows the wall clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from devices.simulated.demonstration import good_rig
from devices.simulated.kinect import Movement, Scene, SimulatedKinect
from devices.simulated.person import anatomy
from devices.simulated.person.anatomy import Array
from devices.simulated.real_time import Beat, PacedSensor
from fusion.body import AZURE_KINECT, Body

_PERIOD_S = 10.0
_LEAD_S = 1.0


class ToAndFro:
    """A movement that is played forward for 10 s, then backward, for ever, in step with the wall clock.

    Backward, so that it has no jump, and begins and ends in the start-up pose.

    Args:
        movement: The movement.
        begins_s: The wall clock's time at time 0, seconds since 1970.
    """

    def __init__(self, movement: Movement, begins_s: float) -> None:
        self.name = movement.name
        self._movement, self._begins_s = movement, begins_s

    def landmarks(self, times: ArrayLike, height: float = anatomy.REFERENCE_HEIGHT) -> Array:
        """(T, N, 3) all landmarks in the world, metres."""
        at = np.mod(np.asarray(times, dtype=np.float64) + self._begins_s, 2.0 * _PERIOD_S)
        return self._movement.landmarks(_PERIOD_S - np.abs(at - _PERIOD_S), height)


class _BeginsAt(Beat):
    """Starts a sensor at a given time of its clock, seconds."""

    def __init__(self, begins_s: float) -> None:
        super().__init__()
        self._begins_s = begins_s

    def begin(self, clock: Callable[[], float], stopping: threading.Event) -> float:
        del clock, stopping
        return self._begins_s


def sensor_by_wall_clock(
    which: int, movement: Movement, body: Body = AZURE_KINECT, *, angle_deg: float = 90.0
) -> PacedSensor:
    """A simulated sensor whose person moves by the wall clock.

    Args:
        which: 0 for sensor A, 1 for B.
        movement: What the person does.
        body: What the tracker reports.
        angle_deg: Between the two sensors.
    """
    begins_s = time.time() + _LEAD_S
    rig = good_rig(body, angle_deg)
    scene = Scene(ToAndFro(movement, begins_s), body)
    beat = _BeginsAt(time.perf_counter() + _LEAD_S)
    return PacedSensor(SimulatedKinect(scene, rig, which), beat)
