"""A session file that is readable while it grows; an interruption loses at most the last block."""

import os
from contextlib import suppress
from io import FileIO
from pathlib import Path
from zlib import crc32

import rerun as rr

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
    """A file that appears under its name with the first block; an existing file stays until then.

    Args:
        stream: The stream whose data is written; it must not have a sink yet.
    """

    def __init__(self, path: Path, stream: rr.RecordingStream, overwrite: bool = False) -> None:
        self._path = Path(os.path.realpath(path))
        self._blocks = Blocks(stream)
        self._overwrite = overwrite
        self._file: FileIO | None = None
        self._size = 0
        self._failed = False

    @property
    def begun(self) -> bool:
        """Whether the file exists under its name."""
        return self._file is not None

    def write(self) -> None:
        """Writes the data logged since the last call.

        Raises:
            OSError: The data is not written. Earlier data is intact. Do not write more.
        """
        block = self._blocks.take()
        try:
            if self._file is None:
                self._file = self._begin(block)
            elif not self._is_there():
                raise FileNotFoundError("it was moved or deleted")
            else:
                _write_whole(self._file, block, self._size)
        except OSError:
            self._failed = True
            raise
        self._size += len(block)

    def close(self) -> None:
        """Ends the file, or raises an OSError. Data not yet written is lost. Closing twice has no effect."""
        self._blocks.close()
        file, self._file = self._file, None
        if file is not None:
            try:
                _write_whole(file, END_OF_FILE, self._size)
            except OSError:
                if not self._failed:
                    raise
            finally:
                file.close()

    def _begin(self, block: memoryview) -> FileIO:
        if not self._overwrite:
            file = FileIO(self._path, "x")
            try:
                _write_whole(file, block, 0)
            except OSError:
                file.close()
                self._path.unlink()
                raise
            return file
        partial = partial_beside(self._path)
        try:
            partial.write_bytes(block)
            partial.replace(self._path)
        finally:
            partial.unlink(missing_ok=True)
        file = FileIO(self._path, "r+")
        file.seek(0, os.SEEK_END)
        return file

    def _is_there(self) -> bool:
        assert self._file is not None
        with suppress(FileNotFoundError):
            return os.path.samestat(os.fstat(self._file.fileno()), self._path.stat())
        return False


def partial_beside(path: Path) -> Path:
    """A unique hidden name in the same folder, for a temporary file that becomes `path`.

    It has the suffix of `path` in lower case, because ezc3d appends the suffix to any other name.
    """
    return path.with_name(f".{crc32(os.fsencode(path.name)):08x}.{os.getpid()}.partial{path.suffix.lower()}")


def _write_whole(file: FileIO, block: bytes | memoryview, at: int) -> None:
    """Writes a block at offset `at`, the end of the file, completely; or raises an OSError and writes
    nothing.
    """
    rest = memoryview(block)
    try:
        while rest:
            rest = rest[file.write(rest) or 0 :]
    except OSError:
        with suppress(OSError):
            file.truncate(at)
            file.seek(at)
        raise
