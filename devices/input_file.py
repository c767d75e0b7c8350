"""Input files: regular ones, which are neither waited for nor without end."""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

from devices.sensor import DeviceError, MissingRecordingError

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


def open_input(path: Path) -> BufferedReader:
    """Opens a regular file for reading.

    Raises:
        OSError: As :func:`check_input`, or it cannot be opened.
    """
    check_input(path)
    opened = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    return os.fdopen(opened, "rb")


def input_text(path: Path, encoding: str = "utf-8") -> str:
    """The text of a regular file of at most :data:`LARGEST_TEXT` bytes.

    Raises:
        OSError: As :func:`open_input`, or it is larger.
        UnicodeDecodeError: It is not such a text.
    """
    with open_input(path) as file:
        content = file.read(LARGEST_TEXT + 1)
    if len(content) > LARGEST_TEXT:
        raise OSError(errno.EFBIG, f"it has more than {LARGEST_TEXT >> 20} MB", str(path))
    return content.decode(encoding)


def check_recording(path: Path) -> None:
    """:func:`check_input` for a file that a library opens.

    Raises:
        DeviceError: There is no such file, or it is not a regular one.
    """
    try:
        check_input(path)
    except FileNotFoundError:
        raise MissingRecordingError(f"No file {path}.") from None
    except OSError as error:
        raise DeviceError(f"{path} cannot be read: {error.strerror or error}.") from None
