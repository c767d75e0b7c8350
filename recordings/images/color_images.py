"""Colour images of a session: the camera's JPEG with its intrinsics and pose, beside the depth image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from devices.sensor import ColorCamera, ColorImage
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from recordings import layout
from recordings.appearance import entity_styles
from recordings.reading.image_reader import ImageReader
from recordings.writing.checksums import image_checksum

_BLOB, _CAMERA, _CHECK = "EncodedImage:blob", "camera", "crc32"


class ColorLog:
    """Writes the colour images of both sensors to a stream. The caller sets the time of the stream."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._placed: set[str] = set()

    def record(self, side: str, frame: int, color: ColorImage) -> None:
        """Logs an image under the number of its frame."""
        entity, camera = layout.color(side), color.camera
        if side not in self._placed:
            self._placed.add(side)
            depth_from_color = camera.color_from_depth.inverse()
            self._stream.log(
                entity,
                rr.Transform3D(translation=depth_from_color.translation, mat3x3=depth_from_color.rotation),
                entity_styles.camera(camera.intrinsics, side),
                static=True,
            )
        values = _values(camera)
        self._stream.log(
            entity,
            rr.EncodedImage(contents=color.jpeg, media_type="image/jpeg"),
            rr.AnyValues(crc32=image_checksum(frame, color.jpeg + values.tobytes()), camera=values),
        )


def read_color(path: Path, side: str, frames: range) -> ImageReader[ColorImage]:
    """The colour images of one sensor of a session."""
    return ImageReader(path, layout.color(side), _checked, _decoded, frames)


def _checked(batch: pa.RecordBatch, k: int, frame: int) -> tuple[tuple[bytes, NDArray[np.float64]], bool]:
    jpeg = batch.column(_BLOB)[k].values[0].values.to_numpy().tobytes()
    values = np.array(batch.column(_CAMERA)[k].as_py(), dtype=np.float64)
    whole = batch.column(_CHECK)[k].as_py() == [image_checksum(frame, jpeg + values.tobytes())]
    return (jpeg, values), whole


def _decoded(raw: tuple[bytes, NDArray[np.float64]]) -> ColorImage:
    jpeg, values = raw
    return ColorImage(jpeg, _camera(values))


def _values(camera: ColorCamera) -> NDArray[np.float64]:
    """Size, focal lengths, principal point; R row by row and t, colour ← depth; the lens's distortion."""
    of, pose = camera.intrinsics, camera.color_from_depth
    size = [of.width, of.height, of.fx, of.fy, of.cx, of.cy]
    return np.array([*size, *pose.rotation.ravel(), *pose.translation, *of.distortion], dtype=np.float64)


def _camera(values: NDArray[np.float64]) -> ColorCamera:
    width, height, fx, fy, cx, cy = values[:6].tolist()
    intrinsics = Intrinsics(int(width), int(height), fx, fy, cx, cy, tuple(values[18:].tolist()))
    return ColorCamera(intrinsics, RigidTransform.of(values[6:15].reshape(3, 3), values[15:18]))
