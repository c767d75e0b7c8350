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
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from devices.events import Event
from fusion.calibration.calibration import Calibration
from fusion.setup import FusionSetup
from recordings.data.images import NO_IMAGES, SessionImages
from recordings.data.session_arrays import SessionArrays, SessionFrame, SessionFrames
from recordings.errors import RecordingError
from recordings.session_series import SessionSeries
from recordings.writing.properties import as_lists, session_properties

if TYPE_CHECKING:
    from recordings.comparing.session_comparison import Comparison
    from recordings.comparing.truth_comparison import TruthComparison
    from recordings.export import Feet, Names, Table

_BLOCK = 300  # frames that are turned into arrays at once


@dataclass(frozen=True, eq=False, repr=False)
class Session(SessionSeries):
    """A recorded capture: the sensor data, the fused skeletons and the settings of the fusion.

    :func:`recordings.fuse`, :func:`recordings.fuse_arrays` and :meth:`open` make one. It can be pickled; its
    depth images are then read from its file.
    """

    @staticmethod
    def of(
        fused: Sequence[tuple[FusionSetup, Iterable[SessionFrame | SessionFrames]]],
        sources: tuple[str, str] = ("a", "b"),
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
                    del block  # before the next one is made
                    yield part
                if begun > first:
                    calibrations.append((first, one.calibration))

        blocks = stacked()
        if (first := next(blocks, None)) is None:
            raise RecordingError("A session needs at least one frame.")
        rows, setup = SessionArrays.joined(chain([first], blocks)), fused[0][0]
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
            frames_lost=0,
            damage=None,
            images=images,
        )

    def export(
        self,
        path: str | Path,
        *,
        rate: float | None = None,
        table: Table = "long",
        names: Names = "body",
        feet: Feet = "planted",
        sigma: bool = False,
    ) -> str:
        """Writes S* for another program, as ``duplex export`` does; an existing file is replaced.

        Args:
            path: Its ending chooses the format: ``.bvh``, ``.c3d``, ``.csv``, ``.glb``, ``.mcap``, ``.mot``,
                ``.npz``, ``.parquet`` or ``.trc``. A name without one is a folder, for OpenSim.
            rate: Frames per second. None: that of the recording, or in a table the recorded times.
            table: Of a ``.csv`` or ``.parquet``: one row per joint (``long``) or per frame (``wide``).
            names: Of the bones in a ``.bvh`` or ``.glb``: see :func:`.export.writer_for`.
            feet: In a ``.bvh`` or ``.glb``: ``planted`` where they stand, or as in S* (``free``).
            sigma: Whether a ``.csv`` or ``.parquet`` has one standard deviation of each value of S*.

        Returns:
            A description of what was written.

        Raises:
            RecordingError: There is no such format, or it does not support an argument, or the package that
                writes it is not installed.
            OutputError: The file could not be written completely. An existing file is then unchanged.
        """
        from recordings.export import export, writer_for

        write = writer_for(Path(path), table, rate, names, feet, sigma)
        return export(self, Path(path), write, overwrite=True)

    @overload
    def compare_with(
        self, other: str | Path, *, names: str | Path | None = None, offset: float | None = None
    ) -> TruthComparison: ...
    @overload
    def compare_with(self, other: Session, *, any_capture: bool = False) -> Comparison: ...
    def compare_with(
        self,
        other: str | Path | Session,
        *,
        names: str | Path | None = None,
        offset: float | None = None,
        any_capture: bool = False,
    ) -> TruthComparison | Comparison:
        """Compares S_A, S_B and S* with motion capture of the same movement, or S* with that of another
        session of this capture, as ``duplex compare`` does.

        Args:
            other: A ``.c3d``, ``.trc`` or ``.csv``, or a session.
            names: Which of its points are joints: a TOML file, or ``mixamo``, ``plug-in-gait`` or
                ``gait2392``; None: the one of these that finds most.
            offset: Seconds to add to its times; None: found from the motion.
            any_capture: Whether the session may be of another capture, too.

        Raises:
            RecordingError: The file cannot be read, or it or the session is of another movement.
            DeviceError: There is no such table of names.
        """
        from devices.skeletons.name_tables import name_table
        from recordings.comparing.session_comparison import Comparison
        from recordings.comparing.truth_comparison import TruthComparison
        from recordings.comparing.truth_files import read_truth

        if isinstance(other, Session):
            for name, given in (("names", names), ("offset", offset)):
                if given is not None:
                    raise RecordingError(f"`{name}` is for motion capture; {other} is a session.")
            return Comparison.of(self, other, any_capture)
        table = None if names is None else name_table(names)
        return TruthComparison.of(self, read_truth(Path(other)), table, offset)

    def to_arrow(self, table: Table = "wide", *, sigma: bool = False) -> Any:
        """The ``pyarrow.Table`` of ``export``; a column's metadata has its ``unit``."""
        from recordings.export.tables import arrow_table

        return arrow_table(self, table, sigma)

    def to_pandas(self, table: Table = "wide", *, sigma: bool = False) -> Any:
        """The table of :meth:`to_arrow` as a ``pandas.DataFrame``; ``.attrs["units"]`` has units by column.

        Raises:
            RecordingError: pandas is not installed.
        """
        from recordings.export.tables import arrow_table, units_of

        made = arrow_table(self, table, sigma)
        try:
            frame = made.to_pandas()
        except ImportError:
            raise RecordingError("to_pandas needs pandas: pip install pandas.") from None
        frame.attrs["units"] = units_of(made)
        return frame

    def save(self, path: str | Path, blueprint: Any = None) -> None:
        """Writes the session with its images to an ``.rrd`` file, which is overwritten.

        Args:
            blueprint: The layout of the viewer; None: the viewer's default.

        Raises:
            OutputError: The file could not be written completely. An existing file is then unchanged.
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
        from recordings.file.session_reader import read_session  # a fused session needs no reader

        return Session(**vars(read_session(Path(path))))


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
