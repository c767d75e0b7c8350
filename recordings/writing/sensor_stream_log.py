"""Figures of two live streams on the timeline: clock drift, dropped frames, unpaired frames."""

from __future__ import annotations

import numpy as np
import rerun as rr

from devices.live.sensor_pair import StreamFigures
from recordings import layout
from recordings.appearance import entity_styles

_AGAIN_NS = 1_000_000_000
"""Longest interval between two values of an unchanged figure, so that its plot line continues."""


class StreamFiguresLog:
    """Writes the figures to a stream when they change, and at least once per second."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._last: dict[str, tuple[int, list[float]]] = {}

    def record(self, frame: int, time_ns: int, figures: StreamFigures) -> None:
        """Logs the figures known at a frame."""
        by_name = {
            "drift_ppm": [figures.drift_ppm],
            "dropped": [float(count) for count in figures.dropped],
            "unpaired": [float(count) for count in figures.unpaired],
        }
        for name, values in by_name.items():
            before = self._last.get(name)
            if before is None:
                self._stream.log(layout.stream_figure(name), entity_styles.STREAM_LINES[name], static=True)
            elif time_ns - before[0] < _AGAIN_NS and (values == before[1] or name == "drift_ppm"):
                continue  # drift changes a little with every frame
            self._last[name] = time_ns, values
            self._stream.set_time(layout.FRAME, sequence=frame)
            self._stream.set_time(layout.TIME, duration=np.timedelta64(time_ns, "ns"))
            self._stream.log(layout.stream_figure(name), rr.Scalars(values))
