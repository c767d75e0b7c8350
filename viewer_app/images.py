"""The images of a pair: whether there are some, and the pair without them."""

from __future__ import annotations

from dataclasses import replace

from devices.pairing import FramePair
from devices.sensor import SensorFrame


def has_images(pair: FramePair) -> bool:
    """Whether a frame of the pair has an image."""
    return any(f is not None and (f.depth is not None or f.color is not None) for f in (pair.a, pair.b))


def without_images(pair: FramePair) -> FramePair:
    """The pair with skeletons only."""

    def bare(frame: SensorFrame | None) -> SensorFrame | None:
        return None if frame is None else replace(frame, depth=None, color=None)

    return replace(pair, a=bare(pair.a), b=bare(pair.b))
