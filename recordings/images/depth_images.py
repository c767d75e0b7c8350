"""Depth images of a session."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recordings import layout
from recordings.images.rvl import decode_depth
from recordings.reading.image_reader import ImageReader
from recordings.writing.checksums import image_checksum

_BLOB, _CHECK = "EncodedDepthImage:blob", "crc32"


def read_depth(path: Path, side: str, frames: range) -> ImageReader[NDArray[np.uint16]]:
    """The depth images of one sensor of a session: (height, width) millimetres, 0 without a reading."""
    return ImageReader(path, layout.depth(side), _checked, decode_depth, frames)


def _checked(batch: pa.RecordBatch, k: int, frame: int) -> tuple[bytes, bool]:
    blob = batch.column(_BLOB)[k].values[0].values.to_numpy().tobytes()
    return blob, batch.column(_CHECK)[k].as_py() == [image_checksum(frame, blob)]
