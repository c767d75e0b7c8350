"""What pyk4a 1.5.0 does not offer (handles of libk4a, the firmware), and the work around an error of it.

pyk4a returns ``None`` without taking a reference first: for an image that is missing from a capture, and
when a sensor cannot be opened. On Python 3.11, each such call lowers the reference count of ``None`` by
one. The process aborts when the count reaches zero: after half an hour with ``--color`` and a failed colour
camera. From Python 3.12 on, ``None`` is immortal and the error has no effect.
"""

import ctypes
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import c_char_p, c_int, c_void_p
from typing import Any

from devices.azure.tracking.native_library import loaded_file
from devices.sensor import DeviceError

Version = tuple[int, int, int]
_LOG_ERRORS = 1  # K4A_LOG_LEVEL_ERROR, and what is worse
RESTARTS_WITHOUT_COLOR: Version = (1, 6, 110)
"""From this firmware on a subordinate without colour can be stopped and started again (SDK issue 818)."""


def capture_pointer(capture: Any) -> int:
    """The ``k4a_capture_t`` in a capture."""
    return _handle(capture._capture_handle, b"pyk4a capture handle")


def capsule_pointer(capsule: object, name: bytes) -> int:
    """The address in a capsule; the name guards against handing the library a pointer to something else."""
    get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    get_pointer.restype, get_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    try:
        pointer: int = get_pointer(capsule, name)
    except ValueError as fault:
        raise DeviceError(
            f"This pyk4a keeps no {name.decode()!r} ({fault}): it is another version. Install pyk4a 1.5."
        ) from fault
    return pointer


def _handle(capsule: object, name: bytes) -> int:
    """A handle of libk4a, whose address is in a capsule."""
    return ctypes.c_void_p.from_address(capsule_pointer(capsule, name)).value or 0


def put_back_none() -> None:
    """Adds the reference to ``None`` that pyk4a should have taken."""
    increase = ctypes.pythonapi.Py_IncRef
    increase.restype, increase.argtypes = None, [ctypes.py_object]
    increase(None)


def image_of(capture: Any, name: str) -> Any:
    """Returns the image ``depth``, ``ir`` or ``color`` of a capture; None if it is missing."""
    image = getattr(capture, name)
    if image is None:
        put_back_none()
    return image


class _HardwareVersion(ctypes.Structure):
    """``k4a_hardware_version_t``: major, minor, iteration of four parts; then build and signature."""

    _fields_ = (
        ("rgb", ctypes.c_uint32 * 3),
        ("depth", ctypes.c_uint32 * 3),
        ("audio", ctypes.c_uint32 * 3),
        ("depth_sensor", ctypes.c_uint32 * 3),
        ("build", ctypes.c_int),
        ("signature", ctypes.c_int),
    )


def firmware_version(device: Any) -> Version | None:
    """The firmware of an opened ``pyk4a.PyK4A``: that of its colour camera, which the releases are named by.

    None if libk4a cannot be found in this process, or does not answer.
    """
    library = loaded_libk4a()
    if library is None or not hasattr(library, "k4a_device_get_version"):
        return None
    library.k4a_device_get_version.restype = ctypes.c_int
    library.k4a_device_get_version.argtypes = [ctypes.c_void_p, ctypes.POINTER(_HardwareVersion)]
    version = _HardwareVersion()
    try:
        handle = _handle(device._device_handle, b"pyk4a device handle")
        status = library.k4a_device_get_version(handle, ctypes.byref(version))
    except (AttributeError, DeviceError):  # another pyk4a, which keeps its handle elsewhere
        return None
    major, minor, iteration = version.rgb
    return None if status != 0 else (major, minor, iteration)


_logs: dict[int, list[str]] = {}  # by the thread that listens
_listening = threading.Lock()


def _keep(_context: int, _level: int, _file: bytes, _line: int, text: bytes) -> None:
    """libk4a logs why a call fails on the thread of the call; another thread's lines are another sensor's."""
    _logs.get(threading.get_ident(), []).append(text.decode(errors="replace"))


_log_line = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_int, c_char_p)(_keep)


@contextmanager
def log_added() -> Iterator[None]:
    """Adds to an exception what libk4a logs as errors until then, as notes: its status gives no reason.

    libk4a has one handler of its log for all sensors.
    """
    own: list[str] = []
    with _listening:
        _logs[threading.get_ident()] = own
        _listen(_log_line, _LOG_ERRORS)
    try:
        yield
    except Exception as fault:
        for text in own:
            fault.add_note(text)
        raise
    finally:
        with _listening:
            del _logs[threading.get_ident()]
            if not _logs:
                _listen(None, 0)


def _listen(handler: Any, level: int) -> None:
    getattr(loaded_libk4a(), "k4a_set_debug_message_handler", lambda *_: None)(handler, None, level)


def loaded_libk4a() -> ctypes.CDLL | None:
    """The libk4a that pyk4a has loaded into this process; None if there is none."""
    file = loaded_file("k4a")
    name = "k4a.dll" if sys.platform == "win32" else None if file is None else str(file)
    try:
        return None if name is None else ctypes.CDLL(name)
    except OSError:
        return None


def firmware_advice(serial: str, version: Version | None) -> str:
    """Advice for a firmware that is too old for a sync cable; empty if it is new enough or unknown."""
    if version is None or version >= RESTARTS_WITHOUT_COLOR or not serial.isdigit():
        return ""
    old, needed = (".".join(map(str, numbers)) for numbers in (version, RESTARTS_WITHOUT_COLOR))
    return (
        f"Kinect {serial} has firmware {old}. Before {needed} a subordinate cannot be started again without "
        f"colour, so colour runs on both; update it with AzureKinectFirmwareTool."
    )
