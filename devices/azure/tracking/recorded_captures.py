"""Converts recorded images to captures of libk4a, the input of the body tracker.

Only recordings need this: the captures of a live sensor come from pyk4a.
"""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import POINTER, byref, c_char_p, c_int, c_size_t, c_uint64, c_void_p
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from devices.azure.tracking.native_library import Prototypes, declare, load_library
from devices.sensor import DeviceError, SensorFrame

CALIBRATION_SIZE = 1032
_DEPTH_MODES = {"NFOV_2X2BINNED": 1, "NFOV_UNBINNED": 2, "WFOV_2X2BINNED": 3, "WFOV_UNBINNED": 4}
_COLOR_OFF = 0
_DEPTH16, _IR16 = 4, 5
_INSTALL = "Install the Azure Kinect Sensor SDK 1.4 (libk4a), which the body tracker needs too."
_PROTOTYPES: Prototypes = {
    "k4a_calibration_get_from_raw": (c_int, [c_char_p, c_size_t, c_int, c_int, c_void_p]),
    "k4a_capture_create": (c_int, [POINTER(c_void_p)]),
    "k4a_capture_release": (None, [c_void_p]),
    "k4a_capture_set_depth_image": (None, [c_void_p, c_void_p]),
    "k4a_capture_set_ir_image": (None, [c_void_p, c_void_p]),
    "k4a_image_create": (c_int, [c_int, c_int, c_int, c_int, POINTER(c_void_p)]),
    "k4a_image_get_buffer": (c_void_p, [c_void_p]),
    "k4a_image_set_device_timestamp_usec": (None, [c_void_p, c_uint64]),
    "k4a_image_release": (None, [c_void_p]),
}


class CaptureMaker:
    """Makes captures of libk4a from images.

    Raises:
        DeviceError: There is no libk4a; it rejects a calibration; a frame lacks depth or infrared.
    """

    def __init__(self, library: Path | None = None) -> None:
        self._library = load_library("k4a", library, _INSTALL)
        declare(self._library, _PROTOTYPES, f"it is not libk4a 1.4. {_INSTALL}")

    def calibration(self, text: bytes, depth_mode: str) -> ctypes.Array[ctypes.c_char]:
        """Converts a sensor's calibration JSON to a ``k4a_calibration_t``.

        Keep the returned buffer alive while its address is in use.
        """
        result = ctypes.create_string_buffer(CALIBRATION_SIZE)
        raw = text.rstrip(b"\0") + b"\0"
        mode = _DEPTH_MODES.get(depth_mode, 0)
        status = self._library.k4a_calibration_get_from_raw(raw, len(raw), mode, _COLOR_OFF, result)
        if status != 0:
            raise DeviceError(
                f"The SDK refuses the recording's calibration (status {status}, depth mode {depth_mode}). "
                f"Check with k4aviewer whether it opens the file."
            )
        return result

    @contextmanager
    def capture(self, frame: SensorFrame) -> Iterator[int]:
        """Yields a ``k4a_capture_t`` of a frame's depth and infrared; releases it after the block."""
        if frame.depth is None or frame.ir is None:
            raise DeviceError("The body tracker needs depth and infrared; this frame lacks one of them.")
        library, capture = self._library, c_void_p()
        _must(library.k4a_capture_create(byref(capture)))
        try:
            for image, kind, attach in (
                (frame.depth, _DEPTH16, library.k4a_capture_set_depth_image),
                (frame.ir, _IR16, library.k4a_capture_set_ir_image),
            ):
                handle = self._image(image, kind, frame.time_ns)
                attach(capture, handle)
                library.k4a_image_release(handle)
            assert capture.value is not None
            yield capture.value
        finally:
            library.k4a_capture_release(capture)

    def _image(self, image: NDArray[np.uint16], kind: int, time_ns: int) -> c_void_p:
        library, handle = self._library, c_void_p()
        height, width = image.shape
        _must(library.k4a_image_create(kind, width, height, 2 * width, byref(handle)))
        whole = np.ascontiguousarray(image, dtype=np.uint16)
        # A copy, because the tracker may keep the image longer than the array exists.
        ctypes.memmove(library.k4a_image_get_buffer(handle), whole.ctypes.data, whole.nbytes)
        library.k4a_image_set_device_timestamp_usec(handle, time_ns // 1000)
        return handle


def _must(status: int) -> None:
    if status != 0:
        raise DeviceError(f"libk4a could not make a capture (status {status}): out of memory?")
