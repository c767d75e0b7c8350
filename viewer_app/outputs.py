"""Files that are either whole or not there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from zlib import crc32

from viewer_app.errors import UsageError

_LEAST_FREE = 20_000_000  # bytes; a session takes 5 MB a minute


def check_writable(path: Path, force: bool) -> None:
    """Finds out before the work, not after it, that a file could not be written.

    Raises:
        UsageError: The file exists and `force` is not set, or its folder is missing or read-only.
    """
    try:
        there = path.exists()
    except OSError as error:
        raise UsageError(f"{path} is no name for a file: {error.strerror or error}.") from None
    if path.is_dir():
        raise UsageError(f"{path} is a folder; name a file.")
    if there and not path.is_file():
        raise UsageError(f"{path} is no plain file; name another.")
    if there and not force:
        raise UsageError(f"{path} exists already. Choose another name, or overwrite it with --force.")
    if not path.parent.is_dir():
        raise UsageError(f"No folder {path.parent} to write {path.name} into.")
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"The folder {path.parent} is not writable.")
    free = shutil.disk_usage(path.parent).free
    if free < _LEAST_FREE:
        raise UsageError(f"The disk of {path.parent} is full: {free / 1e6:.0f} MB are free. Make room first.")


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path], force: bool) -> None:
    """:func:`check_writable` for all files that a command will write.

    Raises:
        UsageError: As there; or two outputs are one file, or an output is an input.
    """
    taken = {_real(path): f"is also read, as {path}" for path in inputs}
    for path in filter(None, outputs):
        if _real(path) in taken:
            raise UsageError(f"{path} cannot be written: it {taken[_real(path)]}. Choose another name.")
        taken[_real(path)] = "is to be written twice"
        check_writable(path, force)


def _real(path: Path) -> Path:
    """Where the path leads; a loop of links leads to itself, where ``Path.resolve`` raises."""
    return Path(os.path.realpath(path))


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Gives a temporary name beside `path`, renamed to it when all went well and removed when not.

    It has the file's own ending, in small letters: ezc3d adds that to any other.
    """
    path = _real(path)
    partial = path.with_name(f".{crc32(path.name.encode()):08x}.{os.getpid()}.partial{path.suffix.lower()}")
    try:
        yield partial
        partial.replace(path)
    except OSError as error:
        raise UsageError(f"{path} could not be written: {error.strerror or error}.") from error
    finally:
        partial.unlink(missing_ok=True)
