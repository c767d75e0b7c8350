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

A little over 300 lines: the public face of a session.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.pairing import FramePair, Pairing
from devices.sensor import ColorImage
from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.intrinsics import Intrinsics
from fusion.setup import FuserSettings, FusionSetup
from recordings import layout
from recordings.errors import RecordingError
from recordings.events import Event, Spell, spells_of
from recordings.images.session_images import NO_IMAGES, Images, SessionImages
from recordings.reading.session_pairs import recorded_pairs
from recordings.session_arrays import RecordedFrame, SessionArrays
from recordings.session_series import QualitySeries, SkeletonSeries
from recordings.writing.checksums import fused_checksums, joint_digests
from recordings.writing.properties import as_lists, session_properties


@dataclass(frozen=True, eq=False, repr=False)
class Session:
    """A recorded capture: the sensor data, the fused skeletons and the settings of the fusion.

    Attributes:
        path: The file; None for a session in memory.
        rows: All per-frame figures as arrays.
        settings: The settings of the fusion.
        calibrations: (first frame, calibration) pairs; the first starts at frame 0. A new fuser starts at
            each.
        intrinsics_a, intrinsics_b: Intrinsics of the depth cameras.
        sources: Names of the sensors, K_A first.
        about: All properties as written, by group and name.
        events: Events in the order of writing.
        fused_checksums: (T,) checksums of S* in float64; the file stores float32.
        joint_digests: (T, J) one digest byte for each joint of S* in float64.
        frames_lost: Number of frames that were written but cannot be read.
        damage: Description of the damage of the file; None if it is whole.
        images: Source of the images.
    """

    path: Path | None
    rows: SessionArrays
    settings: FuserSettings
    calibrations: tuple[tuple[int, Calibration], ...]
    intrinsics_a: Intrinsics
    intrinsics_b: Intrinsics
    sources: tuple[str, str]
    about: dict[str, dict[str, list[Any]]]
    events: tuple[Event, ...]
    fused_checksums: NDArray[np.uint32]
    joint_digests: NDArray[np.uint8]
    frames_lost: int
    damage: str | None
    images: SessionImages = NO_IMAGES

    @staticmethod
    def of(
        fused: Sequence[tuple[FusionSetup, Sequence[RecordedFrame]]],
        sources: tuple[str, str] = ("a", "b"),
        *,
        events: Sequence[Event] = (),
        images: SessionImages = NO_IMAGES,
        about: Mapping[str, str | int] | None = None,
    ) -> Session:
        """Builds a session in memory from fused frames.

        Args:
            fused: (setup, frames) pairs in time order; at least one frame in total.
            sources: Names of the sensors, K_A first.
            events: Events of the session.
            images: The images of the frames.
            about: Additional properties about the session's origin.

        Raises:
            RecordingError: There is no frame.
        """
        frames = [frame for _, of_setup in fused for frame in of_setup]
        if not frames:
            raise RecordingError("A session needs at least one frame.")
        lengths = np.repeat(
            [setup.calibration.bone_lengths for setup, _ in fused], [len(own) for _, own in fused], axis=0
        )
        firsts = np.cumsum([0, *(len(own) for _, own in fused)]).tolist()
        setup = fused[0][0]
        rows = SessionArrays.stack(setup.body, lengths, frames)
        return Session(
            path=None,
            rows=rows,
            settings=setup.settings,
            calibrations=tuple(
                (first, one.calibration) for first, (one, own) in zip(firsts, fused, strict=False) if own
            ),
            intrinsics_a=setup.intrinsics_a,
            intrinsics_b=setup.intrinsics_b,
            sources=sources,
            about=as_lists(session_properties(setup, sources, about or {})),
            events=tuple(events),
            fused_checksums=fused_checksums(rows.fused),
            joint_digests=joint_digests(rows.fused),
            frames_lost=0,
            damage=None,
            images=images,
        )

    def save(self, path: str | Path, blueprint: Any = None) -> None:
        """Writes the session with its images to an ``.rrd`` file.

        Args:
            path: The file; overwritten.
            blueprint: The layout of the viewer; None: the viewer's default.

        Raises:
            OSError: The file could not be written completely.
        """
        from recordings.writing.session_writer import write_session

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
        from recordings.reading.session_reader import read_session

        return read_session(Path(path))

    def __len__(self) -> int:
        """The number of frames T."""
        return len(self.rows)

    def __repr__(self) -> str:
        """A one-line summary without the arrays."""
        seconds = (self.time_ns[-1] - self.time_ns[0]) * 1e-9
        return f"<Session {self.name}: {len(self)} frames, {seconds:.1f} s, {self.body.name}>"

    def __str__(self) -> str:
        """The file of the session, for messages."""
        return "the session in memory" if self.path is None else str(self.path)

    @property
    def name(self) -> str:
        """The file's name."""
        return "session" if self.path is None else self.path.name

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
        """(T, 3) t, K_A ← K_B, metres: the position of K_B in K_A's frame, updated every frame."""
        return self.rows.translation

    @property
    def quality(self) -> QualitySeries:
        """Quality figures per frame."""
        rows = self.rows
        return QualitySeries(
            rows.bone_error,
            rows.disagreement,
            rows.skew_ns,
            rows.fuse_ms,
            rows.iterations,
            rows.predicted,
        )

    @property
    def body(self) -> Body:
        """The body that defines the joints."""
        return self.rows.body

    @property
    def calibration(self) -> Calibration:
        """R, t, the bone lengths and the agreement of the views; the last calibration of the session."""
        return self.calibrations[-1][1]

    @property
    def first_frame(self) -> int:
        """The number of the first frame in the original capture; greater than 0 after a trim."""
        return int(self.about["session"].get("first_frame", [0])[0])

    @property
    def frame_rate(self) -> float:
        """Frames per second: 1 / median interval; 30 for a session of one frame."""
        if len(self) < 2:
            return 30.0
        return float(1e9 / np.median(np.diff(self.rows.time_ns)))

    @property
    def spells(self) -> list[Spell]:
        """Conditions that lasted, each from its start event to its end event."""
        return spells_of(self.events)

    @property
    def tracker(self) -> str:
        """The body tracker that found the people, such as "blazepose full"; empty where not recorded."""
        return str(self.about["session"].get("tracker", [""])[0])

    @property
    def whereabouts(self) -> NDArray[np.float64]:
        """(3,) metres in K_A's frame, the median position of the person; a point in front of K_A without a
        person."""
        points = self.rows.fused.reshape(-1, 3)
        seen = points[np.isfinite(points).all(axis=1)]
        return np.asarray(np.median(seen, axis=0)) if len(seen) else np.array([0.0, 0.0, 2.5])

    @property
    def pairing(self) -> Pairing:
        """The pairs, and the number of frames per sensor; frames dropped before recording are not counted."""
        clocks = self.rows.clock_a, self.rows.clock_b
        seen_a, seen_b = (int((clock != layout.NO_FRAME).sum()) for clock in clocks)
        return Pairing(list(self.pairs()), seen_a, seen_b, 0, 0)

    def setups(self, settings: FuserSettings | None = None) -> Iterator[tuple[FusionSetup, slice]]:
        """The setup and the frames of each calibration; a new fuser starts at each.

        Args:
            settings: Settings to use; None: the session's own.
        """
        firsts = [number for number, _ in self.calibrations]
        for (first, calibration), end in zip(self.calibrations, [*firsts[1:], len(self)], strict=True):
            cameras = self.intrinsics_a, self.intrinsics_b
            yield FusionSetup(calibration, settings or self.settings, *cameras), slice(first, end)

    def pairs(self, depth: bool = False) -> Iterator[FramePair]:
        """The pairs as given by the sensors, so that a session can serve as a source.

        Args:
            depth: Whether to include the session's depth images.
        """
        images = {side: self.depth(side) if depth else () for side in layout.SIDES}
        return recorded_pairs(self.rows, images)

    def depth(self, side: str, first: int = 0, end: int | None = None) -> Images[NDArray[np.uint16]]:
        """Depth images of a sensor, read on demand; damaged images are skipped and counted.

        Args:
            side: ``a`` or ``b``.
            first, end: The frames from `first` to `end`, exclusive; None: to the last frame.

        Returns:
            An iterable of frame number and (height, width) millimetres, 0 without a reading.
        """
        return self.images.depth(side, self._frames(first, end))

    def color(self, side: str, first: int = 0, end: int | None = None) -> Images[ColorImage]:
        """Colour images of a sensor; same arguments and iteration as :meth:`depth`."""
        return self.images.color(side, self._frames(first, end))

    def _frames(self, first: int, end: int | None) -> range:
        return range(first, len(self) if end is None else min(end, len(self)))
