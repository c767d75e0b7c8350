"""The contract of every source of skeletons: live, recorded or simulated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton


class DeviceError(Exception):
    """A source cannot give frames. The message states what happened, the value and the way out."""


class AbsentError(DeviceError):
    """The source is not connected. Checking again is cheap, so it may be done often."""


@dataclass(frozen=True, eq=False)
class ColorCamera:
    """The colour camera beside a depth camera.

    Attributes:
        intrinsics: In the mode it runs in.
        color_from_depth: From the depth camera's frame, which is the sensor's, to the colour camera's.
    """

    intrinsics: Intrinsics
    color_from_depth: RigidTransform


@dataclass(frozen=True, eq=False)
class ColorImage:
    """A colour image as the camera compressed it.

    Attributes:
        jpeg: The file; it begins and ends as one does.
        camera: Which camera took it.
    """

    jpeg: bytes
    camera: ColorCamera

    @staticmethod
    def of(jpeg: bytes, camera: ColorCamera) -> ColorImage | None:
        """An image of what a camera gave; None where that was cut off."""
        whole = jpeg.startswith(b"\xff\xd8") and jpeg.rstrip(b"\0").endswith(b"\xff\xd9")
        return ColorImage(jpeg, camera) if whole else None


@dataclass(frozen=True, eq=False)
class SensorFrame:
    """All data of one sensor at one moment.

    Attributes:
        time_ns: Capture time on the sensor's own clock.
        people: The skeletons seen, by the tracker's person id; empty when no one is seen.
        depth: (height, width) uint16 millimetres, 0 where there is no reading; None without a depth image.
        color: The colour image; None without one.
        ir: (height, width) uint16 active infrared, of the depth camera; None without one.
        host_ns: Arrival time of the images on this machine, on ``time.perf_counter_ns``, before body
            tracking. It
        relates the clocks of two sensors. None for a recording.
    """

    time_ns: int
    people: dict[str, Skeleton] = field(default_factory=dict)
    depth: NDArray[np.uint16] | None = None
    color: ColorImage | None = None
    ir: NDArray[np.uint16] | None = None
    host_ns: int | None = None


@dataclass(frozen=True)
class LinkFigures:
    """How the messages of a sensor on another machine arrive, counted since the start.

    Attributes:
        received: Frames that arrived.
        lost: Frames that never arrived.
        malformed: Messages left out because they were damaged or of another program.
        restarts: How often the other program was started anew.
        round_trip_ns: Shortest of the recent round trips; None before the first.
        clock_bound_ns: By how much the relation of the two machines' clocks can be wrong; None if unknown.
    """

    received: int = 0
    lost: int = 0
    malformed: int = 0
    restarts: int = 0
    round_trip_ns: int | None = None
    clock_bound_ns: int | None = None


class Sensor(Protocol):
    """One source of frames. Building one opens nothing; use it as a context manager."""

    @property
    def name(self) -> str:
        """Name for messages: a serial number or a file name."""
        ...

    @property
    def body(self) -> Body:
        """The body that its tracker reports; available once the sensor is open."""
        ...

    @property
    def intrinsics(self) -> Intrinsics | None:
        """Intrinsics of its depth camera; None if unknown."""
        ...

    @property
    def warnings(self) -> Sequence[str]:
        """Problems so far that did not stop the frames, one line each: cut off, damaged, not closed
        cleanly."""
        ...

    def __enter__(self) -> Sensor:
        """Opens the source.

        Raises:
            DeviceError: It cannot be opened.
        """
        ...

    def __exit__(self, *exc_info: object) -> None:
        """Closes the source on every path. Closing twice has no effect."""
        ...

    def frames(self) -> Iterator[SensorFrame]:
        """The frames in capture order, ending when the source ends.

        Raises:
            DeviceError: The source failed; frames before the failure were given.
        """
        ...


@runtime_checkable
class CountsMissed(Protocol):
    """A sensor that counts its frames that never arrived."""

    @property
    def missed(self) -> int:
        """Number of captured frames that never arrived, since the program started."""
        ...


@runtime_checkable
class Interruptible(Protocol):
    """A sensor that may block between frames and can be interrupted."""

    def interrupt(self) -> None:
        """Makes ``frames`` end within a second. Called from another thread; opening resets it."""
        ...


@runtime_checkable
class NamesItsWait(Protocol):
    """A sensor whose opening, first frame or closing may take minutes, and that reports the reason."""

    @property
    def waits_for(self) -> str:
        """What it is waiting for, such as "its body tracker, which loads its network"; else empty."""
        ...


@runtime_checkable
class ArrivesByNetwork(Protocol):
    """A sensor on another machine."""

    @property
    def link(self) -> LinkFigures:
        """How its messages arrive."""
        ...

    def told(self) -> list[str]:
        """What happened to its messages since the last call, one line each. Called from another thread."""
        ...
