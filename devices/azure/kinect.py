"""Azure Kinect live, with its body tracker.

Orbbec's Femto Bolt and Mega work the same way with Orbbec's K4A wrapper instead of libk4a.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from devices.azure.calibration import COLOR_MODES, CameraMode, depth_mode
from devices.azure.capsules import capsule_pointer, capture_pointer
from devices.azure.capture_stream import CaptureStream
from devices.azure.kinect_settings import KinectSettings, sdk_configuration
from devices.azure.pyk4a_access import (
    close_kinect,
    is_connected,
    load_sdk,
    open_kinect,
    why_not_open,
)
from devices.azure.tracking.body_tracker import BodyTracker, TrackerSettings
from devices.azure.tracking.tracker_queue import TrackerQueue
from devices.capture.frame_decimation import FrameDecimation
from devices.sensor import ColorCamera, DeviceError, SensorFrame
from fusion.body import AZURE_KINECT, Body
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform


class KinectSensor:
    """One Azure Kinect with its body tracker: a :class:`~devices.sensor.Sensor`.

    Attributes:
        name: Its serial number.
        body: The body of the body tracker.
        intrinsics: Intrinsics of the depth camera in the chosen mode; None before opening.
        warnings: Problems that did not stop the sensor.
        missed: Captured frames that were dropped because this program or its tracker was too slow. Moments
            skipped on purpose by the decimation are not counted.
        waits_for: What the sensor is waiting for, if that may take minutes; else empty.
    """

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
            serial: Its serial number, as ``connected_kinects`` and the label on it give it.
            settings: How it runs.
            tracker: How the body tracker runs.
            track: Whether to track people; False for images alone.
            decimation: Which moments go to the tracker; share it between two sensors. None: its own.
            clock: Nanoseconds, of ``host_ns`` and of the tracker's times; tests inject their own.
        """
        self.name = serial
        self.body: Body = AZURE_KINECT
        self.intrinsics: Intrinsics | None = None
        self.warnings: list[str] = []
        self.missed = 0
        self.settings = settings or KinectSettings()
        self.waits_for = ""
        self._decimation = decimation or FrameDecimation(self.settings.fps)
        self._clock = clock
        self._color: ColorCamera | None = None
        self._tracker = BodyTracker(tracker) if track else None
        self._device: Any = None
        self._sdk: Any = None
        self._interrupted = threading.Event()

    def __enter__(self) -> KinectSensor:
        """Opens the sensor, starts its cameras, then its body tracker.

        Raises:
            DeviceError: Not connected, busy, not permitted, no sync cable, or a mode it does not have.
        """
        self.__exit__()
        self._interrupted.clear()
        self._sdk = load_sdk()
        configuration = sdk_configuration(self._sdk, self.settings)
        self._device = open_kinect(self._sdk, self.name, configuration)
        try:
            self._check_jack()
            advice = _START_ADVICE if self.settings.sync == "standalone" else _SYNC_ADVICE + _START_ADVICE
            self._call(self._device.start, "did not start its cameras", advice)
            calibration = self._call(lambda: self._device.calibration, "gives no calibration", _START_ADVICE)
            cameras, mode = self._sdk.CalibrationType, depth_mode(self.settings.depth_mode)
            self.intrinsics = _intrinsics(calibration, cameras.DEPTH, mode)
            if self.settings.color is not None:
                rotation, translation = calibration.get_extrinsic_parameters(cameras.DEPTH, cameras.COLOR)
                self._color = ColorCamera(
                    _intrinsics(calibration, cameras.COLOR, COLOR_MODES[self.settings.color]),
                    RigidTransform.of(rotation, np.ravel(translation)),  # pyk4a's is (1, 3)
                )
            if self._tracker is not None:
                handle = calibration._calibration_handle
                self.waits_for = "its body tracker, which loads its network"
                self._tracker.open(capsule_pointer(handle, b"pyk4a calibration handle"))
                self.waits_for = ""
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Stops the tracker and the sensor, even if the sensor is no longer connected."""
        if self._tracker is not None:
            self._tracker.close()
        self.waits_for = ""
        if self._device is not None:
            device, self._device = self._device, None
            fault = close_kinect(self._sdk, self.name, device)
            if fault:
                self.warnings.append(f"Kinect {self.name} did not close cleanly ({fault}).")

    def interrupt(self) -> None:
        """Makes ``frames`` end after its current wait; for closing from another thread."""
        self._interrupted.set()

    def frames(self) -> Iterator[SensorFrame]:
        """Frames as they arrive, until interrupted.

        Raises:
            DeviceError: Unplugged, stalled, or the tracker failed.
        """
        if self._device is None:
            raise DeviceError(f"Kinect {self.name} is not open: use it in a with statement.")
        self._decimation.restart(self.name)
        captures = CaptureStream(
            *(self._device, self._sdk, self.name, self.settings, self._color, self._decimation, self._clock)
        )
        if self._tracker is None:
            while not self._interrupted.is_set():
                if (taken := self._take(captures, wait=True)) is not None:
                    yield taken[0]
            return
        # Waiting at most three quarters of a frame for the tracker leaves time to fetch the next capture.
        queue = TrackerQueue(self._tracker, 0.75 / self.settings.fps, self._took, self._clock)
        self.waits_for = "its body tracker's first result"
        while not self._interrupted.is_set():
            if not queue.full and (taken := self._take(captures, wait=queue.empty)) is not None:
                frame, capture = taken
                queue.put(frame, capture_pointer(capture))
            for frame in queue.done():
                self.waits_for = ""
                yield frame

    def _take(self, captures: CaptureStream, wait: bool) -> tuple[SensorFrame, Any] | None:
        before = captures.missed
        taken = captures.take(wait)
        self.missed += captures.missed - before
        return taken

    def _took(self, time_ns: int) -> None:
        self._decimation.tracked(self.name, time_ns)

    def _check_jack(self) -> None:
        """Checks that the sync cable is connected, and that a device that opens lazily is not busy."""
        try:
            sync_in, sync_out = self._device.sync_jack_status
        except self._sdk.K4AException as fault:
            if not is_connected(self._sdk, self.name):
                raise DeviceError(f"Kinect {self.name} was unplugged while it opened. Plug it in.") from fault
            raise DeviceError(f"Kinect {self.name} cannot be opened: {why_not_open(fault)}") from fault
        needed = {"master": ("out", sync_out), "subordinate": ("in", sync_in)}.get(self.settings.sync)
        if needed is not None and not needed[1] and self.settings.trust_jacks:
            raise DeviceError(
                f"Kinect {self.name} is to be the {self.settings.sync}, but no cable is in its sync "
                f"{needed[0]} jack. Lead a 3.5 mm cable from the master's sync out to the subordinate's "
                f"sync in, or run both standalone."
            )

    def _call(self, action: Callable[[], Any], what: str, advice: str) -> Any:
        try:
            return action()
        except self._sdk.K4AException as fault:
            said = f" ({fault})" if str(fault) else ""
            raise DeviceError(f"Kinect {self.name} {what}{said}. {advice}".rstrip()) from fault


_START_ADVICE = (
    "Check that no other program keeps it busy (k4aviewer), its power supply and USB 3 port (two sensors "
    "need two USB controllers), and on Linux that libdepthengine and OpenGL are there: k4aviewer must show "
    "its depth."
)
_SYNC_ADVICE = "Check that the sync cable leads from the master's sync out to the subordinate's sync in. "


def _intrinsics(calibration: Any, camera: Any, mode: CameraMode) -> Intrinsics:
    matrix = np.asarray(calibration.get_camera_matrix(camera), dtype=np.float64)
    lens = np.asarray(calibration.get_distortion_coefficients(camera), dtype=np.float64).ravel()
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    return Intrinsics(mode.width, mode.height, fx, fy, cx, cy, tuple(lens.tolist()))
