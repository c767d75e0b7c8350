"""Orbbec Femto Bolt, Femto Mega, Gemini 2 and similar sensors live, by Orbbec's SDK v2."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from devices.capture.frame_decimation import FrameDecimation
from devices.orbbec.frame_stream import OrbbecStream
from devices.orbbec.lens import color_camera, intrinsics_of
from devices.orbbec.sdk_access import faults_of, is_connected, load_sdk, open_orbbec
from devices.orbbec.settings import OrbbecSettings, set_sync_role
from devices.orbbec.streams import Streams, check_modes, choose_streams
from devices.sensor import ColorCamera, DeviceError, SensorFrame
from fusion.body import BLAZEPOSE, Body
from fusion.intrinsics import Intrinsics

_TIMELESS = (
    "{name} gives no times of its own clock, so frames are timed when they arrive. On Windows, run "
    "shared/setup_env.py of the package pyorbbecsdk once: it registers the sensor's metadata."
)


class OrbbecSensor:
    """One Orbbec sensor: a :class:`~devices.sensor.Sensor` whose frames have depth and infrared, no people.

    :class:`~devices.blazepose.tracked_images.TrackedImages` finds the people. Times are those of the sensor's
    own clock, which is set to this machine's once, before the cameras start; from then on its drift is
    followed where frames are paired. The SDK's global time stamps are not used: they are refitted every
    second, and each fit moves all later times.

    Attributes:
        name: Its serial number.
        body: The body of the tracker that takes its images.
        intrinsics: Intrinsics of the depth camera in the chosen mode; None before opening.
        warnings: Problems that did not stop the sensor.
        missed: Captured frames that were dropped because this program or its tracker was too slow. Moments
            skipped on purpose by the decimation are not counted.
    """

    def __init__(
        self,
        serial: str,
        settings: OrbbecSettings | None = None,
        decimation: FrameDecimation | None = None,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        """Names the sensor; opens nothing.

        Args:
            serial: Its serial number, as ``connected_orbbecs`` and the label on it give it.
            settings: How it runs.
            decimation: Which moments are given; share it between two sensors. None: its own.
            clock: Nanoseconds, of ``host_ns``; tests inject their own.
        """
        self.name = serial
        self.body: Body = BLAZEPOSE
        self.intrinsics: Intrinsics | None = None
        self.warnings: list[str] = []
        self.missed = 0
        self.settings = settings or OrbbecSettings()
        self._decimation = decimation or FrameDecimation(self.settings.fps)
        self._clock = clock
        self._color: ColorCamera | None = None
        self._pipeline: Any = None
        self._sdk: Any = None
        self._interrupted = threading.Event()

    def __enter__(self) -> OrbbecSensor:
        """Opens the sensor, gives it its place on the sync cable, starts its cameras.

        Raises:
            DeviceError: Not connected, busy, not permitted, no place on a cable, or a mode it does not have.
        """
        self.__exit__()
        self._interrupted.clear()
        check_modes(self.settings)
        sdk = self._sdk = load_sdk()
        device = open_orbbec(sdk, self.name)
        self._warn(set_sync_role(sdk, device, self.name, self.settings))
        try:
            device.timer_sync_with_host()
        except faults_of(sdk):
            pass  # a clock that starts anywhere will do: pairing finds the offset
        try:
            self._pipeline = sdk.Pipeline(device)
            streams = choose_streams(sdk, self._pipeline, self.name, self.settings)
            self._read_calibration(streams)
            self._pipeline.enable_frame_sync()
            self._pipeline.start(streams.configuration(sdk))
        except faults_of(sdk) as fault:
            self._pipeline = None
            if not is_connected(sdk, self.name):
                raise DeviceError(f"Orbbec {self.name} was unplugged while it opened. Plug it in.") from fault
            raise DeviceError(
                f"Orbbec {self.name} did not start its cameras ({fault}). {_START_ADVICE}"
            ) from fault
        except BaseException:
            self._pipeline = None  # the SDK closes a sensor when nothing refers to it
            raise
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Stops and closes the sensor, even if it is no longer connected."""
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is None:
            return
        try:
            pipeline.stop()
        except faults_of(self._sdk) as fault:
            if is_connected(self._sdk, self.name):
                self._warn(f"Orbbec {self.name} did not close cleanly ({fault}).")

    def interrupt(self) -> None:
        """Makes ``frames`` end after its current wait; for closing from another thread."""
        self._interrupted.set()

    def frames(self) -> Iterator[SensorFrame]:
        """Frames as they arrive, until interrupted.

        Raises:
            DeviceError: Unplugged, or stalled.
        """
        if self._pipeline is None:
            raise DeviceError(f"Orbbec {self.name} is not open: use it in a with statement.")
        self._decimation.restart(self.name)
        stream = OrbbecStream(
            *(self._pipeline, self._sdk, self.name, self.settings, self._color, self._decimation, self._clock)
        )
        while not self._interrupted.is_set():
            before = stream.missed
            frame = stream.take()
            self.missed += stream.missed - before
            if frame is not None:
                if stream.timeless:
                    self._warn(_TIMELESS.format(name=f"Orbbec {self.name}"))
                yield frame

    def _read_calibration(self, streams: Streams) -> None:
        self.intrinsics, warning = intrinsics_of(self._sdk, streams.depth, self.name)
        self._warn(warning)
        self._color = None
        if streams.color is not None:
            self._color, warning = color_camera(self._sdk, streams.color, streams.depth, self.name)
            self._warn(warning)

    def _warn(self, warning: str) -> None:
        if warning and warning not in self.warnings:
            self.warnings.append(warning)


_START_ADVICE = (
    "Check that no other program keeps it busy (OrbbecViewer), its power supply and USB 3 port (two sensors "
    "need two USB controllers), and on Linux that OpenGL is there: OrbbecViewer must show its depth."
)
