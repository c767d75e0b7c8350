"""Regions of an image that hold a person, and the crops that the networks look at."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fusion.support.types import Array

SIDE_PER_RADIUS = 2.5
"""Side of a region per distance between its two points: MediaPipe's 1.25 times the circle's diameter."""


@dataclass(frozen=True)
class Region:
    """A square of an image, turned so that the person in it is upright."""

    u: float  # its centre, pixels; the centre of the first pixel is (0, 0)
    v: float
    side: float  # its side, pixels
    angle: float = 0.0  # angle by which the person is turned clockwise in the image, radians

    @staticmethod
    def around(centre: Array, rim: Array) -> Region:
        """The region of a person in a circle, from (2,) the middle of the hips and (2,) the point of the
        circle above the head, pixels.
        """
        du, dv = float(rim[0] - centre[0]), float(rim[1] - centre[1])
        return Region(
            float(centre[0]), float(centre[1]), SIDE_PER_RADIUS * math.hypot(du, dv), math.atan2(du, -dv)
        )

    def image_from_crop(self, size: int) -> Array:
        """(2, 3) the affine transform from pixels of a square crop to pixels of the image."""
        scale = self.side / size
        c, s = scale * math.cos(self.angle), scale * math.sin(self.angle)
        middle = 0.5 * size - 0.5
        return np.array(((c, -s, self.u - c * middle + s * middle), (s, c, self.v - s * middle - c * middle)))

    def crop(self, image: NDArray[Any], size: int) -> NDArray[Any]:
        """(size, size[, 3]) the region of the image; zero outside of the image.

        A region larger than the crop is averaged, not sampled, so that thin limbs survive.
        """
        transform = self.image_from_crop(size)
        shrink = self.side / size
        while shrink > 1.6:  # bilinear sampling of an image at half its scale would skip pixels
            image = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            transform = transform * 0.5
            transform[:, 2] -= 0.25
            shrink *= 0.5
        return cv2.warpAffine(image, transform, (size, size), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def whole_image(height: int, width: int) -> Region:
    """The square that contains a whole image."""
    return Region(0.5 * (width - 1), 0.5 * (height - 1), float(max(height, width)))


def transformed(transform: Array, points: Array) -> Array:
    """(N, 2) points under an affine transform (2, 3)."""
    moved: Array = points @ transform[:, :2].T + transform[:, 2]
    return moved
