"""The loop: for each pair, fuse it, record it. The same for recorded, simulated and live pairs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

import numpy as np
from rich.console import Console

from devices.pairing import FramePair
from fusion.fuser import Fuser
from recordings.images.rvl import encode_depth
from recordings.session_arrays import RecordedFrame
from recordings.writing.recorder import Recorder
from viewer_app.sinks.live_session import LiveSession

_BLOCK = 1024  # frames written at a time, so that a viewer shows the work going on


def warm_up(fuser: Fuser, console: Console, meanwhile: Callable[[], object] = lambda: None) -> None:
    """Compiles the kernels before the first frame needs them, with a word where that takes its time.

    Args:
        fuser: Whose kernels.
        console: For the word.
        meanwhile: Runs what else there is to compile.
    """
    notice = threading.Timer(1.0, console.print, ["Compiling the kernels; only the first run does this …"])
    notice.daemon = True
    notice.start()
    try:
        fuser.warm_up(meanwhile)
        encode_depth(np.zeros((1, 1), dtype=np.uint16))
    finally:
        notice.cancel()


def fuse_one(fuser: Fuser, pair: FramePair) -> RecordedFrame:
    """Fuses a pair and takes the time."""
    skeletons = pair.skeletons
    before = time.perf_counter_ns()
    fused = fuser.update(skeletons)
    return RecordedFrame(pair, fused, time.perf_counter_ns() - before)


def fuse_offline(
    pairs: Iterable[FramePair], fuser: Fuser, recorder: Recorder | LiveSession
) -> list[RecordedFrame]:
    """Fuses pairs as fast as it goes, writing by columns, a block at a time."""
    frames: list[RecordedFrame] = []
    written = 0
    for pair in pairs:
        frames.append(fuse_one(fuser, pair))
        if len(frames) - written == _BLOCK:
            recorder.record_all(frames[written:])
            written = len(frames)
    if len(frames) > written:
        recorder.record_all(frames[written:])
    return frames
