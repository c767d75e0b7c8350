"""S* at a constant rate, predicted from the newest frame."""

import math
from collections.abc import Sequence
from dataclasses import replace

from devices.capture.clock.host_clock import HostClock
from fusion.body import Body
from viewer_app.sinks.item_queue import Item, QueuedFrame

_FARTHEST_NS = 300_000_000
"""S* is not predicted farther ahead, and moments that are farther behind are left out."""


class EvenSamples:
    """Resamples S* to a constant rate: sample k is due when a frame captured at k / rate can have arrived.

    Frames arrive unevenly: their clock plus their least delay tells when a moment is due.

    Args:
        body: Of the frames.
        rate: Samples per second.
    """

    def __init__(self, body: Body, rate: float) -> None:
        self._body, self._period_ns = body, 1e9 / rate
        self._clock, self._next = HostClock(), 0
        self._newest: QueuedFrame | None = None

    def wait_s(self, now_ns: int) -> float | None:
        """Seconds until the next moment is due; None: for a frame."""
        if self._next > self._last:
            return None
        return max(self._due_ns(self._next) - now_ns, 0) * 1e-9

    def passed_on(self, items: Sequence[Item], now_ns: int) -> list[Item]:
        """These items with the moments that are due now in place of frames."""
        samples: list[Item] = []
        for item in items:
            if isinstance(item, QueuedFrame):
                self._clock.observe(item.time_ns, item.written_ns)
                self._newest = item
            else:
                samples.append(item)
        if self._newest is not None:
            # moments that are too far behind are left out without counting them: a pause may last for hours
            due = math.ceil((now_ns - _FARTHEST_NS - self._due_ns(0)) / self._period_ns)
            self._next = max(self._next, min(due, self._last + 1))
            while self._next <= self._last and self._due_ns(self._next) <= now_ns:
                samples.append(self._sample(self._newest))
                self._next += 1
        return samples

    def _sample(self, newest: QueuedFrame) -> QueuedFrame:
        time_ns = round(self._next * self._period_ns)
        later_ns, unix_ns = time_ns - newest.time_ns, newest.frame.unix_ns
        frame = replace(
            newest.frame,
            fused=newest.fused.predicted_for(self._body, 1e-9 * later_ns),
            unix_ns=None if unix_ns is None else unix_ns + later_ns,
        )
        return QueuedFrame(self._next, frame, time_ns, round(self._due_ns(self._next)))

    @property
    def _last(self) -> int:
        """The last moment that is predicted from the newest frame."""
        return -1 if self._newest is None else int((self._newest.time_ns + _FARTHEST_NS) / self._period_ns)

    def _due_ns(self, number: int) -> float:
        return number * self._period_ns + (self._clock.offset_ns or 0)
