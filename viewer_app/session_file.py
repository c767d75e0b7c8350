"""A session's file, written completely, on a thread of its own."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import replace

import rerun as rr

from devices.pairing import FramePair
from devices.sensor import SensorFrame
from viewer_app.viewer_feed import Item, Opening, write_items

_KEEP_WITH_IMAGES = 60
"""Frames that wait with their images, at most: 90 MB."""
_KEEP = 1800
"""Frames that wait, at most: a minute in which the disk takes nothing."""
_BLOCK_SECONDS = 1.0  # frames are written together: by columns that takes less time and space
_FLUSH_WITHIN = 30.0


class SessionFile:
    """Writes what it is offered; the offering never waits.

    While the disk stands still, images are left out first, after a minute frames too; both are counted.

    Args:
        stream: With its file as sink.
        begin: Writes what is static.
        bounded: Whether anything may be left out; a recording's fusion keeps all its frames anyway.
    """

    def __init__(self, stream: rr.RecordingStream, begin: Opening, bounded: bool = True) -> None:
        self._stream, self._begin, self._bounded = stream, begin, bounded
        self._queue: deque[Item] = deque()
        self._more = threading.Condition()
        self._ending = self._whole = False
        self._error: BaseException | None = None
        self.lost = 0
        """Frames left out."""
        self.without_images = 0
        """Frames whose images were left out."""
        self._thread = threading.Thread(target=self._run, name="session file")
        self._thread.start()

    def offer(self, item: Item) -> None:
        """Takes an item, without waiting."""
        with self._more:
            if self._bounded and isinstance(item, tuple):
                waiting = len(self._queue)
                if waiting >= _KEEP:
                    self.lost += 1
                    return
                number, frame = item
                if waiting >= _KEEP_WITH_IMAGES and has_images(frame.pair):
                    self.without_images += 1
                    item = number, replace(frame, pair=without_images(frame.pair))
            self._queue.append(item)

    @property
    def waiting(self) -> int:
        """How much is offered and not yet written."""
        return len(self._queue)

    def close(self, whole: bool) -> None:
        """Writes what waits, and closes the file.

        Args:
            whole: Whether the session ended as it should, which is then written too.

        Raises:
            Exception: What went wrong while writing.
        """
        with self._more:
            self._ending, self._whole = True, whole
            self._more.notify()
        self._thread.join()
        self._stream.flush(timeout_sec=_FLUSH_WITHIN)
        self._stream.disconnect()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            recorder = self._begin(self._stream)
            ending = False
            while not ending:
                with self._more:
                    self._more.wait_for(lambda: self._ending, timeout=_BLOCK_SECONDS)
                    ending = self._ending
                    items = list(self._queue)
                    self._queue.clear()
                write_items(recorder, items)
            if self._whole:
                recorder.finish()
        except Exception as error:
            self._error = error


def has_images(pair: FramePair) -> bool:
    """Whether a frame of the pair has an image."""
    return any(f is not None and (f.depth is not None or f.color is not None) for f in (pair.a, pair.b))


def without_images(pair: FramePair) -> FramePair:
    """The pair with skeletons only."""

    def bare(frame: SensorFrame | None) -> SensorFrame | None:
        return None if frame is None else replace(frame, depth=None, color=None)

    return replace(pair, a=bare(pair.a), b=bare(pair.b))
