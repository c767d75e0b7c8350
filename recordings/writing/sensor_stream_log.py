"""How two live streams go, on the timeline: the clocks' drift, frames dropped, frames left alone."""

from __future__ import annotations

import numpy as np
import rerun as rr

from devices.live.sensor_pair import StreamFigures
from recordings import layout
from recordings.appearance import entity_styles

_AGAIN_NS = 1_000_000_000
"""How long an unchanged figure is left standing, so that its line goes on."""


class StreamFiguresLog:
    """Writes the figures to a stream where they change, and once a second."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._last: dict[str, tuple[int, list[float]]] = {}

    def record(self, frame: int, time_ns: int, figures: StreamFigures) -> None:
        """Logs what is known at a frame."""
        of = {
            "drift_ppm": [figures.drift_ppm],
            "dropped": [float(count) for count in figures.dropped],
            "unpaired": [float(count) for count in figures.unpaired],
        }
        for name, values in of.items():
            before = self._last.get(name)
            if before is None:
                self._stream.log(layout.stream_figure(name), entity_styles.STREAM_LINES[name], static=True)
            elif time_ns - before[0] < _AGAIN_NS and (values == before[1] or name == "drift_ppm"):
                continue  # drift changes a little with every frame
            self._last[name] = time_ns, values
            self._stream.set_time(layout.FRAME, sequence=frame)
            self._stream.set_time(layout.TIME, duration=np.timedelta64(time_ns, "ns"))
            self._stream.log(layout.stream_figure(name), rr.Scalars(values))
