"""Reads a session from its file: checks its content, and takes the frames before the first damaged one."""

from collections.abc import Iterable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.events import Event, Phase
from fusion.body import BODIES, Body
from fusion.calibration.calibration import Calibration
from fusion.errors import FusionError
from fusion.intrinsics import Intrinsics
from fusion.registration.rigid_fit import Registration
from fusion.rigid import NOWHERE, RigidTransform
from fusion.setup import FuserSettings
from fusion.support.large_arrays import parts
from recordings.data import layout
from recordings.data.checksums import (
    CHECKS_CRC,
    FRAME_CRC,
    checks_checksums,
    event_checksum,
    frame_checksums,
    properties_checksum,
)
from recordings.data.frame_fields import FrameField
from recordings.data.session_arrays import FRAME_FIELDS, SessionArrays
from recordings.data.session_data import OF_DAMAGED, SessionData
from recordings.errors import RecordingError
from recordings.file.rrd_file import Columns, read_columns
from recordings.file.stored_images import FileImages

_TIME, _FRAME_CRC, _CHECKS_CRC = ((layout.QUALITY, of) for of in (layout.TIME, FRAME_CRC, CHECKS_CRC))
_WANTED = {(spec.entity, spec.component) for spec in FRAME_FIELDS.values()} | {_TIME, _FRAME_CRC, _CHECKS_CRC}
"""What is read; all else in a file is for the viewer."""
_PROVISIONAL = ("none yet", "provisional")
"""How descriptions of provisional calibrations begin in sessions of 1.0 and earlier."""


def read_session(path: Path) -> SessionData:
    """Reads a session; see :meth:`recordings.session.Session.open`."""
    found = read_columns(path, _WANTED)
    about = _checked_properties(path, found)
    name = about["session"]["body"][0]
    if name not in BODIES:
        raise RecordingError(f"{path} has an unknown body {name!r}. Known: {', '.join(BODIES)}.")
    calibrations = _calibrations_of(path, BODIES[name], found)
    rows, lost = _frames_of(BODIES[name], calibrations, found)
    used = [number < max(len(rows), 1) for number, _ in calibrations]
    calibrations = [c for c, use in zip(calibrations, used, strict=True) if use]
    events = _events_of(found)
    damage = found.damage
    end = about.get("end", {}).get("frames")
    if end is None:
        damage = damage or "it was not ended"
    elif int(end[0]) != len(rows) or lost:
        lost = max(lost, int(end[0]) - len(rows))
        damage = damage or f"frame {len(rows)} does not match its checksum or is missing"
    session, cameras = about["session"], about["intrinsics"]
    if "made_of_damaged" in session:
        damage = damage or f"{OF_DAMAGED}{session['made_of_damaged'][0]}"
        lost += int(session["made_without_frames"][0])
    if len(rows) == 0:
        raise RecordingError(
            f"{path} has no whole frame" + (f": {damage}." if damage else "; nothing was recorded.")
        )
    return SessionData(
        path=path,
        rows=rows,
        settings=_settings_of(about["settings"]),
        calibrations=tuple(calibrations),
        intrinsics_a=_camera_of(cameras["a"]),
        intrinsics_b=_camera_of(cameras["b"]),
        sources=(str(session["source_a"][0]), str(session["source_b"][0])),
        about=about,
        events=events,
        frames_lost=lost,
        damage=damage,
        images=FileImages(path, found.identity, found.entities),
    )


def _checked_properties(path: Path, found: Columns) -> dict[str, dict[str, list[Any]]]:
    about = found.properties
    session = about.get("session", {})
    if "layout_version" not in session:
        if found.damage is not None:
            raise RecordingError(f"{path} is damaged before its first frame: {found.damage}.")
        raise RecordingError(
            f"{path} is a Rerun recording, but not a session of duplex-kinects: its properties are missing."
        )
    version, writer = session["layout_version"], session.get("written_by", ["another version"])
    if version[0] not in layout.READABLE_VERSIONS:
        raise RecordingError(
            f"{path} has layout {version[0]}, written by {writer[0]}; this version reads layout "
            f"{', '.join(map(str, layout.READABLE_VERSIONS))}. Open it with the version that wrote it."
        )
    written = {name: of for name, of in about.items() if name not in ("check", "end", "RecordingInfo")}
    if about.get("check", {}).get("crc32") != [properties_checksum(written)]:
        raise RecordingError(
            f"{path}: the settings and calibration in it are damaged; they do not match their checksum."
        )
    return about


def _calibrations_of(path: Path, body: Body, found: Columns) -> list[tuple[int, Calibration]]:
    """Each calibration with its first frame, in order."""
    at: dict[int, Calibration] = {}
    for frame, of in found.logged.get(layout.CALIBRATION, []):
        check = of.pop("calibration_crc32", None)
        if check != [properties_checksum({"calibration": {"frame": frame, **of}})]:
            raise RecordingError(f"{path}: a calibration in it is damaged; it does not match its checksum.")
        try:
            at[frame] = _calibration_of(body, of)
        except (FusionError, LookupError, TypeError, ValueError) as fault:
            raise RecordingError(f"{path}: a calibration in it is not valid: {fault}.") from None
    if 0 not in at:
        raise RecordingError(
            f"{path}: its calibration is missing" + (f"; {found.damage}." if found.damage else ".")
        )
    return sorted(at.items())


def _calibration_of(body: Body, of: dict[str, Any]) -> Calibration:
    """Of :func:`recordings.writing.properties.calibration_values`."""

    def array(name: str, shape: tuple[int, ...], default: Any = None) -> NDArray[np.float64]:
        return np.array(of[name] if default is None else of.get(name, default), np.float64).reshape(shape)

    joints = (len(body),)
    a_from_b = RigidTransform.of(array("rotation", (3, 3)), of["translation"])
    lengths = array("bone_lengths", joints)
    registration = None
    if of["pairs"][0] > 0:
        registration = Registration(
            a_from_b,
            float(of["residual_median"][0]),
            float(of["residual_rms"][0]),
            array("joint_residuals", joints),
            float(of["rotation_sd"][0]),
            int(of["pairs"][0]),
            body,
            float(of.get("translation_sd", [np.nan])[0]),
            np.array(of.get("centre", NOWHERE)),
        )
    how = str(of["how"][0])
    provisional = of.get("provisional", [how.startswith(_PROVISIONAL)])[0]
    errors = array("depth_errors", (2,), (0.0, 0.0))
    if not np.isfinite(errors).all():
        raise ValueError(f"its depth errors are {errors}")
    person = int(of.get("person", [0])[0])
    placed = bool(of.get("placed", [True])[0])  # sessions of earlier versions used B all the same
    return Calibration(body, a_from_b, lengths, how, registration, bool(provisional), errors, person, placed)


def _settings_of(of: dict[str, list[Any]]) -> FuserSettings:
    """The settings of a session. Version 0.1 had only the paper's method, with two solvers for the bones."""
    if "solver" in of:
        method = "published" if of["solver"][0] == "paper" else "paper"
        of = {"method": [method], **{name: value for name, value in of.items() if name != "solver"}}
    known = {f.name for f in fields(FuserSettings)}
    strangers = sorted(set(of) - known)
    if strangers:
        raise RecordingError(f"The session was made with settings unknown here: {', '.join(strangers)}.")
    try:
        return FuserSettings(**{name: value[0] for name, value in of.items()})
    except FusionError as error:
        raise RecordingError(f"The session's settings are not valid: {error}") from None


def _camera_of(values: list[float]) -> Intrinsics:
    width, height, fx, fy, cx, cy, *distortion = values
    return Intrinsics(int(width), int(height), fx, fy, cx, cy, tuple(distortion))


def _events_of(found: Columns) -> tuple[Event, ...]:
    events = []
    for frame, time, row in found.texts:
        names = "TextLog:text", "TextLog:level", "crc32", "topic", "phase"
        text, level, check, topic, phase = ((row.get(name) or [None])[0] for name in names)
        known: Phase = "start" if phase == "start" else "end" if phase == "end" else "moment"
        event = Event(text, level, str(topic or ""), known, frame or 0, time or 0)
        complete = frame is not None and time is not None and isinstance(text, str)
        if complete and check == event_checksum(event):
            events.append(event)
        else:
            found.damage = found.damage or "an event does not match its checksum"
    return tuple(events)


def _frames_of(
    body: Body, calibrations: list[tuple[int, Calibration]], found: Columns
) -> tuple[SessionArrays, int]:
    """The frames before the first missing or damaged one, and the number of lost frames."""
    groups = _groups(found)
    stored: dict[tuple[str, str], tuple[int, type[np.generic]]] = {
        key: (sum(spec.width(body) for spec in specs), specs[0].stored) for key, specs in groups.items()
    }
    stored |= {_TIME: (1, np.int64), _FRAME_CRC: (1, np.uint32)}
    if _CHECKS_CRC in found.values:  # sessions of 1.0 and earlier have none
        stored[_CHECKS_CRC] = (1, np.uint32)
    optional = [key for key, specs in groups.items() if specs[0].optional]
    places: list[NDArray[np.int64]] = []

    def column(key: tuple[str, str], count: int | None = None) -> tuple[NDArray[Any], NDArray[np.int64]]:
        values, at = _column(found, key, *stored[key], count)
        same = next((other for other in places if np.array_equal(other, at)), None)
        if same is None:  # usually all have one order, which takes memory once
            places.append(at)
        return values, at if same is None else same

    columns = {key: column(key) for key in stored if key not in optional}
    counts = [int(np.append(at < 0, True).argmax()) for _, at in columns.values()]
    written, n = max(counts), min(counts)
    columns |= {key: column(key, n) for key in optional}
    has = np.array([columns[key][1] >= 0 for key in optional]).reshape(len(optional), n)
    changes = 1 + np.flatnonzero((has[:, 1:] != has[:, :-1]).any(axis=0))

    def whole_frames() -> Iterator[SessionArrays]:
        for part in _split(parts(n), changes.tolist()) if n else [slice(0, 0)]:
            present = {key: of for key, of in columns.items() if (of[1][part] >= 0).all()}
            of_part = {key: values[at[part]] for key, (values, at) in present.items()}
            figures: dict[str, Any] = {}
            with np.errstate(invalid="ignore"):  # damaged numbers are detected below
                for key in groups.keys() & of_part.keys():
                    column = 0
                    for spec in groups[key]:
                        width = spec.width(body)
                        figures[spec.name] = spec.from_file(body, of_part[key][:, column : column + width])
                        column += width
            number = np.arange(part.start, part.stop)
            targets = _targets(calibrations, number)
            rows = SessionArrays(body, targets, number, of_part[_TIME][:, 0], **figures)
            if n:
                fits = frame_checksums(rows) == of_part[_FRAME_CRC][:, 0]
                if _CHECKS_CRC in stored:
                    fits &= checks_checksums(rows) == of_part[_CHECKS_CRC][:, 0]
                rows = rows[: int(np.argmin(np.append(fits, False)))]
            yield rows
            if len(rows) < len(number):
                return

    whole = SessionArrays.joined(whole_frames())
    return whole, written - len(whole)


def _groups(found: Columns) -> dict[tuple[str, str], list[FrameField]]:
    """The figures by component, in storage order; without figures that the file lacks."""
    groups: dict[tuple[str, str], list[FrameField]] = {}
    for spec in FRAME_FIELDS.values():
        key = spec.entity, spec.component
        if not spec.optional or key in found.values:
            groups.setdefault(key, []).append(spec)
    return groups


def _column(
    found: Columns, key: tuple[str, str], width: int, kind: type[np.generic], count: int | None = None
) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """(N, width) values, and where those of frames 0, 1, … are; -1 for a frame that has none.

    Args:
        count: Of the frames; None: as many as there can be without a gap.
    """
    frames, values = found.values.get(key, (np.empty(0, np.int64), np.empty((0, width), kind)))
    if values.dtype != kind or values.size != len(frames) * width:
        frames, values = frames[:0], np.empty((0, width), kind)
    at = np.full(len(frames) if count is None else count, -1)
    known = np.flatnonzero((frames >= 0) & (frames < len(at)))
    at[frames[known]] = known
    return values.reshape(len(frames), width), at


def _split(every: Iterable[slice], at: list[int]) -> Iterator[slice]:
    """The parts, of which none has one of some frames within it: each of those begins one."""
    for part in every:
        bounds = [part.start, *(k for k in at if part.start < k < part.stop), part.stop]
        yield from map(slice, bounds, bounds[1:])


def _targets(calibrations: list[tuple[int, Calibration]], number: NDArray[np.int64]) -> NDArray[np.float64]:
    """(T, J) bone lengths used for the fusion of each frame."""
    firsts = [first for first, _ in calibrations]
    lengths = np.array([calibration.bone_lengths for _, calibration in calibrations])
    return np.asarray(lengths[np.searchsorted(firsts, number, side="right") - 1])
