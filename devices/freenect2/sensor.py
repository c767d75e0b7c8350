"""Kinect v2 (Xbox One, Kinect for Windows v2) live, several on one PC, through libfreenect2."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from devices.capture.capture_stream import CaptureStream, LiveSensor
from devices.capture.clock.moments import ImageJoiner, Moment
from devices.capture.settings import CaptureSettings
from devices.freenect2.library import SHAPE, Camera
from devices.sensor import DeviceError, SensorFrame
from fusion.intrinsics import Intrinsics

_FPS = 30
_TICK_NS = 125_000


class _Freenect2Stream(CaptureStream):
    """The moments of a running camera."""

    def __init__(self, camera: Camera, sensor: Freenect2Sensor) -> None:
        super().__init__(f"Kinect v2 {sensor.name}", sensor, ImageJoiner(round(1e9 / _FPS)))
        self._camera, self._ticks = camera, 0

    def receive(self, timeout_ms: int) -> bool:
        """Takes the oldest depth and infrared that wait."""
        images = self._camera.take(timeout_ms)
        if images is None:
            return False
        # The 32-bit counter, which wraps after six days, continued.
        self._ticks += (images.ticks - self._ticks + 2**31) % 2**32 - 2**31 if self._ticks else images.ticks
        now_ns = self.sensor.clock()
        self.joiner.add_depth(self._ticks * _TICK_NS, now_ns - images.age_ns, images, now_ns)
        return True

    def is_connected(self) -> bool:
        """Whether libfreenect2 still lists the sensor; of one that is unplugged, frames just stop."""
        return self._camera.is_connected()


class Freenect2Sensor(LiveSensor):
    """One Kinect v2: a :class:`~devices.sensor.Sensor` with depth and infrared, no people.

    :class:`~devices.blazepose.tracked_images.TrackedImages` finds the people. Times are those of the sensor's
    own clock. There is no sync cable: two sensors capture up to half a frame apart.
    """

    _camera: Camera | None = None

    def __enter__(self) -> Freenect2Sensor:
        """Opens the sensor, starts its camera."""
        self.__exit__()
        self._interrupted.clear()
        check_modes(self.name, self.settings)
        self._camera = Camera(self.name)
        for warning in self._camera.warnings:
            self._warn(warning)
        self.intrinsics = unmirrored_lens(self._camera.lens)
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Stops and closes the sensor, even if it is no longer connected."""
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.close()

    def frames(self) -> Iterator[SensorFrame]:
        """Frames as they arrive, until interrupted."""
        if self._camera is None:
            raise DeviceError(f"Kinect v2 {self.name} is not open: use it in a with statement.")
        yield from self._frames(_Freenect2Stream(self._camera, self))

    def frame_of(self, moment: Moment) -> SensorFrame:
        """The images of a moment, no longer mirrored."""
        depth, infrared = unmirrored(moment.depth.depth), unmirrored(moment.depth.infrared)
        return SensorFrame(moment.time_ns, depth=depth, ir=infrared, host_ns=moment.host_ns)


def unmirrored(image: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Whole numbers, left and right exchanged; 0 where there is no reading (negative, NaN, infinite)."""
    valid = (image > 0.0) & (image <= np.iinfo(np.uint16).max)
    return np.ascontiguousarray(np.where(valid, np.rint(image), 0.0).astype(np.uint16)[:, ::-1])


def unmirrored_lens(lens: tuple[float, ...]) -> Intrinsics:
    """The camera of :func:`unmirrored` images.

    The library's principal point counts from the corner of the first pixel of the mirrored image; its
    distortion is OpenCV's (``registration.cpp``). Mirroring turns the sign of x, and so that of p2.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    height, width = SHAPE
    return Intrinsics(width, height, fx, fy, width - cx - 0.5, cy - 0.5, (k1, k2, p1, -p2, k3))


def check_modes(serial: str, settings: CaptureSettings) -> None:
    """Checks without a sensor whether one could run in these modes.

    Raises:
        DeviceError: A mode that a Kinect v2 does not have, or this program does not read.
    """
    if settings.depth_mode != CaptureSettings.depth_mode:
        raise DeviceError(f"Kinect v2 {serial} has one depth mode, 512 × 424. Leave `depth_mode` out.")
    if settings.fps != _FPS:
        raise DeviceError(f"Kinect v2 {serial} runs at {_FPS} fps, not {settings.fps}. Leave `fps` out.")
    if settings.sync != "standalone":
        raise DeviceError(f"Kinect v2 {serial} has no port for a sync cable. Leave `sync_master` out.")
    if settings.color is not None:
        raise DeviceError(f"Kinect v2 {serial}: colour is not read. Leave `color` out.")
