"""References to ``None`` that pyk4a 1.5.0 gives away without owning them, put back.

Its functions return ``None`` for an image that is not in a capture, and beside the error of an opening that
fails, without taking a reference first. Up to Python 3.11 the count of references to ``None`` therefore falls
by one each time, and the process aborts when it reaches zero: after half an hour with ``--color`` and a
colour camera that fails. From Python 3.12 on ``None`` is not counted.
"""

from __future__ import annotations

import ctypes
from typing import Any


def put_back_none() -> None:
    """Takes the reference to ``None`` that pyk4a should have taken."""
    increase = ctypes.pythonapi.Py_IncRef
    increase.restype, increase.argtypes = None, [ctypes.py_object]
    increase(None)


def image_of(capture: Any, name: str) -> Any:
    """The capture's image ``depth``, ``ir`` or ``color``; None if it has none."""
    image = getattr(capture, name)
    if image is None:
        put_back_none()
    return image
