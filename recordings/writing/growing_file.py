"""A session's file that can be read while it grows, and is whole but for its last block whenever it ends."""

from __future__ import annotations

import os
from contextlib import suppress
from io import FileIO
from pathlib import Path
from zlib import crc32

import rerun as rr

from recordings.reading.rrd_file import END_OF_FILE, without_footer

_READ_WITHIN = 10.0


class Blocks:
    """What is logged to a recording stream, as blocks that make an ``.rrd`` file when laid end to end.

    Args:
        stream: Which must have no sink yet.
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._bytes = rr.binary_stream(stream)
        self._begun = False

    def take(self) -> memoryview:
        """The next block: everything that was logged since the one before."""
        written = self._bytes.read(flush=True, flush_timeout_sec=_READ_WITHIN)
        if not written:
            return memoryview(b"")
        begun, self._begun = self._begun, True
        return without_footer(written, with_header=not begun)

    def close(self) -> None:
        """Lets the stream go; what was not taken is lost, without Rerun's warning that it is."""
        self._stream.disconnect()
        self._bytes.read(flush=False)


class GrowingFile:
    """A file that gets its name with the first block; one that had the name stays until then.

    Args:
        path: The file.
        stream: What is logged to it is written; it must have no sink yet.
        overwrite: Whether one of that name may be replaced.
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
        """Whether the file is there."""
        return self._file is not None

    def write(self) -> None:
        """Writes what was logged since the last call.

        Raises:
            OSError: It is not written; what was written before is whole. Do not write more.
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
        """Ends the file; what was not written is lost. Closing twice is harmless.

        Raises:
            OSError: Its end is not written.
        """
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
    """A hidden name in the same folder, which no other process takes, for what is to become `path`.

    It has the file's own ending, in small letters: ezc3d adds that to any other.
    """
    return path.with_name(f".{crc32(path.name.encode()):08x}.{os.getpid()}.partial{path.suffix.lower()}")


def _write_whole(file: FileIO, block: bytes | memoryview, at: int) -> None:
    """Writes a block at the end, which is `at`, or nothing of it.

    Raises:
        OSError: It does not fit, say.
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
