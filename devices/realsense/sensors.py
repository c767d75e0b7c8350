"""RealSense sensors live, and their recordings (``.db3``, ``.bag``), by pyrealsense2."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event
from typing import Any

from devices.capture.capture_stream import CaptureStream
from devices.capture.causes import Cause
from devices.capture.clock.moments import Moment
from devices.capture.settings import CaptureSettings
from devices.check import installed_version
from devices.input_file import check_recording, open_input
from devices.realsense.images import FrameReader, Streams, choose_streams, intrinsics_of
from devices.realsense.sdk_access import (
    SDK_NAME,
    connected_realsenses,
    is_connected,
    load_sdk,
    open_realsense,
    set_sync_role,
)
from devices.sensor import DeviceError, ImageRecording, SensorFrame
from devices.vendor import Vendor, VendorSensor, library_check, listed_check
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics

_QUEUE = 16  # frames, of two streams
_CONNECTIONS = 1 << 20  # bytes, which hold them all
_WAIT_S, _SILENT_S = 0.2, 10.0
_ENDS = 5  # frames by which a stream may end before the recording
_TIMELESS = (
    "{label} gives no times of its own clock, so frames are timed when they arrive: on Linux the kernel "
    "passes on no metadata, on Windows they are not registered. See the installation pages of librealsense."
)


class _RealSenseStream(CaptureStream):
    """The moments of running cameras."""

    def __init__(self, sensor: RealSenseSensor, device: Any, queue: Any, reader: FrameReader) -> None:
        super().__init__(sensor.label, sensor, reader.joiner, reader.image)
        self._device, self._queue, self._reader = device, queue, reader

    def receive(self, timeout_ms: int) -> bool:
        """Takes the next frame, of depth or of the image."""
        came, frame = self._queue.try_wait_for_frame(timeout_ms)
        if came:
            self._reader.add(frame, self.sensor.clock())
            if self._reader.timeless:
                self.sensor._warn(_TIMELESS.format(label=self.label))
        return bool(came)

    def is_connected(self) -> bool:
        """Whether the library still lists the sensor; frames of one that is unplugged stop without an
        error."""
        return is_connected(self._device, self.sensor.name)


class RealSenseSensor(VendorSensor):
    """One RealSense sensor: a :class:`~devices.sensor.Sensor` whose frames have depth and infrared.

    With a colour mode they have colour in place of infrared, registered to depth. There are no people:
    :class:`~devices.blazepose.tracked_images.TrackedImages` finds them. Times are those of the sensor's own
    clock. The library's global times, which each new fit moves, are switched off.
    """

    model, programs = "RealSense", "realsense-viewer"

    def open(self) -> tuple[Streams, _RealSenseStream, FrameReader]:
        """Opens the sensor, gives it its place on the sync cable, starts its cameras."""
        label, settings, streams = self.label, self.settings, None
        if settings.depth_mode != CaptureSettings.depth_mode:
            raise DeviceError(f"{label} has no depth mode {settings.depth_mode}; leave `depth_mode` out.")
        sdk = load_sdk()
        device = open_realsense(sdk, self.name)
        try:
            set_sync_role(sdk, device, self.name, settings)
            streams = choose_streams(sdk, device, label, settings.fps, settings.color)
            self.intrinsics, warning = intrinsics_of(streams.depth, label)
            self._warn(warning)
            reader, queue = FrameReader(sdk, streams, self.intrinsics), sdk.frame_queue(_QUEUE, True)
            self.color_camera = reader.camera
            for camera, _ in streams.opened:
                if camera.supports(sdk.option.global_time_enabled):
                    camera.set_option(sdk.option.global_time_enabled, 0)
            streams.start(queue)
        except RuntimeError as fault:
            if streams is not None:
                streams.stop()
            if not is_connected(device, self.name):
                raise Cause.UNPLUGGED.error(label=label) from fault
            raise self.not_started(fault) from fault
        return streams, _RealSenseStream(self, device, queue, reader), reader

    def stream(self, opened: tuple[Streams, _RealSenseStream, FrameReader]) -> CaptureStream:
        """The moments of the running cameras."""
        return opened[1]

    def close(self, opened: tuple[Streams, _RealSenseStream, FrameReader]) -> None:
        """Stops and closes the sensor."""
        opened[0].stop()

    def frame_of(self, moment: Moment) -> SensorFrame:
        """The images of a moment, copied from the library's memory."""
        reader: FrameReader = self._opened[2]
        return reader.frame_of(moment, moment.host_ns)


class RealSenseRecording(ImageRecording):
    """A recording's depth and infrared or colour.

    It is read as fast as its frames are taken; none is dropped. The library plays a damaged file to its first
    fault; a warning then says what is missing.
    """

    def __init__(self, path: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self.path, self.name, self.body = path, path.name, BLAZEPOSE
        self.intrinsics: Intrinsics | None = None
        self.warnings: list[str] = []
        self._clock = clock
        self._opened: tuple[Any, Any, Any, Streams] | None = None

    def __enter__(self) -> RealSenseRecording:
        self.__exit__()
        check_recording(self.path)
        sdk = load_sdk()
        try:
            context = sdk.context()  # of its own: the file is not to be listed as a sensor
            device = context.load_device(str(self.path))
            device.set_real_time(False)
            streams = choose_streams(sdk, device, self.name)
            self.intrinsics, warning = intrinsics_of(streams.depth, self.name)
            self.duration_ns = round(1e9 * device.get_duration().total_seconds())
        except RuntimeError as fault:
            raise DeviceError(
                f"{self.name} cannot be read ({fault}). It is not a recording of a RealSense sensor, or it "
                f"is damaged: play it in realsense-viewer."
            ) from fault
        self.warnings = [warning] if warning else []
        self.interval_ns = round(1e9 / streams.depth.fps())
        self._opened = sdk, context, device, streams
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._opened = None

    def frames(self) -> Iterator[SensorFrame]:
        """The frames in capture order."""
        if self._opened is None or self.intrinsics is None:
            raise DeviceError(f"{self.name} is not open: use it in a with statement.")
        sdk, _, device, streams = self._opened
        # One camera may be read ahead of the other by what the queue holds.
        reader = FrameReader(sdk, streams, self.intrinsics, wait_ns=_QUEUE * self.interval_ns)
        queue: Queue[Any] = Queue(_QUEUE)
        closing = Event()

        def take(frame: Any) -> None:
            frame.keep()
            while not closing.is_set():  # the library waits for this function: nothing is dropped
                try:
                    queue.put(frame, timeout=_WAIT_S)
                except Full:
                    continue
                return

        given, first_ns, last_ns, played_ns, heard_s = 0, 0, -1, 0, self._clock()

        def complete() -> Iterator[SensorFrame]:
            nonlocal given, first_ns, last_ns
            while (moment := reader.joiner.take()) is not None:
                if moment.time_ns > last_ns:
                    first_ns = first_ns if given else moment.time_ns
                    given, last_ns = given + 1, moment.time_ns
                    yield reader.frame_of(moment, None)

        try:
            device.pause()  # else it plays while the second camera starts, whose frames it then drops
            streams.start(take)
            device.resume()
            while True:
                # Asked before waiting: what came until the end is in the queue by then.
                ended = device.current_status() == sdk.playback_status.stopped
                try:
                    frame = queue.get(timeout=_WAIT_S)
                except Empty:
                    if ended or self._clock() - heard_s > _SILENT_S:
                        reader.joiner.flush()
                        yield from complete()
                        break
                    continue
                heard_s, played_ns = self._clock(), max(played_ns, int(device.get_position()))
                reader.add(frame, 0)
                yield from complete()
        except RuntimeError as fault:
            raise DeviceError(f"{self.name} is damaged ({fault}). Play it in realsense-viewer.") from fault
        finally:
            closing.set()
            streams.stop()
        if not given:
            raise DeviceError(f"{self.name} holds no complete frame. Play it in realsense-viewer.")
        if self.duration_ns - played_ns > _ENDS * self.interval_ns:
            read_ns = last_ns - first_ns + self.interval_ns  # the position runs ahead by what is in the queue
            said = (
                f"{self.name} is damaged, or depth ended early: {given} frames of the first "
                f"{1e-9 * read_ns:.1f} of {1e-9 * self.duration_ns:.1f} s could be read."
            )
            self.warnings = [*dict.fromkeys((*self.warnings, said))]


def is_realsense_bag(path: Path) -> bool:
    """Whether a ``.bag``, which Orbbec's SDK writes, too, is of a RealSense sensor, by its message types."""
    try:
        with open_input(path) as file:
            head = file.read(4096)
            at = head.find(b"index_pos=")  # of the list of connections, at the end of a ROS bag 2.0
            file.seek(int.from_bytes(head[at + 10 : at + 18], "little"))
            return at >= 0 and b"realsense_msgs/" in file.read(_CONNECTIONS)
    except (OSError, ValueError):
        return False


VENDOR = Vendor(
    "RealSense (D400, D500)",
    'pip install ".[realsense]" (docs/installing.md)',
    connected_realsenses,
    RealSenseSensor,
    lambda: library_check(SDK_NAME, lambda: load_sdk() and (installed_version(SDK_NAME) or "installed")),
    lambda sensor: listed_check("RealSense", sensor, f"{sensor.description}, sync cable not known"),
)
