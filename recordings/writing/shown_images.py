"""Images of the sensors in a stream: depth and colour, and for a viewer point clouds and infrared images."""

import math
from functools import lru_cache

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from devices.depth.grey_image import compressed
from devices.depth.image_thinning import has_image
from devices.depth.point_cloud import depth_to_points, ray_table
from devices.depth.rvl import MEDIA_TYPE, encode_depth
from devices.frame_pairs import FramePair
from devices.sensor import ColorCamera, ColorImage
from fusion.intrinsics import Intrinsics
from fusion.setup import FusionSetup
from recordings.appearance import entity_styles
from recordings.data import layout
from recordings.data.checksums import image_checksum
from recordings.writing.arrow_columns import depth_image, own_values, points
from recordings.writing.changes import set_time

_POINTS = 10_000
"""Approximate maximum number of points shown; 120 kB."""
LATE_NS = 250_000_000
"""For so long a viewer shows an image and its point cloud: the person of an older one is elsewhere."""


class ImageLog:
    """Writes the images of both sensors to a stream.

    Args:
        every: Keep the images of every n-th pair; 0 for none.
        shown: Whether point clouds and infrared images are added, for a viewer.
    """

    def __init__(self, stream: rr.RecordingStream, setup: FusionSetup, every: int, shown: bool) -> None:
        self._stream, self._every, self._shown = stream, every, shown
        self._cameras = {"a": setup.intrinsics_a, "b": setup.intrinsics_b}
        self._images_ns: dict[
            tuple[str, str], int
        ] = {}  # by side and kind: when what a viewer shows was seen
        self._placed: set[str] = set()  # colour cameras
        if shown:  # takes longer than a frame
            for camera in self._cameras.values():
                _thin_rays(camera)

    def record(self, frame: int, time_ns: int, pair: FramePair) -> None:
        """Logs the images of a pair, if they are to be kept."""
        if self._every == 0 or frame % self._every:
            return
        late = [key for key, seen_ns in self._images_ns.items() if time_ns - seen_ns > LATE_NS]
        for side, kind in late:
            if has_image(getattr(pair, side), kind):
                continue
            del self._images_ns[side, kind]
            set_time(self._stream, frame, time_ns)
            gone = (layout.depth, layout.infrared, layout.points) if kind == "depth" else (layout.color,)
            for entity in gone:
                self._stream.log(entity(side), rr.Clear(recursive=False))
        for side, seen in (("a", pair.a), ("b", pair.b)):
            if seen is not None and seen.depth is not None:
                self.depth(side, frame, time_ns, seen.depth)
                if self._shown and seen.ir is not None:
                    _show_infrared(self._stream, side, seen.ir)
            if seen is not None and seen.color is not None:
                self.color(side, frame, time_ns, seen.color)

    def moments(
        self, side: str, kind: str, time_ns: NDArray[np.int64], has_image: NDArray[np.bool_]
    ) -> NDArray[np.int64]:
        """The indices of the following frames whose skeleton is drawn over the image of a viewer.

        They are those with an image, and those without one whose last image is too late to be shown.
        """
        last_ns = self._images_ns.get((side, kind), -2 * LATE_NS)
        newest = np.maximum.accumulate(np.where(has_image, time_ns, last_ns))
        return np.flatnonzero(has_image | (time_ns - newest > LATE_NS))

    def depth(self, side: str, frame: int, time_ns: int, depth: NDArray[np.uint16]) -> None:
        """Logs a depth image losslessly: (height, width) millimetres."""
        set_time(self._stream, frame, time_ns)
        if self._shown:  # not encoded: a viewer shows the image before until it has decoded this one
            self._images_ns[side, "depth"] = time_ns
            self._stream.log(layout.depth(side), rr.DepthImage(depth, meter=1000.0))
            self._stream.log(layout.points(side), points(thin_points(depth, self._cameras[side])))
            return
        blob = encode_depth(depth)
        image = depth_image(blob, MEDIA_TYPE, meter=1000.0)
        self._stream.log(layout.depth(side), image, own_values(crc32=image_checksum(frame, blob)))

    def color(self, side: str, frame: int, time_ns: int, color: ColorImage) -> None:
        """Logs a colour image."""
        set_time(self._stream, frame, time_ns)
        if self._shown:
            self._images_ns[side, "color"] = time_ns
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
    stream.log(layout.infrared(side), rr.Image(grey, color_model="L"))


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
