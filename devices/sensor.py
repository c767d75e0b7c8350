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
    """A source that cannot give frames: what happened, the value, the way out."""


class AbsentError(DeviceError):
    """The source is not connected. Asking again costs nothing, so it may be asked often."""


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
    """Everything one sensor says about one moment.

    Attributes:
        time_ns: Capture time on the sensor's own clock.
        people: The skeletons seen, by the tracker's person id; empty when no one is seen.
        depth: (height, width) uint16 millimetres, 0 where there is no reading; None without a depth image.
        color: The colour image; None without one.
        ir: (height, width) uint16 active infrared, of the depth camera; None without one.
        host_ns: When the images reached this machine, on ``time.perf_counter_ns``, before any body
            tracking: what relates two sensors' clocks. None for a recording.
    """

    time_ns: int
    people: dict[str, Skeleton] = field(default_factory=dict)
    depth: NDArray[np.uint16] | None = None
    color: ColorImage | None = None
    ir: NDArray[np.uint16] | None = None
    host_ns: int | None = None


class Sensor(Protocol):
    """One source of frames. Building one opens nothing; use it as a context manager."""

    @property
    def name(self) -> str:
        """What to call it in messages: a serial number, a file name."""
        ...

    @property
    def body(self) -> Body:
        """The body its tracker reports; known once it is open."""
        ...

    @property
    def intrinsics(self) -> Intrinsics | None:
        """Of its depth camera; None where the source does not say."""
        ...

    @property
    def warnings(self) -> Sequence[str]:
        """What is wrong so far although frames came: cut off, damaged, not closed cleanly. A line each."""
        ...

    def __enter__(self) -> Sensor:
        """Opens the source.

        Raises:
            DeviceError: It cannot be opened.
        """
        ...

    def __exit__(self, *exc_info: object) -> None:
        """Closes the source, on every path; closing twice is harmless."""
        ...

    def frames(self) -> Iterator[SensorFrame]:
        """The frames in capture order, ending when the source ends.

        Raises:
            DeviceError: The source failed; frames before the failure were given.
        """
        ...


@runtime_checkable
class CountsMissed(Protocol):
    """A sensor that knows how many of its frames never reached us."""

    @property
    def missed(self) -> int:
        """How many it captured between frames that came, since the program began."""
        ...


@runtime_checkable
class Interruptible(Protocol):
    """A sensor that may wait long between frames, and can be asked to stop waiting."""

    def interrupt(self) -> None:
        """Makes ``frames`` end soon, within a second. Called from another thread; opening undoes it."""
        ...


@runtime_checkable
class NamesItsWait(Protocol):
    """A sensor whose opening, first frame or closing may take minutes, and that can say why."""

    @property
    def waits_for(self) -> str:
        """What it waits for now, as in "its body tracker, which loads its network"; empty for nothing."""
        ...
