"""Writes Azure Kinect recordings (.mkv), of any sensor's images.

The layout is that of Microsoft's recorder, which :mod:`devices.azure.mkv` and Microsoft's tools read. The
file is not made by libavformat, whose muxer rounds times to milliseconds, writes none of Microsoft's FOURCC,
and has no FFVHUFF. Element numbers: RFC 9559 (Matroska), RFC 8794 (EBML).

Each frame is a cluster, written at once, so a file that was cut off holds every frame before.
"""

from __future__ import annotations

import struct
import time
from itertools import accumulate
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.azure.calibration import COLOR_SIZES, calibration_json, mode_name
from devices.capture.settings import CaptureSettings
from devices.output_file import GrowingOutput
from devices.sensor import DeviceError, SensorFrame
from fusion.intrinsics import Intrinsics

HOST_TRACK = "HOST"
"""The track of each frame's arrival on the recording machine's clock: int64 ns, little-endian."""
_TRACKS = {"DEPTH": 1, "IR": 2, "COLOR": 3, HOST_TRACK: 4}
_ATTACHMENT = 1
_CALIBRATION = "calibration.json"
_DATES_BEGIN_NS = 978_307_200_000_000_000
"""2001-01-01 UTC, since 1970."""
_UNKNOWN_SIZE = b"\x01" + b"\xff" * 7
_VIDEO, _SUBTITLE = 1, 17


class MkvWriter:
    """A recording that grows.

    Args:
        path: The file; see :class:`~devices.output_file.GrowingOutput`.
        serial: Serial number of the sensor.
        settings: How the sensor runs: rate, place on the sync cable.
        lens: Intrinsics of the depth camera.
        first: The first frame. Later ones may have fewer kinds of images, not more.
        calibration: The JSON that an Azure Kinect stores; empty: made from the cameras' intrinsics.
        compress: Whether depth and infrared are compressed without loss (FFVHUFF). Microsoft's tools read
            raw images only.
        how: Of :class:`~devices.output_file.GrowingOutput`.

    Raises:
        OSError: The file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        serial: str,
        settings: CaptureSettings,
        lens: Intrinsics,
        first: SensorFrame,
        *,
        calibration: bytes = b"",
        compress: bool = False,
        **how: Any,
    ) -> None:
        if first.depth is None:
            raise DeviceError(f"{serial} gives no depth image, so there is nothing to record.")
        self.path, self._start_us, self._last_us = path, first.time_ns // 1000, 0
        self._interval_us = 1_000_000 // settings.fps
        self._encoders: dict[str, Any] = {}
        kinds = {"DEPTH": True, "IR": first.ir is not None, "COLOR": first.color is not None}
        kinds[HOST_TRACK] = first.host_ns is not None
        self._tracks = [name for name, present in kinds.items() if present]
        if compress:
            size = first.depth.shape[1], first.depth.shape[0]
            self._encoders = {name: _encoder(size) for name in self._tracks[:2] if name != "COLOR"}
        color = None if first.color is None else first.color.camera
        mode = mode_name(lens, settings.depth_mode)
        calibration = calibration or calibration_json(lens, mode, color)
        head, self._duration_at = self._head(serial, settings, first, mode, calibration)
        self._file, self._open = GrowingOutput(path, **how), True
        try:
            self._file.append(head)
        except BaseException:
            self._file.close(whole=False)
            raise

    def write(self, frame: SensorFrame) -> None:
        """Appends a frame. Its time is later than that of the frame before.

        Raises:
            OSError: It could not be written; the file then ends with the frame before.
        """
        assert frame.depth is not None
        time_us = frame.time_ns // 1000 - self._start_us
        host = None if frame.host_ns is None else struct.pack("<q", frame.host_ns)
        color = None if frame.color is None else frame.color.jpeg
        images = {"DEPTH": self._coded("DEPTH", frame.depth), "IR": None, "COLOR": color, HOST_TRACK: host}
        if frame.ir is not None:
            images["IR"] = self._coded("IR", frame.ir)
        blocks = []
        for name in self._tracks:
            content = images[name]
            if content is not None:
                # the time within the cluster is 0; each block is a key frame
                blocks += [
                    _head_of(0xA3, len(content) + 4),
                    bytes((0x80 | _TRACKS[name], 0, 0, 0x80)),
                    content,
                ]
        time = _element(0xE7, _number(time_us))
        size = len(time) + sum(map(len, blocks))
        self._file.append(b"".join((_head_of(0x1F43B675, size), time, *blocks)))
        self._last_us = time_us

    def close(self) -> None:
        """Writes the duration and closes. Closing twice has no effect."""
        if not self._open:
            return
        self._open = False
        try:
            self._file.patch(self._duration_at, struct.pack(">d", self._last_us + self._interval_us))
        finally:
            self._file.close()

    def __enter__(self) -> MkvWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        if kind is None:
            self.close()
        self._file.close(whole=False)

    def _coded(self, name: str, image: NDArray[np.uint16]) -> bytes:
        encoder = self._encoders.get(name)
        if encoder is None:
            return image.astype(">u2").tobytes()
        import av

        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="gray16le")
        (packet,) = encoder.encode(picture)
        return bytes(packet)

    def _head(
        self, serial: str, settings: CaptureSettings, first: SensorFrame, mode: str, calibration: bytes
    ) -> tuple[bytes, int]:
        """Everything before the first frame, and where in it the duration is."""
        versions = {0x4286: 1, 0x42F7: 1, 0x42F2: 4, 0x42F3: 8, 0x4287: 4, 0x4285: 2}
        numbers = [_element(key, _number(value)) for key, value in versions.items()]
        head = _element(0x1A45DFA3, *numbers, _element(0x4282, b"matroska"))
        head += b"\x18\x53\x80\x67" + _UNKNOWN_SIZE  # the segment
        program = b"duplex-kinects"
        date = _element(0x4461, struct.pack(">q", time.time_ns() - _DATES_BEGIN_NS))
        about = (date, _element(0x4D80, program), _element(0x5741, program))
        duration = _element(0x4489, struct.pack(">d", 0.0))  # 0 until the file is closed
        file = (_element(0x466E, _CALIBRATION.encode()), _element(0x4660, b"application/octet-stream"))
        attached = (*file, _element(0x46AE, _number(_ATTACHMENT)), _element(0x465C, calibration))
        parts = {
            0x1549A966: (_element(0x2AD7B1, _number(1000)), *about, duration),
            0x1654AE6B: tuple(self._track(name, settings, first) for name in self._tracks),
            0x1941A469: (_element(0x61A7, *attached),),
            0x1254C367: _tags(serial, settings, first, mode, 1000 * self._start_us),
        }
        written = [_element(key, *contents) for key, contents in parts.items()]
        at = len(_seek_head(dict.fromkeys(parts, 0)))
        places = dict(zip(parts, accumulate(map(len, written), initial=at), strict=False))
        head += _seek_head(places)
        duration_at = len(head) + len(written[0]) - 8
        return head + b"".join(written), duration_at

    def _track(self, name: str, settings: CaptureSettings, first: SensorFrame) -> bytes:
        kind = _SUBTITLE if name == HOST_TRACK else _VIDEO
        number = _number(_TRACKS[name])
        about = [_element(0xD7, number), _element(0x73C5, number), _element(0x83, _number(kind))]
        about += [_element(0x9C, _number(0)), _element(0x536E, name.encode())]
        if kind == _SUBTITLE:
            return _element(0xAE, *about, _element(0x86, b"S_DUPLEX/HOST_NS"))
        assert first.depth is not None
        (height, width), fourcc, bits, extra = first.depth.shape, b"b16g", 16, b""
        if name == "COLOR":
            assert first.color is not None
            lens = first.color.camera.intrinsics
            width, height, fourcc, bits = lens.width, lens.height, b"MJPG", 24
        elif name in self._encoders:
            fourcc, extra = b"FFVH", bytes(self._encoders[name].extradata)
        format_ = struct.pack(
            "<IiiHH4sIiiII", 40, width, height, 1, bits, fourcc, 2 * width * height, 0, 0, 0, 0
        )
        about += [
            _element(0x23E383, _number(1_000_000_000 // settings.fps)),
            _element(0x86, b"V_MS/VFW/FOURCC"),
            _element(0x63A2, format_ + extra),
            _element(0xE0, _element(0xB0, _number(width)), _element(0xBA, _number(height))),
        ]
        return _element(0xAE, *about)


def _encoder(size: tuple[int, int]) -> Any:
    """FFVHUFF: the only lossless codec of libavcodec that keeps up; FFV1 takes nine times as long."""
    import av

    encoder: Any = av.CodecContext.create("ffvhuff", "w")
    encoder.width, encoder.height = size
    encoder.pix_fmt, encoder.framerate, encoder.thread_count = "gray16le", 30, 1
    encoder.options = {"pred": "median"}
    encoder.open()
    return encoder


def _tags(
    serial: str, settings: CaptureSettings, first: SensorFrame, mode: str, start_ns: int
) -> tuple[bytes, ...]:
    depth, infrared, color = (_element(0x63C5, _number(_TRACKS[name])) for name in ("DEPTH", "IR", "COLOR"))
    delay_ns = 1000 * settings.delay_us if settings.sync == "subordinate" else 0
    tags = [
        _tag("K4A_DEPTH_MODE", mode, depth),
        _tag("K4A_CALIBRATION_FILE", _CALIBRATION, _element(0x63C6, _number(_ATTACHMENT))),
        _tag("K4A_DEVICE_SERIAL_NUMBER", serial),
        _tag("K4A_START_OFFSET_NS", str(start_ns)),
        _tag("K4A_WIRED_SYNC_MODE", settings.sync.upper()),
        _tag("K4A_SUBORDINATE_DELAY_NS", str(delay_ns)),
        _tag("K4A_DEPTH_DELAY_NS", "0"),
    ]
    if first.ir is not None:
        tags.append(_tag("K4A_IR_MODE", "ACTIVE", infrared))
    if first.color is not None:
        lens = first.color.camera.intrinsics
        sizes = {size: name for name, size in COLOR_SIZES.items()}
        name = sizes.get((lens.width, lens.height), f"{lens.width}X{lens.height}")
        tags.append(_tag("K4A_COLOR_MODE", f"MJPG_{name}", color))
    return tuple(tags)


def _seek_head(places: dict[int, int]) -> bytes:
    """The SeekHead: the positions of the segment's parts, which Microsoft's reader needs."""
    return _element(
        0x114D9B74,
        *(
            _element(0x4DBB, _element(0x53AB, _key(key)), _element(0x53AC, place.to_bytes(8, "big")))
            for key, place in places.items()
        ),
    )


def _tag(name: str, value: str, target: bytes = b"") -> bytes:
    said = _element(0x67C8, _element(0x45A3, name.encode()), _element(0x4487, value.encode()))
    return _element(0x7373, _element(0x63C0, target), said)


def _element(key: int, *contents: bytes) -> bytes:
    return b"".join((_head_of(key, sum(map(len, contents))), *contents))


def _head_of(key: int, size: int) -> bytes:
    return _key(key) + (size | 1 << 56).to_bytes(8, "big")


def _key(key: int) -> bytes:
    return key.to_bytes((key.bit_length() + 7) // 8, "big")


def _number(value: int) -> bytes:
    return value.to_bytes(max(1, (value.bit_length() + 7) // 8), "big")
