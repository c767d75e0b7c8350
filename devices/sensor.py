"""The contract of every source of skeletons: live, recorded or simulated."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from math import isfinite
from numbers import Real
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.errors import BodyError, DuplexError
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton


class DeviceError(DuplexError):
    """A source cannot give frames. The message states what happened, the value and what to do."""


class FrameError(BodyError):
    """A sensor's program gives a frame with values of another kind, shape or unit."""


class MissingRecordingError(DeviceError, FileNotFoundError):
    """There is no such file."""


class AbsentError(DeviceError):
    """The source is not connected. Checking again is cheap, so it may be done often."""


Orientation = Literal[0, 90, 180, 270]
"""By how many degrees a sensor is turned clockwise, seen from behind it."""
ORIENTATIONS: tuple[Orientation, ...] = (0, 90, 180, 270)

_JPEG_QUALITY = 90


@dataclass(frozen=True, eq=False)
class ColorCamera:
    """The colour camera beside a depth camera."""

    intrinsics: Intrinsics  # in the mode it runs in
    color_from_depth: RigidTransform
    """From the depth camera's frame, which is the sensor's, to the colour camera's."""


@dataclass(frozen=True, eq=False)
class ColorImage:
    """A compressed colour image."""

    jpeg: bytes  # the file; it begins and ends as one does
    camera: ColorCamera  # which camera took it

    @staticmethod
    def of(jpeg: bytes, camera: ColorCamera) -> ColorImage | None:
        """An image from a camera's data; None if they were cut off."""
        whole = jpeg.startswith(b"\xff\xd8") and jpeg.rstrip(b"\0").endswith(b"\xff\xd9")
        return ColorImage(jpeg, camera) if whole else None

    @staticmethod
    def of_rgb(rgb: NDArray[np.uint8], camera: ColorCamera) -> ColorImage:
        """An image of (height, width, 3) RGB pixels, from a sensor that does not compress them."""
        import cv2  # it changes the environment; importing this package must not

        _, jpeg = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        return ColorImage(jpeg.tobytes(), camera)

    def rgb(self) -> NDArray[np.uint8] | None:
        """(height, width, 3) RGB pixels; None if the file is damaged."""
        import cv2

        image = cv2.imdecode(np.frombuffer(self.jpeg, np.uint8), cv2.IMREAD_COLOR)
        return None if image is None else cv2.cvtColor(image, cv2.COLOR_BGR2RGB).astype(np.uint8, copy=False)


@dataclass(frozen=True, eq=False, slots=True, weakref_slot=True)
class SensorFrame:
    """All data of one sensor at one moment.

    Attributes:
        time_ns: Capture time on the sensor's own clock.
        people: The skeletons seen, by the tracker's person id; empty when no one is seen.
        depth: (height, width) uint16 millimetres, 0 where there is no reading; None without a depth image.
        color: The colour image; None without one.
        ir: (height, width) uint16 active infrared, of the depth camera; None without one.
        host_ns: Arrival time of the images on this machine, on ``time.perf_counter_ns``, before body
            tracking. It relates the clocks of two sensors. None for a recording.

    Raises:
        FrameError: A value is of another kind, such as depth in metres.
    """

    time_ns: int
    people: dict[str, Skeleton] = field(default_factory=dict)
    depth: NDArray[np.uint16] | None = None
    color: ColorImage | None = None
    ir: NDArray[np.uint16] | None = None
    host_ns: int | None = None

    def __post_init__(self) -> None:
        time_ns: Any = self.time_ns
        people: Any = self.people
        if not isinstance(time_ns, Real) or not isfinite(time_ns):
            raise FrameError(f"A frame's time_ns is nanoseconds; got {time_ns!r}.")
        if not isinstance(people, dict):
            raise FrameError(f"A frame's people are a dict; got a {type(people).__name__}.")
        for name, person in people.items():
            if not isinstance(name, str):
                raise FrameError(f"A frame's people are by an id, a str; got {name!r}.")
            if not isinstance(person, Skeleton):
                got = type(person).__name__
                raise FrameError(f"A frame's people are made by Skeleton.of; got a value of type {got}.")
        images: tuple[tuple[str, Any, str], ...] = ("depth", self.depth, " millimetres"), ("ir", self.ir, "")
        for name, image, unit in images:
            array = isinstance(image, np.ndarray)
            if image is not None and (not array or image.dtype != np.uint16 or image.ndim != 2):
                got = f"{image.shape} {image.dtype}" if array else f"a {type(image).__name__}"
                raise FrameError(f"A frame's {name} is (height, width) uint16{unit}; got {got}.")


@dataclass(frozen=True)
class LinkFigures:
    """How the messages of a sensor on another machine arrive, counted since the start."""

    received: int = 0  # frames that arrived
    lost: int = 0  # frames that never arrived
    malformed: int = 0  # messages left out because they were damaged or of another program
    restarts: int = 0  # how often the other program was started anew
    round_trip_ns: int | None = None  # shortest of the recent round trips; None before the first
    clock_bound_ns: int | None = None
    """By how much the relation of the two machines' clocks can be wrong; None if unknown."""


class Sensor:
    """A source of frames; derive your own from it. Creating one opens nothing: use it as a context manager.

    Attributes:
        name: Name for messages: a serial number or a file name.
        body: The body that its tracker reports; available once the sensor is open.
        intrinsics: Intrinsics of its depth camera; None if unknown.
        depth_offset: Metres by which its depth camera shows all things too far away, as published.
        warnings: Problems so far that did not stop the frames, one line each: cut off, damaged, not closed
            cleanly.
        missed: Number of captured frames that never arrived, since the program started.
        lost: Number of captured frames that were lost on USB.
        waits_for: What opening, the first frame or closing waits for if that may take minutes, such as "its
            body tracker, which loads its network"; else empty.
        tracked_by: The body tracker that finds its people, as a session records it; else empty.
        link: How the messages of a sensor on another machine arrive; None for a local sensor.
        recorded: Whether it plays a recording. A failure then ends it, and is not blamed on cables or power.
        simulated: Whether this machine makes its frames, so that only this machine can be too slow for them.
    """

    name: str
    body: Body
    intrinsics: Intrinsics | None = None
    depth_offset: float = 0.0
    warnings: Sequence[str] = ()
    missed: int = 0
    lost: int = 0
    waits_for: str = ""
    tracked_by: str = ""
    link: LinkFigures | None = None
    recorded: bool = False
    simulated: bool = False

    @property
    def key(self) -> Hashable:
        """Distinguishes it from the other sensors of a session, which may have the same name."""
        return self.name

    def __enter__(self) -> Self:
        """Opens the source.

        Raises:
            DeviceError: It cannot be opened.
        """
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Closes the source on every path. Closing twice has no effect."""

    def frames(self) -> Iterator[SensorFrame]:
        """The frames in capture order, ending when the source ends.

        Raises:
            DeviceError: The source failed; frames before the failure were yielded.
        """
        raise NotImplementedError

    def interrupt(self) -> None:
        """Makes ``frames`` end within a second if it blocks between frames; opening resets it.

        Called from another thread.
        """

    def take_news(self) -> list[str]:
        """News for the user since the last call, one line each. Called from another thread."""
        return []


@dataclass(frozen=True)
class CableSync:
    """How a sensor was synchronised."""

    mode: str  # ``STANDALONE``, ``MASTER`` or ``SUBORDINATE``
    delay_ns: int  # of a subordinate's captures after the master's


IMAGE_SUFFIXES = MKV, BAG, DB3 = ".mkv", ".bag", ".db3"
"""Of recordings of images: Azure Kinect; Orbbec, and RealSense of ROS 1; RealSense of ROS 2."""


class ImageRecording(Sensor):
    """A file with a sensor's images; its frames have no people.

    Attributes:
        path: The file.
        warnings: Faults of a file that is still readable: cut off, damaged frames.
        duration_ns: How long it is, as the file says; 0 before opening, and where the file does not say.
        interval_ns: Time between two frames; 0 before opening.
        sensor: Which one and its modes, in words; empty if the file does not say.
        sync: Known once it is open; None if the file does not say.
        arrivals: Capture time and arrival of the frames given so far, where the file has arrivals.
    """

    path: Path
    duration_ns: int = 0
    interval_ns: int = 0
    sensor: str = ""
    sync: CableSync | None = None
    arrivals: Sequence[tuple[int, int]] = ()


def _of_source(attribute: str) -> Any:
    """A property that returns the wrapped sensor's attribute of that name."""
    default = getattr(Sensor, attribute, None)
    return property(lambda wrapper: getattr(wrapper.source, attribute, default))


class SensorWrapper(Sensor):
    """A sensor that passes on another one's frames, changed or at other times.

    Args:
        source: The other sensor; its name, body, camera, warnings and counts are this one's. It may be of a
            class that is not derived from ``Sensor`` and lacks the attributes that have a default there.
    """

    def __init__(self, source: Sensor) -> None:
        self.source = source

    name = _of_source("name")
    body = _of_source("body")
    intrinsics = _of_source("intrinsics")
    depth_offset = _of_source("depth_offset")
    warnings = _of_source("warnings")
    missed = _of_source("missed")
    lost = _of_source("lost")
    waits_for = _of_source("waits_for")
    tracked_by = _of_source("tracked_by")
    link = _of_source("link")
    recorded = _of_source("recorded")
    simulated = _of_source("simulated")

    @property
    def key(self) -> Hashable:
        key: Hashable = getattr(self.source, "key", self.name)
        return key

    def __enter__(self) -> Self:
        self.source.__enter__()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.source.__exit__(*exc_info)

    def frames(self) -> Iterator[SensorFrame]:
        return self.source.frames()

    def interrupt(self) -> None:
        """Interrupts the source, if it can be."""
        getattr(self.source, "interrupt", lambda: None)()

    def take_news(self) -> list[str]:
        return list(getattr(self.source, "take_news", list)())
