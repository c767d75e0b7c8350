"""Checked content of a session's file besides frames: properties, settings, calibrations and events."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.errors import FusionError
from fusion.intrinsics import Intrinsics
from fusion.registration.rigid_fit import Registration
from fusion.rigid import RigidTransform
from fusion.setup import FuserSettings
from recordings import layout
from recordings.errors import RecordingError
from recordings.events import Event, Phase
from recordings.reading.rrd_file import Columns
from recordings.writing.checksums import event_checksum, properties_checksum


def checked_properties(path: Path, found: Columns) -> dict[str, dict[str, list[Any]]]:
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


def calibrations_of(path: Path, body: Body, found: Columns) -> list[tuple[int, Calibration]]:
    """Each calibration with its first frame, in order."""
    at: dict[int, Calibration] = {}
    for frame, of in found.logged.get(layout.CALIBRATION, []):
        check = of.pop("calibration_crc32", None)
        if check != [properties_checksum({"calibration": {"frame": frame, **of}})]:
            raise RecordingError(f"{path}: a calibration in it is damaged; it does not match its checksum.")
        a_from_b = RigidTransform.of(np.reshape(of["rotation"], (3, 3)), of["translation"])
        lengths = np.array(of["bone_lengths"], dtype=np.float64)
        registration = None
        if of["pairs"][0] > 0:
            registration = Registration(
                a_from_b,
                float(of["residual_median"][0]),
                float(of["residual_rms"][0]),
                np.array(of["joint_residuals"], dtype=np.float64),
                float(of["rotation_sd"][0]),
                int(of["pairs"][0]),
                body,
            )
        at[frame] = Calibration(body, a_from_b, lengths, str(of["how"][0]), registration)
    if 0 not in at:
        raise RecordingError(
            f"{path}: its calibration is missing" + (f"; {found.damage}." if found.damage else ".")
        )
    return sorted(at.items())


def settings_of(of: dict[str, list[Any]]) -> FuserSettings:
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


def camera_of(values: list[float]) -> Intrinsics:
    width, height, fx, fy, cx, cy, *distortion = values
    return Intrinsics(int(width), int(height), fx, fy, cx, cy, tuple(distortion))


def events_of(found: Columns) -> tuple[Event, ...]:
    events = []
    for frame, time, row in found.texts:
        names = "TextLog:text", "TextLog:level", "crc32", "topic", "phase"
        text, level, check, topic, phase = ((row.get(name) or [None])[0] for name in names)
        spell = () if phase in (None, "moment") else (str(topic), str(phase))
        if (
            frame is not None
            and time is not None
            and isinstance(text, str)
            and check == event_checksum((frame, time), text, str(level), *spell)
        ):
            known: Phase = "start" if phase == "start" else "end" if phase == "end" else "moment"
            events.append(Event(frame, time, text, str(level), str(topic or ""), known))
        else:
            found.damage = found.damage or "an event does not match its checksum"
    return tuple(events)
