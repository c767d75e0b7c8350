"""How often a viewer is shown images."""

from __future__ import annotations

from dataclasses import replace

from devices.image_thinning import has_images, without_images
from recordings.session_arrays import RecordedFrame

_EARLY = 0.9  # of an interval: a frame that comes a little early is not put off for the next one
_HALF_NS = 16_000_000
"""Half a frame. A's images begin with the second frame, B's with the third: together, or with the matrix of
trust, whose seconds begin with the first, they would make everyone wait."""


class ImageTurns:
    """Leaves images out, so that a viewer gets as many as it stands, of one sensor at a time.

    Args:
        rate: Images a second and sensor, at most.
    """

    def __init__(self, rate: float) -> None:
        self._interval_ns = int(_EARLY * 1e9 / rate)
        self._next_ns: dict[str, int] = {}

    def capped(self, frame: RecordedFrame) -> RecordedFrame:
        """The next frame with the images whose turn it is."""
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
