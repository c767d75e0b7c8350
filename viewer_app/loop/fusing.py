"""The offline loop: fuse each pair and pass it to the sink."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable

import numpy as np
from rich.console import Console

from devices.pairing import FramePair
from fusion.fuser import Fuser
from recordings.fusing import fuse_one
from recordings.images.rvl import encode_depth
from recordings.session_arrays import RecordedFrame
from viewer_app.sinks.sink import Sink


def warm_up(fuser: Fuser, console: Console, meanwhile: Callable[[], object] = lambda: None) -> None:
    """Compiles the kernels before the first frame; prints a notice if this takes more than a second.

    Args:
        fuser: The fuser whose kernels are compiled.
        console: Receives the notice.
        meanwhile: A callable that compiles further kernels.
    """
    notice = threading.Timer(1.0, console.print, ["Compiling the kernels; only the first run does this …"])
    notice.daemon = True
    notice.start()
    try:
        fuser.warm_up(meanwhile)
        encode_depth(np.zeros((1, 1), dtype=np.uint16))
    finally:
        notice.cancel()


def fuse_offline(pairs: Iterable[FramePair], fuser: Fuser, sink: Sink) -> list[RecordedFrame]:
    """Fuses pairs as fast as possible."""
    frames = []
    for pair in pairs:
        frame = fuse_one(fuser, pair)
        sink.write(frame)
        frames.append(frame)
    return frames
