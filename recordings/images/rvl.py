"""Depth images of a session: the RVL code of :mod:`devices.depth.rvl`, with a recording's errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from devices.depth import rvl
from devices.depth.rvl import MEDIA_TYPE, encode_depth
from devices.sensor import DeviceError
from recordings.errors import RecordingError

__all__ = ["MEDIA_TYPE", "decode_depth", "encode_depth"]


def decode_depth(blob: bytes) -> NDArray[np.uint16]:
    """Decodes the output of :func:`encode_depth` to (height, width) millimetres.

    Raises:
        RecordingError: The bytes are not an RVL image.
    """
    try:
        return rvl.decode_depth(blob)
    except DeviceError as fault:
        raise RecordingError(str(fault)) from fault
