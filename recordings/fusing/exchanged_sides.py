"""Events for the intervals in which a view reports left and right exchanged."""

from __future__ import annotations

from collections.abc import Iterable

from fusion.fused_frame import FusedFrame
from recordings.events import Event, Phase

_PARTS = {0: "trunk", 1: "arms", 2: "legs", 3: "whole body"}
Told = tuple[str, str, str, Phase]
"""Text, level, topic and phase, as :meth:`viewer_app.sinks.sink.Sink.event` takes them."""


class ExchangedSides:
    """Detects when a view starts and stops reporting left and right exchanged."""

    def __init__(self) -> None:
        self._since_ns: dict[str, int | None] = {"A": None, "B": None}

    def observe(self, fused: FusedFrame) -> list[Told]:
        """Returns the events that start or end with the next frame."""
        told: list[Told] = []
        for sensor, code in (("A", fused.exchanged_a), ("B", fused.exchanged_b)):
            since_ns = self._since_ns[sensor]
            topic = f"exchanged_{sensor.lower()}"
            if code and since_ns is None:
                self._since_ns[sensor] = fused.time_ns
                text = f"{sensor} reports left and right exchanged ({_PARTS[code & 3]}); S* corrects this."
                told.append((text, "INFO", topic, "start"))
            elif not code and since_ns is not None:
                self._since_ns[sensor] = None
                seconds = (fused.time_ns - since_ns) * 1e-9
                text = f"{sensor} reports left and right correctly again, after {seconds:.1f} s."
                told.append((text, "INFO", topic, "end"))
        return told


def exchange_events(frames: Iterable[FusedFrame], first_ns: int) -> list[Event]:
    """Returns the events of frames in time order; ``first_ns`` is the time of the session's first pair."""
    sides = ExchangedSides()
    return [
        Event(number, fused.time_ns - first_ns, *told)
        for number, fused in enumerate(frames)
        for told in sides.observe(fused)
    ]
