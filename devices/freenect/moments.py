"""Depth and colour of a Kinect v1 joined in time, and its clock, which wraps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from devices.capture.capture_stream import Moment

FPS = 30
TICKS_PER_S = 60_000_000
"""The clock's rate according to libfreenect's driver for OpenNI 2."""
_WRAP = 2**32  # ticks: 72 s
_HALF_PERIOD_TICKS = TICKS_PER_S // FPS // 2


@dataclass(frozen=True, eq=False)
class FreenectMoment(Moment):
    """Depth and colour of nearly one time."""

    depth: NDArray[np.uint16]  # (480, 640) millimetres on the pixels of colour, 0 where there is no reading
    rgb: NDArray[np.uint8] | None  # (480, 640, 3), the image nearest in time; None without one


class TickCounter:
    """Ticks of the sensor's 32-bit clock without its wraps, by this machine's clock."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None

    def total(self, ticks: int, host_ns: int) -> int:
        """The count nearest to what this machine's clock predicts from the call before.

        Frames may be any time apart, and images of two cameras out of order by up to half a wrap.
        """
        total = ticks
        if self._last is not None:
            last, last_ns = self._last
            expected = last + (host_ns - last_ns) * TICKS_PER_S // 1_000_000_000
            total += _WRAP * round((expected - ticks) / _WRAP)
        self._last = total, host_ns
        return total


class MomentJoiner:
    """Joins each depth image with a colour image at most half a period away; no depth image is left out.

    The cameras run by themselves at the same rate, and one clock times both. If the last colour image is too
    old, a depth image waits for the next one, but no longer than for the next depth image.
    """

    def __init__(self) -> None:
        self._counter = TickCounter()
        self._depth: tuple[int, int, NDArray[np.uint16]] | None = None
        self._color: tuple[int, NDArray[np.uint8]] | None = None

    def add_depth(self, ticks: int, host_ns: int, image: NDArray[np.uint16]) -> list[FreenectMoment]:
        """Takes a depth image; returns the moments that are now complete."""
        moments = [] if self._depth is None else [self._moment(None)]
        self._depth = self._counter.total(ticks, host_ns), host_ns, image
        return moments + self._joined()

    def add_color(self, ticks: int, host_ns: int, image: NDArray[np.uint8]) -> list[FreenectMoment]:
        """Takes a colour image; returns the moments that are now complete."""
        self._color = self._counter.total(ticks, host_ns), image
        return self._joined()

    def _joined(self) -> list[FreenectMoment]:
        if self._depth is None or self._color is None:
            return []
        if abs(self._color[0] - self._depth[0]) > _HALF_PERIOD_TICKS:
            return []
        return [self._moment(self._color[1])]

    def _moment(self, rgb: NDArray[np.uint8] | None) -> FreenectMoment:
        assert self._depth is not None
        (total, host_ns, image), self._depth = self._depth, None
        return FreenectMoment(total * 1_000_000_000 // TICKS_PER_S, host_ns, image, rgb)
