"""Logs what is not logged with every pair: poses, quality over some frames, states, figures of the streams.

Sensors, floor and person are coordinate frames. A recalibration is one message: the new pose of
``/kinect_b``, whose children move with it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from devices.capture.stream_pairing import PairingFigures
from fusion.setup import FusionSetup
from recordings import layout
from recordings.appearance import entity_styles
from recordings.appearance.floor import FloorFinder
from recordings.session_arrays import SessionArrays

_POSE_AGAIN = 300
"""Frames between two logs of an unchanged pose, 10 s."""
_QUALITY_EVERY = 15
"""Frames between two values, half a second."""
_FIGURE_AGAIN_NS = 1_000_000_000
"""Longest interval between two values of an unchanged figure of a stream, so that its plot line continues."""


def set_time(stream: rr.RecordingStream, frame: int | np.integer, time_ns: int | np.integer) -> None:
    """Sets both timelines of a session for what is logged next."""
    stream.set_time(layout.FRAME, sequence=int(frame))
    stream.set_time(layout.TIME, duration=np.timedelta64(int(time_ns), "ns"))


class PlacementLog:
    """Logs the pose of K_B and of the floor in K_A's frame.

    Args:
        stream: The recording stream.
        setup: The body and the first calibration.
        again: Whether to log the poses again from time to time, although they did not change. A hub forgets
            its oldest messages, and a viewer that connects later would not know where K_B is.
    """

    def __init__(self, stream: rr.RecordingStream, setup: FusionSetup, again: bool = False) -> None:
        self._stream, self._again, self._since = stream, again, 0
        self._floor = FloorFinder(setup.body)
        self._b: NDArray[np.float64] | None = None  # (3, 4) [R t]
        self._log_static()

    def record(self, rows: SessionArrays) -> None:
        """Logs what changed within some frames, in time order."""
        placement = np.concatenate((rows.rotation, rows.translation[..., None]), axis=2)
        before = placement[:1] if self._b is None else self._b[None]
        changed = (placement != np.concatenate((before, placement[:-1]))).any(axis=(1, 2))
        self._since += len(rows)
        again = self._again and self._since >= _POSE_AGAIN
        changed[0] |= self._b is None or again
        self._b = placement[-1].copy()
        for t in np.flatnonzero(changed):
            pose = rr.Transform3D(mat3x3=rows.rotation[t], translation=rows.translation[t])
            set_time(self._stream, rows.frame[t], rows.time_ns[t])
            self._stream.log(layout.kinect("b"), pose)
        if self._floor.add(rows.fused) or again:
            self._log_floor(rows.frame[0], rows.time_ns[0])
        if again:
            self._since = 0
        if len(rows) > 1:  # before the columns that follow: a browser draws what it has loaded so far
            self._stream.flush(timeout_sec=0.0)

    def _log_floor(self, frame: int, time_ns: int) -> None:
        """At the first of the frames: in a recording, the floor is the same from its beginning."""
        floor = self._floor.a_from_floor
        set_time(self._stream, frame, time_ns)
        self._stream.log(layout.FLOOR, rr.Transform3D(mat3x3=floor.rotation, translation=floor.translation))

    def _log_static(self) -> None:
        once = self._stream.log
        once(layout.kinect("a"), rr.Transform3D.from_fields(translation=(0.0, 0.0, 0.0)), static=True)
        for side in layout.SIDES:
            once(layout.sensor_label(side), entity_styles.sensor_label(side), static=True)
        once(layout.FLOOR, entity_styles.floor_grid(), static=True)
        self._log_floor(0, 0)
        for name, entity in layout.FRAME_NAMES.items():
            same = rr.Transform3D.from_fields(
                translation=(0.0, 0.0, 0.0), parent_frame=f"tf#{entity}", child_frame=name
            )
            once(layout.named_frame(name), same, static=True)


class QualityLog:
    """Logs jitter and the drift of the calibration, about twice a second.

    The first values are those of the first three frames, so that no plot of a new session is empty.

    Args:
        stream: The recording stream.
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._kept: NDArray[np.float32] | None = None  # (3, n, J, 3) S_A, S_B, S* of the last frames
        self._first: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        for name, lines in entity_styles.QUALITY_LINES.items():
            stream.log(layout.stream_figure(name), lines, static=True)

    def record(self, rows: SessionArrays) -> None:
        """Takes frames in time order."""
        each = np.stack((rows.positions_a, rows.positions_b, rows.fused.astype(np.float32)))
        if self._kept is not None:
            each = np.concatenate((self._kept, each), axis=1)
        before = each.shape[1] - len(rows)
        while each.shape[1] >= (window := 3 if self._first is None else _QUALITY_EVERY + 2):
            t = window - 1 - before
            set_time(self._stream, rows.frame[t], rows.time_ns[t])
            jitters = [1e3 * jitter(of) for of in each[:, :window]]
            self._stream.log(layout.stream_figure("jitter_mm"), rr.Scalars(jitters))
            moved = self._moved(rows.rotation[t], rows.translation[t])
            self._stream.log(layout.stream_figure("placement"), rr.Scalars(moved))
            each, before = each[:, window - 2 :], before - (window - 2)
        self._kept = each

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

    def record(self, frame: int, time_ns: int, figures: PairingFigures) -> None:
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
            elif time_ns - before[0] < _FIGURE_AGAIN_NS and (values == before[1] or name == "drift_ppm"):
                continue  # drift changes a little with every frame
            self._last[name] = time_ns, values
            set_time(self._stream, frame, time_ns)
            self._stream.log(layout.stream_figure(name), rr.Scalars(values))


def jitter(positions: NDArray[np.float32]) -> float:
    """Metres: the median over joints and frames of |p(t−1) − 2 p(t) + p(t+1)|; NaN without data.

    Motion at a constant speed has none; of white noise of σ in each coordinate it is 3.8 σ.

    Args:
        positions: (T, J, 3) metres, NaN where not tracked; T ≥ 3.
    """
    accelerations = np.linalg.norm(positions[:-2] - 2.0 * positions[1:-1] + positions[2:], axis=2)
    accelerations = accelerations[np.isfinite(accelerations)]
    return float(np.median(accelerations)) if accelerations.size else float("nan")


class Lanes:
    """Finds the changes of states over time.

    Args:
        steady: Whether a state that never changes has a lane, too.
    """

    def __init__(self, steady: bool = False) -> None:
        self._steady = steady
        self._before: NDArray[np.integer] | None = None
        self._open: set[int] = set()

    def add(self, states: NDArray[np.integer]) -> Iterator[tuple[int, list[tuple[int | None, int]]]]:
        """Adds (T, n) states in time order.

        Returns:
            (column, changes) of each column that changed; a change is (index of the frame, state). The first
            change of a column is preceded by its initial state, at index None.
        """
        begins = self._before is None
        before = states[0] if self._before is None else self._before
        whole = np.concatenate((before[None], states))
        changed = (whole[1:] != whole[:-1]).any(axis=0)
        for column in range(states.shape[1]) if begins and self._steady else np.flatnonzero(changed).tolist():
            lane = whole[:, column]
            changes: list[tuple[int | None, int]] = [
                (int(t), int(states[t, column])) for t in np.flatnonzero(lane[1:] != lane[:-1])
            ]
            if column not in self._open:
                self._open.add(column)
                changes.insert(0, (None, int(lane[0])))
            yield column, changes
        self._before = states[-1].copy()  # a view would keep the whole block in memory
