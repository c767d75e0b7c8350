"""The same session in large blocks, to take the place of the file that grew once that is complete."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import rerun as rr

from recordings.writing.growing_file import partial_beside
from recordings.writing.recorder import Recorder
from recordings.writing.session_writer import check_whole
from viewer_app.sinks.queue_items import Frame, Item, Opening, write_items

_BLOCK = 600
"""Items written together: 20 s, which then take less than half the room of half seconds."""
_FLUSH_WITHIN = 5.0


class CompactCopy:
    """Writes items to a second file, which has Rerun's table of contents, too.

    That has no name where the system knows such files, so that a process that is killed leaves nothing
    behind. Whatever goes wrong, only the copy is given up. With the first image it gives itself up: images
    take nearly all of a file, and gain nothing by being written together.

    Args:
        path: The file that grows; the copy is in its folder, to end up on the same disk.
        stream: A second stream of the same recording.
        begin: Writes what is static.
    """

    def __init__(self, path: Path, stream: rr.RecordingStream, begin: Opening) -> None:
        self._path = Path(os.path.realpath(path))
        self._partial = partial_beside(self._path)
        self._stream = stream
        self._recorder: Recorder | None = None
        self._waiting: list[Item] = []
        with suppress(OSError):
            self._file = tempfile.TemporaryFile(dir=self._path.parent)  # noqa: SIM115
            nameless = Path(f"/proc/self/fd/{self._file.fileno()}")
            self._written = nameless if nameless.exists() else self._partial
            stream.set_sinks(rr.FileSink(str(self._written)))
            self._recorder = begin(stream)

    def add(self, items: Sequence[Item]) -> None:
        """Takes items."""
        if any(isinstance(item, Frame) and item.has_images for item in items):
            self.close()
        if self._recorder is not None:
            self._waiting += items
            if len(self._waiting) >= _BLOCK:
                write_items(self._recorder, self._waiting)
                self._waiting.clear()

    def take_place(self) -> None:
        """Ends the session, and puts it where the grown one is, in one step."""
        if self._recorder is not None:
            write_items(self._recorder, self._waiting)
            self._waiting.clear()
            self._recorder.finish()
            with suppress(OSError, TimeoutError):
                self._stream.flush(timeout_sec=_FLUSH_WITHIN)
                self._stream.disconnect()
                check_whole(self._written)
                if self._written != self._partial:
                    shutil.copyfile(self._written, self._partial)
                self._partial.replace(self._path)
        self.close()

    def close(self) -> None:
        """Gives the copy up, unless it took the place; closing twice is harmless."""
        if self._recorder is not None:
            self._recorder = None
            self._waiting.clear()
            with suppress(OSError):
                self._file.truncate(0)  # makes room for what the stream has yet to write, on a full disk
            self._stream.disconnect()
            self._file.close()
            with suppress(OSError):
                self._partial.unlink(missing_ok=True)
