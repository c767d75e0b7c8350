"""The images of a session, read on demand. Damaged images are skipped and counted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Generic, TypeVar

import pyarrow as pa

from recordings import layout
from recordings.reading.rrd_file import RrdFile

T = TypeVar("T")
_WRONG = (LookupError, TypeError, ValueError, AttributeError, pa.ArrowException)
"""Exceptions that a damaged chunk can cause."""


class ImageReader(Generic[T]):
    """The images of one sensor with their frame numbers, in order; iteration reads the file.

    Args:
        path: The session.
        entity: The entity of the images.
        checked: Returns the bytes of row k of a chunk, and whether they match their checksum. The checksum
            also covers the frame number.
        decoded: Decodes these bytes.
        frames: The wanted frames; with a step, images of frames that are at least so far apart.
    """

    def __init__(
        self,
        path: Path,
        entity: str,
        checked: Callable[[pa.RecordBatch, int, int], tuple[Any, bool]],
        decoded: Callable[[Any], T],
        frames: range,
    ) -> None:
        self._path, self._entity, self._checked, self._decoded = path, entity, checked, decoded
        self._frames = frames
        self.damaged = 0
        """Number of images that the last iteration skipped because their checksums do not match."""

    def __iter__(self) -> Iterator[tuple[int, T]]:
        """Reads the images one by one, up to the last wanted frame."""
        return ((frame, self._decoded(raw)) for frame, raw in self._whole())

    def count(self) -> int:
        """Counts the whole images without decoding them."""
        return sum(1 for _ in self._whole())

    def _whole(self) -> Iterator[tuple[int, Any]]:
        self.damaged = 0
        next_frame = self._frames.start
        with RrdFile(self._path) as file:
            for entity, batch in file.chunks(images=True):
                if entity != self._entity or layout.FRAME not in batch.schema.names:
                    continue
                for k, frame in enumerate(batch.column(layout.FRAME).to_pylist()):
                    try:
                        raw, whole = self._checked(batch, k, frame)
                    except _WRONG:
                        raw, whole = None, False
                    if not whole:
                        self.damaged += 1
                    elif frame >= self._frames.stop:
                        return
                    elif frame >= next_frame:
                        next_frame = frame + self._frames.step
                        yield frame, raw
            self.damaged += file.unread(self._entity)
