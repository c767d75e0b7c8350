"""Logs what is not logged with every pair: poses, quality over some frames, states, figures of the streams.

Sensors, floor and person are coordinate frames. A recalibration is one message: the new pose of
``/kinect_b``, whose children move with it.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from devices.frame_pairs import PairingFigures
from fusion.body import Body
from fusion.setup import FusionSetup
from recordings.appearance import entity_styles
from recordings.appearance.floor import FloorFinder
from recordings.appearance.joint_trust import LIMBS, SOURCES, LimbSources
from recordings.data import layout
from recordings.data.frame_noise import FrameDeviations, noise_of
from recordings.data.session_arrays import SessionArrays
from recordings.data.session_data import SessionData
from recordings.quality.per_second import merged_by_word, quality_per_second
from recordings.writing.arrow_columns import Column, Times, converted, state_changes

_POSE_AGAIN_NS = 10_000_000_000
"""Between two logs of an unchanged pose."""
_QUALITY_NS = 495_000_000
"""Between two values: half a second, less the rounding of times."""
_FIGURE_AGAIN_NS = 1_000_000_000
"""Longest interval between two values of an unchanged figure of a stream, so that its plot line continues."""
Changes = list[tuple[int | None, int]]
"""(index of the frame, state); the index is None for the state before the first frame."""


def set_time(stream: rr.RecordingStream, frame: int | np.integer, time_ns: int | np.integer) -> None:
    """Sets both timelines of a session for what is logged next."""
    stream.set_time(layout.FRAME, sequence=int(frame))
    stream.set_time(layout.TIME, duration=np.timedelta64(int(time_ns), "ns"))


class PlacementLog:
    """Logs the pose of K_B and of the floor in K_A's frame.

    Args:
        again: Whether to log the poses again from time to time, although they did not change. A hub forgets
            its oldest messages, and a viewer that connects later would not know where K_B is.
    """

    def __init__(self, stream: rr.RecordingStream, setup: FusionSetup, again: bool = False) -> None:
        self._stream, self._again = stream, again
        self._again_ns: int | None = None  # when all poses were logged for the last time
        self._floor = FloorFinder(setup.body)
        self._b: NDArray[np.float64] | None = None  # (3, 4) [R t]
        self._log_floor(0, 0)

    @property
    def up(self) -> NDArray[np.float64]:
        """(3,) against gravity in K_A's frame, from the newest floor."""
        return -self._floor.a_from_floor.rotation[:, 1]

    def record(self, rows: SessionArrays) -> None:
        """Logs what changed within some frames, in time order."""
        placement = np.concatenate((rows.rotation, rows.translation[..., None]), axis=2)
        before = placement[:1] if self._b is None else self._b[None]
        changed = (placement != np.concatenate((before, placement[:-1]))).any(axis=(1, 2))
        self._again_ns = int(rows.time_ns[0]) if self._again_ns is None else self._again_ns
        again = self._again and int(rows.time_ns[-1]) - self._again_ns >= _POSE_AGAIN_NS
        changed[0] |= self._b is None or again
        self._b = placement[-1].copy()
        for t in np.flatnonzero(changed):
            pose = rr.Transform3D(mat3x3=rows.rotation[t], translation=rows.translation[t])
            set_time(self._stream, rows.frame[t], rows.time_ns[t])
            self._stream.log(layout.kinect("b"), pose)
        if self._floor.add(rows.fused) or again:
            self._log_floor(rows.frame[0], rows.time_ns[0])
        if again:
            self._again_ns = int(rows.time_ns[-1])
        if len(rows) > 1:  # before the columns that follow: a browser draws what it has loaded so far
            self._stream.flush(timeout_sec=0.0)

    def _log_floor(self, frame: int, time_ns: int) -> None:
        """At the first of the frames: in a recording, the floor is the same from its beginning."""
        floor = self._floor.a_from_floor
        set_time(self._stream, frame, time_ns)
        self._stream.log(layout.FLOOR, rr.Transform3D(mat3x3=floor.rotation, translation=floor.translation))


class QualityLog:
    """Logs jitter, the noise of all joints, and the drift of the calibration, about twice a second.

    The first values are those of the first three frames, so that no plot of a new session is empty.
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._tracks = [FrameDeviations() for _ in range(3)]  # of S_A, S_B, S*
        self._kept: list[NDArray[np.float64]] = []  # (3, n, J) their deviations since the last value
        self._frames, self._last_ns = 0, 0  # so far; the time of the last value
        self._first: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def record(self, rows: SessionArrays) -> None:
        """Logs the changes in the following frames, which are in order of time."""
        views: list[NDArray[np.floating]] = [rows.positions_a, rows.positions_b, rows.fused]
        tracks = zip(self._tracks, views, strict=True)
        self._kept.append(np.stack([track.add(view, rows.time_ns) for track, view in tracks]))
        due = [k for k, time_ns in enumerate(rows.time_ns.tolist()) if self._due(time_ns)]
        if not due:
            return
        every = np.concatenate(self._kept, axis=1)
        ends = np.array(due, dtype=np.int64) + 1 + every.shape[1] - len(rows)
        *windows, rest = np.split(every, ends, axis=1)
        self._kept = [rest.copy()]  # a view would keep the whole block in memory
        jitters = 1e3 * np.array([noise_of(window) for window in windows])
        at = np.array(due, dtype=np.int64)
        for entity, values in ((layout.JITTER, jitters), (layout.PLACEMENT, self._moved(rows, at))):
            scalars = converted(rr.Scalars, "scalars", values, values.size)
            columns: list[Any] = [Column(*scalars, len(due))]
            times = Times.of_frames(rows.frame[at], rows.time_ns[at])
            self._stream.send_columns(entity, times, columns)

    def _due(self, time_ns: int) -> bool:
        """Returns whether the value is to be logged with the next frame."""
        self._frames += 1
        due = self._frames == 3 or (self._frames > 3 and not 0 <= time_ns - self._last_ns < _QUALITY_NS)
        self._last_ns = time_ns if due else self._last_ns
        return due

    def _moved(self, rows: SessionArrays, at: NDArray[np.int64]) -> NDArray[np.float64]:
        """(n, 2) millimetres and degrees between the first pose of K_B and those of some frames."""
        rotation, translation = rows.rotation[at], rows.translation[at]
        if self._first is None:
            self._first = rotation[0], translation[0]
        cosine = (np.einsum("ij,tij->t", self._first[0], rotation) - 1.0) / 2.0
        turned = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        return np.stack([1e3 * np.linalg.norm(translation - self._first[1], axis=1), turned], axis=1)


class StreamFiguresLog:
    """Writes the figures to a stream when they change, and at least once per second."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._last: dict[str, tuple[int, list[float]]] = {}

    def record(self, frame: int, time_ns: int, figures: PairingFigures) -> None:
        """Logs the figures known at a frame."""
        of_entities = {
            layout.DRIFT: [figures.drift_ppm],
            layout.DROPPED: [float(count) for count in figures.dropped],
            layout.UNPAIRED: [float(count) for count in figures.unpaired],
        }
        for entity, values in of_entities.items():
            before = self._last.get(entity)
            if before is None:
                self._stream.log(entity, entity_styles.LINES[entity], static=True)
            elif time_ns - before[0] < _FIGURE_AGAIN_NS and (values == before[1] or entity == layout.DRIFT):
                continue  # drift changes a little with every frame
            self._last[entity] = time_ns, values
            set_time(self._stream, frame, time_ns)
            self._stream.log(entity, rr.Scalars(values))


def log_quality(stream: rr.RecordingStream, session: SessionData) -> None:
    """Logs how good the seconds of a session are, equal ones as one: the viewer cuts off the text of each."""
    stretches = merged_by_word(quality_per_second(session))
    texts = [f"{each.word}: {each.reason}" if each.reason else each.word for each in stretches]
    starts = np.array([each.start for each in stretches])
    frames = np.searchsorted(session.rows.time_ns, starts * 1e9).clip(max=len(session) - 1)
    times = Times.of_frames(frames, np.rint(starts * 1e9).astype(np.int64))
    stream.send_columns(layout.SECONDS_LANE, times, state_changes(texts))
    words = {text: each.word for text, each in zip(texts, stretches, strict=True)}
    stream.log(layout.SECONDS_LANE, entity_styles.seconds_lane(words), static=True)


class Lanes:
    """Finds the changes of states over time.

    Args:
        steady: Whether a state that never changes has a lane, too.
    """

    def __init__(self, steady: bool = False) -> None:
        self._steady = steady
        self._before: NDArray[np.integer] | None = None
        self._open: set[int] = set()

    def add(self, states: NDArray[np.integer]) -> Iterator[tuple[int, Changes]]:
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
            changes: Changes = [
                (int(t), int(states[t, column])) for t in np.flatnonzero(lane[1:] != lane[:-1])
            ]
            if column not in self._open:
                self._open.add(column)
                changes.insert(0, (None, int(lane[0])))
            yield column, changes
        self._before = states[-1].copy()  # a view would keep the whole block in memory


class StatesLog:
    """Logs the view that each limb of S* follows, and the tracking states of joints, when they change.

    Args:
        pause: Called before each message.
    """

    def __init__(self, stream: rr.RecordingStream, body: Body, pause: Callable[[], object]) -> None:
        self._stream, self._body, self._pause = stream, body, pause
        self._limb_sources, self._trust = LimbSources(body), Lanes(steady=True)
        self._states = {side: Lanes() for side in layout.VIEWS}

    def record(self, rows: SessionArrays) -> None:
        """Takes frames in time order."""
        for limb, changes in self._trust.add(self._limb_sources.add(rows)):
            lane = layout.trust_lane(LIMBS[limb].replace(" ", "_"))
            self._log(rows, lane, SOURCES, changes, entity_styles.TRUST_LANES)
        for side, states in (("a", rows.states_a), ("b", rows.states_b)):
            for joint, changes in self._states[side].add(states):
                lane = layout.state_lane(side, self._body.joints[joint])
                self._log(rows, lane, layout.STATE_NAMES, changes, entity_styles.STATE_LANES)

    def _log(
        self, rows: SessionArrays, lane: str, names: Sequence[str], changes: Changes,
        look: rr.StateConfiguration,
    ) -> None:  # fmt: skip
        self._pause()
        places = [(0, 0) if t is None else (int(rows.frame[t]), int(rows.time_ns[t])) for t, _ in changes]
        frames, times = np.array(places).T
        states = state_changes([names[state] for _, state in changes])
        self._stream.send_columns(lane, Times.of_frames(frames, times), states)
        if changes[0][0] is None:
            self._stream.log(lane, look, static=True)
