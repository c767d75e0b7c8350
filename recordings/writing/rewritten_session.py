"""A session written anew: trimmed, or in larger blocks. Frames stay as they are, nothing is fused again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import rerun as rr

from recordings import layout
from recordings.errors import RecordingError
from recordings.reading.rrd_file import damage_of
from recordings.session import Session
from recordings.writing.recorder import Recorder

_BLOCK = 2048
_FLUSH_WITHIN = 60.0


def rewrite(
    session: Session, path: Path, blueprint: Any = None, first: int = 0, end: int | None = None
) -> int:
    """Writes frames `first` up to, without, `end` of a session into a new file.

    The new session's frames count from 0 and its time starts with them; ``first_frame`` among its properties
    keeps where they came from.

    Returns:
        How many damaged images were left out.

    Raises:
        RecordingError: There is no such frame.
        OSError: The file is not whole afterwards.
    """
    end = len(session) if end is None else min(end, len(session))
    if not 0 <= first < end:
        raise RecordingError(f"{session.path} has {len(session)} frames; none from {first} to {end}.")
    about: dict[str, str | int] = {"first_frame": session.first_frame + first}
    stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4())
    stream.set_sinks(rr.FileSink(str(path)))
    if blueprint is not None:
        stream.send_blueprint(blueprint)
    try:
        segments = [(setup, own) for setup, own in session.setups() if own.stop > first and own.start < end]
        recorder = Recorder(stream, segments[0][0], session.sources, about=about)
        start_ns = int(session.rows.time_ns[first])
        for setup, own in segments:
            if own.start > first:
                recorder.recalibrated(setup)
            stop = min(own.stop, end)
            for begin in range(max(own.start, first), stop, _BLOCK):
                block = slice(begin, min(begin + _BLOCK, stop))
                rows = session.rows[block]
                rows = replace(rows, frame=rows.frame - first, time_ns=rows.time_ns - start_ns)
                recorder.record_rows(rows, (session.fused_checksums[block], session.joint_digests[block]))
        damaged = copy_images(session, recorder, first, end)
        kept = [e for e in session.events if e.frame is not None and first <= e.frame < end]
        if segments[0][1].start < first:  # what it was calibrated on was said before
            recorder.event(f"calibrated: {segments[0][0].calibration.how}", at=(0, 0))
        for event in kept:
            if event.frame is not None and event.time_ns is not None:
                recorder.event(event.text, event.level, (event.frame - first, event.time_ns - start_ns))
        recorder.finish()
        stream.flush(timeout_sec=_FLUSH_WITHIN)
    finally:
        stream.disconnect()
    check_whole(path)
    return damaged


def copy_images(session: Session, recorder: Recorder, first: int, end: int) -> int:
    """Logs the images of frames `first` up to, without, `end`, which are to count from 0.

    Returns:
        How many were damaged and left out.
    """
    damaged = 0
    time_ns = (session.time_ns - session.time_ns[first]).tolist()
    for side in layout.SIDES:
        depth, color = session.depth(side, first, end), session.color(side, first, end)
        for frame, image in depth:
            recorder.record_depth(side, frame - first, time_ns[frame], image)
        for frame, picture in color:
            recorder.record_color(side, frame - first, time_ns[frame], picture)
        damaged += depth.damaged + color.damaged
    return damaged


def check_whole(path: Path) -> None:
    """Finds out whether everything that was logged has reached the file.

    Raises:
        OSError: It has not; the disk is full, as a rule.
    """
    try:
        damage = damage_of(path)
    except RecordingError as error:
        raise OSError(str(error)) from None
    if damage is not None:
        raise OSError(f"{damage}; the disk may be full")
