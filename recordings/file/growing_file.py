"""A session file that is readable while it grows; an interruption loses at most the last block."""

from pathlib import Path
from typing import Any

import rerun as rr

from devices.output_file import GrowingOutput
from recordings.file.rrd_file import END_OF_FILE, without_footer

_READ_WITHIN = 10.0


class Blocks:
    """The data logged to a recording stream, as blocks that form an ``.rrd`` file when concatenated."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._bytes = rr.binary_stream(stream)
        self._begun = False

    def take(self) -> memoryview:
        """Returns the next block: all data logged since the previous block."""
        written = self._bytes.read(flush=True, flush_timeout_sec=_READ_WITHIN)
        if not written:
            return memoryview(b"")
        begun, self._begun = self._begun, True
        return without_footer(written, with_header=not begun)

    def close(self) -> None:
        """Releases the stream. Data not yet taken is lost; Rerun's warning about it is suppressed."""
        self._stream.disconnect()
        self._bytes.read(flush=False)


class GrowingFile:
    """A session's file as :class:`~devices.output_file.GrowingOutput`, which readers of Rerun take.

    Args:
        stream: The stream whose data is written; it must not have a sink yet.
        how: Of :class:`~devices.output_file.GrowingOutput`.
    """

    def __init__(self, path: Path, stream: rr.RecordingStream, **how: Any) -> None:
        self._blocks, self._file = Blocks(stream), GrowingOutput(path, **how)
        self._failed = self._closed = False

    @property
    def begun(self) -> bool:
        """Whether data is written."""
        return self._file.size > 0

    def write(self) -> None:
        """Writes the data logged since the last call.

        Raises:
            OSError: The data is not written. Earlier data is intact. Do not write more.
        """
        try:
            self._file.append(self._blocks.take())
        except OSError:
            self._failed = True
            raise

    def close(self) -> None:
        """Ends the file, or raises an OSError. Data not yet written is lost. Closing twice has no effect."""
        self._blocks.close()
        closed, self._closed = self._closed, True
        try:
            if self.begun and not self._failed and not closed:
                self._file.append(END_OF_FILE)
        finally:
            self._file.close(whole=not self._failed)
