"""A session file, written on a separate thread."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import rerun as rr

from devices.events import Phase
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.file.growing_file import GrowingFile
from recordings.session_arrays import RecordedFrame
from recordings.writing.recorder import Recorder
from viewer_app.sinks.compact_copy import CompactCopy
from viewer_app.sinks.queue_items import Frame, Item, Note, Opening, Page, Recalibration, write_items
from viewer_app.sinks.sink import Sink

_KEEP_WITH_IMAGES = 60
"""Maximum number of queued frames with images: 90 MB."""
_KEEP = 1800
"""Maximum number of queued frames: one minute without progress of the disk."""
_LOOK_SECONDS = 0.04
"""Images are encoded one by one: encoding a whole block at once would block other threads."""
_BLOCK_SECONDS = 0.5
"""Frames per block: columns take less time and space. A killed process loses at most one block."""


class FileSink(Sink):
    """Interface of a file that is written while the loop runs; this base class writes none."""

    @property
    def path(self) -> Path | None:
        """The file; None for none."""
        return None

    @property
    def saves(self) -> bool:
        """Whether a file is being written."""
        return False

    @property
    def failure(self) -> str | None:
        """Why saving stopped, as a sentence; None if it did not."""
        return None

    @property
    def saved(self) -> int:
        """Frames that are in the file."""
        return 0

    @property
    def saved_bytes(self) -> int:
        """The file's size so far."""
        return 0

    @property
    def lost(self) -> int:
        """Frames left out while the disk stood still."""
        return 0

    @property
    def without_images(self) -> int:
        """Frames whose images were left out, because the disk was too slow for those."""
        return 0


class SessionFile(FileSink):
    """Writes a live session on a separate thread; the loop never waits.

    The file is readable while it grows. It appears under its name, and replaces an existing file, with the
    first frames. A full disk stops only the saving; see :attr:`failure`. While the disk blocks, images are
    dropped first, after a minute frames too; both are counted.

    Args:
        path: The file.
        open_stream: Creates a stream of the recording, without a sink.
        begin: Writes the static data.
        overwrite: Whether an existing file may be replaced.
        turn: Waits until the viewer's thread has written, at most the given seconds. A lower thread priority
            is no alternative: a preempted thread may hold the GIL and block all others.
        on_failure: Called on the thread with the reason when saving stops.
    """

    def __init__(
        self,
        path: Path,
        open_stream: Callable[[], rr.RecordingStream],
        begin: Opening,
        *,
        overwrite: bool = False,
        turn: Callable[[float], object] | None = None,
        on_failure: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._path = path
        self._open_stream, self._begin, self._overwrite = open_stream, begin, overwrite
        self._turn, self._on_failure = turn or self._wait_for_end, on_failure
        self._queue: deque[Item] = deque()
        self._more = threading.Condition()
        self._ending = self._whole = False
        self._error: BaseException | None = None
        self._failure: str | None = None
        self._offered = self._saved = self._lost = self._without_images = 0
        self._thread = threading.Thread(target=self._run, name="session file")
        self._thread.start()

    def write(self, frame: RecordedFrame) -> None:
        """Takes a frame, without waiting."""
        item = Frame(self._offered, frame)
        self._offered += 1
        waiting = len(self._queue)
        if waiting >= _KEEP:
            self._lost += self._takes
            return
        if waiting >= _KEEP_WITH_IMAGES and item.has_images:
            self._without_images += self._takes
            item = item.without_images()
        self._offer(item)

    def event(self, text: str, level: str = "INFO", topic: str = "", phase: Phase = "moment") -> None:
        """Takes an event, without waiting."""
        self._offer(Note(text, level, topic, phase))

    def recalibrated(self, setup: FusionSetup) -> None:
        """Takes a calibration, without waiting."""
        self._offer(Recalibration(setup))

    def coach(self, page: CoachPage) -> None:
        """Takes a page, without waiting."""
        self._offer(Page(page))

    def finish(self) -> None:
        """Marks the session as complete."""
        self._whole = True

    @property
    def path(self) -> Path | None:
        """The file."""
        return self._path

    @property
    def saves(self) -> bool:
        """Whether the file is being written; False after a failure."""
        return self._failure is None

    @property
    def failure(self) -> str | None:
        """Why not everything is saved, in a sentence; None where it is."""
        return self._failure

    @property
    def saved(self) -> int:
        """Frames that are in the file."""
        return self._saved

    @property
    def saved_bytes(self) -> int:
        """The file's size so far."""
        try:
            return self._path.stat().st_size if self._saved else 0
        except OSError:
            return 0

    @property
    def lost(self) -> int:
        """Frames left out while the disk stood still."""
        return self._lost

    @property
    def without_images(self) -> int:
        """Frames whose images were left out."""
        return self._without_images

    @property
    def waiting(self) -> int:
        """Number of queued items."""
        return len(self._queue)

    def close(self) -> None:
        """Writes the queued items and closes the file.

        Raises:
            Exception: A fault of the program.
        """
        with self._more:
            self._ending = True
            self._more.notify()
        self._thread.join()
        error, self._error = self._error, None
        if error is not None:
            raise error

    @property
    def _takes(self) -> bool:
        return not self._ending and self._failure is None and self._error is None

    def _offer(self, item: Item) -> None:
        if self._takes:
            self._queue.append(item)

    def _run(self) -> None:
        try:
            self._write_growing()
        except OSError as error:
            self._fail(error)
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
                frames = sum(isinstance(item, Frame) for item in items)
                whole = ending and self._whole and self._saved + frames > 0
                if whole:
                    recorder.finish()
                if file.begun or frames:
                    file.write()
                    self._saved += frames
            file.close()
            if whole:
                compact.take_place()

    def _take_block(self, recorder: Recorder, compact: CompactCopy) -> tuple[bool, list[Item]]:
        """Whether this is the end, and the items of the last half second.

        Their images are already written and so precede their skeletons: a file cut off in between has images
        without a frame, which the readers skip.
        """
        begun = time.monotonic()
        block: list[Item] = []
        ending = False
        while not ending and time.monotonic() - begun < _BLOCK_SECONDS:
            self._turn(_LOOK_SECONDS)
            ending, items = self._take()
            compact.add(items)
            for item in items:
                if isinstance(item, Frame):
                    recorder.record_images(item.number, item.frame)
                    item = item.without_images()
                block.append(item)
        if not ending:
            self._turn(_LOOK_SECONDS)
        return ending, block

    def _wait_for_end(self, seconds: float) -> None:
        with self._more:
            self._more.wait_for(lambda: self._ending, timeout=seconds)

    def _take(self) -> tuple[bool, list[Item]]:
        """Whether this is the end, and the queued items."""
        with self._more:
            ending = self._ending
        return ending, [self._queue.popleft() for _ in range(len(self._queue))]

    def _fail(self, error: OSError) -> None:
        why = error.strerror or error
        self._failure = (
            f"{self._path} is not saved from frame {self._saved} on: {why}. What is before that can be read."
            if self._saved
            else f"{self._path} could not be written: {why}."
        )
        self._on_failure(self._failure)
