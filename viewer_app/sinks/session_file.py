"""A session's file, written on a thread of its own."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import rerun as rr

from recordings.writing.growing_file import GrowingFile
from recordings.writing.recorder import Recorder
from recordings.writing.rewritten_session import check_whole
from viewer_app.loop.image_thinning import has_images, without_images
from viewer_app.sinks.compact_copy import CompactCopy
from viewer_app.sinks.viewer_feed import Item, Opening, write_items

_KEEP_WITH_IMAGES = 60
"""Frames that wait with their images, at most: 90 MB."""
_KEEP = 1800
"""Frames that wait, at most: a minute in which the disk takes nothing."""
_LOOK_SECONDS = 0.04
"""Images are encoded as they come: those of a block at once would keep everyone waiting."""
_BLOCK_SECONDS = 0.5
"""Frames are written together, for by columns that takes less time and space; a kill loses as many."""
_FLUSH_WITHIN = 30.0


class SessionFile:
    """Writes what it is offered; the offering never waits.

    A live session's file can be read while it grows; it gets its name, and replaces one that had it, with the
    first frames. A disk that is full stops its saving and nothing else: :attr:`failure` then says so. While
    the disk stands still, images are left out first, after a minute frames too; both are counted.

    Args:
        path: The file.
        open_stream: Makes a stream of the recording, without a sink.
        begin: Writes what is static.
        growing: Whether it is that of a live session. A recording's, whose fusion keeps all frames anyway, is
            complete, or :meth:`close` raises; it is there before, but not to be read.
        overwrite: Whether a live session may replace a file of that name.
        turn: Waits until whoever goes first has had a turn, so many seconds at most. A lower priority of the
            thread would hold up all the others: while it is kept waiting, it may hold Python's lock.
        on_failure: Told, on the thread, why saving stopped.
    """

    def __init__(
        self,
        path: Path,
        open_stream: Callable[[], rr.RecordingStream],
        begin: Opening,
        *,
        growing: bool = True,
        overwrite: bool = False,
        turn: Callable[[float], object] | None = None,
        on_failure: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._path = path
        self._open_stream, self._begin = open_stream, begin
        self._growing, self._overwrite = growing, overwrite
        self._turn, self._on_failure = turn or self._wait_for_end, on_failure
        self._queue: deque[Item] = deque()
        self._more = threading.Condition()
        self._ending = self._whole = False
        self._error: BaseException | None = None
        self.failure: str | None = None
        """Why not everything is saved; None where it is."""
        self.saved = 0
        """Frames that are in the file."""
        self.lost = 0
        """Frames left out while the disk stood still."""
        self.without_images = 0
        """Frames whose images were left out."""
        self._thread = threading.Thread(target=self._run, name="session file")
        self._thread.start()

    def offer(self, item: Item) -> None:
        """Takes an item, without waiting."""
        if self._ending or self.failure is not None or self._error is not None:
            return
        if self._growing and isinstance(item, tuple):
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
            OSError: Not everything of a recording has reached the file.
            Exception: A fault of the program.
        """
        with self._more:
            self._ending, self._whole = True, whole
            self._more.notify()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            if self._growing:
                self._write_growing()
            else:
                self._write_at_once()
        except OSError as error:
            if self._growing:
                self._fail(error)
            else:
                self._error = error
        except Exception as error:
            self._error = error
        finally:
            self._queue.clear()

    def _write_growing(self) -> None:
        stream = self._open_stream()
        with (
            closing(GrowingFile(self._path, stream, self._overwrite)) as file,
            closing(CompactCopy(self._path, self._open_stream(), self._begin)) as compact,
        ):
            recorder = self._begin(stream)
            ending = False
            while not ending:
                ending, items = self._take_block(recorder, compact)
                write_items(recorder, items)
                frames = sum(isinstance(item, tuple) for item in items)
                whole = ending and self._whole and self.saved + frames > 0
                if whole:
                    recorder.finish()
                if file.begun or frames:
                    file.write()
                    self.saved += frames
            file.close()
            if whole:
                compact.take_place()

    def _write_at_once(self) -> None:
        stream = self._open_stream()
        stream.set_sinks(rr.FileSink(str(self._path)))
        try:
            recorder = self._begin(stream)
            ending = False
            while not ending:
                self._wait_for_end(_BLOCK_SECONDS)
                ending, items = self._take()
                write_items(recorder, items)
            if self._whole:
                recorder.finish()
            stream.flush(timeout_sec=_FLUSH_WITHIN)
        finally:
            stream.disconnect()
        if self._whole:
            check_whole(self._path)

    def _take_block(self, recorder: Recorder, compact: CompactCopy) -> tuple[bool, list[Item]]:
        """Whether this is the end, and what was offered in half a second and a turn or two.

        Its images are written already, so that they stand before its skeletons: a file cut off between them
        has images without a frame, which our readers leave out.
        """
        begun = time.monotonic()
        block: list[Item] = []
        ending = False
        while not ending and time.monotonic() - begun < _BLOCK_SECONDS:
            self._turn(_LOOK_SECONDS)
            ending, items = self._take()
            compact.add(items)
            for item in items:
                if isinstance(item, tuple):
                    number, frame = item
                    recorder.record_images(number, frame)
                    item = number, replace(frame, pair=without_images(frame.pair))
                block.append(item)
        if not ending:
            self._turn(_LOOK_SECONDS)
        return ending, block

    def _wait_for_end(self, seconds: float) -> None:
        with self._more:
            self._more.wait_for(lambda: self._ending, timeout=seconds)

    def _take(self) -> tuple[bool, list[Item]]:
        """Whether this is the end, and what was offered."""
        with self._more:
            ending = self._ending
        return ending, [self._queue.popleft() for _ in range(len(self._queue))]

    def _fail(self, error: OSError) -> None:
        why = error.strerror or error
        self.failure = (
            f"{self._path} is not saved from frame {self.saved} on: {why}. What is before that can be read."
            if self.saved
            else f"{self._path} could not be written: {why}."
        )
        self._on_failure(self.failure)
