"""Azure Kinect live, with its body tracker.

Orbbec's Femto Bolt and Mega come the same way with Orbbec's K4A wrapper in place of libk4a.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from devices.azure.calibration import COLOR_MODES, CameraMode, depth_mode
from devices.azure.pyk4a_access import (
    capsule_pointer,
    capture_pointer,
    close_kinect,
    load_sdk,
    open_kinect,
)
from devices.azure.tracking.body_tracker import BodyTracker, TrackerSettings
from devices.azure.tracking.tracker_queue import TrackerQueue
from devices.azure.usb import usb_kinects
from devices.sensor import ColorCamera, ColorImage, DeviceError, SensorFrame
from fusion.body import AZURE_KINECT, Body
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform

LASER_GAP_US = 160
"""How much later than the master a subordinate captures, so that their lasers do not blind each other."""


@dataclass(frozen=True)
class KinectSettings:
    """How a Kinect runs.

    Attributes:
        depth_mode: NFOV_UNBINNED or WFOV_2X2BINNED, which the body tracker takes; others without a tracker.
        fps: 5, 15 or 30.
        color: Colour resolution, ``720P`` to ``3072P``; None for off.
        infrared: Whether frames carry the infrared image. The body tracker gets it anyway.
        sync: Its place on the sync cable.
        delay_us: How much later than the master a subordinate captures.
        timeout_ms: How long one wait for a frame may take.
        stall_s: After how long without depth the stream counts as stalled.
        start_s: The same for a subordinate's first frame, which waits until its master runs.
    """

    depth_mode: str = "NFOV_UNBINNED"
    fps: Literal[5, 15, 30] = 30
    color: str | None = None
    infrared: bool = False
    sync: Literal["standalone", "master", "subordinate"] = "standalone"
    delay_us: int = LASER_GAP_US
    timeout_ms: int = 1000
    stall_s: float = 5.0
    start_s: float = 120.0


class KinectSensor:
    """One Azure Kinect with its body tracker: a :class:`~devices.sensor.Sensor`.

    Attributes:
        name: Its serial number.
        body: The body tracker's.
        intrinsics: Of the depth camera in the mode chosen; None before opening.
        warnings: What went wrong without stopping it.
        missed: Frames captured that never came, for the SDK keeps a few only for a program that is too slow.
    """

    def __init__(
        self,
        serial: str,
        settings: KinectSettings | None = None,
        tracker: TrackerSettings | None = None,
        track: bool = True,
    ) -> None:
        """Names the sensor; opens nothing.

        Args:
            serial: Its serial number, as ``connected_kinects`` and the label on it give it.
            settings: How it runs.
            tracker: How the body tracker runs.
            track: Whether to track people; False for images alone.
        """
        self.name = serial
        self.body: Body = AZURE_KINECT
        self.intrinsics: Intrinsics | None = None
        self.warnings: list[str] = []
        self.missed = 0
        self.settings = settings or KinectSettings()
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
        configuration = _configuration(self._sdk, self.settings)
        self._device = open_kinect(self._sdk, self.name, configuration)
        try:
            self._check_jack()
            self._call(self._device.start, "did not start its cameras", _START_ADVICE)
            calibration = self._call(lambda: self._device.calibration, "gives no calibration", _START_ADVICE)
            cameras, mode = self._sdk.CalibrationType, depth_mode(self.settings.depth_mode)
            self.intrinsics = _intrinsics(calibration, cameras.DEPTH, mode)
            if self.settings.color is not None:
                self._color = ColorCamera(
                    _intrinsics(calibration, cameras.COLOR, COLOR_MODES[self.settings.color]),
                    RigidTransform.of(*calibration.get_extrinsic_parameters(cameras.DEPTH, cameras.COLOR)),
                )
            if self._tracker is not None:
                handle = calibration._calibration_handle
                self._tracker.open(capsule_pointer(handle, b"pyk4a calibration handle"))
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Stops the tracker and the sensor, also when it is no longer there."""
        if self._tracker is not None:
            self._tracker.close()
        if self._device is not None:
            device, self._device = self._device, None
            fault = close_kinect(self._sdk, self.name, device)
            if fault:
                self.warnings.append(f"Kinect {self.name} did not close cleanly ({fault}).")

    def interrupt(self) -> None:
        """Makes ``frames`` end after its present wait; for closing from another thread."""
        self._interrupted.set()

    def frames(self) -> Iterator[SensorFrame]:
        """Frames as they come, until interrupted.

        Raises:
            DeviceError: Unplugged, stalled, or the tracker failed.
        """
        if self._device is None:
            raise DeviceError(f"Kinect {self.name} is not open: use it in a with statement.")
        # Waiting three quarters of a frame for its people leaves time to fetch the next one.
        wait_s = 0.75 / self.settings.fps
        queue = None if self._tracker is None else TrackerQueue(self._tracker, wait_s)
        silent_s, last_ns = 0.0, None
        patience_s = self.settings.start_s if self.settings.sync == "subordinate" else self.settings.stall_s
        while not self._interrupted.is_set():
            try:
                capture = self._device.get_capture(timeout=self.settings.timeout_ms)
                frame = self._frame(capture)
            except self._sdk.K4ATimeoutException:
                frame, waited_s = None, self.settings.timeout_ms / 1000
            except self._sdk.K4AException as fault:
                raise self._lost(fault) from fault
            else:
                waited_s = 1 / self.settings.fps
            if frame is None:
                silent_s += waited_s
                if silent_s >= patience_s:
                    raise self._stalled(silent_s)
                continue
            silent_s, patience_s = 0.0, self.settings.stall_s
            if last_ns is not None:  # a clock that is reset goes back: nothing is known of that gap
                self.missed += max(0, round((frame.time_ns - last_ns) * self.settings.fps / 1e9) - 1)
            last_ns = frame.time_ns
            if queue is None:
                yield frame
                continue
            queue.put(frame, capture_pointer(capture))
            yield from queue.done()

    def _check_jack(self) -> None:
        sync_in, sync_out = self._call(lambda: self._device.sync_jack_status, "hides its sync jacks", "")
        needed = {"master": ("out", sync_out), "subordinate": ("in", sync_in)}.get(self.settings.sync)
        if needed is not None and not needed[1]:
            raise DeviceError(
                f"Kinect {self.name} is to be the {self.settings.sync}, but no cable is in its sync "
                f"{needed[0]} jack. Lead a 3.5 mm cable from the master's sync out to the subordinate's "
                f"sync in, or run both standalone."
            )

    def _frame(self, capture: Any) -> SensorFrame | None:
        """The capture's images, copied so that the SDK has its memory back; None if one is missing."""
        depth, ir = capture.depth, capture.ir
        if depth is None or ir is None:
            return None
        jpeg = None if self._color is None else capture.color
        color = None if jpeg is None or self._color is None else ColorImage.of(jpeg.tobytes(), self._color)
        now_ns, host_ns = time.perf_counter_ns(), int(capture.depth_system_timestamp_nsec)
        return SensorFrame(
            time_ns=1000 * int(capture.depth_timestamp_usec),
            depth=np.array(depth, dtype=np.uint16),
            ir=np.array(ir, dtype=np.uint16) if self.settings.infrared else None,
            color=color,
            # The SDK's host time is this clock's; a wrapper that leaves it empty must not lead us astray.
            host_ns=host_ns if 0 <= now_ns - host_ns < 5_000_000_000 else now_ns,
        )

    def _call(self, action: Callable[[], Any], what: str, advice: str) -> Any:
        try:
            return action()
        except self._sdk.K4AException as fault:
            said = f" ({fault})" if str(fault) else ""
            raise DeviceError(f"Kinect {self.name} {what}{said}. {advice}".rstrip()) from fault

    def _lost(self, fault: Exception) -> DeviceError:
        if self._sdk.connected_device_count() == 0 or not self._is_listed():
            return DeviceError(f"Kinect {self.name} was unplugged or lost its power. Plug it in again.")
        said = f" ({fault})" if str(fault) else ""
        return DeviceError(f"Kinect {self.name} stopped giving frames{said}. Unplug it and plug it in again.")

    def _is_listed(self) -> bool:
        """Whether the bus still has the sensor; where the bus tells no serials, that cannot be known."""
        serials = [device.serial for device in usb_kinects()]
        return not any(serials) or self.name in serials

    def _stalled(self, silent_s: float) -> DeviceError:
        cause = (
            "A subordinate gives frames only while its master runs: check the master and the sync cable."
            if self.settings.sync == "subordinate"
            else "Check its USB 3 port and power supply; two sensors need two USB controllers."
        )
        return DeviceError(f"Kinect {self.name} stalls: no depth for {silent_s:.0f} s. {cause}")


_START_ADVICE = (
    "Check its power supply and USB 3 port (two sensors need two USB controllers), that no other program "
    "uses it, and on Linux that libdepthengine and OpenGL are there: k4aviewer must show its depth."
)


def _intrinsics(calibration: Any, camera: Any, mode: CameraMode) -> Intrinsics:
    matrix = np.asarray(calibration.get_camera_matrix(camera), dtype=np.float64)
    lens = np.asarray(calibration.get_distortion_coefficients(camera), dtype=np.float64).ravel()
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    return Intrinsics(mode.width, mode.height, fx, fy, cx, cy, tuple(lens.tolist()))


def _configuration(sdk: Any, settings: KinectSettings) -> Any:
    depth_mode(settings.depth_mode)
    if settings.color is not None and settings.color not in COLOR_MODES:
        raise DeviceError(f"No colour mode {settings.color}. There are {', '.join(COLOR_MODES)}.")
    if settings.fps == 30 and (settings.depth_mode == "WFOV_UNBINNED" or settings.color == "3072P"):
        mode = "WFOV_UNBINNED" if settings.depth_mode == "WFOV_UNBINNED" else "Colour 3072P"
        raise DeviceError(f"{mode} runs at 15 fps at most, not 30. Choose 15 fps or another mode.")
    return sdk.Config(
        color_resolution=sdk.ColorResolution[f"RES_{settings.color}" if settings.color else "OFF"],
        color_format=sdk.ImageFormat.COLOR_MJPG,
        depth_mode=sdk.DepthMode[settings.depth_mode],
        camera_fps=sdk.FPS[f"FPS_{settings.fps}"],
        synchronized_images_only=settings.color is not None,
        wired_sync_mode=sdk.WiredSyncMode[settings.sync.upper()],
        subordinate_delay_off_master_usec=settings.delay_us if settings.sync == "subordinate" else 0,
    )
