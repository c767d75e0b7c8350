"""A session read back as arrays: ``Session.open("walk.rrd").fused[100]`` in a notebook as in a test."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.pairing import FramePair
from devices.sensor import ColorImage, SensorFrame
from fusion.body import BODIES, Body
from fusion.calibration import Calibration
from fusion.errors import FusionError
from fusion.fuser import Fuser, FuserSettings
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton
from fusion.viewing_plane import Intrinsics
from recordings import layout
from recordings.arrays import SessionArrays
from recordings.checksums import frame_checksums, image_checksum, properties_checksum, text_checksum
from recordings.color import read_color
from recordings.errors import RecordingError
from recordings.rrd_file import Columns, RrdFile, read_columns
from recordings.rvl import decode_depth

_BLOB = "EncodedDepthImage:blob"
PERSON = "0"
"""The id of the one person of a session, as a source of pairs."""


@dataclass(frozen=True)
class Event:
    """What happened.

    Attributes:
        frame: The frame it happened at; None where it happened before the first.
        time_ns: Since the first pair; None likewise.
        text: What.
        level: INFO, WARN or ERROR.
    """

    frame: int | None
    time_ns: int | None
    text: str
    level: str


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
        found = read_columns(path, lambda entity: not entity.startswith("/bones/"))
        about = _checked_properties(path, found)
        name = about["session"]["body"][0]
        if name not in BODIES:
            raise RecordingError(f"{path} is of an unknown body {name!r}. Known: {', '.join(BODIES)}.")
        calibrations, residuals = _calibrations(path, BODIES[name], found)
        rows, checks, lost = _frames(BODIES[name], calibrations[-1][1].bone_lengths, found)
        used = [number < max(len(rows), 1) for number, _ in calibrations]
        calibrations = [c for c, use in zip(calibrations, used, strict=True) if use]
        about["calibration"] = {"residual_median": [residuals[len(calibrations) - 1]]}
        rows = replace(rows, bone_lengths=calibrations[-1][1].bone_lengths)
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
            settings=_settings(about["settings"]),
            calibrations=tuple(calibrations),
            intrinsics_a=_camera(cameras["a"]),
            intrinsics_b=_camera(cameras["b"]),
            sources=(str(session["source_a"][0]), str(session["source_b"][0])),
            about=about,
            events=_events(found),
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


def _checked_properties(path: Path, found: Columns) -> dict[str, dict[str, list[Any]]]:
    about = found.properties
    session = about.get("session", {})
    if "layout_version" not in session:
        if found.damage is not None:
            raise RecordingError(f"{path} is damaged before its first frame: {found.damage}.")
        raise RecordingError(
            f"{path} is a Rerun recording, but no session of duplex-kinects: its properties are missing."
        )
    version, writer = session["layout_version"], session.get("written_by", ["another version"])
    if version != [layout.VERSION]:
        raise RecordingError(
            f"{path} has layout {version[0]}, written by {writer[0]}; this version reads layout "
            f"{layout.VERSION}. Open it with the version that wrote it."
        )
    written = {name: of for name, of in about.items() if name not in ("check", "end", "RecordingInfo")}
    if about.get("check", {}).get("crc32") != [properties_checksum(written)]:
        raise RecordingError(
            f"{path}: the settings and calibration in it are damaged; they do not match their checksum."
        )
    return about


def _calibrations(
    path: Path, body: Body, found: Columns
) -> tuple[list[tuple[int, Calibration]], list[float]]:
    """Each with the frame it begins at, in order, and how far apart the views were (median)."""
    at: dict[int, tuple[Calibration, float]] = {}
    for frame, of in found.logged.get(layout.CALIBRATION, []):
        check = of.pop("calibration_crc32", None)
        if check != [properties_checksum({"calibration": {"frame": frame, **of}})]:
            raise RecordingError(f"{path}: a calibration in it is damaged; it does not match its checksum.")
        a_from_b = RigidTransform.of(np.reshape(of["rotation"], (3, 3)), of["translation"])
        lengths = np.array(of["bone_lengths"], dtype=np.float64)
        at[frame] = Calibration(body, a_from_b, lengths, str(of["how"][0])), float(of["residual_median"][0])
    if 0 not in at:
        raise RecordingError(
            f"{path}: its calibration is missing" + (f"; {found.damage}." if found.damage else ".")
        )
    ordered = sorted(at.items())
    return [(frame, calibration) for frame, (calibration, _) in ordered], [r for _, (_, r) in ordered]


def _settings(of: dict[str, list[Any]]) -> FuserSettings:
    known = {f.name for f in fields(FuserSettings)}
    strangers = sorted(set(of) - known)
    if strangers:
        raise RecordingError(f"The session was made with settings unknown here: {', '.join(strangers)}.")
    try:
        return FuserSettings(**{name: value[0] for name, value in of.items()})
    except FusionError as error:
        raise RecordingError(f"The session's settings cannot be followed: {error}") from None


def _camera(values: list[float]) -> Intrinsics:
    width, height, fx, fy, cx, cy, *distortion = values
    return Intrinsics(int(width), int(height), fx, fy, cx, cy, tuple(distortion))


def _events(found: Columns) -> tuple[Event, ...]:
    events = []
    for frame, time, row in found.texts:
        text, level, check = (row.get(k) or [None] for k in ("TextLog:text", "TextLog:level", "crc32"))
        if isinstance(text[0], str) and check[0] == text_checksum(text[0], str(level[0])):
            events.append(Event(frame, time, text[0], str(level[0])))
    return tuple(events)


def _frames(
    body: Body, bone_lengths: NDArray[np.float64], found: Columns
) -> tuple[SessionArrays, NDArray[np.uint32], int]:
    """The frames before the first that is missing or damaged, their S* checksums, how many are lost."""
    J = len(body)
    stored: dict[str, tuple[tuple[str, str], tuple[int, ...], Any]] = {
        "time_ns": ((layout.CHECKS, layout.TIME), (), np.int64),
        "checks": ((layout.CHECKS, "frame_crc32"), (2,), np.uint32),
        "placement": ((layout.PLACEMENT, "rotation_translation"), (12,), np.float64),
        "fused": ((layout.FUSED_SKELETON, "Points3D:positions"), (J, 3), np.float32),
        "predicted": ((layout.FUSED_TRUST, "predicted"), (J,), np.bool_),
        "misleading": ((layout.FUSED_TRUST, "misleading"), (J,), np.int32),
        "iterations": ((layout.quality("iterations"), "Scalars:scalars"), (1,), np.float64),
        "skew_ms": ((layout.quality("skew_ms"), "Scalars:scalars"), (1,), np.float64),
        "fuse_ms": ((layout.quality("fuse_ms"), "Scalars:scalars"), (1,), np.float64),
        "stale": ((layout.quality("stale"), "Scalars:scalars"), (2,), np.float64),
    }
    for side in layout.SIDES:
        stored |= {
            f"positions_{side}": ((layout.skeleton(side), "Points3D:positions"), (J, 3), np.float32),
            f"states_{side}": ((layout.states(side), "state"), (J,), np.uint8),
            f"weights_{side}": ((layout.weights(side), "Scalars:scalars"), (J,), np.float64),
            f"clock_{side}": ((layout.clock(side), "captured_ns"), (1,), np.int64),
        }
    truth = (layout.TRUTH_SKELETON, "Points3D:positions")
    if truth in found.values:
        stored["truth"] = (truth, (J, 3), np.float32)
    written = 0
    whole: int | None = None
    at: dict[str, NDArray[Any]] = {}
    for name, (key, shape, kind) in stored.items():
        frames, values = found.values.get(key, (np.empty(0, np.int64), np.empty((0, *shape), kind)))
        if values.shape[1:] != shape or values.dtype != kind:
            frames, values = frames[:0], np.empty((0, *shape), kind)
        order = np.argsort(frames, kind="stable")
        frames = frames[order]
        count = int(np.argmin(np.concatenate([frames, [-1]]) == np.arange(len(frames) + 1)))
        written = max(written, count)
        whole = count if whole is None else min(whole, count)
        at[name] = values[order]
    n = whole or 0
    at = {name: values[:n] for name, values in at.items()}
    with np.errstate(invalid="ignore"):  # damaged numbers are found below
        rows = SessionArrays(
            body=body,
            bone_lengths=bone_lengths,
            frame=np.arange(n),
            time_ns=at["time_ns"],
            skew_ns=np.rint(at["skew_ms"][:, 0] * 1e6).astype(np.int64),
            clock_a=at["clock_a"][:, 0],
            clock_b=at["clock_b"][:, 0],
            positions_a=at["positions_a"],
            positions_b=at["positions_b"],
            states_a=at["states_a"],
            states_b=at["states_b"],
            weights_a=at["weights_a"].astype(np.float32),
            weights_b=at["weights_b"].astype(np.float32),
            misleading=at["misleading"],
            rotation=at["placement"][:, :9].reshape(-1, 3, 3),
            translation=at["placement"][:, 9:],
            fused=at["fused"].astype(np.float64),
            predicted=at["predicted"],
            iterations=at["iterations"][:, 0].astype(np.int64),
            stale_a=at["stale"][:, 0] != 0.0,
            stale_b=at["stale"][:, 1] != 0.0,
            fuse_ms=at["fuse_ms"][:, 0],
            truth=at["truth"].astype(np.float64) if "truth" in at else None,
        )
    if n:
        fits = frame_checksums(rows) == at["checks"][:, 0]
        n = int(np.argmin(np.append(fits, False)))
    return rows[:n], at["checks"][:n, 1], written - n
