"""Works around a reference-counting error of pyk4a 1.5.0.

pyk4a returns ``None`` without taking a reference first: for an image that is missing from a capture, and
when a sensor cannot be opened. Up to Python 3.11, each such call lowers the reference count of ``None`` by
one. The process aborts when the count reaches zero: after half an hour with ``--color`` and a failed colour
camera. From Python 3.12 on, ``None`` is immortal and the error has no effect.
"""

from __future__ import annotations

import ctypes
from typing import Any


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
