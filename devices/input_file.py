"""Input files: regular ones, which are neither waited for nor without end."""

import errno
import math
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from devices.sensor import DeviceError, MissingRecordingError
from fusion.errors import DuplexError

LARGEST_TEXT = 64 << 20
"""Bytes of a text that is read at once: calibrations, tables of names, manifests."""


def check_input(path: Path) -> None:
    """Refuses what is not a regular file: a pipe or a device would be waited for.

    Raises:
        FileNotFoundError: There is no such file.
        OSError: It is not a regular file, or no name of one.
    """
    try:
        mode = path.stat().st_mode
    except ValueError as error:  # a zero byte
        raise OSError(errno.EINVAL, f"it is no name of a file ({error})", str(path)) from None
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is not a file", str(path))


def open_input(path: Path, most: float = math.inf) -> BufferedReader:
    """Opens a regular file of at most so many bytes for reading.

    Raises:
        OSError: As :func:`check_input`, or it is larger or cannot be opened.
    """
    check_input(path)
    if path.stat().st_size > most:
        raise OSError(errno.EFBIG, f"it has more than {int(most) >> 20} MB", str(path))
    opened = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    return os.fdopen(opened, "rb")


def input_text(path: Path, encoding: str = "utf-8", errors: str = "strict", most: int = LARGEST_TEXT) -> str:
    """The text of a regular file of at most so many bytes.

    Raises:
        OSError: As :func:`open_input`, or it is larger.
        UnicodeDecodeError: It is not such a text, and `errors` are strict.
    """
    with open_input(path, most) as file:
        return file.read().decode(encoding, errors)


@contextmanager
def reading(
    path: Path | str, refused: type[DuplexError], missing: type[DuplexError], called: str = ""
) -> Iterator[None]:
    """Within the block, what the system says of a file is said in one line.

    Raises:
        DuplexError: `missing` if there is no such file; `refused` if it cannot be read, or not in the memory
            of this machine.
    """
    name = f"The {called} {path}" if called else path
    try:
        yield
    except FileNotFoundError:
        raise missing(f"No {called or 'file'} {path}.") from None
    except OSError as error:
        raise refused(f"{name} cannot be read: {error.strerror or error}.") from None
    except MemoryError:
        raise refused(f"{name} is too large for the memory of this machine.") from None


def check_recording(path: Path) -> None:
    """:func:`check_input` for a file that a library opens.

    Raises:
        DeviceError: There is no such file, or it is not a regular one.
    """
    with reading(path, DeviceError, MissingRecordingError):
        check_input(path)
