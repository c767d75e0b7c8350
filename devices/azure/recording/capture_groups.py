"""Groups the packets of a recording's cameras into captures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(eq=False)
class Capture:
    """The images of one capture, as recorded.

    Attributes:
        at_ns: Time from the start of the file.
        depth, ir, color: Content of each packet; None if the image is missing.
        color_off_ns: Absolute time difference between the colour and the depth image.
    """

    at_ns: int
    depth: bytes
    ir: bytes | None = None
    color: bytes | None = None
    color_off_ns: int = 0


class Captures:
    """Groups packets into captures.

    The packets of the streams are interleaved. A colour image may differ from its depth image by some ms.

    Args:
        reach_ns: Largest time difference between a depth image and the other images of its capture.
    """

    def __init__(self, reach_ns: int) -> None:
        self._reach_ns = reach_ns
        self._open: list[Capture] = []
        self._early: list[tuple[str, int, bytes]] = []

    def add(self, title: str, at_ns: int, data: bytes) -> None:
        """Adds a packet to its capture; a packet that precedes its depth image waits for it."""
        if title == "DEPTH":
            self._open.append(Capture(at_ns, data))
            early, self._early = self._early, []
            for packet in early:
                self.add(*packet)
            return
        nearest = min(self._open, key=lambda capture: abs(capture.at_ns - at_ns), default=None)
        off_ns = abs(nearest.at_ns - at_ns) if nearest is not None else self._reach_ns + 1
        if nearest is None or off_ns > self._reach_ns:
            self._early = [*self._early[-3:], (title, at_ns, data)]
        elif title == "IR":
            nearest.ir = data
        elif nearest.color is None or off_ns < nearest.color_off_ns:
            nearest.color, nearest.color_off_ns = data, off_ns

    def complete(self, newest_ns: float) -> list[Capture]:
        """Removes and returns the captures that no packet after ``newest_ns`` can belong to."""
        done = [capture for capture in self._open if capture.at_ns < newest_ns - 2 * self._reach_ns]
        self._open = [capture for capture in self._open if capture not in done]
        return sorted(done, key=lambda capture: capture.at_ns)

    def gather(self, packets: Iterator[tuple[str, int, bytes]]) -> Iterator[Capture]:
        """Groups the packets of a file and yields its captures in capture order."""
        newest = 0
        for title, at_ns, data in packets:
            self.add(title, at_ns, data)
            newest = max(newest, at_ns)
            yield from self.complete(newest)
        yield from self.complete(math.inf)
