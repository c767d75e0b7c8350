"""Removes or thins the images of a pair."""

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from devices.frame_pairs import FramePair
from devices.sensor import SensorFrame
from fusion.intrinsics import Intrinsics

Depth = Literal["none", "half", "full"]
"""Depth images: none, every second pixel in both directions, or all of them."""


def pair_has_images(pair: FramePair) -> bool:
    """Whether a frame of the pair has an image."""
    return has_image(pair.a) or has_image(pair.b)


def has_image(frame: SensorFrame | None, *kinds: str) -> bool:
    """Whether a frame has an image, or one of some kinds: depth, color."""
    return frame is not None and any(getattr(frame, kind) is not None for kind in kinds or ("depth", "color"))


def pair_without_images(pair: FramePair, of: str = "ab") -> FramePair:
    """The pair without images, or without the images of the sensors in `of`."""

    def bare(frame: SensorFrame | None, side: str) -> SensorFrame | None:
        return frame if frame is None or side not in of else replace(frame, depth=None, color=None, ir=None)

    return replace(pair, a=bare(pair.a, "a"), b=bare(pair.b, "b"))


def with_depth(pair: FramePair, depth: Depth) -> FramePair:
    """The pair with thinned depth images, which are views of the originals, not copies."""

    def of(frame: SensorFrame | None) -> SensorFrame | None:
        if frame is None or frame.depth is None:
            return frame
        if depth == "none":
            return replace(frame, depth=None, ir=None)
        ir = None if frame.ir is None else thinned(frame.ir, depth)
        return replace(frame, depth=thinned(frame.depth, depth), ir=ir)

    return pair if depth == "full" else replace(pair, a=of(pair.a), b=of(pair.b))


def thinned(image: NDArray[np.uint16], depth: Depth) -> NDArray[np.uint16]:
    """A thinned image. Pixels are dropped, not averaged: a mean across an edge lies on no surface."""
    return image[::2, ::2] if depth == "half" else image


def thinned_camera(camera: Intrinsics, depth: Depth) -> Intrinsics:
    """The camera of :func:`thinned` images: its pixel (u, v) is (2u, 2v) of the whole image.

    Trust compares distances within an image, so S* is bit-identical with either image.
    """
    if depth != "half":
        return camera
    return replace(
        camera,
        width=(camera.width + 1) // 2,
        height=(camera.height + 1) // 2,
        fx=camera.fx / 2.0,
        fy=camera.fy / 2.0,
        cx=camera.cx / 2.0,
        cy=camera.cy / 2.0,
    )
