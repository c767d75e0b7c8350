"""The images that a viewer gets: some of a live session's, and of a saved one those that are read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from devices.depth.image_thinning import has_images, without_images
from devices.sensor import ColorImage
from recordings.images import Images, MadeImages
from recordings.session import Session
from recordings.session_arrays import SessionFrame
from viewer_app.sinks.queued_sink import DepthImage

_EARLY = 0.9  # share of the interval: a frame that arrives slightly early still counts
_HALF_NS = 16_000_000
"""Half a frame. A's images start with the second frame, B's with the third. Sending them together,
would add latency."""
_SHOWN_EVERY = 3  # depth images of a recording


class ImageTurns:
    """Drops images, so that a viewer is not overloaded; passes images of one sensor at a time.

    Args:
        rate: Maximum images per second and sensor.
    """

    def __init__(self, rate: float) -> None:
        self._interval_ns = int(_EARLY * 1e9 / rate)
        self._next_ns: dict[str, int] = {}

    def capped(self, frame: SessionFrame) -> SessionFrame:
        """The next frame, with only the images that are due."""
        if not has_images(frame.pair):
            return frame
        now = frame.pair.time_ns
        if not self._next_ns:
            self._next_ns = {"a": now + _HALF_NS, "b": now + 3 * _HALF_NS}
        shown = [side for side, due in self._next_ns.items() if now >= due]
        for side in shown:
            self._next_ns[side] = now + self._interval_ns
        left_out = "".join(self._next_ns.keys() - shown)
        return replace(frame, pair=without_images(frame.pair, left_out)) if left_out else frame


class ShownImages:
    """The images of a session; one of three depth images is shown when it is read.

    Args:
        session: The session.
        show: Takes the depth images to show.
    """

    def __init__(self, session: Session, show: Callable[[DepthImage], object]) -> None:
        self._session, self._show = session, show

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Returns depth images that are shown one by one while they are read."""

        def made() -> Iterator[tuple[int, NDArray[np.uint16]]]:
            for k, image in self._session.images.depth(side, frames):
                if k % _SHOWN_EVERY == 0:
                    self._show(DepthImage(side, k, int(self._session.time_ns[k]), image))
                yield k, image

        return MadeImages(made)

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        """Returns colour images without showing them."""
        return self._session.images.color(side, frames)
