"""An ``.rrd`` file as columns of numbers, whatever happened to it: cut off, damaged, or still growing.

Rerun's reader gives up on a file that ends inside a message, so such a file is read from a copy that ends
before. Where a message in the middle cannot be decoded, what stands before it is given.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from rerun.chunk import Chunk, RrdReader

from recordings import layout
from recordings.errors import RecordingError

_MAGIC = b"RRF2"
_FILE_HEADER = 12
_MESSAGE = struct.Struct("<QQ")  # kind, length of what follows
_END, _LAST_KIND = 0, 3
_LZ4_RATIO = (
    255  # the most that LZ4 can pack: a message that claims more is damaged, and would fill the memory
)
PROPERTIES = "/__properties"


@dataclass
class Columns:
    """What a file holds.

    Attributes:
        properties: Values by property and component name.
        values: By (entity, component): frame numbers (N,) and a value each, (N, …), as stored.
        texts: Of the text log: (frame or None, time or None, {component: value}).
        damage: Why reading ended early; None where it did not.
    """

    properties: dict[str, dict[str, list[Any]]] = field(default_factory=dict)
    values: dict[tuple[str, str], tuple[NDArray[np.int64], NDArray[Any]]] = field(default_factory=dict)
    texts: list[tuple[int | None, int | None, dict[str, Any]]] = field(default_factory=list)
    damage: str | None = None


def read_columns(path: Path, without: Sequence[str]) -> Columns:
    """Everything in the file but the entities named.

    Args:
        path: The file.
        without: Entities to leave out, subtrees with ``/**``; of a whole file they are not even read.

    Raises:
        RecordingError: It cannot be read, or is no such file.
    """
    found = Columns()
    parts: dict[tuple[str, str], list[tuple[NDArray[np.int64], NDArray[Any]]]] = {}
    with chunks(path, drop=without) as source:
        try:
            for chunk in source:
                _take(chunk, found, parts)
        except _Damaged as damaged:
            found.damage = str(damaged)
        if source.cut is not None:
            found.damage = found.damage or source.cut
    for key, pieces in parts.items():
        shape = pieces[0][1].shape[1:]
        fitting = [p for p in pieces if p[1].shape[1:] == shape and p[1].dtype == pieces[0][1].dtype]
        found.values[key] = (
            np.concatenate([frames for frames, _ in fitting]),
            np.concatenate([values for _, values in fitting]),
        )
    return found


class _Damaged(Exception):
    """A message in the middle of the file that cannot be decoded."""


@dataclass
class ChunkSource:
    """The chunks of a file in the order they were written, up to the first that cannot be decoded.

    Attributes:
        cut: Why the file was read from its beginning only; None where it is whole.
    """

    reader: RrdReader
    only: str | None
    drop: Sequence[str]
    cut: str | None

    def __iter__(self) -> Iterator[pa.RecordBatch]:
        """Chunks as record batches.

        Raises:
            _Damaged: A message cannot be decoded.
        """
        try:
            try:
                stream = self.reader.store().stream()
            except (RuntimeError, ValueError):  # no footer: a file that was not ended
                stream = self.reader.stream()
            for entity in self.drop:
                stream = stream.drop(content=entity)
            if self.only is not None:
                stream = stream.filter(content=self.only)
            for chunk in stream:
                yield chunk
        except GeneratorExit:
            raise
        except BaseException as error:
            if not _is_decoding(error):
                raise
            raise _Damaged(_one_line(error)) from None


@contextmanager
def chunks(path: Path, only: str | None = None, drop: Sequence[str] = ()) -> Iterator[ChunkSource]:
    """Opens a file.

    Args:
        path: The file.
        only: The one entity wanted; all where None.
        drop: Entities not wanted.

    Raises:
        RecordingError: It cannot be read, or is no such file.
    """
    end, cut = _whole_messages(path)
    with tempfile.TemporaryDirectory(prefix="duplex-") as folder:
        readable = path if cut is None else _beginning(path, end, Path(folder) / "whole.rrd")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about the missing footer of a file that was not ended
            try:
                reader = RrdReader(readable)
                recordings = reader.recordings()
            except BaseException as error:
                if not _is_decoding(error):
                    raise
                if cut is not None:
                    raise RecordingError(f"{path} is damaged throughout: {_one_line(error)}.") from None
                cut = f"its table of contents is damaged ({_one_line(error)})"
                readable = _beginning(path, end, Path(folder) / "whole.rrd")
                reader, recordings = _reopen(path, readable)
            if not recordings:
                raise RecordingError(f"{path} holds no recording.")
            yield ChunkSource(reader, only, drop, cut)


def _reopen(path: Path, readable: Path) -> tuple[RrdReader, list[Any]]:
    try:
        reader = RrdReader(readable)
        return reader, reader.recordings()
    except BaseException as error:
        if not _is_decoding(error):
            raise
        raise RecordingError(f"{path} is damaged throughout: {_one_line(error)}.") from None


def _whole_messages(path: Path) -> tuple[int, str | None]:
    """Where the last whole message before the footer ends, and what is wrong after it."""
    try:
        size = path.stat().st_size
        if path.is_dir():
            raise RecordingError(f"{path} is a folder, not a session.")
        with path.open("rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise RecordingError(f"{path} is no session: it does not begin as an .rrd file does.")
            if size <= _FILE_HEADER:
                raise RecordingError(f"{path} is empty: the session was cut off before its first frame.")
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                return _walk(data, min(size, len(data)))
    except FileNotFoundError:
        raise RecordingError(f"No session {path}.") from None
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from None


def without_footer(rrd: bytes, with_header: bool) -> bytes:
    """The messages of a whole ``.rrd`` in memory, to be followed by more.

    Rerun's binary stream gives a whole file, header and footer, each time it is read.
    """
    at = _FILE_HEADER
    while at < len(rrd):
        kind, length = _MESSAGE.unpack_from(rrd, at)
        if kind == _END:
            break
        at += _MESSAGE.size + length
    return rrd[0 if with_header else _FILE_HEADER : at]


def damage_of(path: Path) -> str | None:
    """What is wrong with how a file ends; None where it is whole.

    Raises:
        RecordingError: It cannot be read, or is no such file.
    """
    return _whole_messages(path)[1]


def _walk(data: mmap.mmap, size: int) -> tuple[int, str | None]:
    at = _FILE_HEADER
    while at + _MESSAGE.size <= size:
        kind, length = _MESSAGE.unpack_from(data, at)
        after = at + _MESSAGE.size + length
        if kind > _LAST_KIND:
            return at, f"the message at byte {at} is damaged"
        if after > size:
            return at, f"it is cut off at byte {size}"
        if kind == _END:
            return at, None if after < size else "its footer is missing"
        if kind == 2 and _claims_too_much(data[at + _MESSAGE.size : after]):
            return at, f"the message at byte {at} is damaged"
        at = after
    return at, "it was not ended"


def _claims_too_much(message: bytes) -> bool:
    """Whether an ArrowMsg claims to unpack to more than its bytes can hold (its field 3, a varint)."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        wire = tag & 7
        if wire == 0:
            value, at = _varint(message, at)
            if tag >> 3 == 3:
                return value > _LZ4_RATIO * len(message)
        elif wire == 2:
            length, at = _varint(message, at)
            at += length
        else:
            at += {1: 8, 5: 4}.get(wire, len(message))
    return False


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(message) and shift < 70:
        byte = message[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            break
    return value, at


def _beginning(path: Path, end: int, copy: Path) -> Path:
    with path.open("rb") as source, copy.open("wb") as target:
        at = 0
        while at < end:
            sent = os.sendfile(target.fileno(), source.fileno(), at, end - at)
            if sent == 0:
                break
            at += sent
    return copy


def _take(
    chunk: Chunk,
    found: Columns,
    parts: dict[tuple[str, str], list[tuple[NDArray[np.int64], NDArray[Any]]]],
) -> None:
    entity = chunk.entity_path
    batch = chunk.to_record_batch()
    names = batch.schema.names
    if chunk.is_static:
        if entity.startswith(f"{PROPERTIES}/"):
            values = found.properties.setdefault(entity.removeprefix(f"{PROPERTIES}/"), {})
            for name in names[1:]:
                values[name] = batch.column(name).to_pylist()[-1]
        return
    if entity == layout.EVENTS:
        found.texts += _texts(batch)
        return
    if layout.FRAME not in names:
        return
    frames = np.asarray(batch.column(layout.FRAME).to_numpy(zero_copy_only=False))
    if frames.dtype != np.int64:
        return
    for name, column in [*zip(names, batch.columns, strict=True)][1:]:
        if name == layout.FRAME:
            continue
        values = _dense(column)
        if values is not None and len(values) == len(frames):
            parts.setdefault((entity, name), []).append((frames, values))


def _texts(batch: pa.RecordBatch) -> list[tuple[int | None, int | None, dict[str, Any]]]:
    def column(name: str) -> list[Any]:
        if name not in batch.schema.names:
            return [None] * batch.num_rows
        values = batch.column(name)
        if pa.types.is_duration(values.type):
            values = values.cast(pa.int64())
        return list(values.to_pylist())

    rows = {name: column(name) for name in batch.schema.names[1:]}
    return [
        (frame, time, {name: values[k] for name, values in rows.items()})
        for k, (frame, time) in enumerate(zip(column(layout.FRAME), column(layout.TIME), strict=True))
    ]


def _dense(column: pa.Array) -> NDArray[Any] | None:
    """(N, …) of a list column whose rows are of one length; None where they are not, or are no numbers."""
    shape = [len(column)]
    if pa.types.is_list(column.type) or pa.types.is_large_list(column.type):
        lengths = np.unique(np.diff(np.asarray(column.offsets)))
        if column.null_count or len(lengths) != 1:
            return None
        shape.append(int(lengths[0]))
        column = column.flatten()
    while pa.types.is_fixed_size_list(column.type):
        shape.append(column.type.list_size)
        column = column.flatten()
    if pa.types.is_duration(column.type):
        column = column.cast(pa.int64())
    if column.null_count or not (pa.types.is_primitive(column.type)):
        return None
    values = np.asarray(column.to_numpy(zero_copy_only=False))
    return values.reshape(shape) if values.size == np.prod(shape) else None


def _is_decoding(error: BaseException) -> bool:
    """Whether this is how Rerun or Arrow say that bytes make no sense, a panic in Rust among them."""
    return isinstance(
        error, (RuntimeError, ValueError, TypeError, OSError, MemoryError, pa.ArrowException)
    ) or (type(error).__name__ == "PanicException")


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200].rstrip(".")
