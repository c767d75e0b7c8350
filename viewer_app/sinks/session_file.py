"""A session file, written on a separate thread."""

import time
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
from viewer_app.sinks.queued_file import QueuedFile
from viewer_app.sinks.queued_sink import Opening, QueuedSink, write_items

_LOOK_SECONDS = 0.04
"""Images are encoded one by one: encoding a whole block at once would block other threads."""
_BLOCK_SECONDS = 0.5
"""Frames per block: columns take less time and space. A killed process loses at most one block."""


class SessionFile(QueuedFile[Item], QueuedSink):
    """Writes a live session on a separate thread; the loop never waits.

    The file is readable while it grows. It appears under its name, and replaces an existing file, with the
    first frames.

    Args:
        open_stream: Creates a stream of the recording, without a sink.
        begin: Writes the static data.
        turn: Waits until the viewer's thread has written, at most the given seconds. A lower thread priority
            is no alternative: a preempted thread may hold the GIL and block all others.
    """

    keep = 1800  # one minute without progress of the disk
    keep_with_images = 60  # 90 MB
    frame_type = QueuedFrame

    def __init__(
        self,
        path: Path,
        open_stream: Callable[[], rr.RecordingStream],
        begin: Opening,
        *,
        overwrite: bool = False,
        turn: Callable[[float], object] | None = None,
        on_failure: Callable[[str], object] = lambda _: None,
    ) -> None:
        QueuedFile.__init__(self, path, "session file", on_failure)
        QueuedSink.__init__(self, self._queue)
        self._open_stream, self._begin, self._overwrite = open_stream, begin, overwrite
        self._turn = turn or self._queue.wait_for_end
        self._whole = False
        self._thread.start()

    def finish(self) -> None:
        self._whole = True

    def _write(self) -> None:
        stream = self._open_stream()
        with (
            closing(GrowingFile(self.path, stream, overwrite=self._overwrite, again=self._again)) as file,
            closing(CompactCopy(self.path, self._open_stream(), self._begin)) as compact,
        ):
            recorder = self._begin(stream)
            ending = False
            while not ending:
                ending, items = self._take_block(recorder, compact)
                write_items(recorder, items)
                frames = sum(isinstance(item, QueuedFrame) for item in items)
                whole = ending and self._whole and self.written + frames > 0
                if whole:
                    recorder.finish()
                if file.begun or frames:
                    file.write()
                    self.written += frames
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
                    item = self._without_images(item)
                block.append(item)
        if not ending:
            self._turn(_LOOK_SECONDS)
        return ending, block

    def _without_images(self, item: Item) -> Item:
        if isinstance(item, QueuedFrame) and pair_has_images(item.frame.pair):
            return replace(item, frame=replace(item.frame, pair=pair_without_images(item.frame.pair)))
        return item
