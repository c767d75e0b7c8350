"""A session read back as arrays, in a notebook as in a test.

>>> from recordings import Session
>>> session = Session.open("walk.rrd")
>>> session
<Session walk.rrd: 120 frames, 4.0 s, kinect_v1>
>>> session.fused.shape, session.skeleton_a.positions.shape, session.rotation.shape
((120, 20, 3), (120, 20, 3), (120, 3, 3))
>>> float(session.quality.bone_error.max()) < 1e-6  # metres: S* is kept in float32
True
>>> [frame for frame, image in session.depth("a")]  # read only now
[0, 60]

Everything is in SI units and in K_A's frame, but for what a sensor gave, which is in its own.
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
    """A recorded capture: what the sensors saw, what was made of it, and with which settings.

    Attributes:
        path: The file; None for a session that is in memory only.
        rows: Everything that has a value a frame, as arrays.
        settings: What the fusion ran with.
        calibrations: From which frame on it was fused with which, each by a new fuser; the first from 0.
        intrinsics_a, intrinsics_b: Of the depth cameras.
        sources: What the sensors were called, K_A first.
        about: All properties as they were written, by group and name.
        events: In the order they were written.
        fused_checksums: (T,) of S* in float64; the file keeps float32.
        joint_digests: (T, J) a byte for each joint, likewise.
        frames_lost: How many frames are known to have been written and cannot be read.
        damage: What is wrong with the file, in words; None where it is whole.
        images: Where its images are read from.
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
        """A session in memory, of frames that were fused just now.

        Args:
            fused: Frames in time order, by what they were fused with; at least one in all.
            sources: What the sensors are called, K_A first.
            events: What happened.
            images: The frames' images.
            about: More to say of the session's origin.

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
        """Writes the session into an ``.rrd`` file, its images included.

        Args:
            path: The file; overwritten.
            blueprint: What a viewer shows; its own choice where None.

        Raises:
            OSError: The file is not whole afterwards.
        """
        from recordings.writing.session_writer import write_session

        write_session(self, Path(path), blueprint=blueprint)

    @staticmethod
    def open(path: str | Path) -> Session:
        """Reads a session without its depth images.

        A file that was cut off or damaged gives the frames before the damage; ``damage`` and
        ``frames_lost`` say so. Every frame is checked against its checksum.

        Raises:
            RecordingError: The file is missing, no session, of another layout, or damaged before its first
                frame.
        """
        from recordings.reading.session_reader import read_session

        return read_session(Path(path))

    def __len__(self) -> int:
        """The number of frames T."""
        return len(self.rows)

    def __repr__(self) -> str:
        """In a line: its arrays are too many to be shown."""
        seconds = (self.time_ns[-1] - self.time_ns[0]) * 1e-9
        return f"<Session {self.name}: {len(self)} frames, {seconds:.1f} s, {self.body.name}>"

    def __str__(self) -> str:
        """For messages: its file."""
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
        """S_A, of the principal sensor; its frame is the world's."""
        of = self.rows
        return SkeletonSeries(of.positions_a, of.states_a, of.weights_a, of.clock_a, of.stale_a)

    @property
    def skeleton_b(self) -> SkeletonSeries:
        """S_B, of the secondary sensor, in that one's frame: :attr:`rotation` and :attr:`translation` lay it
        into K_A's."""
        of = self.rows
        return SkeletonSeries(of.positions_b, of.states_b, of.weights_b, of.clock_b, of.stale_b)

    @property
    def fused(self) -> NDArray[np.float64]:
        """(T, J, 3) metres, S* in K_A's frame, to float32; NaN where there is none."""
        return self.rows.fused

    @property
    def bone_lengths(self) -> NDArray[np.float64]:
        """(T, J) metres, the lengths bones of S* were held to, by the joint at the far end; 0 at the root."""
        return self.rows.bone_lengths

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(T, 3, 3) R: turns K_B's axes into K_A's."""
        return self.rows.rotation

    @property
    def translation(self) -> NDArray[np.float64]:
        """(T, 3) metres, t: where K_B stands in K_A's frame; renewed every frame."""
        return self.rows.translation

    @property
    def quality(self) -> QualitySeries:
        """How good each frame is."""
        of = self.rows
        return QualitySeries(
            of.bone_error, of.disagreement, of.skew_ns, of.fuse_ms, of.iterations, of.predicted
        )

    @property
    def body(self) -> Body:
        """Which joints these are."""
        return self.rows.body

    @property
    def calibration(self) -> Calibration:
        """R, t, the bone lengths and how well the views agreed; the last where there were several."""
        return self.calibrations[-1][1]

    @property
    def first_frame(self) -> int:
        """The number, in the capture, of the first frame; more than 0 after a trim."""
        return int(self.about["session"].get("first_frame", [0])[0])

    @property
    def frame_rate(self) -> float:
        """Frames a second: 1 over the median interval; 30 where there is but one frame."""
        if len(self) < 2:
            return 30.0
        return float(1e9 / np.median(np.diff(self.rows.time_ns)))

    @property
    def spells(self) -> list[Spell]:
        """What lasted: from the event that began it to the one that ended it."""
        return spells_of(self.events)

    @property
    def whereabouts(self) -> NDArray[np.float64]:
        """(3,) metres in K_A's frame, the middle of where the person is; before K_A where no one is."""
        at = self.rows.fused.reshape(-1, 3)
        seen = at[np.isfinite(at).all(axis=1)]
        return np.asarray(np.median(seen, axis=0)) if len(seen) else np.array([0.0, 0.0, 2.5])

    @property
    def pairing(self) -> Pairing:
        """The pairs, and how many frames each sensor gave; what was dropped before recording is not known."""
        clocks = self.rows.clock_a, self.rows.clock_b
        seen_a, seen_b = (int((clock != layout.NO_FRAME).sum()) for clock in clocks)
        return Pairing(list(self.pairs()), seen_a, seen_b, 0, 0)

    def setups(self, settings: FuserSettings | None = None) -> Iterator[tuple[FusionSetup, slice]]:
        """What each calibration's frames were fused with, by a new fuser each, and which frames those are.

        Args:
            settings: To fuse with; the session's own where None.
        """
        firsts = [number for number, _ in self.calibrations]
        for (first, calibration), end in zip(self.calibrations, [*firsts[1:], len(self)], strict=True):
            cameras = self.intrinsics_a, self.intrinsics_b
            yield FusionSetup(calibration, settings or self.settings, *cameras), slice(first, end)

    def pairs(self, depth: bool = False) -> Iterator[FramePair]:
        """The pairs as the sensors gave them: a session is a source like any other.

        Args:
            depth: With the depth images the session has.
        """
        images = {side: self.depth(side) if depth else () for side in layout.SIDES}
        return recorded_pairs(self.rows, images)

    def depth(self, side: str, first: int = 0, end: int | None = None) -> Images[NDArray[np.uint16]]:
        """Depth images of a sensor, read as they are asked for; damaged ones are left out and counted.

        Args:
            side: ``a`` or ``b``.
            first, end: Of frames `first` up to, without, `end`; to the last where None.

        Returns:
            To be iterated over: the frame's number and its (height, width) millimetres, 0 without a reading.
        """
        return self.images.depth(side, self._frames(first, end))

    def color(self, side: str, first: int = 0, end: int | None = None) -> Images[ColorImage]:
        """Colour images of a sensor, as :meth:`depth` gives depth images."""
        return self.images.color(side, self._frames(first, end))

    def _frames(self, first: int, end: int | None) -> range:
        return range(first, len(self) if end is None else min(end, len(self)))
