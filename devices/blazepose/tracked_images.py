"""A sensor whose people are found by the program's own tracker."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from devices.blazepose.pace import TrackingPace
from devices.blazepose.settings import BlazePoseSettings
from devices.capture.frame_decimation import Newest
from devices.sensor import DeviceError, Sensor, SensorFrame, SensorWrapper
from fusion.body import BLAZEPOSE
from fusion.skeleton import Skeleton

if TYPE_CHECKING:
    from devices.blazepose.blazepose import BlazePose


_OR = "or the same one after a second out of sight"
_Images = tuple[SensorFrame, "NDArray[np.uint8] | None"]
_NAMED = 5  # changes whose times a warning names


class TrackedImages(SensorWrapper):
    """The frames of another sensor with the person that :class:`BlazePose` finds: a Sensor.

    A frame needs depth and infrared of the same pixels, or depth and a colour image registered to it. Other
    frames have no people.
    """

    body = BLAZEPOSE

    def __init__(
        self,
        source: Sensor,
        settings: BlazePoseSettings | None = None,
        *,
        registered: Callable[[SensorFrame], NDArray[np.uint8] | None] | None = None,
        took: Callable[[int], object] = lambda _: None,
        pace: TrackingPace | None = None,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        """Stores the source without opening it.

        Args:
            registered: Gives the (h, w, 3) RGB image of the source's last frame, if it has no infrared, on
                the depth's pixels. None: the frame's colour image, where its camera is the depth camera.
            pace: For live sensors, shared by both: it gets the tracker's times and says which network to
                use. The source, which leaves out the frames that it does not keep, runs on a thread of its
                own, and the newest frame is tracked. None: every frame, one network.
        """
        # OpenCV changes the environment when it is imported; importing this package must not.
        from devices.blazepose.blazepose import BlazePose

        super().__init__(source)
        self.tracker: BlazePose = BlazePose(settings)
        self._registered = registered
        self._took, self._pace, self._clock = took, pace, clock
        self._person = ""  # id of the person seen last
        self._changes: list[int] = []  # times at which another one was followed, ns since the first frame
        self._news: deque[str] = deque()
        self._skipped = 0
        self._newest: Newest[_Images] | None = None  # of live images, while frames are taken

    @property
    def missed(self) -> int:  # type: ignore[override]
        """The source's, and frames of which a newer one came before the tracker was free."""
        return self.source.missed + self._skipped

    @property
    def tracked_by(self) -> str:  # type: ignore[override]
        """The tracker with its network."""
        return f"blazepose {self.tracker.settings.network}"

    @property
    def warnings(self) -> Sequence[str]:  # type: ignore[override]
        """The source's, and when another person was followed."""
        if not self._changes:
            return self.source.warnings
        times = ", ".join(f"{1e-9 * time_ns:.1f} s" for time_ns in self._changes[:_NAMED])
        more = " …" if len(self._changes) > _NAMED else ""
        return [
            *self.source.warnings,
            f"{self.name}: another person is followed, {_OR}, from {times}{more} on.",
        ]

    def take_news(self) -> list[str]:
        """The source's, and that another person is followed."""
        return [*super().take_news(), *(self._news.popleft() for _ in range(len(self._news)))]

    def __enter__(self) -> TrackedImages:
        """Loads the networks, then opens the source."""
        self.tracker.__enter__()
        try:
            self.source.__enter__()
        except BaseException:
            self.tracker.__exit__()
            raise
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self._newest is not None:
            self._newest.close()
        self.source.__exit__(*exc_info)
        self.tracker.__exit__(*exc_info)

    def frames(self) -> Iterator[SensorFrame]:
        """The source's frames with the person in them."""
        images: Iterator[_Images] = self._images()
        if self._pace is None:
            yield from self._tracked(images)
            return
        name = f"images of {self.name}"
        self._newest = Newest(images, name, drop=self._skip, interrupt=self.interrupt)
        try:
            yield from self._tracked(self._newest)
        finally:
            self._newest.close()

    def _tracked(self, images: Iterator[_Images]) -> Iterator[SensorFrame]:
        first_ns: int | None = None
        for frame, registered in images:
            first_ns = frame.time_ns if first_ns is None else first_ns
            if frame.depth is None:
                yield replace(frame, people={})
                continue
            if self._pace is not None and self.tracker.settings.network != self._pace.network:
                try:
                    self.tracker.use(self._pace.network)
                except DeviceError as fault:  # a damaged file must not end the session
                    self._pace.stay(self.tracker.settings.network, fault)
            begun_ns = self._clock()
            people = self._people(frame, registered)
            spent_ns = self._clock() - begun_ns
            self._took(spent_ns)
            if self._pace is not None:
                self._pace.tracked(self.key, spent_ns)
            for person in people:
                if person != self._person and self._person:
                    self._changes.append(frame.time_ns - first_ns)
                    self._news.append(f"{self.name}: another person is followed, {_OR}.")
                self._person = person
            yield replace(frame, people=people)

    def _images(self) -> Iterator[_Images]:
        """The source's frames with their registered images; the source keeps that of its last frame only."""
        for frame in self.source.frames():
            yield frame, None if self._registered is None else self._registered(frame)

    def _skip(self) -> None:
        self._skipped += 1

    def _people(self, frame: SensorFrame, registered: NDArray[np.uint8] | None) -> dict[str, Skeleton]:
        camera = self.source.intrinsics
        if camera is None:
            raise DeviceError(f"{self.name} does not know its depth camera, which the body tracker needs.")
        image = frame.ir if frame.ir is not None else registered
        if image is None and self._registered is None:
            image = registered_color(frame)
        assert frame.depth is not None
        if image is None or image.shape[:2] != frame.depth.shape:
            return {}
        return self.tracker.track(image, frame.depth, camera, frame.time_ns)


def registered_color(frame: SensorFrame) -> NDArray[np.uint8] | None:
    """(h, w, 3) RGB of a frame whose colour camera is its depth camera; None for other frames."""
    color, depth = frame.color, frame.depth
    if color is None or depth is None:
        return None
    lens, move = color.camera.intrinsics, color.camera.color_from_depth
    same_place = np.array_equal(move.rotation, np.eye(3)) and not np.any(move.translation)
    if not same_place or (lens.height, lens.width) != depth.shape:
        return None
    return color.rgb()
