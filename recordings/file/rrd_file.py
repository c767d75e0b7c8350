"""Reads an ``.rrd`` file into columns of numbers, even if it is cut off, damaged or still growing.

Rerun's own reader reads nothing of a file that is cut off or damaged. The file is a sequence of messages,
each preceded by its kind and length. A message of kind 2 holds one chunk of one entity as an Arrow stream
compressed with LZ4. A message that cannot be decompressed is skipped, and the rest is read.
"""

from __future__ import annotations

import math
import mmap
import os
import struct
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from devices.arrow_numbers import numbers_of
from devices.input_file import open_input, reading
from fusion.support.large_arrays import GrowingArray, give_back
from recordings.data import layout
from recordings.errors import MissingFileError, RecordingError

PROPERTIES = "/__properties"

_MAGIC = b"RRF2"
_KEPT = 32_000_000  # bytes of the file that are in memory at once
_FILE_HEADER = 12
_MESSAGE = struct.Struct("<QQ")  # kind, length of the content
_END, _CHUNK, _LAST_KIND = 0, 2, 3
# field numbers of a chunk's message, and some of their values
_STORE, _PACKING, _SIZE, _PAYLOAD = 1, 2, 3, 5
_RECORDING, _LZ4 = 1, 2
END_OF_FILE = _MESSAGE.pack(_END, 0)
"""Ends a file that has no table of contents."""
_ROW_ID = "row"  # bytes that increase with every row that is logged
_LZ4_RATIO = 255  # the most that LZ4 can pack: a message that claims more would only fill the memory
_ENTITY = b"rerun:entity_path"
# The part of "EncodedDepthImage" that LZ4 cannot pack: "depth" occurs before, in the entity's path.
_IMAGE, _IMAGE_WITHIN = b"Encoded", 2048


_DAMAGED = (
    *(pa.ArrowException, ValueError, TypeError, LookupError, AttributeError, OSError, MemoryError),
    StopIteration,  # from a stream without a batch
)
"""Exceptions that unpacking invalid bytes can cause."""


@dataclass
class Columns:
    """The content of a file, except images."""

    properties: dict[str, dict[str, list[Any]]] = field(default_factory=dict)
    """Values by property and component name."""
    values: dict[tuple[str, str], tuple[NDArray[np.int64], NDArray[Any]]] = field(default_factory=dict)
    """By (entity, component): frame numbers (N,) and values (N, …) as stored."""
    texts: list[tuple[int | None, int | None, dict[str, Any]]] = field(default_factory=list)
    """Entries of the text log: (frame or None, time or None, {component: value})."""
    logged: dict[str, list[tuple[int, dict[str, Any]]]] = field(default_factory=dict)
    """By entity, for entities logged occasionally: (frame, {component: values})."""
    damage: str | None = None  # description of the damage; None if the file is whole
    identity: tuple[str, str] | None = None  # application and recording id
    entities: Entities = field(default_factory=dict)


_Parts = dict[tuple[str, str], tuple[GrowingArray, GrowingArray, NDArray[Any]]]
"""By (entity, component): frame numbers, values, and an empty array like these."""


def read_columns(path: Path, wanted: Collection[tuple[str, str]]) -> Columns:
    """Reads properties, events, calibrations and the wanted components. Raises as :class:`RrdFile`."""
    found, entities = Columns(), {entity for entity, _ in wanted}
    parts: _Parts = {}
    with RrdFile(path, found.entities) as file:
        for entity, batch in file.chunks(images=False):
            if not _take(entity, batch, found) and entity in entities:
                _take_numbers(entity, batch, wanted, parts)
        found.damage, found.identity = file.damage, file.identity()
    arrays = GrowingArray.wholes(array for frames, values, _ in parts.values() for array in (frames, values))
    found.values = dict(zip(parts, zip(arrays[::2], arrays[1::2], strict=True), strict=True))
    return found


Entities = dict[tuple[int, ...], str]
"""Of chunks that were unpacked, by file, its size and time, and their first byte: none is in vain again."""


class RrdFile:
    """The messages that a file has at the time of opening.

    Args:
        entities: Known already; more are added.

    Raises:
        RecordingError: The file cannot be read, or is not an .rrd file.
    """

    def __init__(self, path: Path, entities: Entities | None = None) -> None:
        self.damage: str | None = None
        self._unread: list[tuple[int, int]] = []
        self._path = path
        with reading(path, RecordingError, MissingFileError, "session"), open_input(path) as file:
            start = file.read(_FILE_HEADER)
            if start[:4] != _MAGIC:
                raise RecordingError(f"{path} is not a session: it does not begin like an .rrd file.")
            self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            now = os.fstat(file.fileno())
        self._file = now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns
        self._entities = {} if entities is None else entities

    def __enter__(self) -> RrdFile:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._data.close()

    def messages(self) -> Iterator[tuple[int, int, int]]:
        """Kind, start and end of each message's content, up to the end or the first incomplete message."""
        offset, size, kept_from = _FILE_HEADER, len(self._data), 0
        while offset + _MESSAGE.size <= size:
            if offset > kept_from + _KEPT:
                give_back(self._data)
                kept_from = offset
            kind, length = _MESSAGE.unpack_from(self._data, offset)
            begin, end = offset + _MESSAGE.size, offset + _MESSAGE.size + length
            if kind > _LAST_KIND:
                self._wrong(f"byte {offset} is damaged")
                return
            if end > size:
                self._wrong(f"it is cut off at byte {size}")
                return
            yield kind, begin, end
            if kind == _END:
                if (other := self._data.find(_MAGIC + b"\0", end)) >= 0:
                    self._wrong(f"another recording begins at byte {other}, which is not read")
                return
            offset = end
        self._wrong("it was not ended")

    def chunks(
        self, images: bool, wanted: Callable[[str], bool] = bool
    ) -> Iterator[tuple[str, pa.RecordBatch]]:
        """Entity and content of each chunk of wanted entities, in the order of writing. Images are not even
        decompressed unless `images`.
        """
        for kind, begin, end in self.messages():
            if kind != _CHUNK:
                continue
            if not images and self._data.find(_IMAGE, begin, min(begin + _IMAGE_WITHIN, end)) >= 0:
                continue
            if (known := self._entities.get((*self._file, begin))) is not None and not wanted(known):
                continue
            try:
                entity, batch = _unpack(self._data[begin:end])
            except _DAMAGED:
                self._wrong(f"the message at byte {begin} is damaged")
                self._unread.append((begin, end))
                continue
            self._entities[*self._file, begin] = sys.intern(entity)
            if wanted(entity):
                yield entity, batch

    def identity(self) -> tuple[str, str] | None:
        """Application and recording id, by the first whole chunk; None without one."""
        for kind, begin, end in self.messages():
            if kind == _CHUNK:
                with suppress(*_DAMAGED):
                    store = _fields(_fields(self._data[begin:end])[_STORE])
                    if store.get(1) == _RECORDING:
                        return _fields(store[3])[1].decode(), store[2].decode()
        return None

    def unread(self, entity: str) -> int:
        """Number of requested chunks that could not be unpacked and seem to belong to an entity."""
        path = entity.encode()
        return sum(
            self._data.find(path, begin, min(begin + _IMAGE_WITHIN, end)) >= 0 for begin, end in self._unread
        )

    def _wrong(self, what: str) -> None:
        self.damage = self.damage or what


def damage_of(path: Path) -> str | None:
    """Description of a damaged end of a file; None if the file is whole. Raises as :class:`RrdFile`."""
    with RrdFile(path) as file:
        for _ in file.messages():
            pass
        return file.damage


def without_footer(rrd: bytes, with_header: bool) -> memoryview:
    """The messages of a whole ``.rrd`` in memory, so that more messages can follow.

    Rerun's binary stream returns a whole file with header and footer at each read.
    """
    offset = _FILE_HEADER
    while offset < len(rrd):
        kind, length = _MESSAGE.unpack_from(rrd, offset)
        if kind == _END:
            break
        offset += _MESSAGE.size + length
    return memoryview(rrd)[0 if with_header else _FILE_HEADER : offset]


def _unpack(message: bytes) -> tuple[str, pa.RecordBatch | None]:
    """Entity and content of a chunk; of a blueprint neither."""
    fields = _fields(message)
    if _fields(fields[_STORE]).get(1) != _RECORDING:
        return "", None
    payload = fields[_PAYLOAD]
    if fields[_PACKING] == _LZ4:
        if fields[_SIZE] > _LZ4_RATIO * len(payload):
            raise ValueError("claims more than it can hold")
        payload = pa.Codec("lz4_raw").decompress(payload, fields[_SIZE])
    with pa.ipc.open_stream(payload) as stream:
        batch = stream.read_next_batch()
    batch.validate(full=True)
    for column in batch.schema:
        _decode_names(column.type)
    if len(set(batch.schema.names)) != len(batch.schema.names):
        raise ValueError("two columns of one name")
    return (batch.schema.metadata or {})[_ENTITY].decode(), batch


def _decode_names(of: pa.DataType) -> None:
    """Raises UnicodeDecodeError for a nested field name that is not text; Arrow's validation does not check
    this."""
    for k in range(of.num_fields):
        within = of.field(k)
        str(within.name)
        _decode_names(within.type)


def _fields(message: bytes) -> dict[int, Any]:
    """The fields of a protobuf message by number; each value is an int or bytes."""
    fields: dict[int, Any] = {}
    offset = 0
    while offset < len(message):
        tag, offset = _varint(message, offset)
        wire = tag & 7
        if wire == 0:
            fields[tag >> 3], offset = _varint(message, offset)
            continue
        if wire == 2:
            length, offset = _varint(message, offset)
        else:
            length = {1: 8, 5: 4}[wire]
        if offset + length > len(message):
            raise ValueError("a field is longer than its message")
        fields[tag >> 3] = message[offset : offset + length]
        offset += length
    return fields


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while shift < 70:
        byte = message[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
    raise ValueError("a number has no end")


def _take(entity: str, batch: pa.RecordBatch, found: Columns) -> bool:
    """Takes what is no numbers of frames; whether it was that."""
    names = batch.schema.names
    if entity.startswith(f"{PROPERTIES}/"):
        values = found.properties.setdefault(entity.removeprefix(f"{PROPERTIES}/"), {})
        for name in names[1:]:
            value = batch.column(name).to_pylist()
            if value and isinstance(value[-1], list) and value[-1]:
                values[name] = value[-1]
    elif entity == layout.EVENTS:
        found.texts += _texts(batch)
        found.texts.sort(
            key=lambda text: text[2][_ROW_ID]
        )  # chunks are not always in the order of their rows
    elif entity == layout.CALIBRATION and layout.FRAME in names:
        of_entity = found.logged.setdefault(entity, [])
        components = [name for name in names[1:] if name not in (layout.FRAME, layout.TIME, "log_time")]
        for frame, _, row in _texts(batch):
            of_entity.append((frame or 0, {name: row[name] for name in components}))
    else:
        return False
    return True


def _take_numbers(
    entity: str, batch: pa.RecordBatch, wanted: Collection[tuple[str, str]], parts: _Parts
) -> None:
    names = batch.schema.names
    if layout.FRAME not in names:
        return
    if batch.column(layout.FRAME).type != pa.int64() or batch.column(layout.FRAME).null_count:
        return
    frames = numbers_of(batch.column(layout.FRAME))
    for name, column in [*zip(names, batch.columns, strict=True)][1:]:
        if name == layout.FRAME:
            continue
        for field_name, of_field in _fields_of(name, column):
            dense = _dense(of_field) if (entity, field_name) in wanted else None
            if dense is None or len(dense) != len(frames):
                continue
            of_frames, of_values, like = parts.setdefault(
                (entity, field_name), (GrowingArray(), GrowingArray(), dense[:0].copy())
            )
            if dense.shape[1:] == like.shape[1:] and dense.dtype == like.dtype:
                of_frames.append(frames.copy())  # a view would keep the whole chunk in memory
                of_values.append(dense.copy())


def _texts(batch: pa.RecordBatch) -> list[tuple[int | None, int | None, dict[str, Any]]]:
    def column(name: str) -> list[Any]:
        if name not in batch.schema.names:
            return [None] * batch.num_rows
        values = batch.column(name)
        if pa.types.is_duration(values.type) or pa.types.is_timestamp(values.type):
            values = values.cast(pa.int64())  # without pandas, Arrow makes no Python times of ns
        return list(values.to_pylist())

    rows = {name: column(name) for name in batch.schema.names[1:]}
    rows[_ROW_ID] = [row if isinstance(row, bytes) else b"" for row in batch.column(0).to_pylist()]
    return [
        (frame, time, {name: values[k] for name, values in rows.items()})
        for k, (frame, time) in enumerate(zip(column(layout.FRAME), column(layout.TIME), strict=True))
    ]


def _fields_of(name: str, column: pa.Array) -> Iterator[tuple[str, pa.Array]]:
    """Splits a column of structs into ``name.field`` columns; yields any other column unchanged."""
    if not (pa.types.is_list(column.type) and pa.types.is_struct(column.type.value_type)):
        yield name, column
    elif column.null_count == 0 and column.values.null_count == 0:
        for k, of_field in enumerate(column.values.type):
            values = column.values.field(k)
            yield f"{name}.{of_field.name}", pa.ListArray.from_arrays(column.offsets, values)


def _dense(column: pa.Array) -> NDArray[Any] | None:
    """(N, …) values of a list column; None if its rows differ in length or are not numbers.

    For a dictionary of names the values are the indices.
    """
    shape = [len(column)]
    if pa.types.is_list(column.type) or pa.types.is_large_list(column.type):
        lengths = np.diff(numbers_of(column.offsets))
        if column.null_count or not lengths.size or (lengths != lengths[0]).any():
            return None
        shape.append(int(lengths[0]))
        column = column.flatten()
    while pa.types.is_fixed_size_list(column.type):
        shape.append(column.type.list_size)
        column = column.flatten()
    if pa.types.is_temporal(column.type):
        if column.type.bit_width != 64:  # dates
            return None
        column = column.view(pa.int64())
    if pa.types.is_dictionary(column.type):
        column = column.indices
    if column.null_count or not (pa.types.is_primitive(column.type)):
        return None
    values = numbers_of(column)
    return values.reshape(shape) if values.size == math.prod(shape) else None
