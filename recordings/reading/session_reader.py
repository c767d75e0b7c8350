"""Builds a session from the checked content of its file."""

from __future__ import annotations

from pathlib import Path

from fusion.body import BODIES
from recordings import layout
from recordings.errors import RecordingError
from recordings.images.session_images import FileImages
from recordings.reading.rrd_file import read_columns
from recordings.reading.stored_frames import frames_of
from recordings.reading.stored_settings import (
    calibrations_of,
    camera_of,
    checked_properties,
    events_of,
    settings_of,
)
from recordings.session import Session


def read_session(path: Path) -> Session:
    """Reads a session; see :meth:`recordings.session.Session.open`."""
    found = read_columns(path, lambda entity: entity != layout.BONES)
    about = checked_properties(path, found)
    name = about["session"]["body"][0]
    if name not in BODIES:
        raise RecordingError(f"{path} has an unknown body {name!r}. Known: {', '.join(BODIES)}.")
    calibrations = calibrations_of(path, BODIES[name], found)
    rows, checks, lost = frames_of(BODIES[name], calibrations, found)
    used = [number < max(len(rows), 1) for number, _ in calibrations]
    calibrations = [c for c, use in zip(calibrations, used, strict=True) if use]
    events = events_of(found)
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
        events=events,
        fused_checksums=checks[0],
        joint_digests=checks[1],
        frames_lost=lost,
        damage=damage,
        images=FileImages(path),
    )
