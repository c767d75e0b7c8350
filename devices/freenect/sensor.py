"""Kinect v1 (Xbox 360, Kinect for Windows) live, through libfreenect."""

from __future__ import annotations

import ctypes
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.capture.capture_stream import CaptureStream
from devices.capture.clock.moments import ImageJoiner, Moment
from devices.freenect.libfreenect import PROGRAMS, Context, connected_freenects, how_to_install, load_library
from devices.sensor import ColorCamera, ColorImage, DeviceError, SensorFrame
from devices.vendor import Vendor, VendorSensor, library_check, listed_check
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform

FPS = 30
TICKS_PER_S = 60_000_000
"""The clock's rate according to libfreenect's driver for OpenNI 2."""
_WRAP = 2**32  # ticks: the clock wraps after 72 s
INTRINSICS = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
"""The colour camera's nominal lens, on whose pixels registered depth is: the sensor stores no calibration of
it. 525 is the focal length that ROS's driver assumes."""
CAMERA = ColorCamera(INTRINSICS, RigidTransform.identity())
_PERIOD_NS = 1_000_000_000 // FPS
_QUEUE = 32  # images that wait for the reader: half a second, more than a body tracker takes
_EVENTS_S = 0.1  # longest wait for events of USB


class _Camera:
    """Opens a camera, handles its USB events, closes it: all on this thread, as libfreenect wants it.

    libfreenect buffers 32 ms of USB data, and the body tracker takes longer: they need threads of their own.
    """

    def __init__(self, sensor: FreenectSensor) -> None:
        self._thread = threading.Thread(target=self._run, name=f"libfreenect {sensor.name}", daemon=True)
        self._sensor = sensor
        self._counter, self._images = TickCounter(), deque[tuple[int, int, NDArray[Any]]](maxlen=_QUEUE)
        self._changed = threading.Condition()
        self._stopping, self._started, self._ended = False, False, False
        self._fault: BaseException | None = None
        self.said = ""

    def open(self) -> None:
        """Starts the thread, and returns when the cameras run.

        Raises:
            DeviceError: They do not start.
        """
        self._thread.start()
        with self._changed:
            self._changed.wait_for(lambda: self._started or self._ended)
        if self._fault is not None:
            raise self._fault

    def take(self, timeout_s: float) -> tuple[int, int, NDArray[Any]] | None:
        """Capture time, arrival and pixels of the oldest image that waits.

        None if none comes, or the camera is lost: see :attr:`lost`.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._images or self._ended, timeout_s)
            return self._images.popleft() if self._images else None

    @property
    def lost(self) -> bool:
        """Whether the camera gives no more images."""
        return self._ended

    def close(self) -> None:
        """Stops and closes the camera."""
        self._stopping = True
        self._thread.join()

    def _run(self) -> None:
        """Runs the camera until it is closed or lost."""
        try:
            with Context() as context:
                context.open(self._sensor.name)
                if not context.start(self._take_depth, self._take_color):
                    raise self._sensor.not_started(Exception(context.said))
                self._tell(started=True)
                while not self._stopping and context.process(_EVENTS_S):
                    pass
                self.said = context.said
                self._tell(ended=True)  # before closing, which may take long
        except BaseException as fault:
            self._fault = fault
        finally:
            self._tell(ended=True)

    def _tell(self, started: bool = False, ended: bool = False) -> None:
        with self._changed:
            self._started, self._ended = self._started or started, self._ended or ended
            self._changed.notify_all()

    def _take_depth(self, address: int, ticks: int) -> None:
        self._keep(np.empty((INTRINSICS.height, INTRINSICS.width), np.uint16), address, ticks)

    def _take_color(self, address: int, ticks: int) -> None:
        self._keep(np.empty((INTRINSICS.height, INTRINSICS.width, 3), np.uint8), address, ticks)

    def _keep(self, image: NDArray[Any], address: int, ticks: int) -> None:
        ctypes.memmove(image.ctypes.data, address, image.nbytes)
        host_ns = self._sensor.clock()
        time_ns = self._counter.total(ticks, host_ns) * 1_000_000_000 // TICKS_PER_S
        with self._changed:
            self._images.append((time_ns, host_ns, image))
            self._changed.notify_all()


class _FreenectStream(CaptureStream):
    """The moments of a running camera: one clock times both cameras, which run by themselves."""

    def __init__(self, camera: _Camera, sensor: FreenectSensor) -> None:
        joiner = ImageJoiner(_PERIOD_NS, color=_PERIOD_NS)
        super().__init__(sensor.label, sensor, joiner, "color")
        self._camera = camera

    def receive(self, timeout_ms: int) -> bool:
        """Takes the oldest image that waits."""
        taken = self._camera.take(timeout_ms / 1000)
        if taken is None:
            if self._camera.lost and timeout_ms:  # else the moments before were for nothing
                raise self.lost(DeviceError(self._camera.said))
            return False
        time_ns, host_ns, image = taken
        if image.ndim == 2:
            self.joiner.add_depth(time_ns, host_ns, image, self.sensor.clock())
        else:
            self.joiner.add("color", time_ns, image)
        return True

    def is_connected(self) -> bool:
        """Whether libfreenect still lists the sensor."""
        try:
            with Context() as context:
                return self.sensor.name in context.serials()
        except DeviceError:
            return False


class FreenectSensor(VendorSensor):
    """One Kinect v1: a :class:`~devices.sensor.Sensor` with depth registered to colour, no people.

    :class:`~devices.blazepose.tracked_images.TrackedImages` finds the people in :attr:`rgb`. Times are those
    of the sensor's own clock. There is no sync cable: two sensors capture up to half a frame apart.

    Attributes:
        rgb: (480, 640, 3) the colour image of the frame given last; None without one.
    """

    model, programs = "Kinect v1", PROGRAMS
    rgb: NDArray[np.uint8] | None = None

    def open(self) -> _Camera:
        """Opens the sensor, starts its cameras."""
        self.refuse_modes("640 × 480", FPS)
        self._warn(
            f"{self.label} has no stored lens: its colour camera counts as ideal, with "
            f"{INTRINSICS.fx:g} pixels of focal length."
        )
        if self.settings.color is not None:
            self._warn(f"{self.label}: colour is 640 × 480, not {self.settings.color}.")
        camera = _Camera(self)
        camera.open()
        self.intrinsics, self.color_camera = INTRINSICS, CAMERA
        return camera

    def stream(self, opened: _Camera) -> CaptureStream:
        """The moments of the running cameras."""
        return _FreenectStream(opened, self)

    def close(self, opened: _Camera) -> None:
        """Stops and closes the sensor."""
        opened.close()

    def registered(self, _: SensorFrame) -> NDArray[np.uint8] | None:
        """The colour image of the latest frame; depth is registered to its pixels."""
        return self.rgb

    def _frames(self, stream: CaptureStream) -> Iterator[SensorFrame]:
        for moment in self._moments(stream):
            frame, self.rgb = self.made(moment), moment.color
            if self.on_capture is not None:
                # the tracker finds the same in the image that a recording keeps
                self.rgb = None if frame.color is None else frame.color.rgb()
            yield frame if self.settings.color is not None else replace(frame, color=None)

    def frame_of(self, moment: Moment) -> SensorFrame:
        """The images of a moment, for a recording always with colour, in which people are found later."""
        colored = self.settings.color is not None or self.on_capture is not None
        return SensorFrame(
            time_ns=moment.time_ns,
            depth=moment.depth,
            color=ColorImage.of_rgb(moment.color, CAMERA) if colored and moment.color is not None else None,
            host_ns=moment.host_ns,
        )


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


VENDOR = Vendor(
    "Kinect v1 (Xbox 360)",
    how_to_install().removeprefix("Install it: ").partition(" (")[0],
    connected_freenects,
    FreenectSensor,
    lambda: library_check("libfreenect 0.5 (Kinect v1)", lambda: load_library()._name),
    lambda sensor: listed_check("Kinect v1", sensor, "no sync jacks"),
)
