"""A movement by name, from a file, or in another place."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from devices.sensor import DeviceError
from devices.simulated.person import anatomy
from devices.simulated.person.captured_motion import read_bvh
from devices.simulated.person.movements import MOTIONS
from fusion.support.types import Array


class Movement(Protocol):
    """A source of landmark positions over time: synthetic or captured motion."""

    @property
    def name(self) -> str:
        """Name of the movement."""
        ...

    def landmarks(self, times: ArrayLike, height: float = ...) -> Array:
        """(T, N, 3) all landmarks in the world, metres."""
        ...


def movement(name: str | Path) -> Movement:
    """A movement of the library by name, or a BVH file.

    Raises:
        DeviceError: There is no such movement or file.
    """
    if str(name) in MOTIONS:
        return MOTIONS[str(name)]
    if str(name).lower().endswith(".bvh"):
        return read_bvh(Path(name))
    raise DeviceError(f"No movement {str(name)!r}. There are {', '.join(MOTIONS)}; or name a .bvh file.")


@dataclass(frozen=True)
class Beside:
    """A movement in another place: the person stands aside, or goes to and fro.

    Attributes:
        motion: The movement at the origin.
        place: (3,) of the origin in the world, metres.
        reach: (3,) metres, amplitude of going to and fro.
        seconds: Of one period.
        later: Seconds by which the movement has gone on at the start.
    """

    motion: Movement
    place: tuple[float, float, float]
    reach: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seconds: float = 9.0
    later: float = 0.0

    @property
    def name(self) -> str:
        return self.motion.name

    def landmarks(self, times: ArrayLike, height: float = anatomy.REFERENCE_HEIGHT) -> Array:
        """(T, N, 3) as :meth:`Movement.landmarks`."""
        at = np.asarray(times, dtype=np.float64)
        marks = self.motion.landmarks(at + self.later, height)
        swing = np.sin(2.0 * np.pi * np.atleast_1d(at) / self.seconds)
        moved: Array = marks + np.array(self.place) + swing[:, None, None] * np.array(self.reach)
        return moved
