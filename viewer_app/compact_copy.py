"""The same session in large blocks, to take the place of the file that grew once that is complete."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import rerun as rr

from recordings.growing import Blocks, partial_beside
from recordings.recorder import Recorder
from recordings.rrd_file import END_OF_FILE
from viewer_app.images import has_images
from viewer_app.viewer_feed import Image, Item, Opening, write_items

_BLOCK = 600
"""Items written together: 20 s, which then take less than half the room of half seconds."""


class CompactCopy:
    """Writes items to a file without a name, so that a process that is killed leaves none behind.

    Whatever goes wrong, only the copy is given up. With the first image it gives itself up: images take
    nearly all of a file, and gain nothing by being written together.

    Args:
        path: The file that grows; the copy is in its folder, to end up on the same disk.
        stream: A second stream of the same recording.
        begin: Writes what is static.
        blueprint: What a viewer that opens the file shows.
    """

    def __init__(self, path: Path, stream: rr.RecordingStream, begin: Opening, blueprint: Any) -> None:
        self._path = path
        self._blocks = Blocks(stream, blueprint)
        self._recorder: Recorder | None = begin(stream)
        self._waiting: list[Item] = []
        try:
            self._file = tempfile.TemporaryFile(dir=path.parent)  # noqa: SIM115
        except OSError:
            self._recorder = None

    def add(self, items: Sequence[Item]) -> None:
        """Takes items."""
        if any(isinstance(i, Image) or (isinstance(i, tuple) and has_images(i[1].pair)) for i in items):
            self.close()
        if self._recorder is not None:
            self._waiting += items
            if len(self._waiting) >= _BLOCK:
                self._write(self._recorder)

    def close(self) -> None:
        """Gives the copy up, unless it took the place; closing twice is harmless."""
        if self._recorder is not None:
            self._recorder = None
            self._waiting.clear()
            self._file.close()
        self._blocks.close()

    def take_place(self) -> None:
        """Ends the session, and puts it where the grown one is, in one step."""
        if self._recorder is not None:
            write_items(self._recorder, self._waiting)
            self._waiting.clear()
            self._recorder.finish()
            partial = partial_beside(self._path)
            with suppress(OSError):
                self._file.write(self._blocks.take())
                self._file.write(END_OF_FILE)
                self._file.seek(0)
                with partial.open("xb") as whole:
                    shutil.copyfileobj(self._file, whole, 1 << 20)
                partial.replace(self._path)
            with suppress(OSError):
                partial.unlink(missing_ok=True)
        self.close()

    def _write(self, recorder: Recorder) -> None:
        write_items(recorder, self._waiting)
        self._waiting.clear()
        try:
            self._file.write(self._blocks.take())
        except OSError:
            self.close()
