"""Azure Kinect live, with its body tracker.

Orbbec's Femto Bolt and Mega work the same way with Orbbec's K4A wrapper instead of libk4a.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from devices.azure.calibration import COLOR_SIZES, depth_mode
from devices.azure.checks import sdk_check, sensor_check
from devices.azure.pyk4a_access import (
    close_kinect,
    connected_kinects,
    is_connected,
    is_listed,
    load_sdk,
    open_kinect,
    why_not_open,
    why_not_started,
)
from devices.azure.pyk4a_internals import capsule_pointer, capture_pointer, image_of, log_added
from devices.azure.settings import KinectSettings, sdk_configuration
from devices.azure.tracking.body_tracker import BodyTracker
from devices.azure.tracking.settings import TrackerSettings
from devices.azure.tracking.tracker_queue import TrackerQueue
from devices.capture.capture_stream import CaptureStream, LiveSensor
from devices.capture.causes import Cause
from devices.capture.clock.host_clock import arrival_ns
from devices.capture.clock.moments import ImageJoiner, Moment
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.settings import CaptureSettings
from devices.depth.camera import AZURE_KINECT_OFFSET
from devices.sensor import AbsentError, ColorCamera, ColorImage, DeviceError, SensorFrame
from devices.vendor import Vendor
from fusion.body import AZURE_KINECT
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform


class _KinectStream(CaptureStream):
    """The captures of a running ``pyk4a.PyK4A``."""

    cable_advice = (
        "A subordinate gives frames only while its master runs: check the master and the sync cable."
    )

    def __init__(self, device: Any, sdk: Any, sensor: KinectSensor) -> None:
        period_ns = round(1e9 / sensor.settings.fps)
        colored = sensor.settings.color is not None
        joiner = ImageJoiner(period_ns, color=period_ns) if colored else ImageJoiner(period_ns)
        super().__init__(f"Kinect {sensor.name}", sensor, joiner, "infrared", *["color"] * colored)
        self._device, self._sdk = device, sdk

    def receive(self, timeout_ms: int) -> bool:
        """Takes the next capture: depth with infrared, colour, or both."""
        try:
            capture = self._device.get_capture(timeout=timeout_ms)
        except self._sdk.K4ATimeoutException:
            return False
        except self._sdk.K4AException as fault:
            raise self.lost(fault) from fault
        depth, now_ns = image_of(capture, "depth"), self.sensor.clock()
        time_ns = 1000 * int(capture.depth_timestamp_usec) if depth is not None else None
        if self.sensor.settings.color is not None and image_of(capture, "color") is not None:
            color_ns = 1000 * int(capture.color_timestamp_usec) if time_ns is None else time_ns
            self.joiner.add("color", color_ns, capture)
        if time_ns is not None:
            # Orbbec's wrapper gives the epoch's time.
            host_ns = arrival_ns(int(capture.depth_system_timestamp_nsec), now_ns)
            lacks = ("infrared",) if image_of(capture, "ir") is None else ()
            self.joiner.add_depth(time_ns, host_ns, capture, now_ns, lacks)
        return True

    def is_connected(self) -> bool:
        return is_connected(self._sdk, self.sensor.name)

    def unplugged(self) -> DeviceError:
        """The error for a sensor that is not connected, or whose master is not."""
        if self.sensor.settings.sync == "subordinate" and not is_listed(self.sensor.name):
            return AbsentError(Cause.IT_OR_MASTER_UNPLUGGED.says(label=self.label))
        return super().unplugged()


class KinectSensor(LiveSensor):
    """One Azure Kinect with its body tracker."""

    settings: KinectSettings
    tracked_by = "k4abt"
    depth_offset = AZURE_KINECT_OFFSET

    def __init__(
        self,
        serial: str,
        settings: KinectSettings | None = None,
        tracker: TrackerSettings | None = None,
        track: bool = True,
        decimation: FrameDecimation | None = None,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        """Names the sensor; opens nothing.

        Args:
            track: Whether to track people; False for images alone.
            decimation: Which moments go to the tracker; share it between two sensors. None: its own.
            clock: Nanoseconds, of ``host_ns`` and of the tracker's times; tests inject their own.
        """
        super().__init__(serial, settings or KinectSettings(), decimation, clock)
        self.body = AZURE_KINECT
        self._tracker = BodyTracker(tracker) if track else None
        self._device: Any = None

    def __enter__(self) -> KinectSensor:
        """Opens the sensor, starts its cameras, then its body tracker."""
        self.__exit__()
        self._interrupted.clear()
        self._sdk = load_sdk()
        configuration = sdk_configuration(self._sdk, self.settings)
        try:
            self.awaits = "its driver, which opens it"
            self._device = open_kinect(self._sdk, self.name, configuration)
            self._check_jack()
            advice = "" if self.settings.sync == "standalone" else _SYNC_ADVICE
            self._call(self._device.start, "did not start its cameras", advice)
            calibration = self._call(lambda: self._device.calibration, "gives no calibration")
            if self.on_capture is not None:
                raw = self._call(lambda: self._device.calibration_raw, "gives no calibration")
                self.calibration_json = raw.encode()
            cameras, mode = self._sdk.CalibrationType, depth_mode(self.settings.depth_mode)
            self.intrinsics = _intrinsics(calibration, cameras.DEPTH, (mode.width, mode.height))
            self.color_camera = None
            if self.settings.color is not None:
                rotation, translation = calibration.get_extrinsic_parameters(cameras.DEPTH, cameras.COLOR)
                self.color_camera = ColorCamera(
                    _intrinsics(calibration, cameras.COLOR, COLOR_SIZES[self.settings.color]),
                    RigidTransform.of(rotation, np.ravel(translation)),  # pyk4a's is (1, 3)
                )
            if self._tracker is not None:
                handle = calibration._calibration_handle
                self.awaits = "its body tracker, which loads its network"
                self._tracker.open(capsule_pointer(handle, b"pyk4a calibration handle"))
            self.awaits = ""
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Stops the tracker and the sensor, even if the sensor is no longer connected."""
        self._stream = None  # it holds captures, which are given back before their device closes
        if self._tracker is not None:
            self.awaits = "its body tracker, which stops"
            self._tracker.close()
        if self._device is not None:
            self.awaits = "its cameras, which stop"
            device, self._device = self._device, None
            fault = close_kinect(self._sdk, self.name, device)
            if fault:
                self.warnings.append(f"Kinect {self.name} did not close cleanly ({fault}).")
        self.awaits = ""

    def frames(self) -> Iterator[SensorFrame]:
        """Frames as they arrive, until interrupted."""
        if self._device is None:
            raise DeviceError(f"Kinect {self.name} is not open: use it in a with statement.")
        stream = _KinectStream(self._device, self._sdk, self)
        frames = self._frames(stream) if self._tracker is None else self._tracked(stream, self._tracker)
        for frame in frames:
            yield frame if self.settings.infrared else replace(frame, ir=None)

    def _tracked(self, stream: CaptureStream, tracker: BodyTracker) -> Iterator[SensorFrame]:
        """The newest frames with their people."""
        self._stream = stream
        self.decimation.restart(self.name)
        # Waiting at most three quarters of a frame for the tracker leaves time to fetch the next capture.
        took = partial(self.decimation.tracked, self.name)
        queue = TrackerQueue(tracker, 0.75 / self.settings.fps, took, self.clock)
        newest: Moment | None = None
        while not self.interrupted:
            # a recording takes captures from the SDK's queue while the tracker is busy, too
            if (not queue.full or self.on_capture is not None) and (taken := stream.take(wait=queue.empty)):
                self.missed += newest is not None
                newest = taken
            if newest is not None and not queue.full:
                if "infrared" not in newest.lacks:  # the tracker refuses such a capture
                    queue.put(self.made(newest), capture_pointer(newest.depth))
                newest = None
            self.awaits = "" if queue.empty else "its body tracker's result"
            yield from queue.done()

    def frame_of(self, moment: Moment) -> SensorFrame:
        """The capture's images, copied so that the SDK has its memory back."""
        infrared = self.settings.infrared or self.on_capture is not None
        ir = image_of(moment.depth, "ir") if infrared else None
        camera = self.color_camera
        jpeg = None if moment.color is None else image_of(moment.color, "color")
        return SensorFrame(
            time_ns=moment.time_ns,
            depth=np.array(moment.depth.depth, dtype=np.uint16),
            ir=None if ir is None else np.array(ir, dtype=np.uint16),
            color=None if jpeg is None or camera is None else ColorImage.of(jpeg.tobytes(), camera),
            host_ns=moment.host_ns,
        )

    def _check_jack(self) -> None:
        """Checks that the sync cable is connected, and that a device that opens lazily is not busy."""
        try:
            sync_in, sync_out = self._device.sync_jack_status
        except self._sdk.K4AException as fault:
            if not is_connected(self._sdk, self.name):
                raise Cause.UNPLUGGED.error(label=f"Kinect {self.name}") from fault
            raise DeviceError(
                f"Kinect {self.name} cannot be opened: {why_not_open(fault, self.name)}"
            ) from fault
        needed = {"master": ("out", sync_out), "subordinate": ("in", sync_in)}.get(self.settings.sync)
        if needed is not None and not needed[1] and self.settings.trust_jacks:
            raise DeviceError(
                f"Kinect {self.name} is to be the {self.settings.sync}, but no cable is in its sync "
                f"{needed[0]} jack. Lead a 3.5 mm cable from the master's sync out to the subordinate's "
                f"sync in, or run both standalone."
            )

    def _call(self, action: Callable[[], Any], what: str, advice: str = "") -> Any:
        try:
            with log_added():
                return action()
        except self._sdk.K4AException as fault:
            raise why_not_started(fault, f"Kinect {self.name}", what, advice) from fault


_SYNC_ADVICE = "Check that the sync cable leads from the master's sync out to the subordinate's sync in. "


def _intrinsics(calibration: Any, camera: Any, size: tuple[int, int]) -> Intrinsics:
    matrix = np.asarray(calibration.get_camera_matrix(camera), dtype=np.float64)
    lens = np.asarray(calibration.get_distortion_coefficients(camera), dtype=np.float64).ravel()
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    return Intrinsics(*size, fx, fy, cx, cy, tuple(lens.tolist()))


def _of_images(serial: str, settings: CaptureSettings, decimation: FrameDecimation) -> KinectSensor:
    """The sensor without a body tracker, whose frames have infrared."""
    with_infrared = KinectSettings(**{**vars(settings), "infrared": True})
    return KinectSensor(serial, with_infrared, track=False, decimation=decimation)


VENDOR = Vendor(
    "Azure Kinect",
    'Sensor SDK 1.4 and pip install ".[kinect]" (docs/installing.md)',
    connected_kinects,
    _of_images,
    sdk_check,
    sensor_check,
)
