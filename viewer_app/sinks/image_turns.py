"""Limits the rate of images sent to a viewer."""

from __future__ import annotations

from dataclasses import replace

from devices.depth.image_thinning import has_images, without_images
from recordings.session_arrays import RecordedFrame

_EARLY = 0.9  # share of the interval: a frame that arrives slightly early still counts
_HALF_NS = 16_000_000
"""Half a frame. A's images start with the second frame, B's with the third. Sending them together,
or with the trust matrix at the first frame, would add latency."""


class ImageTurns:
    """Drops images, so that a viewer is not overloaded; passes images of one sensor at a time.

    Args:
        rate: Maximum images per second and sensor.
    """

    def __init__(self, rate: float) -> None:
        self._interval_ns = int(_EARLY * 1e9 / rate)
        self._next_ns: dict[str, int] = {}

    def capped(self, frame: RecordedFrame) -> RecordedFrame:
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
