"""Images of the sensors in a stream: depth and colour, and for a viewer point clouds and infrared images."""

import io
import math
from functools import lru_cache

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from PIL import Image

from devices.blazepose.grey_image import compressed
from devices.depth.point_cloud import depth_to_points, ray_table
from devices.depth.rvl import MEDIA_TYPE, encode_depth
from devices.pairing import FramePair
from devices.sensor import ColorCamera, ColorImage
from fusion.intrinsics import Intrinsics
from fusion.setup import FusionSetup
from recordings import layout
from recordings.appearance import entity_styles
from recordings.writing.arrow_columns import depth_image, own_values, points
from recordings.writing.changes import set_time
from recordings.writing.checksums import image_checksum

_POINTS = 10_000
"""Approximate maximum number of points shown; 120 kB."""
_CLOUD_NS = 250_000_000
"""For so long a point cloud is shown: the person of an older one is elsewhere than their skeleton."""
_INFRARED_QUALITY = 80  # of the JPEG, per cent: 20 KB for an image of 320 × 288 pixels


class ImageLog:
    """Writes the images of both sensors to a stream.

    Args:
        every: Keep the images of every n-th pair; 0 for none.
        shown: Whether point clouds and infrared images are added, for a viewer.
    """

    def __init__(self, stream: rr.RecordingStream, setup: FusionSetup, every: int, shown: bool) -> None:
        self._stream, self._every, self._shown = stream, every, shown
        self._cameras = {"a": setup.intrinsics_a, "b": setup.intrinsics_b}
        self._clouds_ns: dict[str, int] = {}  # when the point clouds that are shown were seen
        self._placed: set[str] = set()  # colour cameras
        if shown:  # takes longer than a frame
            for camera in self._cameras.values():
                _thin_rays(camera)

    def record(self, frame: int, time_ns: int, pair: FramePair) -> None:
        """Logs the images of a pair, if they are to be kept."""
        if self._every == 0 or frame % self._every:
            return
        for side, since_ns in list(self._clouds_ns.items()):
            if time_ns - since_ns > _CLOUD_NS:
                del self._clouds_ns[side]
                set_time(self._stream, frame, time_ns)
                self._stream.log(layout.points(side), rr.Points3D.from_fields(positions=np.empty((0, 3))))
        for side, seen in (("a", pair.a), ("b", pair.b)):
            if seen is not None and seen.depth is not None:
                self.depth(side, frame, time_ns, seen.depth)
                if self._shown and seen.ir is not None:
                    _show_infrared(self._stream, side, seen.ir)
            if seen is not None and seen.color is not None:
                self.color(side, frame, time_ns, seen.color)

    def depth(self, side: str, frame: int, time_ns: int, depth: NDArray[np.uint16]) -> None:
        """Logs a depth image losslessly: (height, width) millimetres."""
        blob = encode_depth(depth)
        set_time(self._stream, frame, time_ns)
        image = depth_image(blob, MEDIA_TYPE, meter=1000.0)
        self._stream.log(layout.depth(side), image, own_values(crc32=image_checksum(frame, blob)))
        if self._shown:
            self._clouds_ns[side] = time_ns
            self._stream.log(layout.points(side), points(thin_points(depth, self._cameras[side])))

    def color(self, side: str, frame: int, time_ns: int, color: ColorImage) -> None:
        """Logs a colour image."""
        set_time(self._stream, frame, time_ns)
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
        values = _camera_values(camera)
        self._stream.log(
            entity,
            rr.EncodedImage(contents=color.jpeg, media_type="image/jpeg"),
            own_values(crc32=image_checksum(frame, color.jpeg + values.tobytes()), camera=values),
        )


def _camera_values(camera: ColorCamera) -> NDArray[np.float64]:
    """Size, focal lengths, principal point; R row by row and t, colour ← depth; the lens's distortion."""
    of, pose = camera.intrinsics, camera.color_from_depth
    size = [of.width, of.height, of.fx, of.fy, of.cx, of.cy]
    return np.array([*size, *pose.rotation.ravel(), *pose.translation, *of.distortion], dtype=np.float64)


def _show_infrared(stream: rr.RecordingStream, side: str, image: NDArray[np.uint16]) -> None:
    """Logs an infrared image as the body tracker sees it, at the stream's current time.

    Args:
        stream: The stream of a viewer. Files hold no infrared: no step after the body tracker reads it.
        image: (height, width) uint16, on the pixels of the depth image.
    """
    grey = np.rint(255.0 * compressed(image)).astype(np.uint8)
    jpeg = io.BytesIO()
    Image.fromarray(grey).save(jpeg, "JPEG", quality=_INFRARED_QUALITY)
    stream.log(layout.infrared(side), rr.EncodedImage(contents=jpeg.getvalue(), media_type="image/jpeg"))


def thin_points(depth: NDArray[np.uint16], camera: Intrinsics) -> NDArray[np.float32]:
    """(N, 3) points of every n-th row and column of a depth image, metres in the sensor's frame.

    Args:
        depth: (height, width) millimetres, 0 where there is no reading.

    Raises:
        DeviceError: The sizes of the image and the camera differ.
    """
    step, rays = _thin_rays(camera)
    return depth_to_points(depth[::step, ::step], rays)


@lru_cache(maxsize=4)
def _thin_rays(camera: Intrinsics) -> tuple[int, NDArray[np.float32]]:
    step = max(1, round(math.sqrt(camera.width * camera.height / _POINTS)))
    return step, np.ascontiguousarray(ray_table(camera)[::step, ::step])
