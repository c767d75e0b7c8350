"""Kinect v2 (Xbox One, Kinect for Windows v2) live, several on one PC, through libfreenect2."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from devices.capture.capture_stream import CaptureStream
from devices.capture.clock.moments import ImageJoiner, Moment
from devices.depth.camera import KINECT_V2_OFFSET
from devices.freenect2.library import PROGRAMS, SHAPE, Camera, connected_freenect2s, library_check
from devices.sensor import DeviceError, SensorFrame
from devices.vendor import Vendor, VendorSensor, listed_check
from fusion.intrinsics import Intrinsics

_FPS = 30
_TICK_NS = 125_000


class _Freenect2Stream(CaptureStream):
    """The moments of a running camera."""

    def __init__(self, camera: Camera, sensor: Freenect2Sensor) -> None:
        super().__init__(sensor.label, sensor, ImageJoiner(round(1e9 / _FPS)))
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


class Freenect2Sensor(VendorSensor):
    """One Kinect v2: a :class:`~devices.sensor.Sensor` with depth and infrared, no people.

    :class:`~devices.blazepose.tracked_images.TrackedImages` finds the people. Times are those of the sensor's
    own clock. There is no sync cable: two sensors capture up to half a frame apart.
    """

    model, programs = "Kinect v2", PROGRAMS
    depth_offset = KINECT_V2_OFFSET

    def open(self) -> Camera:
        """Opens the sensor, starts its camera."""
        self.refuse_modes("512 × 424", _FPS)
        if self.settings.color is not None:
            raise DeviceError(f"{self.label}: colour is not read. Leave `color` out.")
        camera = Camera(self)
        for warning in camera.warnings:
            self._warn(warning)
        self.intrinsics = unmirrored_lens(camera.lens)
        return camera

    def stream(self, opened: Camera) -> CaptureStream:
        """The moments of the running camera."""
        return _Freenect2Stream(opened, self)

    def close(self, opened: Camera) -> None:
        """Stops and closes the sensor."""
        opened.close()

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


VENDOR = Vendor(
    "Kinect v2 (Xbox One)",
    "build libfreenect2 as docs/installing.md says",
    connected_freenect2s,
    Freenect2Sensor,
    library_check,
    lambda sensor: listed_check("Kinect v2", sensor, "no sync port"),
)
