"""Images from the SDK's frames, and the images of one moment joined."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.capture.capture_stream import Moment, arrival_ns
from devices.sensor import ColorCamera, ColorImage


@dataclass(frozen=True, eq=False)
class OrbbecMoment(Moment):
    """Depth and infrared of one exposure."""

    depth: Any  # the SDK's frames
    infrared: Any
    color: Any  # the newest frame of the colour camera at that moment; None without one


class MomentJoiner:
    """Joins depth, infrared and colour into moments.

    Depth and infrared are one exposure and have one device time, but a set of frames may hold them
    separately where colour is on. Colour is of another camera: the newest one, half a frame away at most.

    Attributes:
        timeless: Whether a frame came without a device time.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._depth: Any = None
        self._infrared: Any = None
        self._color: Any = None
        self.timeless = False

    def add(self, frames: Any, now_ns: int) -> OrbbecMoment | None:
        """Takes a ``FrameSet``; returns the moment that is now complete, if one is."""
        self._depth = frames.get_depth_frame() or self._depth
        # of a single camera, or of a stereo sensor's left one
        self._infrared = frames.get_ir_frame() or frames.get_left_ir_frame() or self._infrared
        self._color = frames.get_color_frame() or self._color
        depth, infrared = self._depth, self._infrared
        if depth is None or infrared is None:
            return None
        time_ns = self._time_ns(depth)
        if abs(self._time_ns(infrared) - time_ns) > self._period_ns // 2:
            return None
        self._depth = self._infrared = None
        color = self._color
        if color is not None and abs(self._time_ns(color) - time_ns) > self._period_ns // 2:
            color = None
        host_ns = arrival_ns(1000 * int(depth.get_system_timestamp_us()), now_ns)
        return OrbbecMoment(time_ns, host_ns, depth, infrared, color)

    def _time_ns(self, frame: Any) -> int:
        """The device's time; the host's where the driver passes none on."""
        device_us = int(frame.get_timestamp_us())
        if device_us:
            return 1000 * device_us
        self.timeless = True
        return 1000 * int(frame.get_system_timestamp_us())


def depth_image(frame: Any) -> NDArray[np.uint16]:
    """(height, width) uint16 millimetres; 0 where there is no reading, or beyond 65.5 m."""
    image = _pixels(frame, np.uint16)
    scale = float(frame.get_depth_scale())  # millimetres per unit
    if scale == 1.0:
        return image
    scaled = np.rint(image * np.float32(scale))
    return np.where(scaled <= np.iinfo(np.uint16).max, scaled, 0.0).astype(np.uint16)


def infrared_image(frame: Any) -> NDArray[np.uint16]:
    """(height, width) uint16; an 8-bit image keeps its values."""
    if frame.get_data_size() == frame.get_width() * frame.get_height():
        return _pixels(frame, np.uint8).astype(np.uint16)
    return _pixels(frame, np.uint16)


def color_image(frame: Any, camera: ColorCamera | None) -> ColorImage | None:
    """The colour image as the camera compressed it; None where there is none, or a part of one."""
    if frame is None or camera is None:
        return None
    return ColorImage.of(bytes(frame.get_data()), camera)


def _pixels(frame: Any, kind: type[np.unsignedinteger[Any]]) -> NDArray[Any]:
    data = np.asarray(frame.get_data(), dtype=np.uint8).view(kind)  # get_data copies
    return data.reshape(frame.get_height(), frame.get_width())
