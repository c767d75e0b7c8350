"""Writes a complete session to a file: a fused, replayed or trimmed session, or one in a test.

:mod:`recordings.file.growing_file` writes a session that is still running. Frames are copied unchanged;
nothing is fused again.
"""

from __future__ import annotations

import errno
import os
import shutil
import sys
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import pyarrow as pa
import rerun as rr
import rerun_bindings

from devices.arrow_numbers import numbers_of
from devices.output_file import whole_file
from fusion.support.large_arrays import parts
from fusion.support.progress import Progress, quietly
from recordings.appearance.coach_page import CoachPage
from recordings.data import layout
from recordings.data.session_data import OF_DAMAGED, SessionData
from recordings.errors import RecordingError
from recordings.file.rrd_file import RrdFile, damage_of
from recordings.writing.changes import log_quality
from recordings.writing.recorder import Recorder

_BLOCK, _MOST_BLOCKS = 1200, 256
"""Frames per write: a file that is cut off loses at most forty seconds more than what is missing.
One of more than 3 hours loses more: Rerun keeps 0.4 MB of each block until the file is complete, and
7 kB of each frame while it writes a block."""
_FLUSH_WITHIN = 60  # seconds
_FULL = 65_536  # bytes: with less space, a disk is full
LEFT_AFTER = 2.0
"""Seconds to wait for a stream whose file may have failed."""


def write_session(
    session: SessionData,
    path: Path,
    *,
    blueprint: Any = None,
    page: CoachPage | None = None,
    block: int = _BLOCK,
    progress: Progress = quietly,
) -> int:
    """Writes a session to a file, which may be the session's own.

    Args:
        path: The file; replaced once the new one is whole.

    Returns:
        The number of damaged images, or frames of other people, that were skipped.

    Raises:
        OSError: The file could not be written completely.
    """
    about = session.origin | {
        "first_frame": session.first_frame,
        "method_revision": session.method_revision,
    }
    if session.damage is not None:
        first_damage = session.damage.removeprefix(OF_DAMAGED)
        about |= {"made_of_damaged": first_damage, "made_without_frames": session.frames_lost}
    with whole_recording(path, blueprint, recording_id=_kept_id(session, path)) as stream:
        segments = list(session.setups())
        recorder = Recorder(stream, segments[0][0], session.sources, about=about)
        if page is not None:  # before the frames, so that it is seen from the beginning
            recorder.coach(page)
        events = deque(sorted(session.events, key=lambda event: event.frame))
        for setup, own in segments:
            if own.start > 0:
                recorder.recalibrated(setup)
            size, count = max(block, len(session) // _MOST_BLOCKS), own.stop - own.start
            for part in progress(parts(count, size), "writing", -(-count // size)):
                part = slice(own.start + part.start, own.start + part.stop)
                recorder.record_rows(session.rows[part])
                # with their frames: a file that is cut off keeps the events up to the cut
                # the last ones may be of frames that a damaged session has lost
                while events and (events[0].frame < part.stop or part.stop == len(session)):
                    recorder.event(events.popleft(), placed=True)
                _flush(stream, path)  # else all that a slow disk has not yet written would be in memory
        log_quality(stream, session)
        damaged = _copy_images(session, recorder)
        _copy_logged(session, stream, without=None if page is None else layout.COACH)
        recorder.finish()
    return damaged


def _kept_id(session: SessionData, path: Path) -> str | None:
    """The recording's id if a session replaces its own file, so that its images are still found there."""
    if session.path is None or not path.exists() or not path.samefile(session.path):
        return None
    with RrdFile(path) as file:
        identity = file.identity()
    return None if identity is None else identity[1]


@contextmanager
def whole_recording(
    path: Path,
    blueprint: Any = None,
    application: str = layout.APPLICATION_ID,
    recording_id: str | None = None,
) -> Iterator[rr.RecordingStream]:
    """A recording stream to a file, which has its name when the block has ended without error.

    Until then a file of that name stays as it is.

    Raises:
        OSError: The file cannot be created, or some logged data did not reach the file, usually because
            the disk is full.
    """
    with (
        whole_file(path, overwrite=True) as hidden,
        _recording_to(hidden, application, recording_id) as stream,
    ):
        yield stream
        if blueprint is not None:
            # The timeline of the blueprint must exist: what was logged comes first in the file.
            _flush(stream, hidden)
            _send_blueprint(stream, blueprint)


@contextmanager
def _recording_to(path: Path, application: str, recording_id: str | None) -> Iterator[rr.RecordingStream]:
    _free_dropped_streams()  # of earlier files: this one is still referred to when it is complete
    stream = rr.RecordingStream(application, recording_id=recording_id or uuid4())
    try:
        stream.set_sinks(rr.FileSink(str(path)))
    except RuntimeError as error:  # Rerun's, for a folder in which no file can be created
        raise OSError(f"{path} cannot be created") from error
    try:
        yield stream
        _flush(stream, path)
        disconnect(stream, _FLUSH_WITHIN)
        check_whole(path)
    except RuntimeError as error:
        # Rerun's, once its thread could not write
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from error
    finally:
        if sys.exception() is not None:
            disconnect(stream, LEFT_AFTER)


def _flush(stream: rr.RecordingStream, path: Path) -> None:
    """Waits until all logged data is in the file.

    Raises:
        OSError: The disk is full: Rerun's thread has then ended and a longer wait would be in vain.
        TimeoutError: The disk is too slow.
    """
    for tries in range(_FLUSH_WITHIN):
        try:
            stream.flush(timeout_sec=1.0)
            return
        except TimeoutError:
            if shutil.disk_usage(path.parent).free < _FULL:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from None
            if tries == _FLUSH_WITHIN - 1:
                raise


def disconnect(stream: rr.RecordingStream, within: float) -> None:
    """Disconnects a stream; leaves it behind where Rerun waits for ever, as after a failed write."""
    waiting = threading.Thread(target=stream.disconnect, daemon=True)
    waiting.start()
    waiting.join(within)
    if waiting.is_alive():
        _LEFT_BEHIND.append(stream)
        rr.unregister_shutdown()  # at exit it would wait for this stream, too


def check_whole(path: Path) -> None:
    """Checks that all logged data has reached the file.

    Raises:
        OSError: Some data is missing, usually because the disk is full.
    """
    try:
        damage = damage_of(path)
    except RecordingError as error:
        raise OSError(str(error)) from None
    if damage is not None:
        raise OSError(f"{damage}; the disk may be full")


def _copy_images(session: SessionData, recorder: Recorder) -> int:
    """Logs the other people and the images; returns the number of damaged ones."""
    damaged, time_ns = 0, session.rows.time_ns
    for side in layout.VIEWS:
        others = session.images.others(side, range(len(session)))
        recorder.others.all_bones(side, ((frame, int(time_ns[frame]), bones) for frame, bones in others))
        depth, color = session.depth(side), session.color(side)
        for frame, image in depth:
            recorder.images.depth(side, frame, int(time_ns[frame]), image)
        for frame, picture in color:
            recorder.images.color(side, frame, int(time_ns[frame]), picture)
        damaged += others.damaged + depth.damaged + color.damaged
    return damaged


def _copy_logged(session: SessionData, stream: rr.RecordingStream, without: str | None) -> None:
    """Logs again what was logged beside the frames, at the frames' times; not an entity and those below."""
    for entity, batch in session.images.logged():
        if without is not None and entity.startswith(without):
            continue
        if layout.FRAME in batch.schema.names:
            frames = numbers_of(batch.column(layout.FRAME))
            there = (frames >= 0) & (frames < len(session))
            times = pa.array(session.rows.time_ns[frames[there]].astype("m8[ns]"))
            at = batch.schema.get_field_index(layout.TIME)
            batch = batch.filter(pa.array(there)).set_column(at, batch.schema.field(at), times)
        if batch.num_rows:
            stream.send_record_batch(batch)


# Rerun keeps two threads and the buffers of each stream, together 1 to 4 MB, until it looks for streams to
# which the program no longer refers. Only ``rr.init`` does that. ``RecordingStream.send_blueprint`` makes
# another stream, which is never disconnected and therefore never freed. The functions below call the same
# internal functions of Rerun as these two, which is safe while ``pyproject.toml`` pins Rerun's minor version.


_LEFT_BEHIND: list[rr.RecordingStream] = []


def _free_dropped_streams() -> None:
    """Frees all disconnected streams to which the program no longer refers.

    Rerun looks at all streams for that, and would wait for ever for one that was left behind.
    """
    if not _LEFT_BEHIND:
        rerun_bindings.flush_and_cleanup_orphaned_recordings()


def _send_blueprint(stream: rr.RecordingStream, blueprint: Any) -> None:
    """Sends a layout, as ``stream.send_blueprint`` does, but the stream that it makes can be freed.

    The layout is made the active one; otherwise a viewer restores the layout that it remembers.
    """
    application = rr.get_application_id(stream)
    assert application is not None
    layout = rr.RecordingStream._from_native(
        rerun_bindings.new_blueprint(application, make_default=False, make_thread_default=False)
    )
    layout.set_time("blueprint", sequence=0)
    blueprint.to_blueprint()._log_to_stream(layout)
    storage = layout.memory_recording().storage
    rerun_bindings.send_blueprint(storage, make_active=True, make_default=True, recording=stream.to_native())
    layout.disconnect()
