"""A copy of the session in large blocks, which replaces the growing file when the session ends."""

import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import rerun as rr

from devices.depth.image_thinning import pair_has_images
from devices.output_file import Hidden, real_path, whole_file
from recordings.file.session_writer import LEFT_AFTER, check_whole, disconnect
from recordings.writing.recorder import Recorder
from viewer_app.sinks.item_queue import Item, QueuedFrame
from viewer_app.sinks.queued_sink import Opening, write_items

_BLOCK = 600
"""Items per block: 20 s, which need less than half the space of blocks of half a second."""
_FLUSH_WITHIN = 5.0


class CompactCopy:
    """Writes items to a second file, which also has Rerun's table of contents.

    The file has no name if the system supports unnamed files, so that a killed process leaves nothing behind.
    Any failure discards only the copy. The first image discards the copy too: images fill almost the whole
    file and do not benefit from large blocks.
    """

    def __init__(self, path: Path, stream: rr.RecordingStream, begin: Opening) -> None:
        self._path = real_path(path)
        self._stream = stream
        self._recorder: Recorder | None = None
        self._waiting: list[Item] = []
        with suppress(OSError, RuntimeError):  # Rerun raises the second
            self._file = tempfile.TemporaryFile(dir=self._path.parent)  # noqa: SIM115
            nameless = Path(f"/proc/self/fd/{self._file.fileno()}")
            self._hidden = None if nameless.exists() else Hidden(self._path)
            self._written = nameless if self._hidden is None else self._hidden.path
            stream.set_sinks(rr.FileSink(str(self._written)))
            self._recorder = begin(stream)

    def add(self, items: Sequence[Item]) -> None:
        """Takes items."""
        if any(isinstance(item, QueuedFrame) and pair_has_images(item.frame.pair) for item in items):
            self.close()
        if self._recorder is not None:
            self._waiting += items
            if len(self._waiting) >= _BLOCK:
                write_items(self._recorder, self._waiting)
                self._waiting.clear()

    def take_place(self) -> None:
        """Ends the session, and replaces the grown file atomically."""
        if self._recorder is not None:
            with suppress(OSError, RuntimeError):  # Rerun raises the second once its thread could not write
                write_items(self._recorder, self._waiting)
                self._waiting.clear()
                self._recorder.finish()
                self._stream.flush(timeout_sec=_FLUSH_WITHIN)
                disconnect(self._stream, _FLUSH_WITHIN)
                check_whole(self._written)
                with whole_file(self._path, overwrite=True) as place:
                    shutil.copyfile(self._written, place)
        self.close()

    def close(self) -> None:
        """Discards the copy, unless it replaced the file. Closing twice has no effect."""
        if self._recorder is not None:
            self._recorder = None
            self._waiting.clear()
            with suppress(OSError):
                self._file.truncate(0)  # on a full disk, frees space for the rest of the stream
            disconnect(self._stream, LEFT_AFTER)
            self._file.close()
            if self._hidden is not None:
                self._hidden.remove()
