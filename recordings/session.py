"""A session as arrays, for notebooks, tests and programs.

>>> from recordings import Session
>>> session = Session.open("walk.rrd")
>>> session
<Session walk.rrd: 120 frames, 4.0 s, kinect_v1>
>>> session.fused.shape, session.skeleton_a.positions.shape, session.rotation.shape
((120, 20, 3), (120, 20, 3), (120, 3, 3))
>>> float(session.quality.bone_error.max()) < 1e-6  # metres: S* is stored in float32
True
>>> [frame for frame, image in session.depth("a")]  # reads the images now
[0, 60]

All values are in SI units and in K_A's frame, except the data of a sensor, which is in the sensor's own
frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from devices.events import Event, Spell, spells_of
from devices.pairing import FramePair, RecordedPairs
from fusion.angles import ANGLES, angle_sigma, joint_angles
from fusion.calibration.calibration import Calibration
from fusion.facing.evidence import upright_direction
from fusion.large_arrays import GrowingArray
from fusion.pair_arrays import Pairs, View
from fusion.setup import FusionSetup
from recordings import layout
from recordings.errors import RecordingError
from recordings.file.session_reader import read_session
from recordings.gait import Gait, find_gait
from recordings.images import NO_IMAGES, SessionImages
from recordings.interpolation import positions_at, sigma_at
from recordings.session_arrays import SessionArrays, SessionFrame, SessionFrames
from recordings.session_data import SessionData
from recordings.writing.checksums import fused_checksums, joint_digests
from recordings.writing.properties import as_lists, session_properties


@dataclass(frozen=True, eq=False)
class SkeletonSeries:
    """S_A or S_B over T frames of J joints, as given by the sensor.

    Attributes:
        positions: (T, J, 3) float32 metres in the sensor's own frame; NaN without a skeleton.
        states: (T, J) uint8, 0 not tracked, 1 inferred, 2 tracked.
        weights: (T, J) float32, w of eq. (11).
        captured_ns: (T,) time on the sensor's clock; :data:`recordings.layout.NO_FRAME` if it gave no frame.
        stale: (T,) whether the sensor repeated its last skeleton.
    """

    positions: NDArray[np.float32]
    states: NDArray[np.uint8]
    weights: NDArray[np.float32]
    captured_ns: NDArray[np.int64]
    stale: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class QualitySeries:
    """Quality figures of T frames.

    Attributes:
        bone_error: (T,) largest absolute error of a bone length of S*, metres; NaN without S*.
        disagreement: (T,) median distance between p and R q + t, metres; NaN if no joint is in both views.
        skew_ns: (T,) capture time of B minus capture time of A; 0 where only one of them gave a frame.
        fuse_ms: (T,) duration of the fusion, milliseconds.
        iterations: (T,) iterations of the solver.
        predicted: (T, J) whether a joint of S* has no data.
    """

    bone_error: NDArray[np.float64]
    disagreement: NDArray[np.float64]
    skew_ns: NDArray[np.int64]
    fuse_ms: NDArray[np.float64]
    iterations: NDArray[np.int64]
    predicted: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class AngleSeries:
    """Joint angles of S* over T frames; see :mod:`fusion.angles` for their definitions.

    Attributes:
        names: The K angles.
        degrees: (T, K); NaN where a joint is missing.
        sigma: (T, K) degrees, one standard deviation; NaN with the paper's methods.
    """

    names: tuple[str, ...]
    degrees: NDArray[np.float64]
    sigma: NDArray[np.float64]

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """(T,) degrees of an angle.

        Raises:
            KeyError: There is no such angle; the message lists all.
        """
        if name not in self.names:
            raise KeyError(f"no angle {name!r}; there are {', '.join(self.names)}")
        return np.asarray(self.degrees[:, self.names.index(name)])


@dataclass(frozen=True, eq=False, repr=False)
class Session(SessionData):
    """A recorded capture: the sensor data, the fused skeletons and the settings of the fusion.

    All attributes are those of :class:`recordings.session_data.SessionData`.
    """

    @staticmethod
    def of(
        fused: Sequence[tuple[FusionSetup, Iterable[SessionFrame | SessionFrames]]],
        sources: tuple[str, str] = ("a", "b"),
        *,
        events: Sequence[Event] = (),
        images: SessionImages = NO_IMAGES,
        about: Mapping[str, str | float] | None = None,
    ) -> Session:
        """Builds a session in memory from fused frames.

        Args:
            fused: (setup, frames) pairs in time order, one by one or in blocks; at least one frame in total.
                The frames are not kept.
            sources: Names of the sensors, K_A first.
            about: Additional properties about the session's origin.

        Raises:
            RecordingError: There is no frame.
        """
        calibrations: list[tuple[int, Calibration]] = []
        checks = GrowingArray(), GrowingArray()

        def stacked() -> Iterator[SessionArrays]:
            begun = start_ns = 0
            for one, frames in fused:
                first = begun
                for block in _blocks(frames):
                    start_ns = start_ns if begun else int(block[0].pair.time_ns)
                    numbers = range(begun, begun + len(block))
                    part = SessionArrays.stack(
                        one.body, one.calibration.bone_lengths, block, numbers, start_ns
                    )
                    begun += len(part)
                    checks[0].append(fused_checksums(part.fused))
                    checks[1].append(joint_digests(part.fused))
                    del block  # before the next one is made
                    yield part
                if begun > first:
                    calibrations.append((first, one.calibration))

        blocks = stacked()
        first = next(blocks, None)
        if first is None:
            raise RecordingError("A session needs at least one frame.")
        rows, setup = SessionArrays.joined(chain([first], blocks)), fused[0][0]
        fused_crc, digests = GrowingArray.wholes(checks)
        return Session(
            path=None,
            rows=rows,
            settings=setup.settings,
            calibrations=tuple(calibrations),
            intrinsics_a=setup.intrinsics_a,
            intrinsics_b=setup.intrinsics_b,
            sources=sources,
            about=as_lists(session_properties(setup, sources, about or {})),
            events=tuple(events),
            fused_checksums=fused_crc,
            joint_digests=digests,
            frames_lost=0,
            damage=None,
            images=images,
        )

    def save(self, path: str | Path, blueprint: Any = None) -> None:
        """Writes the session with its images to an ``.rrd`` file, which is overwritten.

        Args:
            blueprint: The layout of the viewer; None: the viewer's default.

        Raises:
            OSError: The file could not be written completely.
        """
        # the writer imports OpenCV, which changes the environment of the process
        from recordings.file.session_writer import write_session

        write_session(self, Path(path), blueprint=blueprint)

    @staticmethod
    def open(path: str | Path) -> Session:
        """Reads a session without its depth images.

        From a damaged or cut-off file it reads the frames before the damage; see ``damage`` and
        ``frames_lost``. Every frame is verified against its checksum.

        Raises:
            RecordingError: The file is missing, is not a session, has another layout version, or is damaged
                before its first frame.
        """
        return Session(**vars(read_session(Path(path))))

    def __repr__(self) -> str:
        seconds = (self.time_ns[-1] - self.time_ns[0]) * 1e-9
        return f"<Session {self.name}: {len(self)} frames, {seconds:.1f} s, {self.body.name}>"

    @property
    def time_ns(self) -> NDArray[np.int64]:
        """(T,) nanoseconds since the first pair."""
        return self.rows.time_ns

    @property
    def skeleton_a(self) -> SkeletonSeries:
        """S_A of the principal sensor, in K_A's frame, which is the world frame."""
        rows = self.rows
        return SkeletonSeries(rows.positions_a, rows.states_a, rows.weights_a, rows.clock_a, rows.stale_a)

    @property
    def skeleton_b(self) -> SkeletonSeries:
        """S_B of the secondary sensor, in K_B's frame; see :attr:`rotation` and :attr:`translation`."""
        rows = self.rows
        return SkeletonSeries(rows.positions_b, rows.states_b, rows.weights_b, rows.clock_b, rows.stale_b)

    @property
    def fused(self) -> NDArray[np.float64]:
        """(T, J, 3) S* in K_A's frame, metres, in float32 precision; NaN where S* is missing."""
        return self.rows.fused

    def at(self, time_ns: ArrayLike) -> NDArray[np.float64]:
        """(N, J, 3) S* at any times (N,) in nanoseconds since the first pair, with bones of constant length.

        See :func:`recordings.interpolation.positions_at`.
        """
        return positions_at(self.rows, time_ns)

    def sigma_at(self, time_ns: ArrayLike) -> NDArray[np.float64]:
        """(N, J) metres, the uncertainty of :meth:`at`; see :func:`recordings.interpolation.sigma_at`."""
        return sigma_at(self.rows, time_ns)

    @property
    def up(self) -> NDArray[np.float64]:
        """(3,) unit vector against gravity in K_A's frame, from the person's standing."""
        step = max(1, len(self) // _SAMPLES)
        with np.errstate(invalid="ignore", over="ignore"):  # a damaged file has any numbers
            return upright_direction(self.body, np.asarray(self.rows.fused[::step]))

    @property
    def never_seen(self) -> tuple[str, ...]:
        """Names of the joints that no sensor reports in any frame. S* there is a guess by the bones."""
        return tuple(np.array(self.body.joints)[self.rows.never_seen].tolist())

    @property
    def angles(self) -> AngleSeries:
        """Joint angles of S*, computed now; NaN where they need a joint that was never seen."""
        rows, seen, up = self.rows, self.rows.seen, self.up
        sigma = angle_sigma(self.body, seen, rows.filled("sigma"), up)
        return AngleSeries(ANGLES, joint_angles(self.body, seen, up), sigma)

    @property
    def gait(self) -> Gait:
        """Heel strikes, toe-offs and steps of S*, computed now; see :mod:`recordings.gait`."""
        return find_gait(self.body, self.time_ns, self.rows.seen, self.up, self.rows.sigma)

    @property
    def bone_lengths(self) -> NDArray[np.float64]:
        """(T, J) target lengths of the bones of S*, metres, indexed by the child joint; 0 at the root."""
        return self.rows.bone_lengths

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(T, 3, 3) R, K_A ← K_B."""
        return self.rows.rotation

    @property
    def translation(self) -> NDArray[np.float64]:
        """(T, 3) t, K_A ← K_B, metres: the position of K_B in K_A's frame.

        It changes with a calibration; with the method ``paper`` in every frame.
        """
        return self.rows.translation

    @property
    def quality(self) -> QualitySeries:
        """Quality figures per frame."""
        rows = self.rows
        return QualitySeries(
            rows.bone_error, rows.disagreement, rows.skew_ns, rows.fuse_ms, rows.iterations, rows.predicted
        )

    @property
    def calibration(self) -> Calibration:
        """R, t, the bone lengths and the agreement of the views; the last calibration of the session."""
        return self.calibrations[-1][1]

    @property
    def frame_rate(self) -> float:
        """Frames per second; see :attr:`recordings.session_arrays.SessionArrays.frame_rate`."""
        return self.rows.frame_rate

    @property
    def spells(self) -> list[Spell]:
        """Conditions that lasted, each from its start event to its end event."""
        return spells_of(self.events)

    @property
    def whereabouts(self) -> NDArray[np.float64]:
        """(3,) metres in K_A's frame, the median position of the person; a point in front of K_A without a
        person."""
        step = max(1, len(self) // _SAMPLES)
        some = [rows.fused[rows.frame % step == 0] for rows in self.rows.parts()]
        points = np.concatenate(some).reshape(-1, 3)
        seen = points[np.isfinite(points).all(axis=1)]
        return np.asarray(np.median(seen, axis=0)) if len(seen) else np.array([0.0, 0.0, 2.5])

    @property
    def frame_counts(self) -> dict[str, int]:
        """The counts of :class:`devices.pairing.Pairing`; frames dropped before saving count where known."""
        clocks = self.rows.clock_a, self.rows.clock_b
        seen_a, seen_b = (int((clock != layout.NO_FRAME).sum()) for clock in clocks)
        lost_a, lost_b = (count or 0 for count in self.dropped)
        alone_a, alone_b = (
            int(((own != layout.NO_FRAME) & (other == layout.NO_FRAME)).sum())
            for own, other in (clocks, clocks[::-1])
        )
        return {
            "frames_a": seen_a + lost_a, "frames_b": seen_b + lost_b,
            "dropped_a": lost_a, "dropped_b": lost_b,
            "alone_a": alone_a, "alone_b": alone_b,
        }  # fmt: skip

    @property
    def recorded_pairs(self) -> RecordedPairs:
        """The pairs as given by the sensors, without images, so that a session can serve as a source."""
        rows, number = self.rows, np.arange(len(self))
        clocks = rows.clock_a, rows.clock_b
        views = (
            View(rows.clock_a, rows.positions_a, rows.states_a, rows.witness_a),
            View(rows.clock_b, rows.positions_b, rows.states_b, rows.witness_b),
        )
        frames = np.stack([np.where(clock == layout.NO_FRAME, -1, number) for clock in clocks], axis=1)
        return RecordedPairs(Pairs(rows.body, views, rows.time_ns, rows.skew_ns, frames))

    def pairs(self, depth: bool = False) -> Iterator[FramePair]:
        """The pairs as given by the sensors, one by one."""
        images = {side: iter(self.depth(side) if depth else ()) for side in layout.SIDES}
        ahead = {side: next(images[side], None) for side in layout.SIDES}
        for t, pair in enumerate(self.recorded_pairs):
            for side, image in ahead.items():
                if image is not None and image[0] == t:
                    pair = replace(pair, **{side: replace(getattr(pair, side), depth=image[1])})
                    ahead[side] = next(images[side], None)
            yield pair


_BLOCK = 300  # frames that are turned into arrays at once
_SAMPLES = 9000  # frames, from which a person's usual place is found


def _blocks(frames: Iterable[SessionFrame | SessionFrames]) -> Iterator[Sequence[SessionFrame]]:
    """The frames in blocks; some are already."""
    single: list[SessionFrame] = []
    for each in frames:
        if isinstance(each, SessionFrame):
            single.append(each)
        if single and (isinstance(each, SessionFrames) or len(single) == _BLOCK):
            yield single
            single = []
        if isinstance(each, SessionFrames):
            yield each
    if single:
        yield single
