"""Columns of numbers for ``RecordingStream.send_columns``, made without Rerun's conversions.

Rerun converts the values of each argument of an archetype in Python, which takes longer than everything else
that is done with a frame. Here the type of each argument is asked of Rerun once; after that, Arrow arrays are
made directly.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from recordings.data import layout


class Batch:
    """One component at one time; what ``log`` takes for a ``DescribedComponentBatch``."""

    def __init__(self, descriptor: rr.ComponentDescriptor, values: pa.Array) -> None:
        self._descriptor, self._values = descriptor, values

    def component_descriptor(self) -> rr.ComponentDescriptor:
        """The component."""
        return self._descriptor

    def as_arrow_array(self) -> pa.Array:
        """The values."""
        return self._values


class Column(Batch):
    """One component at T times; what ``send_columns`` takes for a ``ComponentColumn``.

    Args:
        values: n values for each time, one after another.
        frames: T.
    """

    def __init__(self, descriptor: rr.ComponentDescriptor, values: pa.Array, frames: int) -> None:
        super().__init__(descriptor, values)
        self._frames = frames

    @staticmethod
    def of_data(name: str, values: pa.Array, frames: int) -> Column:
        """A component of our own."""
        return Column(_descriptor(name), values, frames)

    def at(self, frames: NDArray[np.int64]) -> Column:
        """The values of some of the times."""
        each = len(self._values) // max(self._frames, 1)
        chosen = (frames[:, None] * each + np.arange(each)).ravel()
        return Column(self.component_descriptor(), self._values.take(pa.array(chosen)), len(frames))

    def as_arrow_array(self) -> pa.Array:
        """(T,) lists of n values."""
        return pa.ListArray.from_arrays(_offsets(self._frames, len(self._values)), self._values)


class Times:
    """A column of times; what ``send_columns`` takes for a ``TimeColumn``.

    Args:
        times: (T,) int64 numbers, or durations in nanoseconds.
    """

    def __init__(self, timeline: str, times: NDArray[Any]) -> None:
        self._timeline, self._times = timeline, pa.array(times)

    @staticmethod
    def of_frames(frame: NDArray[np.int64], time_ns: NDArray[np.int64]) -> list[Times]:
        """Both timelines of a session."""
        return [Times(layout.FRAME, frame), Times(layout.TIME, time_ns.astype("timedelta64[ns]"))]

    def timeline_name(self) -> str:
        """The timeline."""
        return self._timeline

    def as_arrow_array(self) -> pa.Array:
        """(T,) times."""
        return self._times


def own_values(**values: Any) -> list[Any]:
    """Components of our own, each a value or a sequence of values of one type.

    The Arrow type follows from the Python type: bool, int64, float64 or text. ``rr.AnyValues`` would take
    the type that the first value of this name had in the process, and drop values that do not fit.
    """
    return [Batch(_descriptor(name), _own_array(value)) for name, value in values.items()]


def points(positions: NDArray[np.float32]) -> list[Any]:
    """What ``rr.Points3D.from_fields(positions=…)`` consists of; (n, 3) metres."""
    return [Batch(*converted(rr.Points3D, "positions", positions, len(positions)))]


def depth_image(blob: bytes, media_type: str, meter: float) -> list[Any]:
    """What ``rr.EncodedDepthImage`` with these arguments consists of.

    Args:
        meter: Units of the image in a metre.
    """
    descriptor, kind, same = _depth_image(media_type, meter)
    whole = np.array([0, len(blob)], dtype=np.int32)
    values = pa.ListArray.from_arrays(pa.array(whole), pa.array(np.frombuffer(blob, np.uint8)), type=kind)
    return [Batch(descriptor, values), *same]


def state_changes(states: Sequence[str]) -> list[Any]:
    """What ``rr.StateChange.columns`` makes of states at as many times, which takes it 0.2 ms."""
    return [Column(_state(), pa.array(states), len(states))]


def converted(
    archetype: Any, argument: str, values: NDArray[Any], count: int
) -> tuple[rr.ComponentDescriptor, pa.Array]:
    """Component and `count` values of an argument of one of Rerun's archetypes, as the archetype converts it.

    Args:
        archetype: ``rr.Points3D`` or another archetype whose arguments are numbers.
        values: (count, …) numbers; or (T, n, …), where `count` is T times n.
    """
    descriptor, kind = _like(archetype, argument)
    flat = np.ascontiguousarray(values).reshape(count, values.size // max(count, 1))
    if argument == "colors":  # 0xRRGGBBAA
        bytes_of = np.full((count, 4), 255, dtype=np.uint8)
        bytes_of[:, : flat.shape[1]] = flat
        flat = bytes_of.view(">u4").astype(np.uint32)
    elif argument == "mat3x3":  # column by column
        flat = np.ascontiguousarray(flat.reshape(count, 3, 3).transpose(0, 2, 1)).reshape(count, 9)
    if not pa.types.is_fixed_size_list(kind):
        return descriptor, pa.array(flat.ravel(), kind)
    each = pa.array(flat.ravel(), kind.value_type)
    return descriptor, pa.FixedSizeListArray.from_arrays(each, type=kind)


def _own_array(value: Any) -> pa.Array:
    values = np.atleast_1d(np.asarray(value)).ravel()
    return pa.array(values.tolist(), _OWN_TYPES[values.dtype.kind])


_OWN_TYPES = {"b": pa.bool_(), "i": pa.int64(), "u": pa.int64(), "f": pa.float64(), "U": pa.string()}


@cache
def _depth_image(media_type: str, meter: float) -> tuple[rr.ComponentDescriptor, pa.DataType, list[Any]]:
    """Component and type of the image's bytes, and the components that are the same for all images."""
    batches = rr.EncodedDepthImage(b"", media_type=media_type, meter=meter).as_component_batches()
    by_name = {batch.component_descriptor().component: batch for batch in batches}
    blob = by_name.pop("EncodedDepthImage:blob")
    return blob.component_descriptor(), blob.as_arrow_array().type, list(by_name.values())


@cache
def _state() -> rr.ComponentDescriptor:
    (batch,) = rr.StateChange(state="").as_component_batches()
    return batch.component_descriptor()


@cache
def _descriptor(name: str) -> rr.ComponentDescriptor:
    return rr.ComponentDescriptor(name)


@cache
def _like(archetype: Any, argument: str) -> tuple[rr.ComponentDescriptor, pa.DataType]:
    """Component and type of an argument, of a column that Rerun makes of zeros."""
    zeros = np.zeros((1, 3, 3) if argument == "mat3x3" else 1 if argument == "class_ids" else (1, 3))
    example = next(iter(archetype.columns(**{argument: zeros.astype(_EXAMPLES.get(argument, np.float32))})))
    return example.component_descriptor(), example.as_arrow_array().type.value_type


_EXAMPLES = {"colors": np.uint8, "class_ids": np.uint16}


@lru_cache(maxsize=64)
def _offsets(frames: int, values: int) -> pa.Array:
    """Where the values of each frame begin."""
    return pa.array(np.arange(frames + 1, dtype=np.int32) * np.int32(values // frames))
