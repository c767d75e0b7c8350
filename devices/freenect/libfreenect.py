"""Access to Kinects v1 through libfreenect 0.5. Only this file calls the library, by its C functions."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from ctypes import POINTER, c_char_p, c_int, c_int8, c_int16, c_int32, c_long, c_uint32, c_void_p
from ctypes.util import find_library
from functools import cache
from typing import Any

from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.usb import usb_kinects, why_not_open
from devices.sensor import DeviceError
from devices.vendor import absent

PROGRAMS = "freenect-glview"
_COMMANDS = {
    "linux": "apt install libfreenect0.5 (Debian, Ubuntu), dnf install libfreenect (Fedora)",
    "darwin": "brew install libfreenect (DYLD_FALLBACK_LIBRARY_PATH names its folder if it is not found)",
    "win32": "build it as its README says (CMake, libusbK), and put the folder of freenect.dll on PATH",
}
_CAMERA = 0x02  # FREENECT_DEVICE_CAMERA: neither the motor nor the microphones are opened
_MEDIUM = 1  # FREENECT_RESOLUTION_MEDIUM, 640 × 480
_REGISTERED = 4  # FREENECT_DEPTH_REGISTERED: millimetres, on the pixels of the colour image
_RGB = 0  # FREENECT_VIDEO_RGB
_ERROR = 1  # FREENECT_LOG_ERROR
_INTERRUPTED = -10  # LIBUSB_ERROR_INTERRUPTED: a signal came, nothing is wrong


class FrameMode(ctypes.Structure):
    """``freenect_frame_mode``."""

    _fields_ = (
        ("reserved", c_uint32),
        ("resolution", c_int),
        ("format", c_int32),
        ("bytes", c_int32),
        ("width", c_int16),
        ("height", c_int16),
        ("data_bits_per_pixel", c_int8),
        ("padding_bits_per_pixel", c_int8),
        ("framerate", c_int8),
        ("is_valid", c_int8),
    )


class Attributes(ctypes.Structure):
    """``struct freenect_device_attributes``, an item of a linked list."""


Attributes._fields_ = (("next", POINTER(Attributes)), ("camera_serial", c_char_p))


class _Timeval(ctypes.Structure):
    """``struct timeval``; little-endian, so that a narrower ``tv_usec`` before padding reads the same."""

    _fields_ = (("seconds", c_long), ("microseconds", c_long))


FRAME_CALLBACK = ctypes.CFUNCTYPE(None, c_void_p, c_void_p, c_uint32)  # device, image, ticks
_LOG_CALLBACK = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p)  # context, level, message

SIGNATURES: dict[str, tuple[Any, ...]] = {  # the result, then the arguments; libfreenect.h
    "freenect_init": (c_int, POINTER(c_void_p), c_void_p),
    "freenect_shutdown": (c_int, c_void_p),
    "freenect_set_log_level": (None, c_void_p, c_int),
    "freenect_set_log_callback": (None, c_void_p, _LOG_CALLBACK),
    "freenect_process_events_timeout": (c_int, c_void_p, POINTER(_Timeval)),
    "freenect_num_devices": (c_int, c_void_p),
    "freenect_list_device_attributes": (c_int, c_void_p, POINTER(POINTER(Attributes))),
    "freenect_free_device_attributes": (None, POINTER(Attributes)),
    "freenect_select_subdevices": (None, c_void_p, c_int),
    "freenect_open_device_by_camera_serial": (c_int, c_void_p, POINTER(c_void_p), c_char_p),
    "freenect_close_device": (c_int, c_void_p),
    "freenect_find_depth_mode": (FrameMode, c_int, c_int),
    "freenect_find_video_mode": (FrameMode, c_int, c_int),
    "freenect_set_depth_mode": (c_int, c_void_p, FrameMode),
    "freenect_set_video_mode": (c_int, c_void_p, FrameMode),
    "freenect_set_depth_callback": (None, c_void_p, FRAME_CALLBACK),
    "freenect_set_video_callback": (None, c_void_p, FRAME_CALLBACK),
    "freenect_start_depth": (c_int, c_void_p),
    "freenect_start_video": (c_int, c_void_p),
    "freenect_stop_depth": (c_int, c_void_p),
    "freenect_stop_video": (c_int, c_void_p),
}


@cache
def load_library() -> Any:
    """The library, with the types of its functions.

    Raises:
        DeviceError: It is not installed, or lacks a function.
    """
    path = find_library("freenect")
    if path is None:
        raise DeviceError(f"A Kinect v1 needs libfreenect, which is not installed. {how_to_install()}")
    try:
        library = ctypes.CDLL(path)
        for name, (result, *arguments) in SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as fault:  # fakenect lacks functions, too
        raise DeviceError(f"{path} is not libfreenect 0.5 ({fault}). {how_to_install()}") from fault
    return library


def how_to_install(platform: str = sys.platform) -> str:
    """The command that installs the library."""
    return f"Install it: {_COMMANDS.get(platform, _COMMANDS['linux'])}."


class Context:
    """A ``freenect_context`` with at most one camera: a context manager, used by one thread.

    Each context has its own of libusb, so that contexts of several threads do not disturb each other.

    Attributes:
        said: The last error that the library logged; empty if there is none.
    """

    def __init__(self) -> None:
        self._library = load_library()
        self._handle, self._device = c_void_p(), c_void_p()
        self._callbacks: list[Any] = []  # the library calls them as long as the context lives
        self.said = ""

    def __enter__(self) -> Context:
        """Opens libusb.

        Raises:
            DeviceError: libusb does not start.
        """
        code = self._library.freenect_init(self._handle, None)
        if code < 0:
            raise DeviceError(f"libfreenect cannot search for sensors (libusb error {code}). Check USB.")
        log = _LOG_CALLBACK(self._log)
        self._callbacks.append(log)
        self._library.freenect_set_log_callback(self._handle, log)
        self._library.freenect_set_log_level(self._handle, _ERROR)
        self._library.freenect_select_subdevices(self._handle, _CAMERA)
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Stops the streams, each by itself, because closing a device stops one of them only; closes."""
        if self._device:
            self._library.freenect_stop_video(self._device)
            self._library.freenect_stop_depth(self._device)
            self._library.freenect_close_device(self._device)
        if self._handle:
            self._library.freenect_shutdown(self._handle)
        self._device, self._handle = c_void_p(), c_void_p()

    def serials(self) -> list[str]:
        """The serial numbers of the connected sensors that this user may open."""
        first = POINTER(Attributes)()
        if self._library.freenect_list_device_attributes(self._handle, first) < 0:
            return []
        found, item = [], first
        while item:
            found.append((item.contents.camera_serial or b"").decode("ascii", "replace"))
            item = item.contents.next
        self._library.freenect_free_device_attributes(first)
        return found

    def count(self) -> int:
        """How many sensors are connected, whether they may be opened or not."""
        return max(0, int(self._library.freenect_num_devices(self._handle)))

    def open(self, serial: str) -> None:
        """Opens a camera.

        Raises:
            AbsentError: It is not connected.
            DeviceError: It cannot be opened.
        """
        there = self.serials()
        if serial not in there:
            raise absent("Kinect v1", serial, there, "Check its USB and power supply.")
        if self._call("open_device_by_camera_serial", self._handle, self._device, serial.encode()) < 0:
            why = why_not_open(Exception(self.said), usb_kinects(), PROGRAMS, "freenect")
            raise DeviceError(f"Kinect v1 {serial} cannot be opened: {why}")

    def start(self, depth: Callable[[int, int], None], color: Callable[[int, int], None]) -> bool:
        """Starts registered depth and colour, both 640 × 480 at 30 fps; returns whether they started.

        Args:
            depth: Called by :meth:`process` with the address of each image and its time in ticks.
            color: The same for colour.
        """
        # The mode of the colour image first: it gives the tables by which depth is registered.
        streams = (("video", _RGB, color), ("depth", _REGISTERED, depth))
        for name, image_format, called in streams:
            mode = getattr(self._library, f"freenect_find_{name}_mode")(_MEDIUM, image_format)
            if not mode.is_valid or self._call(f"set_{name}_mode", self._device, mode) < 0:
                return False
            callback = FRAME_CALLBACK(lambda _device, image, ticks, called=called: called(image, ticks))
            self._callbacks.append(callback)
            self._call(f"set_{name}_callback", self._device, callback)
        return all(self._call(f"start_{name}", self._device) >= 0 for name in ("depth", "video"))

    def process(self, seconds: float) -> bool:
        """Waits for events of USB and calls the callbacks; returns whether the camera is still there."""
        timeout = _Timeval(int(seconds), int(seconds % 1.0 * 1e6))
        code = int(self._call("process_events_timeout", self._handle, timeout))
        return code >= 0 or code == _INTERRUPTED

    def _call(self, name: str, *arguments: Any) -> Any:
        return getattr(self._library, f"freenect_{name}")(*arguments)

    def _log(self, _context: int, _level: int, message: bytes) -> None:
        self.said = message.decode("utf-8", "replace").strip() or self.said


def connected_freenects() -> list[ConnectedSensor]:
    """The Kinects v1 on the buses.

    Raises:
        DeviceError: The library is not installed, or cannot search.
    """
    with Context() as context:
        serials, count = context.serials(), context.count()
    found = [
        ConnectedSensor(
            *(index, serial, False, False), sdk="freenect", description="Kinect v1", has_port=False
        )
        for index, serial in enumerate(serials)
    ]
    for index in range(len(serials), count):  # libfreenect leaves out those that it cannot open
        why = why_not_open(Exception(), usb_kinects(), PROGRAMS, "freenect")
        fault = f"Kinect v1 at place {index} cannot be opened: {why}"
        found.append(ConnectedSensor(index, None, fault=fault, sdk="freenect"))
    return found
