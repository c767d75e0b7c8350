"""What pyk4a 1.5.0 does not offer (handles of libk4a), and the work around an error of it.

pyk4a returns ``None`` without taking a reference first: for an image that is missing from a capture, and
when a sensor cannot be opened. On Python 3.11, each such call lowers the reference count of ``None`` by
one. The process aborts when the count reaches zero: after half an hour with ``--color`` and a failed colour
camera. From Python 3.12 on, ``None`` is immortal and the error has no effect.
"""

from __future__ import annotations

import ctypes
from typing import Any

from devices.sensor import DeviceError


def capture_pointer(capture: Any) -> int:
    """The ``k4a_capture_t`` in a capture: its capsule holds the address of the handle."""
    address = capsule_pointer(capture._capture_handle, b"pyk4a capture handle")
    return ctypes.c_void_p.from_address(address).value or 0


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
