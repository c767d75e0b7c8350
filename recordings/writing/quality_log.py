"""Figures that are not logged with every pair.

Quality over several frames that needs no truth: jitter, and how far K_B's pose has changed. State of two live
streams: clock drift, dropped frames, unpaired frames.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from devices.capture.sensor_pair import StreamFigures
from recordings import layout
from recordings.appearance import entity_styles
from recordings.session_arrays import SessionArrays

_EVERY = 15
"""Frames between two values, half a second."""
_AGAIN_NS = 1_000_000_000
"""Longest interval between two values of an unchanged figure of a stream, so that its plot line continues."""


class QualityLog:
    """Logs jitter and the drift of the calibration, about twice a second.

    The first values are those of the first three frames, so that no plot of a new session is empty.

    Args:
        stream: The recording stream.
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._kept: list[tuple[NDArray[np.float32], ...]] = []  # S_A, S_B, S* of each frame
        self._first: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        for name, lines in entity_styles.QUALITY_LINES.items():
            stream.log(layout.stream_figure(name), lines, static=True)

    def record(self, rows: SessionArrays) -> None:
        """Takes frames in time order."""
        for t in range(len(rows)):
            each = rows.positions_a[t], rows.positions_b[t], rows.fused[t].astype(np.float32)
            self._kept.append(each)
            if len(self._kept) < (3 if self._first is None else _EVERY + 2):
                continue
            jitters = [1e3 * jitter(np.array(of)) for of in zip(*self._kept, strict=True)]
            self._kept = self._kept[-2:]
            self._stream.set_time(layout.FRAME, sequence=int(rows.frame[t]))
            self._stream.set_time(layout.TIME, duration=np.timedelta64(int(rows.time_ns[t]), "ns"))
            self._stream.log(layout.stream_figure("jitter_mm"), rr.Scalars(jitters))
            moved = self._moved(rows.rotation[t], rows.translation[t])
            self._stream.log(layout.stream_figure("placement"), rr.Scalars(moved))

    def _moved(self, rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> tuple[float, float]:
        """Millimetres and degrees between the first pose of K_B and this one."""
        if self._first is None:
            self._first = rotation.copy(), translation.copy()
        cosine = (np.trace(self._first[0].T @ rotation) - 1.0) / 2.0
        turned = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        return 1e3 * float(np.linalg.norm(translation - self._first[1])), float(turned)


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


def jitter(positions: NDArray[np.float32]) -> float:
    """Metres: the median over joints and frames of |p(t−1) − 2 p(t) + p(t+1)|; NaN without data.

    Motion at a constant speed has none; of white noise of σ in each coordinate it is 3.8 σ.

    Args:
        positions: (T, J, 3) metres, NaN where not tracked; T ≥ 3.
    """
    bends = np.linalg.norm(positions[:-2] - 2.0 * positions[1:-1] + positions[2:], axis=2)
    bends = bends[np.isfinite(bends)]
    return float(np.median(bends)) if bends.size else float("nan")
