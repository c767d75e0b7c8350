"""Streams of a RealSense sensor, and the depth and image of one moment from their frames."""

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.capture.clock.moments import ImageJoiner, Moment
from devices.sensor import ColorCamera, ColorImage, DeviceError, SensorFrame
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform

COLOR_SIZES = {"720P": (1280, 720), "1080P": (1920, 1080)}
_USUAL_WIDTH = 640
_WRAP_NS = 1000 * 2**32  # the sensors' clocks are 32-bit microseconds: 72 minutes
_OLDEST_NS = 5_000_000_000


@dataclass(frozen=True, eq=False)
class Streams:
    """Depth, and the image that people are found in: infrared of the same pixels, or colour."""

    depth: Any  # the library's video_stream_profile
    image: Any
    opened: tuple[tuple[Any, tuple[Any, ...]], ...]  # the library's sensors, and the profiles of each

    def start(self, take: Any) -> None:
        """Starts the cameras, which give their frames to a ``frame_queue`` or a function."""
        for sensor, profiles in self.opened:
            sensor.open(list(profiles))
        for sensor, _ in self.opened:
            sensor.start(take)

    def stop(self) -> None:
        """Stops the cameras, also of a sensor that is gone or was never started."""
        for sensor, _ in self.opened:
            for end in (sensor.stop, sensor.close):
                with suppress(RuntimeError):
                    end()


def choose_streams(
    sdk: Any, device: Any, label: str, fps: int | None = None, color: str | None = None
) -> Streams:
    """Chooses the streams of a sensor or a recording.

    Depth is that nearest to 640 pixels wide. The image is infrared of the same pixels; it is colour where
    that is asked for, or where there is no such infrared.

    Args:
        fps: The rate; None: any.
        color: A colour mode such as ``720P``; None: infrared, else the smallest colour.

    Raises:
        DeviceError: There are no such images.
    """
    if color is not None and color not in COLOR_SIZES:
        raise DeviceError(f"RealSense sensors have no colour {color}: {', '.join(COLOR_SIZES)}.")
    stream, form = sdk.stream, sdk.format
    found = [
        (sensor, profile.as_video_stream_profile())
        for sensor in device.query_sensors()
        for profile in sensor.get_stream_profiles()
        if profile.is_video_stream_profile() and fps in (None, profile.fps())
    ]

    def of(kind: Any, image_format: Any) -> list[tuple[Any, Any]]:
        return [one for one in found if (one[1].stream_type(), one[1].format()) == (kind, image_format)]

    at = "" if fps is None else f" at {fps} fps"
    depths = of(stream.depth, form.z16)
    if not depths:
        raise DeviceError(f"{label} has no depth{at}. Choose another `fps`, or record depth.")
    # Depth is of the left camera's pixels: infrared stream 1, or 0 where there is one. 2 is the right
    # camera's, a baseline away. Y16 is not rectified.
    lefts = [one for one in of(stream.infrared, form.y8) if one[1].stream_index() < 2]
    infrareds = {_size(one[1]): one for one in lefts}
    colors = of(stream.color, form.rgb8)
    if color is not None:
        colors = [one for one in colors if _size(one[1]) == COLOR_SIZES[color]]
    usable = [] if color is not None else [one for one in depths if _size(one[1]) in infrareds]
    if color is not None and not colors:
        raise DeviceError(f"{label} has no colour {color} (RGB8){at}. Leave `color` out.")
    if not usable and not colors:
        raise DeviceError(
            f"{label} has no infrared image of its depth's size and no colour (RGB8){at}. The body tracker "
            f"needs one of them."
        )
    depth = min(usable or depths, key=lambda one: (abs(one[1].width() - _USUAL_WIDTH), -one[1].height()))
    image = infrareds[_size(depth[1])] if usable else min(colors, key=lambda one: _size(one[1]))
    if depth[0] is image[0]:
        return Streams(depth[1], image[1], ((depth[0], (depth[1], image[1])),))
    return Streams(depth[1], image[1], ((depth[0], (depth[1],)), (image[0], (image[1],))))


def _size(profile: Any) -> tuple[int, int]:
    return profile.width(), profile.height()


def intrinsics_of(profile: Any, label: str) -> tuple[Intrinsics, str]:
    """The lens of a stream, and a warning; empty if there is none.

    A distortion that is not OpenCV's is left out with a warning. Depth of the D400 series has none.
    """
    lens = profile.get_intrinsics()
    coefficients = tuple(float(value) for value in lens.coeffs)
    warning = ""
    if not any(coefficients) or lens.model.name != "brown_conrady":
        if any(coefficients):
            warning = f"{label}: lens distortion of the model {lens.model.name} is not known and is left out."
        coefficients = ()
    pinhole = Intrinsics(lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy, coefficients)
    return pinhole, warning


class FrameReader:
    """Gives the frames of two streams, which come in any order, to a joiner, and makes images of moments.

    Attributes:
        joiner: Infrared is of the exposure of depth and has its time; colour is at most half a frame away.
        image: The stream beside depth, ``infrared`` or ``color``.
        camera: That of colour registered to depth; None if there is no colour.
        timeless: Whether a frame came without a time of the sensor's own clock.
    """

    def __init__(self, sdk: Any, streams: Streams, lens: Intrinsics, *, wait_ns: int | None = None) -> None:
        self._sdk = sdk
        self.image = "color" if streams.image.stream_type() == sdk.stream.color else "infrared"
        self._registered = ColorCamera(lens, RigidTransform.identity())
        self.camera = self._registered if self.image == "color" else None
        depth_ns, image_ns = (round(1e9 / stream.fps()) for stream in (streams.depth, streams.image))
        self.joiner = ImageJoiner(depth_ns, wait_ns, **{self.image: image_ns})
        self._last_ns = 0
        self.timeless = False
        # The library aligns sets of frames only. Its block keeps the function: what that refers to lives as
        # long as the block, and must not refer to it.
        self._parts, self._sets = list[Any](), list[Any]()
        parts = self._parts
        self._join = sdk.processing_block(
            lambda _, source: source.frame_ready(source.allocate_composite_frame(parts))
        )
        self._join.start(self._sets.append)
        self._align = sdk.align(sdk.stream.depth)

    def add(self, frame: Any, now_ns: int) -> None:
        """Takes a frame."""
        if frame.is_depth_frame():
            host_ns = now_ns - self._age_ns(frame)
            self.joiner.add_depth(self._time_ns(frame), host_ns, frame, now_ns)
        else:
            self.joiner.add(self.image, self._time_ns(frame), frame)

    def frame_of(self, moment: Moment, host_ns: int | None) -> SensorFrame:
        """The images of a moment; colour as an image of the depth camera."""
        depth, infrared, color = depth_image(moment.depth), None, None
        if moment.infrared is not None:
            infrared = _pixels(moment.infrared).astype(np.uint16)
        if moment.color is not None:
            self._parts[:] = moment.depth, moment.color
            self._join.invoke(moment.depth)
            aligned = self._align.process(self._sets.pop().as_frameset())
            self._parts.clear()
            color = ColorImage.of_rgb(_pixels(aligned.get_color_frame()), self._registered)
        return SensorFrame(moment.time_ns, depth=depth, ir=infrared, color=color, host_ns=host_ns)

    def _time_ns(self, frame: Any) -> int:
        """The time of the sensor's own clock, continued where its counter starts anew."""
        time_ns = round(1e6 * float(frame.get_timestamp()))
        domain = self._sdk.timestamp_domain
        self.timeless = self.timeless or frame.get_frame_timestamp_domain() == domain.system_time
        if frame.get_frame_timestamp_domain() == domain.hardware_clock:
            time_ns += max(0, round((self._last_ns - time_ns) / _WRAP_NS)) * _WRAP_NS
        self._last_ns = time_ns
        return time_ns

    def _age_ns(self, frame: Any) -> int:
        """How long ago a frame reached this machine; 0 where the library does not say."""
        arrival = self._sdk.frame_metadata_value.time_of_arrival
        if not frame.supports_frame_metadata(arrival):
            return 0
        age_ns = time.time_ns() - 1_000_000 * int(frame.get_frame_metadata(arrival))
        return int(age_ns) if 0 <= age_ns < _OLDEST_NS else 0


def depth_image(frame: Any) -> NDArray[np.uint16]:
    """(height, width) uint16 millimetres; 0 where there is no reading, or beyond 65.5 m."""
    scale = np.float32(1000.0 * frame.as_depth_frame().get_units())  # millimetres per unit
    if abs(scale - 1.0) < 1e-6:
        return _pixels(frame)
    scaled = np.rint(_pixels(frame) * scale)
    return np.where(scaled <= np.iinfo(np.uint16).max, scaled, 0.0).astype(np.uint16)


def _pixels(frame: Any) -> NDArray[Any]:
    return np.array(frame.get_data())  # a copy: the library uses the memory again
