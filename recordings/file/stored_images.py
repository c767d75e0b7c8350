"""The images and other people in a session's file, read on demand. What is damaged is skipped and counted."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from devices.depth.rvl import decode_depth
from devices.sensor import ColorCamera, ColorImage
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from recordings.data import layout
from recordings.data.checksums import image_checksum
from recordings.data.images import Images, SessionImages
from recordings.errors import RecordingError
from recordings.file.rrd_file import Entities, RrdFile

T = TypeVar("T")
_WRONG = (LookupError, TypeError, ValueError, AttributeError, pa.ArrowException)
"""Exceptions that a damaged chunk can cause."""


class ImageReader(Images[T]):
    """The images of one sensor with their frame numbers, in order; iteration reads the file.

    Args:
        opened: Opens the file.
        checked: Returns the bytes of row k of a chunk, and whether they match their checksum. The checksum
            also covers the frame number.
        frames: The wanted frames; with a step, images of frames that are at least so far apart.
    """

    def __init__(
        self,
        opened: Callable[[], AbstractContextManager[RrdFile]],
        entity: str,
        checked: Callable[[pa.RecordBatch, int, int], tuple[Any, bool]],
        decoded: Callable[[Any], T],
        frames: range,
    ) -> None:
        super().__init__(lambda: ((frame, decoded(raw)) for frame, raw in self._whole()))
        self._opened = opened
        self._entity, self._checked, self._frames = entity, checked, frames

    def count(self) -> int:
        """Counts the whole images without decoding them."""
        return sum(1 for _ in self._whole())

    def _whole(self) -> Iterator[tuple[int, Any]]:
        self.damaged = 0
        next_frame = self._frames.start
        images = self._entity not in map(layout.others, layout.VIEWS)
        with self._opened() as file:
            for _, batch in file.chunks(images, self._entity.__eq__):
                if layout.FRAME not in batch.schema.names:
                    continue
                for k, frame in enumerate(batch.column(layout.FRAME).to_pylist()):
                    try:
                        raw, whole = self._checked(batch, k, frame)
                    except _WRONG:
                        raw, whole = None, False
                    if not whole:
                        self.damaged += frame is None or self._frames.start <= frame < self._frames.stop
                    elif frame >= self._frames.stop:
                        return
                    elif frame >= next_frame:
                        next_frame = frame + self._frames.step
                        yield frame, raw
            self.damaged += file.unread(self._entity)


class FileImages(SessionImages):
    """The images in a session's file.

    Args:
        identity: Of the recording that was opened; another one under its name is refused.
        entities: What is known of the file.
    """

    def __init__(self, path: Path, identity: tuple[str, str] | None, entities: Entities) -> None:
        self._path, self._identity, self._entities = path, identity, entities

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        return ImageReader(self._opened, layout.depth(side), _checked_depth, decode_depth, frames)

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        return ImageReader(self._opened, layout.color(side), _checked_color, _decoded_color, frames)

    def others(self, side: str, frames: range) -> Images[NDArray[np.float32]]:
        return ImageReader(self._opened, layout.others(side), _checked_others, lambda bones: bones, frames)

    def logged(self) -> Iterator[tuple[str, pa.RecordBatch]]:
        with self._opened() as file:
            yield from file.chunks(False, layout.is_logged)

    @contextmanager
    def _opened(self) -> Iterator[RrdFile]:
        with RrdFile(self._path, self._entities) as file:
            if file.identity() != self._identity:
                raise RecordingError(
                    f"{self._path} holds another session now. Open it again to read its images."
                )
            yield file


def _checked_others(batch: pa.RecordBatch, k: int, frame: int) -> tuple[NDArray[np.float32], bool]:
    parts = (batch.column(f"Arrows3D:{of}")[k].values for of in ("origins", "vectors"))
    bones = np.stack([np.from_dlpack(part.flatten()).reshape(-1, 3) for part in parts], axis=1)
    return bones, batch.column("crc32")[k].as_py() == [image_checksum(frame, bones.tobytes())]


def _checked_depth(batch: pa.RecordBatch, k: int, frame: int) -> tuple[bytes, bool]:
    blob = _bytes(batch, "EncodedDepthImage:blob", k)
    return blob, batch.column("crc32")[k].as_py() == [image_checksum(frame, blob)]


def _checked_color(
    batch: pa.RecordBatch, k: int, frame: int
) -> tuple[tuple[bytes, NDArray[np.float64]], bool]:
    jpeg = _bytes(batch, "EncodedImage:blob", k)
    values = np.array(batch.column("camera")[k].as_py(), dtype=np.float64)
    whole = batch.column("crc32")[k].as_py() == [image_checksum(frame, jpeg + values.tobytes())]
    return (jpeg, values), whole


def _decoded_color(raw: tuple[bytes, NDArray[np.float64]]) -> ColorImage:
    jpeg, values = raw
    width, height, fx, fy, cx, cy = values[:6].tolist()
    intrinsics = Intrinsics(int(width), int(height), fx, fy, cx, cy, tuple(values[18:].tolist()))
    color_from_depth = RigidTransform.of(values[6:15].reshape(3, 3), values[15:18])
    return ColorImage(jpeg, ColorCamera(intrinsics, color_from_depth))


def _bytes(batch: pa.RecordBatch, component: str, k: int) -> bytes:
    return np.from_dlpack(batch.column(component)[k].values[0].values).tobytes()
