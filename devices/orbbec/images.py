"""Images from the SDK's frames."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.capture.clock.host_clock import arrival_ns
from devices.capture.clock.moments import ImageJoiner
from devices.sensor import ColorCamera, ColorImage


class FrameReader:
    """Gives the images in the SDK's sets of frames to a joiner.

    A set may hold any of depth, infrared and colour.

    Attributes:
        timeless: Whether a frame came without a device time.
    """

    def __init__(self, joiner: ImageJoiner) -> None:
        self.joiner, self.timeless = joiner, False

    def add(self, frames: Any, now_ns: int) -> None:
        """Takes a ``FrameSet``."""
        # infrared of a single camera, or of a stereo sensor's left one
        infrared, color = frames.get_ir_frame() or frames.get_left_ir_frame(), frames.get_color_frame()
        for stream, frame in (("infrared", infrared), ("color", color)):
            if frame is not None:
                self.joiner.add(stream, self._time_ns(frame), frame)
        depth = frames.get_depth_frame()
        if depth is not None:
            host_ns = arrival_ns(1000 * int(depth.get_system_timestamp_us()), now_ns)
            self.joiner.add_depth(self._time_ns(depth), host_ns, depth, now_ns)

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
    """The colour image as the camera compressed it; None if there is none, or a part of one."""
    if frame is None or camera is None:
        return None
    return ColorImage.of(bytes(frame.get_data()), camera)


def _pixels(frame: Any, kind: type[np.unsignedinteger[Any]]) -> NDArray[Any]:
    data = np.asarray(frame.get_data(), dtype=np.uint8).view(kind)  # get_data copies
    return data.reshape(frame.get_height(), frame.get_width())
