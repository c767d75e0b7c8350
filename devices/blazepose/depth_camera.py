"""Any depth camera as a sensor: a generator of images, and the program's own body tracker."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.blazepose.settings import BlazePoseSettings
from devices.blazepose.tracked_images import TrackedImages
from devices.sensor import DeviceError, Sensor, SensorFrame
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics

DepthImages = Callable[[], Iterable[tuple[NDArray[Any], NDArray[Any], int]]]
"""Opens a camera and gives (depth, image, time in ns) until it ends; called again after a failure.

Depth is (h, w): uint16 millimetres, or floating-point metres; 0 or NaN where there is no reading. The image
is of the **same pixels**: (h, w) infrared or grey, uint8 or uint16, or (h, w, 3) RGB, uint8. A colour camera
that sits beside the depth camera must be registered to it first: nearly every camera's library does that.
Times are capture times on any clock that does not jump.
"""


class DepthCamera(TrackedImages):
    """A sensor that finds people in the images of any depth camera.

    It needs the tracker's networks: ``duplex tracker fetch`` fetches them once.

    >>> def images():
    ...     with my_camera() as camera:
    ...         while True:
    ...             shot = camera.wait()
    ...             yield shot.depth, shot.infrared, shot.time_ns
    >>> left = DepthCamera("left", images, Intrinsics(640, 480, 580.0, 580.0, 319.5, 239.5))
    """

    def __init__(
        self,
        name: str,
        images: DepthImages,
        intrinsics: Intrinsics,
        settings: BlazePoseSettings | None = None,
        took: Callable[[int], object] = lambda _: None,
    ) -> None:
        """Stores the camera without opening it.

        Args:
            images: The camera. OSError and RuntimeError from it mean a lost camera, which is opened again.
            took: Called with the time that the tracker worked on each frame, ns.
        """
        source = _Images(name, images, intrinsics)
        super().__init__(source, settings, registered=lambda _: source.rgb, took=took)


class _Images(Sensor):
    """The images of a generator as a sensor without people.

    Attributes:
        rgb: (h, w, 3) of the frame given last; None if its image was infrared.
    """

    def __init__(self, name: str, images: DepthImages, intrinsics: Intrinsics) -> None:
        self.name = name
        self.body = BLAZEPOSE
        self.intrinsics = intrinsics
        self.rgb: NDArray[np.uint8] | None = None
        self._images, self._lens = images, intrinsics
        self._interrupted = False

    def __enter__(self) -> _Images:
        self._interrupted = False
        return self

    def interrupt(self) -> None:
        """Makes ``frames`` end after the image that it waits for."""
        self._interrupted = True

    def frames(self) -> Iterator[SensorFrame]:
        """The images as frames."""
        try:
            for depth, image, time_ns in self._images():
                if self._interrupted:
                    return
                yield self._frame(depth, image, time_ns)
        except (OSError, RuntimeError) as fault:
            raise DeviceError(f"{self.name} failed: {fault or type(fault).__name__}.") from fault

    def _frame(self, depth: NDArray[Any], image: NDArray[Any], time_ns: int) -> SensorFrame:
        size = (self._lens.height, self._lens.width)
        if depth.shape != size or image.shape[:2] != size:
            raise DeviceError(
                f"{self.name} gives depth {depth.shape} and an image {image.shape}; its intrinsics are of "
                f"{size}. Both must be of the depth camera's pixels: register the image to depth."
            )
        self.rgb = image if image.shape[2:] == (3,) and image.dtype == np.uint8 else None
        if self.rgb is None and (image.ndim != 2 or image.dtype not in (np.uint8, np.uint16)):
            raise DeviceError(
                f"{self.name} gives an image {image.shape} of {image.dtype}; needed: (h, w) uint8 or uint16, "
                f"or (h, w, 3) uint8."
            )
        ir = image.astype(np.uint16) if self.rgb is None else None
        return SensorFrame(time_ns=int(time_ns), depth=_millimetres(depth, self.name), ir=ir)


_FARTHEST_M = 65.0
"""An image whose readings are nearly all farther away is in millimetres, as of libfreenect2."""


def _millimetres(depth: NDArray[Any], name: str) -> NDArray[np.uint16]:
    if depth.dtype == np.uint16:
        return depth
    if not np.issubdtype(depth.dtype, np.floating):
        raise DeviceError(f"{name} gives depth of {depth.dtype}; needed: uint16 millimetres or float metres.")
    with np.errstate(invalid="ignore"):
        millimetres = np.rint(1000.0 * depth)
        readings = (depth > 0) & (depth < np.inf)
        if 10 * np.count_nonzero(readings & (depth > _FARTHEST_M)) > 9 * np.count_nonzero(readings):
            raise DeviceError(
                f"{name} gives depth of {np.median(depth[readings]):.4g} m (median), as {depth.dtype} is "
                f"metres. Give millimetres as uint16, or divide them by 1000."
            )
        valid = (millimetres > 0) & (millimetres <= np.iinfo(np.uint16).max)  # False for NaN
        return np.where(valid, millimetres, 0).astype(np.uint16)
