"""What ``duplex demo`` shows: where its sensors stand, what the person does, and which moments are hard.

The benchmarks use ``Rig()`` and the movements as they are; nothing here changes those.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from devices.depth.image_thinning import Depth
from devices.simulated.kinect import Beside, Movement, Scene, SimulatedKinect, Truth, movement
from devices.simulated.person import anatomy
from devices.simulated.person.gait import walking
from devices.simulated.person.motion import STARTUP_SECONDS
from devices.simulated.real_time import Beat, PacedSensor
from devices.simulated.rig import Rig
from devices.simulated.tracking.scripted_faults import ScriptedFaults, Spells
from fusion.body import KINECT_V1, Body
from fusion.support.types import Array

_HEIGHT, _TILT_DEG = 1.2, 5.0  # metres, degrees
_DISTANCE, _DISTANCE_V1 = 2.9, 3.2  # metres
"""The middle between the nearest distance at which a tall person fits into the image and the farthest that
the sensor measures, so that every movement stays between the two. A Kinect v1 has the narrowest image."""
BAD_ANGLE_DEG = 30.0
_BAD_DISTANCE, _BAD_HEIGHT = 1.3, 1.5  # metres: too close, and too high to see the feet without a tilt

_PERIOD_S, _LEAD_S = 10.0, 1.0
_EVERY = 8.0  # seconds: one round of the badminton
MISPLACED = Spells(7.0, 1.2, _EVERY)
"""The left arm in A's view. In badminton, the lunge: A stands on the right, so the trunk hides that arm."""
MIRRORED = Spells(4.4, 1.0, _EVERY)
"""The whole person in B's view. In badminton, the wind-up: the back is half turned to B."""


def therapist(does: Literal["walks", "sits"] = "walks") -> Movement:
    """Another one, who hides the person and is hidden.

    Walks behind the person to and fro, and past them in both views; or sits down between them and A, and
    stands up again.
    """
    if does == "sits":
        return Beside(movement("sit"), (-0.45, 0.0, -1.1))
    return Beside(walking("walk", length=8.4, strides=10), (0.0, 0.0, 1.3), later=STARTUP_SECONDS)


@dataclass(frozen=True)
class HardMoment:
    """Something that a tracker does wrong in the demonstration."""

    starts: Sequence[float]  # when it starts, seconds; each lasts for about one second
    fault: str  # what happens, a clause about the sensor


@dataclass(frozen=True)
class Demonstration:
    """Two simulated sensors, the truth, and what to look at."""

    a: SimulatedKinect
    b: SimulatedKinect
    truth: Truth
    moments: Sequence[HardMoment]


def good_rig(body: Body, angle_deg: float = 90.0) -> Rig:
    """Two well placed sensors: a person is in both images and at a good distance in every movement."""
    distance = _DISTANCE_V1 if body is KINECT_V1 else _DISTANCE
    return Rig(angle_deg=angle_deg, distance=distance, height=_HEIGHT, tilt_deg=_TILT_DEG)


def bad_rig() -> Rig:
    """Two badly placed sensors: too close, too high to see the feet, and side by side."""
    return Rig(angle_deg=BAD_ANGLE_DEG, distance=_BAD_DISTANCE, height=_BAD_HEIGHT, tilt_deg=0.0)


def demonstrated(name: str | Path) -> Movement:
    """A movement of the library by name, or a BVH file.

    The walk is as fast as that of the library, on shorter loops: those leave the range of a Kinect v1, which
    is 1.6 m deep.
    """
    return walking("walk", length=6.0, strides=7) if str(name) == "walk" else movement(name)


def demonstration(
    scene: Scene,
    *,
    angle_deg: float = 90.0,
    depth: Depth = "none",
    infrared: bool = False,
    bad_setup: bool = False,
) -> Demonstration:
    """The sensors of ``duplex demo``."""
    body, seconds = scene.body, scene.seconds or 0.0
    rig = bad_rig() if bad_setup else good_rig(body, angle_deg)
    scripts: tuple[ScriptedFaults | None, ScriptedFaults | None] = (None, None)
    moments: tuple[HardMoment, ...] = ()
    if not bad_setup:
        scripts = ScriptedFaults(body, misplaced=(MISPLACED,)), ScriptedFaults(body, mirrored=(MIRRORED,))
        moments = (
            HardMoment(MISPLACED.starts_before(seconds), "Kinect A loses the left arm"),
            HardMoment(MIRRORED.starts_before(seconds), "Kinect B exchanges left and right"),
        )
    a, b = (
        SimulatedKinect(scene, rig, which, depth=depth, infrared=infrared, script=script)
        for which, script in enumerate(scripts)
    )
    return Demonstration(a, b, Truth(scene, rig), tuple(moment for moment in moments if moment.starts))


class _ToAndFro:
    """A movement that is played forward for 10 s, then backward, for ever, in step with the wall clock.

    Backward, so that it has no jump, and begins and ends in the start-up pose.
    """

    def __init__(self, movement: Movement, begins_s: float) -> None:
        self.name = movement.name
        self._movement, self._begins_s = movement, begins_s

    def landmarks(self, times: ArrayLike, height: float = anatomy.REFERENCE_HEIGHT) -> Array:
        """(T, N, 3) all landmarks in the world, metres."""
        seconds = np.mod(np.asarray(times, dtype=np.float64) + self._begins_s, 2.0 * _PERIOD_S)
        return self._movement.landmarks(_PERIOD_S - np.abs(seconds - _PERIOD_S), height)


def sensor_by_wall_clock(which: int, movement: Movement, body: Body) -> PacedSensor:
    """A simulated sensor whose person moves by the wall clock: two programs see the same person."""
    scene = Scene(_ToAndFro(movement, time.time() + _LEAD_S), body)
    beat = Beat(begins_s=time.perf_counter() + _LEAD_S)
    return PacedSensor(SimulatedKinect(scene, good_rig(body), which), beat)
