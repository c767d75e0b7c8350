"""Where things stand: sensors, floor and person as coordinate frames, each logged when it changes.

A recalibration is one message: the new pose of ``/kinect_b``, whose children move with it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fusion.setup import FusionSetup
from recordings import layout
from recordings.appearance import entity_styles
from recordings.appearance.floor import FloorFinder
from recordings.session_arrays import SessionArrays

_AGAIN_EVERY = 300
"""Frames, 10 s."""


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
        again = self._again and self._since >= _AGAIN_EVERY
        changed[0] |= self._b is None or again
        self._b = placement[-1].copy()
        for t in np.flatnonzero(changed):
            pose = rr.Transform3D(mat3x3=rows.rotation[t], translation=rows.translation[t])
            self._log(rows, int(t), layout.kinect("b"), pose)
        if self._floor.add(rows.fused) or again:
            self._log_floor(rows)
        if again:
            self._since = 0
        if len(rows) > 1:  # before the columns that follow: a browser draws what it has loaded so far
            self._stream.flush(timeout_sec=0.0)

    def _log_floor(self, rows: SessionArrays | None) -> None:
        """At the first of the frames: in a recording, the floor is the same from its beginning."""
        floor = self._floor.a_from_floor
        pose = rr.Transform3D(mat3x3=floor.rotation, translation=floor.translation)
        self._log(rows, 0, layout.FLOOR, pose)

    def _log(self, rows: SessionArrays | None, t: int, entity: str, what: Any) -> None:
        self._stream.set_time(layout.FRAME, sequence=0 if rows is None else int(rows.frame[t]))
        time_ns = 0 if rows is None else int(rows.time_ns[t])
        self._stream.set_time(layout.TIME, duration=np.timedelta64(time_ns, "ns"))
        self._stream.log(entity, what)

    def _log_static(self) -> None:
        once = self._stream.log
        once(layout.kinect("a"), rr.Transform3D.from_fields(translation=(0.0, 0.0, 0.0)), static=True)
        for side in layout.SIDES:
            once(layout.sensor_label(side), entity_styles.sensor_label(side), static=True)
        once(layout.FLOOR, entity_styles.floor_grid(), static=True)
        self._log_floor(None)
        for name, entity in layout.FRAME_NAMES.items():
            same = rr.Transform3D.from_fields(
                translation=(0.0, 0.0, 0.0), parent_frame=f"tf#{entity}", child_frame=name
            )
            once(layout.named_frame(name), same, static=True)
