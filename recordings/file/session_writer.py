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
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import rerun as rr
import rerun_bindings

from devices.events import Event, spells_of
from devices.output_file import whole_file
from fusion.large_arrays import parts
from fusion.progress import Progress, quietly
from recordings import layout
from recordings.appearance.coach_page import CoachPage
from recordings.errors import RecordingError
from recordings.file.rrd_file import RrdFile, damage_of
from recordings.session_data import OF_DAMAGED, SessionData
from recordings.writing.recorder import Recorder

_BLOCK, _MOST_BLOCKS = 300, 256
"""Frames per write: a file that is cut off loses at most ten seconds more than what is missing.
One of more than 25 minutes loses more: Rerun keeps 0.4 MB of each block until the file is complete, and
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
    first: int = 0,
    end: int | None = None,
    block: int = _BLOCK,
    progress: Progress = quietly,
) -> int:
    """Writes frames `first` to `end` (exclusive) of a session to a file, which may be the session's own.

    The frame numbers and the time of the new session start at 0. Its property ``first_frame`` is the number
    of the first frame in the original capture.

    Args:
        path: The file; replaced once the new one is whole.
        first, end: The range of frames; if `end` is None, to the last.

    Returns:
        The number of damaged images that were skipped.

    Raises:
        RecordingError: The range has no frame.
        OSError: The file could not be written completely.
    """
    end = len(session) if end is None else min(end, len(session))
    if not 0 <= first < end:
        raise RecordingError(f"{session} has {len(session)} frames; none from {first} to {end}.")
    about = session.origin | {
        "first_frame": session.first_frame + first,
        "method_revision": session.method_revision,
    }
    if (first, end) != (0, len(session)):  # nobody knows which frames were dropped in this part
        of_all = "dropped", "others_seen"
        about = {name: value for name, value in about.items() if not name.startswith(of_all)}
    if session.damage is not None:
        first_damage = session.damage.removeprefix(OF_DAMAGED)
        about |= {"made_of_damaged": first_damage, "made_without_frames": session.frames_lost}
    with whole_recording(path, blueprint, recording_id=_kept_id(session, path, first, end)) as stream:
        segments = [(setup, own) for setup, own in session.setups() if own.stop > first and own.start < end]
        recorder = Recorder(stream, segments[0][0], session.sources, about=about)
        start_ns = int(session.rows.time_ns[first])
        if page is not None:  # before the frames, so that it is seen from the beginning
            recorder.coach(page)
        if segments[0][1].start < first:  # its calibration event comes before the range
            recorder.event(Event(f"calibrated: {segments[0][0].calibration.how}"), placed=True)
        for event in _lasting(session.events, first):
            recorder.event(event.placed(0, 0), placed=True)
        events = deque(sorted((e for e in session.events if first <= e.frame), key=lambda e: e.frame))
        for setup, own in segments:
            if own.start > first:
                recorder.recalibrated(setup)
            begin, size = max(own.start, first), max(block, (end - first) // _MOST_BLOCKS)
            count = min(own.stop, end) - begin
            for part in progress(parts(count, size), "writing", -(-count // size)):
                part = slice(begin + part.start, begin + part.stop)
                rows = session.rows[part]
                rows = replace(rows, frame=rows.frame - first, time_ns=rows.time_ns - start_ns)
                recorder.record_rows(rows, (session.fused_checksums[part], session.joint_digests[part]))
                # with their frames: a file that is cut off keeps the events up to the cut
                # the last ones may be of frames that a damaged session has lost
                while events and (events[0].frame < part.stop or part.stop == len(session)):
                    event = events.popleft()
                    moment = event.frame - first, event.time_ns - start_ns
                    recorder.event(event.placed(*moment), placed=True)
                _flush(stream, path)  # else all that a slow disk has not yet written would be in memory
        damaged = _copy_images(session, recorder, first, end)
        recorder.finish()
    return damaged


def _lasting(events: Iterable[Event], first: int) -> Iterator[Event]:
    """Earlier events that hold at frame `first`: starts without an end, and warnings of the first frame."""
    if first == 0:
        return
    yield from (e for e in events if e.frame == 0 and e.phase == "moment" and e.level != "INFO")
    for spell in spells_of(events):
        if spell.start.frame < first and (spell.end is None or spell.end.frame >= first):
            yield spell.start


def _kept_id(session: SessionData, path: Path, first: int, end: int) -> str | None:
    """The recording's id if a session replaces its own file, so that its images are still found there."""
    if session.path is None or (first, end) != (0, len(session)) or not path.exists():
        return None
    if not path.samefile(session.path):
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


def _copy_images(session: SessionData, recorder: Recorder, first: int, end: int) -> int:
    """Logs the other people and the images of frames `first` to `end` (exclusive).

    Returns the number of damaged images.
    """
    damaged = 0
    time_ns = session.rows.time_ns - session.rows.time_ns[first]
    for side in layout.SIDES:
        for frame, bones in session.images.others(side, range(first, end)):
            recorder.others.bones(side, frame - first, int(time_ns[frame]), bones)
        depth, color = session.depth(side, first, end), session.color(side, first, end)
        for frame, image in depth:
            recorder.images.depth(side, frame - first, int(time_ns[frame]), image)
        for frame, picture in color:
            recorder.images.color(side, frame - first, int(time_ns[frame]), picture)
        damaged += depth.damaged + color.damaged
    return damaged


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
