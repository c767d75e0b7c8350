"""Reads Azure Kinect recordings (.mkv) without an SDK.

A recording is a Matroska file with the streams DEPTH and IR (raw 16 bit, big-endian; of this program also
compressed). The stream COLOR is read where there is no infrared and colour is of the depth camera's pixels;
inertial measurements are not read. The factory calibration is an attachment. Device time is the packet's time
plus the start offset in the file's metadata. Recordings of this program have the arrival of each frame, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from devices.azure.calibration import DEPTH_MODES, depth_intrinsics, depth_mode
from devices.depth.camera import AZURE_KINECT_OFFSET, KINECT_V2_OFFSET
from devices.input_file import check_recording
from devices.sensor import CableSync, ColorCamera, ColorImage, DeviceError, ImageRecording, SensorFrame
from fusion.body import AZURE_KINECT, Body
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform

_RAW = ("DEPTH", "IR")
_READ = (*_RAW, "COLOR", "HOST")


@dataclass(frozen=True, eq=False)
class MkvInfo:
    """Metadata of a recording and of its sensor."""

    serial: str  # the sensor's serial number; empty if the file has none
    depth_mode: str  # a key of ``DEPTH_MODES``; of another vendor's sensor its size, as in 640X480
    sync_mode: str  # ``STANDALONE``, ``MASTER`` or ``SUBORDINATE``
    subordinate_delay_ns: int  # delay of a subordinate's captures after the master's
    start_offset_ns: int  # device time of the file's time 0
    recorded: str  # when, ISO 8601; empty if the file does not say
    interval_ns: int  # time between two frames
    duration_ns: int  # time from the start of the file to its last frame; 0 if the file was never closed
    intrinsics: Intrinsics  # intrinsics of the depth camera in this mode
    calibration_json: bytes  # the JSON that the sensor stores, for the SDK


class MkvRecording(ImageRecording):
    """A recording of an Azure Kinect."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.name = self.path.name
        self.body: Body = AZURE_KINECT
        self.intrinsics: Intrinsics | None = None
        self.info: MkvInfo | None = None
        self.warnings: list[str] = []
        self._container: Any = None
        self.arrivals: list[tuple[int, int]] = []
        self._begun, self._described = False, 0

    def __enter__(self) -> MkvRecording:
        self.__exit__()
        self._container, self._begun = self._open(), False
        self.warnings, self.arrivals = [], []
        try:
            self.info = self._describe(self._container)
        except BaseException:
            self.__exit__()
            raise
        self.intrinsics, self._described = self.info.intrinsics, len(self.warnings)
        offset = KINECT_V2_OFFSET if self.info.depth_mode == "512X424" else 0.0
        offset = AZURE_KINECT_OFFSET if self.info.depth_mode in DEPTH_MODES else offset
        self.depth_offset = 0.0 if self.info.serial.startswith("simulated") else offset
        self.duration_ns, self.interval_ns = self.info.duration_ns, self.info.interval_ns
        serial = self.info.serial or "unknown"
        self.sensor = f"{serial}, {self.info.depth_mode}, {self.info.sync_mode.lower()}"
        self.sync = CableSync(self.info.sync_mode, self.info.subordinate_delay_ns)
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self._container is not None:
            self._container.close()
            self._container = None

    def frames(self) -> Iterator[SensorFrame]:
        """Yields the recorded frames in capture order: depth and infrared.

        If a crash cut the file off, its complete frames are yielded and ``warnings`` states what is missing;
        no complete frame is a DeviceError. Each call starts at the first frame.
        """
        if self._container is None or self.info is None:
            raise DeviceError(f"{self.name} is not open: use it in a with statement.")
        if self._begun:  # an iterator that is still in use keeps its own open file
            self._container = self._open()
            self.arrivals.clear()
            del self.warnings[self._described :]
        self._begun = True
        info = self.info
        given = missing = last_ns = 0
        with_infrared = "IR" in _streams(self._container)
        camera = ColorCamera(info.intrinsics, RigidTransform.identity())
        for last_ns, images in _exposures(self._images(info), info.interval_ns // 2):
            given += 1
            depth, infrared, color, host = (images.get(title) for title in _READ)
            missing += with_infrared and infrared is None
            time_ns = info.start_offset_ns + last_ns
            host_ns = None if host is None else int.from_bytes(host[:8], "little", signed=True)
            if host_ns is not None:
                self.arrivals.append((time_ns, host_ns))
            yield SensorFrame(
                time_ns=time_ns,
                depth=depth,
                ir=infrared,
                color=None if color is None else ColorImage.of(color, camera),
                host_ns=host_ns,
            )
        self._judge(given, last_ns, missing, info)

    def _open(self) -> Any:
        import av

        check_recording(self.path)
        try:
            return av.open(str(self.path), metadata_errors="ignore")
        except (av.FFmpegError, OSError) as fault:
            raise DeviceError(
                f"{self.name} cannot be opened as an .mkv recording ({fault}): it was cut off within its "
                f"first bytes, or is another kind of file. Record it again."
            ) from fault

    def _describe(self, container: Any) -> MkvInfo:
        streams = _streams(container)
        tags: dict[str, str] = dict(container.metadata)
        for stream in container.streams:
            tags.update({key: value for key, value in stream.metadata.items() if key.startswith("K4A_")})
        if "DEPTH" not in streams or "K4A_DEPTH_MODE" not in tags:
            found = ", ".join(title for title in streams if title) or "no named stream"
            raise DeviceError(
                f"{self.name} has no depth of an Azure Kinect (found: {found}). Record with depth on: "
                f"k4arecorder --depth-mode NFOV_UNBINNED."
            )
        depth = tags["K4A_DEPTH_MODE"]
        mode = depth_mode(depth)
        stream = streams["DEPTH"]
        width, height = _size(stream)
        if (width, height) != (mode.width, mode.height):
            raise DeviceError(
                f"{self.name} says depth mode {depth}, {mode.width} x {mode.height}, but its images are "
                f"{width} x {height}. The file is damaged; record it again."
            )
        calibration = self._attachment(container)
        rate = stream.average_rate or 30
        return MkvInfo(
            serial=tags.get("K4A_DEVICE_SERIAL_NUMBER", ""),
            depth_mode=depth,
            sync_mode=tags.get("K4A_WIRED_SYNC_MODE", "STANDALONE"),
            subordinate_delay_ns=_whole(tags.get("K4A_SUBORDINATE_DELAY_NS")),
            start_offset_ns=_whole(tags.get("K4A_START_OFFSET_NS")),
            recorded=tags.get("creation_time", ""),
            interval_ns=int(1e9 / rate),
            duration_ns=int(container.duration or 0) * 1000,
            intrinsics=depth_intrinsics(calibration, depth),
            calibration_json=calibration,
        )

    def _attachment(self, container: Any) -> bytes:
        for stream in container.streams:
            if stream.type == "attachment" and "calibration" in (stream.name or "calibration"):
                return bytes(stream.data)
        raise DeviceError(
            f"{self.name} holds no calibration, so its depth cannot be placed in space. It was cut off "
            f"before it, or copied by a program that drops attachments; use the original file."
        )

    def _images(self, info: MkvInfo) -> Iterator[tuple[str, int, Any]]:
        """Yields (title, ns from the file's start, content) of each whole image, until the first damaged one.

        Depth and infrared are arrays; colour and arrival are bytes.
        """
        import av

        mode = depth_mode(info.depth_mode)
        size = mode.width, mode.height
        container = self._container
        streams = _streams(container)
        color = streams.get("COLOR")
        read = [streams[title] for title in _READ if title in streams and title != "COLOR"]
        if "IR" not in streams and _size(color) == size:
            read.append(color)
        try:
            for packet in container.demux(read):
                if packet.pts is None or packet.is_corrupt or not packet.size:
                    continue
                title = packet.stream.metadata["title"]
                content: Any = None
                at_ns = int(packet.pts * packet.time_base * 1_000_000_000)
                if title not in _RAW:
                    content = bytes(packet)
                elif getattr(packet.stream.codec_context, "name", "") == "ffvhuff":
                    for picture in packet.decode():
                        if _size(picture) == size:
                            content = picture.to_ndarray(format="gray16le")
                elif packet.size == 2 * mode.width * mode.height:
                    image = np.frombuffer(packet, dtype=">u2")
                    content = image.reshape(mode.height, mode.width).astype(np.uint16)
                if content is not None:
                    yield title, at_ns, content
        except (av.FFmpegError, OSError) as fault:
            self.warnings.append(f"{self.name} cannot be read to its end ({fault}).")

    def _judge(self, given: int, last_ns: int, missing: int, info: MkvInfo) -> None:
        if not given:
            raise DeviceError(
                f"{self.name} holds no complete frame: it was cut off before the first, or depth stopped at "
                f"once. Record it again."
            )
        if missing:
            self.warnings.append(f"{self.name}: frames without their infrared image: {missing} of {given}.")
        # Closing a recording writes its duration: 0 means never closed, too long means truncated later.
        if info.duration_ns == 0 or info.duration_ns - last_ns > 1.5 * info.interval_ns:
            said = f" of {info.duration_ns / 1e9:.1f} s" if info.duration_ns else ""
            self.warnings.append(
                f"{self.name} is cut off: {given} frames up to {last_ns / 1e9:.1f} s{said} could be read."
            )


def _streams(container: Any) -> dict[str, Any]:
    return {stream.metadata.get("title", ""): stream for stream in container.streams}


def _size(stream: Any) -> tuple[int, int]:
    """Width and height; 0 of a stream with a damaged header."""
    return getattr(stream, "width", 0), getattr(stream, "height", 0)


def _whole(text: str | None) -> int:
    try:
        return int(text or 0)
    except ValueError:
        return 0


def _exposures(images: Iterator[tuple[str, int, Any]], reach_ns: int) -> Iterator[tuple[int, dict[str, Any]]]:
    """Joins each depth image with the nearest of each other stream at most ``reach_ns`` away, in any order in
    the file.
    """
    waiting: dict[str, dict[int, Any]] = {title: {} for title in _READ}
    depths = waiting["DEPTH"]
    others = {title: kept for title, kept in waiting.items() if title != "DEPTH"}

    def complete(until_ns: float) -> Iterator[tuple[int, dict[str, Any]]]:
        for depth_ns in sorted(time_ns for time_ns in depths if time_ns < until_ns):
            joined = {"DEPTH": depths.pop(depth_ns)}
            for title, kept in others.items():
                nearest_ns = min(kept, key=lambda time_ns: abs(time_ns - depth_ns), default=None)
                if nearest_ns is not None and abs(nearest_ns - depth_ns) <= reach_ns:
                    joined[title] = kept.pop(nearest_ns)
            yield depth_ns, joined
        for kept in others.values():
            for old_ns in [time_ns for time_ns in kept if time_ns < until_ns - reach_ns]:
                del kept[old_ns]

    newest_ns = 0
    for title, time_ns, data in images:
        waiting[title][time_ns] = data
        newest_ns = max(newest_ns, time_ns)
        yield from complete(newest_ns - 2 * reach_ns)
    yield from complete(math.inf)
