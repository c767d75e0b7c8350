"""A session file, written on a separate thread."""

import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import rerun as rr

from devices.depth.image_thinning import pair_has_images, pair_without_images
from recordings.file.growing_file import GrowingFile
from recordings.writing.recorder import Recorder
from viewer_app.sinks.compact_copy import CompactCopy
from viewer_app.sinks.item_queue import Item, QueuedFrame
from viewer_app.sinks.queued_sink import Opening, QueuedSink, write_items

_KEEP_WITH_IMAGES = 60
"""Maximum number of queued frames with images: 90 MB."""
_KEEP = 1800
"""Maximum number of queued frames: one minute without progress of the disk."""
_LOOK_SECONDS = 0.04
"""Images are encoded one by one: encoding a whole block at once would block other threads."""
_BLOCK_SECONDS = 0.5
"""Frames per block: columns take less time and space. A killed process loses at most one block."""


class SessionFile(QueuedSink):
    """Writes a live session on a separate thread; the loop never waits.

    The file is readable while it grows. It appears under its name, and replaces an existing file, with the
    first frames. A full disk stops only the saving; see :attr:`failure`. While the disk blocks, images are
    dropped first, after a minute frames too; both are counted.

    Args:
        open_stream: Creates a stream of the recording, without a sink.
        begin: Writes the static data.
        turn: Waits until the viewer's thread has written, at most the given seconds. A lower thread priority
            is no alternative: a preempted thread may hold the GIL and block all others.
        on_failure: Called on the thread with the reason when saving stops.

    Attributes:
        failure: Why not everything is saved, in a sentence; None where it is.
        saved: Frames that are in the file.
        lost: Frames left out while the disk stood still.
        without_images: Frames whose images were left out, because the disk was too slow for those.
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
        super().__init__("session file", self._admitted, daemon=False)
        self.path = path
        self.failure: str | None = None
        self.saved = self.lost = self.without_images = 0
        self._open_stream, self._begin, self._overwrite = open_stream, begin, overwrite
        self._turn, self._on_failure = turn or self._queue.wait_for_end, on_failure
        self._whole = False
        self._fault: Exception | None = None
        self._thread.start()

    def finish(self) -> None:
        self._whole = True

    @property
    def saved_bytes(self) -> int:
        """The file's size so far."""
        try:
            return self.path.stat().st_size if self.saved else 0
        except OSError:
            return 0

    def close(self) -> None:
        self._queue.end()
        self._thread.join()
        fault, self._fault = self._fault, None
        if fault is not None:
            raise fault

    def _admitted(self, queued: deque[Item], item: Item) -> Item | None:
        if isinstance(item, QueuedFrame):
            if len(queued) >= _KEEP:
                self.lost += 1
                return None
            if len(queued) >= _KEEP_WITH_IMAGES and pair_has_images(item.frame.pair):
                self.without_images += 1
                return _without_images(item)
        return item

    def _run(self) -> None:
        try:
            self._write_growing()
        except OSError as error:
            self._fail(error)
        except Exception as fault:
            self._fault = fault
        finally:
            self._queue.end()
            self._queue.take(0.0)

    def _write_growing(self) -> None:
        stream = self._open_stream()
        with (
            closing(GrowingFile(self.path, stream, self._overwrite)) as file,
            closing(CompactCopy(self.path, self._open_stream(), self._begin)) as compact,
        ):
            recorder = self._begin(stream)
            ending = False
            while not ending:
                ending, items = self._take_block(recorder, compact)
                write_items(recorder, items)
                frames = sum(isinstance(item, QueuedFrame) for item in items)
                whole = ending and self._whole and self.saved + frames > 0
                if whole:
                    recorder.finish()
                if file.begun or frames:
                    try:
                        file.write()
                    except OSError:
                        self.saved = self.saved if file.placed else 0  # an older file stays
                        raise
                    self.saved += frames
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
            ending = self._queue.ended  # before the last items are taken
            for _ in range(len(self._queue)):
                # the others stay in the queue, whose length is limited
                (item,) = self._queue.take(0.0, most=1)
                compact.add([item])
                if isinstance(item, QueuedFrame):
                    recorder.record_images(item.number, item.frame)
                    item = _without_images(item)
                block.append(item)
        if not ending:
            self._turn(_LOOK_SECONDS)
        return ending, block

    def _fail(self, error: OSError) -> None:
        why = error.strerror or error
        self.failure = (
            f"{self.path} is not saved from frame {self.saved} on: {why}. Everything before that can be read."
            if self.saved
            else f"{self.path} could not be written: {why}."
        )
        self._on_failure(self.failure)


def _without_images(item: QueuedFrame) -> QueuedFrame:
    return replace(item, frame=replace(item.frame, pair=pair_without_images(item.frame.pair)))
