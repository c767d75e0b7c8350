"""Recordings of Orbbec's SDK v2 (``.bag``), through its ``PlaybackDevice``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from devices.capture.clock.moments import ImageJoiner
from devices.input_file import check_recording
from devices.orbbec.images import FrameReader, depth_image, infrared_image
from devices.orbbec.sdk_access import context_of, faults_of, load_sdk
from devices.orbbec.streams import intrinsics_of
from devices.sensor import DeviceError, ImageRecording, SensorFrame
from fusion.body import BLAZEPOSE, Body
from fusion.intrinsics import Intrinsics

_WAIT_MS = 200
_SILENT_S = 10.0  # of a recording that neither gives frames nor says that it has ended
_ENDS = 5  # frames by which the last one may come before the end that the file states


class OrbbecRecording(ImageRecording):
    """A recording's depth and infrared images.

    The SDK plays at the pace of the recording and drops what is not taken in time; frames that are missing
    are counted in ``warnings``.
    """

    def __init__(self, path: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self.path, self.name = path, path.name
        self.body: Body = BLAZEPOSE
        self.intrinsics: Intrinsics | None = None
        self.warnings: list[str] = []
        self._clock = clock
        self._sdk: Any = None
        self._device: Any = None
        self._pipeline: Any = None
        self._streams: tuple[Any, ...] = ()

    def __enter__(self) -> OrbbecRecording:
        self.__exit__()
        check_recording(self.path)
        sdk = self._sdk = load_sdk()
        context_of(sdk)  # silences the SDK
        try:
            self._device = sdk.PlaybackDevice(str(self.path))
            pipeline = self._pipeline = sdk.Pipeline(self._device)
            depth = _first(sdk, pipeline, sdk.OBSensorType.DEPTH_SENSOR)
            infrared = _first(sdk, pipeline, sdk.OBSensorType.IR_SENSOR) or _first(
                sdk, pipeline, sdk.OBSensorType.LEFT_IR_SENSOR
            )
            if depth is None or infrared is None:
                missing = "depth" if depth is None else "infrared"
                raise DeviceError(f"{self.name} has no {missing} stream. Record depth and infrared.")
            self.intrinsics, warning = intrinsics_of(sdk, depth, self.name)
            self.warnings = [warning] if warning else []
            self._streams = depth, infrared
            self.duration_ns = 1_000_000 * int(self._device.get_duration())  # the SDK's are milliseconds
            self.interval_ns = round(1e9 / depth.get_fps())
        except faults_of(sdk) as fault:
            self.__exit__()
            raise DeviceError(
                f"{self.name} cannot be read ({fault}). It is not a recording of Orbbec's SDK v2, or it is "
                f"damaged: play it in OrbbecViewer."
            ) from fault
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._pipeline = self._device = None
        self._streams = ()

    def frames(self) -> Iterator[SensorFrame]:
        """The frames in capture order."""
        if self._pipeline is None:
            raise DeviceError(f"{self.name} is not open: use it in a with statement.")
        sdk, device, pipeline = self._sdk, self._device, self._pipeline
        joiner = ImageJoiner(self.interval_ns, infrared=self.interval_ns)
        reader, configuration = FrameReader(joiner), sdk.Config()
        for profile in self._streams:
            configuration.enable_stream(profile)
        configuration.set_frame_aggregate_output_mode(sdk.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
        given, missing, heard_s = 0, 0, self._clock()
        first_ns = last_ns = -1
        try:
            pipeline.start(configuration)
            while True:
                # Asked before waiting: what came until the end is in the queue by then.
                ended = device.get_playback_status() == sdk.OBPlaybackStatus.STOPPED
                frames = pipeline.wait_for_frames(_WAIT_MS)
                if frames is None:
                    if (ended and given) or self._clock() - heard_s > _SILENT_S:
                        break
                    continue
                heard_s = self._clock()
                reader.add(frames, 0)
                while (moment := joiner.take()) is not None:
                    if given and moment.time_ns <= last_ns:
                        continue
                    if given:
                        missing += max(0, round((moment.time_ns - last_ns) / self.interval_ns) - 1)
                    first_ns, last_ns = moment.time_ns if first_ns < 0 else first_ns, moment.time_ns
                    given += 1
                    yield SensorFrame(
                        time_ns=moment.time_ns,
                        depth=depth_image(moment.depth),
                        ir=None if moment.infrared is None else infrared_image(moment.infrared),
                    )
        except faults_of(sdk) as fault:
            raise DeviceError(f"{self.name} is damaged ({fault}). Play it in OrbbecViewer.") from fault
        finally:
            with suppress(*faults_of(sdk)):  # a fault of reading, which is told, often makes this fail, too
                pipeline.stop()
            if missing:
                self._warn(
                    f"{self.name}: frames are missing: {missing}; they are not in the recording, or reading "
                    f"was slower than its {1e9 / self.interval_ns:.3g} frames per second."
                )
        if not given:
            raise DeviceError(f"{self.name} holds no complete frame. Play it in OrbbecViewer.")
        played_ns = last_ns - first_ns + self.interval_ns
        if self.duration_ns - played_ns > _ENDS * self.interval_ns:
            self._warn(
                f"{self.name} is damaged, or depth ended early: {given} frames of the first "
                f"{1e-9 * played_ns:.1f} of {1e-9 * self.duration_ns:.1f} s could be read."
            )

    def _warn(self, warning: str) -> None:
        if warning not in self.warnings:
            self.warnings.append(warning)


def _first(sdk: Any, pipeline: Any, sensor: Any) -> Any:
    """The stream of a recorded camera, of which a recording has one; None if it was not recorded."""
    try:
        profiles = pipeline.get_stream_profile_list(sensor)
        return profiles.get_stream_profile_by_index(0) if profiles.get_count() else None
    except faults_of(sdk):
        return None
