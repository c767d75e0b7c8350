"""Shows what is computed of a saved session while it is viewed: the quality of each second, and point clouds.

The file is not changed. A program of its own computes the clouds, because it may take longer than the command
that opened the viewer; it ends when all are sent or the viewer is gone.
"""

import contextlib
import os
import platform
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO
from urllib.parse import urlsplit

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from recordings.data import layout
from recordings.file.rrd_file import RrdFile
from recordings.session import Session
from recordings.writing.changes import log_quality
from recordings.writing.shown_images import thin_points

_MOST = 1000
"""Clouds of both sensors, 120 MB: the viewer keeps them in memory."""
_LOOKS_EVERY = 20
"""Clouds between two looks whether the viewer is still there."""
_SENT_WITHIN = 20.0  # seconds


def add_computed(session: IO[bytes], url: str) -> subprocess.Popen[bytes]:
    """Starts the program that adds to a viewer what a session's file lacks.

    Args:
        session: The open file. On Linux it may be deleted after this returns; elsewhere nothing is added
            then.
        url: Where the viewer or its hub listens.
    """
    shared = platform.system() == "Linux"  # elsewhere, reading would move the viewer's place in the file
    path = f"/dev/fd/{session.fileno()}" if shared else session.name
    return subprocess.Popen(
        [sys.executable, "-m", __name__, path, url],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        pass_fds=(session.fileno(),) if shared else (),
    )


def has_depth(session: Session) -> bool:
    """Whether an open session has a depth image."""
    return any(next(iter(session.depth(side)), None) is not None for side in layout.VIEWS)


def clouds(session: Session) -> Iterator[tuple[str, int, NDArray[np.float32]]]:
    """Side, frame and (N, 3) points in the sensor's frame, metres: both sensors by turns, evenly in time."""
    step = max(1, -(-2 * len(session) // _MOST))
    frames = range(0, len(session), step)
    streams = {side: iter(session.images.depth(side, frames)) for side in layout.VIEWS}
    cameras = {"a": session.intrinsics_a, "b": session.intrinsics_b}
    while streams:
        for side in list(streams):
            found = next(streams[side], None)
            if found is None:
                del streams[side]
            else:
                yield side, found[0], thin_points(found[1], cameras[side])


def send_computed(path: Path, url: str) -> int:
    """Sends quality and clouds of a session to the viewer that shows it; returns the number of clouds."""
    session = Session.open(path)
    with RrdFile(path) as file:
        identity = file.identity()
    if identity is None:
        return 0
    stream = rr.RecordingStream(identity[0], recording_id=identity[1], send_properties=False)
    stream.connect_grpc(url)
    log_quality(stream, session)
    count = 0
    for side, frame, points in clouds(session):
        if count % _LOOKS_EVERY == 0 and not _listens(url):
            return count
        stream.set_time(layout.FRAME, sequence=frame)
        stream.set_time(layout.TIME, duration=np.timedelta64(int(session.time_ns[frame]), "ns"))
        stream.log(layout.points(side), rr.Points3D.from_fields(positions=points))
        count += 1
    stream.flush(timeout_sec=_SENT_WITHIN)
    return count


def _listens(url: str) -> bool:
    where = urlsplit(url)
    try:
        socket.create_connection((where.hostname, where.port), timeout=1.0).close()
    except OSError:
        return False
    return True


if __name__ == "__main__":
    with contextlib.suppress(Exception):  # nobody reads what this program would say
        send_computed(Path(sys.argv[1]), sys.argv[2])
    os._exit(0)  # at a normal exit, the SDK would wait for a viewer that is gone
