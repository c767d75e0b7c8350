"""Orbbec Femto Bolt, Femto Mega, Gemini 2 and similar sensors live, by Orbbec's SDK v2."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from devices.capture.capture_stream import CaptureStream
from devices.capture.causes import Cause
from devices.capture.clock.moments import ImageJoiner, Moment
from devices.orbbec.images import FrameReader, color_image, depth_image, infrared_image
from devices.orbbec.sdk_access import (
    COMMAND,
    connected_orbbecs,
    faults_of,
    is_connected,
    load_sdk,
    open_orbbec,
    sdk_check,
    sensor_check,
    set_sync_role,
)
from devices.orbbec.streams import Streams, check_modes, choose_streams, color_camera, intrinsics_of
from devices.sensor import SensorFrame
from devices.vendor import Vendor, VendorSensor

_TIMELESS = (
    "{name} gives no times of its own clock, so frames are timed when they arrive. On Windows, run "
    "shared/setup_env.py of the package pyorbbecsdk once: it registers the sensor's metadata."
)


class _OrbbecStream(CaptureStream):
    """The moments of a running ``pyorbbecsdk.Pipeline``."""

    cable_advice = (
        "A secondary gives frames only while its primary runs: check the primary, the sync hub and the "
        "cables."
    )

    def __init__(self, pipeline: Any, sdk: Any, sensor: OrbbecSensor) -> None:
        period_ns = round(1e9 / sensor.settings.fps)
        wanted = ("infrared",) if sensor.settings.color is None else ("infrared", "color")
        joiner = ImageJoiner(period_ns, **dict.fromkeys(wanted, period_ns))
        super().__init__(sensor.label, sensor, joiner, *wanted)
        self._pipeline, self._sdk, self._reader = pipeline, sdk, FrameReader(joiner)

    def receive(self, timeout_ms: int) -> bool:
        """Takes the next set of frames."""
        try:
            frames = self._pipeline.wait_for_frames(timeout_ms)
        except faults_of(self._sdk) as fault:
            raise self.lost(fault) from fault
        if frames is not None:
            self._reader.add(frames, self.sensor.clock())
            if self._reader.timeless:
                self.sensor._warn(_TIMELESS.format(name=self.label))
        return frames is not None

    def is_connected(self) -> bool:
        """Whether the SDK still lists the sensor; frames of one that is unplugged stop without an error."""
        return is_connected(self._sdk, self.sensor.name)


class OrbbecSensor(VendorSensor):
    """One Orbbec sensor: a :class:`~devices.sensor.Sensor` whose frames have depth and infrared, no people.

    :class:`~devices.blazepose.tracked_images.TrackedImages` finds the people. Times are those of the sensor's
    own clock, which is set to this machine's once, before the cameras start; from then on its drift is
    followed where frames are paired. The SDK's global time stamps are not used: they are refitted every
    second, and each fit moves all later times.

    A sensor without the sizes of Femto Bolt and Mega runs in that nearest to 640 pixels wide.
    """

    model, programs = "Orbbec", "OrbbecViewer"

    def open(self) -> Any:
        """Opens the sensor, gives it its place on the sync cable, starts its cameras."""
        check_modes(self.settings)
        sdk = self._sdk = load_sdk()
        device = open_orbbec(sdk, self.name)
        self._warn(set_sync_role(sdk, device, self.name, self.settings))
        with suppress(*faults_of(sdk)):  # a clock that starts anywhere will do: pairing finds the offset
            device.timer_sync_with_host()
        try:
            pipeline = sdk.Pipeline(device)
            streams = choose_streams(sdk, pipeline, self.name, self.settings)
            self._read_calibration(streams)
            pipeline.disable_frame_sync()
            pipeline.start(streams.configuration(sdk))
        except faults_of(sdk) as fault:
            if not is_connected(sdk, self.name):
                raise Cause.UNPLUGGED.error(label=self.label) from fault
            raise self.not_started(fault) from fault
        return pipeline  # the SDK closes a sensor when nothing refers to it

    def stream(self, opened: Any) -> CaptureStream:
        """The moments of the running ``pyorbbecsdk.Pipeline``."""
        return _OrbbecStream(opened, self._sdk, self)

    def close(self, opened: Any) -> None:
        """Stops and closes the sensor."""
        try:
            opened.stop()
        except faults_of(self._sdk) as fault:
            if is_connected(self._sdk, self.name):
                self._warn(f"{self.label} did not close cleanly ({fault}).")

    def frame_of(self, moment: Moment) -> SensorFrame:
        """The images of a moment, copied from the SDK's memory."""
        return SensorFrame(
            time_ns=moment.time_ns,
            depth=depth_image(moment.depth),
            ir=None if moment.infrared is None else infrared_image(moment.infrared),
            color=color_image(moment.color, self.color_camera),
            host_ns=moment.host_ns,
        )

    def _read_calibration(self, streams: Streams) -> None:
        self.intrinsics, warning = intrinsics_of(self._sdk, streams.depth, self.name)
        self._warn(warning)
        self.color_camera = None
        if streams.color is not None:
            self.color_camera, warning = color_camera(self._sdk, streams.color, streams.depth, self.name)
            self._warn(warning)


VENDOR = Vendor("Orbbec (Femto, Gemini)", COMMAND, connected_orbbecs, OrbbecSensor, sdk_check, sensor_check)
