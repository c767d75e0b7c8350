"""What a reader of skeleton files takes and gives: the bytes of a text file, and the recording in it."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from devices.people import RecordedPeople
from devices.sensor import DeviceError, SensorFrame
from fusion.body import Body

_KINDS = (
    (b"RRF", "a session or another Rerun recording; look at it with duplex review"),
    (b"\x1f\x8b", "compressed by gzip; unpack it first"),
    (b"PK\x03\x04", "a zip archive or a spreadsheet; save it as text"),
    (b"\x1aE\xdf\xa3", "a Matroska video; its name must end in .mkv"),
    (b"\xff\xfe", "UTF-16; save it as UTF-8"),
    (b"\xfe\xff", "UTF-16; save it as UTF-8"),
)
"""First bytes of files that are often taken for a skeleton file, and what to say about them."""
_FEWEST_NULS = 8  # bytes in a row that a power cut leaves; a single one may be a flipped bit


@dataclass(frozen=True, eq=False)
class ReadFile:
    """The content of a skeleton file."""

    body: Body
    people: RecordedPeople
    warnings: tuple[str, ...] = ()  # what the user should know about the file, a line each


def text_bytes(path: Path) -> bytes:
    """The bytes of a text file in UTF-8; see :func:`text_blocks`."""
    return b"".join(text_blocks(path))


def text_blocks(path: Path, size: int = -1) -> Iterator[bytes]:
    """The lines of a text file in UTF-8, in blocks of about this many bytes.

    Raises:
        DeviceError: The file is no regular file, is empty, has another format, or is not UTF-8.
        OSError: It cannot be read.
    """
    if path.exists() and not path.is_file():  # a pipe would be waited for without end
        raise DeviceError(f"{path} cannot be read: it is {'a folder' if path.is_dir() else 'not a file'}.")
    with path.open("rb") as file:
        start = file.read(1024)
        for magic, words in _KINDS:
            if start.startswith(magic):
                raise DeviceError(f"{path} is not a file of skeletons but {words}.")
        if b"\0" * _FEWEST_NULS in start:
            raise DeviceError(f"{path} is not text: it contains zero bytes.")
        read = 0
        while more := file.read(size):
            raw, start = start + more, b""
            if size > 0 and len(more) == size:
                end = raw.rfind(b"\n") + 1
                raw, start = raw[:end], raw[end:]
                if end == 0:  # no line ends here, or they are those of an old Mac
                    continue
            _check_text(path, raw, read)
            if read == 0 and not raw.strip():
                break
            read += len(raw)
            yield raw
        if start.strip():
            _check_text(path, start, read)
            yield start
        elif read == 0:
            raise DeviceError(f"{path} is empty.")


def _check_text(path: Path, raw: bytes, before: int) -> None:
    """Refuses what is not text; so many bytes of the file come before."""
    if raw.isascii() and b"\0" not in raw:
        return
    nuls = raw.find(b"\0" * _FEWEST_NULS)
    if nuls >= 0:
        line = _line(path, before + nuls)
        raise DeviceError(f"{path} is damaged: zero bytes in line {line}. Copy it again, or delete the rest.")
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError as error:
        byte = before + error.start
        raise DeviceError(
            f"{path} is not text in UTF-8: byte {byte + 1}, in line {_line(path, byte)}. Save it as UTF-8."
        ) from None


def _line(path: Path, byte: int) -> int:
    """The number of a byte's line, from 1."""
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            byte -= len(line)
            if byte < 0:
                return number
    raise AssertionError(f"{path} became shorter")


def in_time_order(
    path: Path, body: Body, frames: list[SensorFrame]
) -> tuple[RecordedPeople, tuple[str, ...]]:
    """The frames sorted by time, with a warning if they were not.

    Raises:
        DeviceError: Two frames have the same time.
    """
    ordered = sorted(frames, key=lambda frame: frame.time_ns)
    for before, after in pairwise(ordered):
        if before.time_ns == after.time_ns:
            raise DeviceError(f"{path}: two frames have the same time, {after.time_ns // 1000} µs.")
    for number, (before, after) in enumerate(pairwise(frames), start=1):
        if after.time_ns < before.time_ns:
            warning = f"{path}: the time goes back at frame {number}; the frames were sorted by time."
            return RecordedPeople.of(body, ordered), (warning,)
    return RecordedPeople.of(body, ordered), ()
