"""A session read back as arrays: ``Session.open("walk.rrd").fused[100]`` in a notebook as in a test."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.pairing import FramePair
from devices.sensor import ColorImage, SensorFrame
from fusion.body import BODIES, Body
from fusion.calibration import Calibration
from fusion.fuser import Fuser, FuserSettings
from fusion.skeleton import Skeleton
from fusion.viewing_plane import Intrinsics
from recordings import layout
from recordings.arrays import SessionArrays
from recordings.checksums import image_checksum
from recordings.color import read_color
from recordings.errors import RecordingError
from recordings.rrd_file import RrdFile, read_columns
from recordings.rvl import decode_depth
from recordings.stored_frames import frames_of
from recordings.stored_settings import (
    Event,
    calibrations_of,
    camera_of,
    checked_properties,
    events_of,
    settings_of,
)

_BLOB = "EncodedDepthImage:blob"
PERSON = "0"
"""The id of the one person of a session, as a source of pairs."""


@dataclass(frozen=True, eq=False)
class Session:
    """A recorded capture: what the sensors saw, what was made of it, and with which settings.

    Attributes:
        path: The file.
        rows: Everything that has a value a frame, as arrays.
        settings: What the fusion ran with.
        calibrations: From which frame on it was fused with which, each by a new fuser; the first from 0.
        intrinsics_a, intrinsics_b: Of the depth cameras.
        sources: What the sensors were called, K_A first.
        about: All properties as they were written, by group and name.
        events: In the order they were written.
        fused_checksums: (T,) of S* in float64; the file keeps float32.
        frames_lost: How many frames are known to have been written and cannot be read.
        damage: What is wrong with the file, in words; None where it is whole.
    """

    path: Path
    rows: SessionArrays
    settings: FuserSettings
    calibrations: tuple[tuple[int, Calibration], ...]
    intrinsics_a: Intrinsics
    intrinsics_b: Intrinsics
    sources: tuple[str, str]
    about: dict[str, dict[str, list[Any]]]
    events: tuple[Event, ...]
    fused_checksums: NDArray[np.uint32]
    frames_lost: int
    damage: str | None

    @staticmethod
    def open(path: str | Path) -> Session:
        """Reads a session without its depth images.

        A file that was cut off or damaged gives the frames before the damage; ``damage`` and
        ``frames_lost`` say so. Every frame is checked against its checksum.

        Raises:
            RecordingError: The file is missing, no session, of another layout, or damaged before its first
                frame.
        """
        path = Path(path)
        found = read_columns(path, lambda entity: entity != layout.BONES)
        about = checked_properties(path, found)
        name = about["session"]["body"][0]
        if name not in BODIES:
            raise RecordingError(f"{path} is of an unknown body {name!r}. Known: {', '.join(BODIES)}.")
        calibrations, residuals = calibrations_of(path, BODIES[name], found)
        rows, checks, lost = frames_of(BODIES[name], calibrations, found)
        used = [number < max(len(rows), 1) for number, _ in calibrations]
        calibrations = [c for c, use in zip(calibrations, used, strict=True) if use]
        about["calibration"] = {"residual_median": [residuals[len(calibrations) - 1]]}
        damage = found.damage
        end = about.get("end", {}).get("frames")
        if end is None:
            damage = damage or "it was not ended"
        elif int(end[0]) != len(rows) or lost:
            lost = max(lost, int(end[0]) - len(rows))
            damage = damage or f"frame {len(rows)} does not match its checksum or is missing"
        if len(rows) == 0:
            raise RecordingError(
                f"{path} has no whole frame" + (f": {damage}." if damage else "; nothing was recorded.")
            )
        session, cameras = about["session"], about["intrinsics"]
        return Session(
            path=path,
            rows=rows,
            settings=settings_of(about["settings"]),
            calibrations=tuple(calibrations),
            intrinsics_a=camera_of(cameras["a"]),
            intrinsics_b=camera_of(cameras["b"]),
            sources=(str(session["source_a"][0]), str(session["source_b"][0])),
            about=about,
            events=events_of(found),
            fused_checksums=checks,
            frames_lost=lost,
            damage=damage,
        )

    def __len__(self) -> int:
        """The number of frames T."""
        return len(self.rows)

    @property
    def body(self) -> Body:
        """Which joints these are."""
        return self.rows.body

    @property
    def calibration(self) -> Calibration:
        """R, t and the bone lengths, the last where there were several; without its ``registration``."""
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
    def calibration_residual(self) -> float:
        """Metres by which the two views differed (median) when they were registered; NaN where not known."""
        return float(self.about["calibration"].get("residual_median", [np.nan])[0])

    def depth_count(self, side: str) -> int:
        """How many depth images of a sensor the session has."""
        with RrdFile(self.path) as file:
            return sum(1 for _ in _images(file, layout.depth(side)))

    def fusers(self, settings: FuserSettings | None = None) -> Iterator[tuple[Fuser, slice]]:
        """The fuser of each calibration as it was before its first frame, and which frames are its own.

        Args:
            settings: To fuse with; the session's own where None.
        """
        firsts = [number for number, _ in self.calibrations]
        for (first, calibration), end in zip(self.calibrations, [*firsts[1:], len(self)], strict=True):
            settings = settings or self.settings
            yield Fuser(calibration, settings, self.intrinsics_a, self.intrinsics_b), slice(first, end)

    def pairs(self, depth: bool = False) -> Iterator[FramePair]:
        """The pairs as the sensors gave them: a session is a source like any other.

        Args:
            depth: With the depth images the session has.
        """
        images = {side: self.depth(side) if depth else iter(()) for side in layout.SIDES}
        ahead = {side: next(images[side], None) for side in layout.SIDES}
        rows = self.rows
        for t in range(len(rows)):
            seen: dict[str, NDArray[np.uint16]] = {}
            for side in layout.SIDES:
                image = ahead[side]
                if image is not None and image[0] == t:
                    seen[side] = image[1]
                    ahead[side] = next(images[side], None)
            yield FramePair(
                _sensor_frame(
                    self.body, rows.clock_a[t], rows.positions_a[t], rows.states_a[t], seen.get("a")
                ),
                _sensor_frame(
                    self.body, rows.clock_b[t], rows.positions_b[t], rows.states_b[t], seen.get("b")
                ),
                PERSON,
                PERSON,
                int(rows.time_ns[t]),
                int(rows.skew_ns[t]),
            )

    def depth(self, side: str) -> Iterator[tuple[int, NDArray[np.uint16]]]:
        """Depth images of a sensor, read as they are asked for.

        Args:
            side: ``a`` or ``b``.

        Yields:
            The frame's number and its (height, width) millimetres, 0 without a reading.

        Raises:
            RecordingError: An image is damaged; those before it were given.
        """
        with RrdFile(self.path) as file:
            for frame, blob, check in _images(file, layout.depth(side)):
                if check != image_checksum(frame, blob):
                    raise RecordingError(f"{self.path}: the depth image of frame {frame} is damaged.")
                if frame < len(self):
                    yield frame, decode_depth(blob)

    def color(self, side: str) -> Iterator[tuple[int, ColorImage]]:
        """Colour images of a sensor, as :meth:`depth` gives depth images."""
        return ((frame, image) for frame, image in read_color(self.path, side) if frame < len(self))


def _images(file: RrdFile, entity: str) -> Iterator[tuple[int, bytes, int | None]]:
    for of, batch in file.chunks(images=True):
        names = batch.schema.names
        if of != entity or layout.FRAME not in names or _BLOB not in names:
            continue
        checks = batch.column("crc32") if "crc32" in names else None
        for k, frame in enumerate(batch.column(layout.FRAME).to_pylist()):
            cell, check = batch.column(_BLOB)[k].values, None if checks is None else checks[k].as_py()
            if not cell or not cell[0].is_valid or not check:
                raise RecordingError(f"{entity[1:]}: the depth image of frame {frame} is damaged.")
            yield frame, cell[0].values.to_numpy().tobytes(), check[0]


def _sensor_frame(
    body: Body,
    clock: np.int64,
    positions: NDArray[np.float32],
    states: NDArray[np.uint8],
    depth: NDArray[np.uint16] | None,
) -> SensorFrame | None:
    if clock == layout.NO_FRAME:
        return None
    people = {PERSON: Skeleton.of(body, positions, states, int(clock))} if states.any() else {}
    return SensorFrame(int(clock), people, depth)
