"""Storage of per-frame figures: array in memory, component in a session's file, part of a checksum.

The figures themselves are the attributes of :class:`recordings.session_arrays.SessionArrays`, one declaration
each. The writer, the reader and the checksums iterate over these declarations.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from fusion.body import Body
from recordings import layout

JOINTS = -1
"""Placeholder in a shape for the number of joints."""

Names = Callable[[Body], tuple[str, ...]]


@dataclass(frozen=True, eq=False)
class FrameField:
    """One per-frame figure.

    In memory it is an array of shape (T, *shape). In the file it is a component of an entity, or a field of
    a component that is a struct (``figures.fuse_ms``), or an argument of one of Rerun's archetypes
    (``Points3D:positions``). Figures that name the same component are stored one after the other in it.
    """

    dtype: type[np.generic]  # type in memory
    shape: tuple[int, ...]  # shape for one frame; :data:`JOINTS` stands for the number of joints
    entity: str  # place in the file
    component: str
    stored: type[np.generic]  # type in the file
    value: str | Callable[[Any], Any]
    """The value of a :class:`recordings.session_arrays.SessionFrame`: the path of an attribute, such as
    ``pair.a.time_ns``, or a function. None if there is none, or if ``a`` in the path is None."""
    absent: int | None = None
    """Value in memory for a frame without a value; None: NaN, or 0 of a type without NaN."""
    optional: bool = False
    """Whether a session may lack the figure, as sessions written before it was added do. The attribute is
    then None. An optional figure does not share its component with other figures."""
    step: float | None = None  # values are rounded to multiples of this, which makes a file smaller
    scale: float | None = None
    """The stored value is the value in memory times this: 1e3 stores metres as millimetres."""
    names: Names | None = None
    """Names indexed by the values; the file stores them as a dictionary. If `dtype` is signed, -1 means the
    last name."""

    def shape_for(self, body: Body) -> tuple[int, ...]:
        """The shape for one frame of a body."""
        return tuple(len(body) if size == JOINTS else size for size in self.shape)

    def width(self, body: Body) -> int:
        """The number of values per frame of a body."""
        return int(np.prod(self.shape_for(body), dtype=np.int64))

    def value_of(self, frame: Any) -> Any:
        """The value of a frame; None if there is none."""
        if not isinstance(self.value, str):
            return self.value(frame)
        value = frame
        for name in self.value.split("."):
            if value is None:
                return None
            value = getattr(value, name)
        return value

    def nothing(self, body: Body, frames: int) -> NDArray[Any]:
        """(T, …) of absent values."""
        absent: float | None = self.absent
        if absent is None:
            absent = np.nan if np.issubdtype(self.dtype, np.floating) else 0
        return np.broadcast_to(np.array(absent, self.dtype), (frames, *self.shape_for(body)))

    def stacked(self, body: Body, frames: Sequence[Any]) -> NDArray[Any] | None:
        """(T, …) values of the frames; None if the figure is optional and no frame has a value."""
        values = [self.value_of(frame) for frame in frames]
        missing = [k for k, value in enumerate(values) if value is None]
        if missing:
            if self.optional and len(missing) == len(values):
                return None
            nothing = self.nothing(body, 1)[0]
            for k in missing:
                values[k] = nothing
        return self._in_memory(np.array(values))

    def of_block(self, body: Body, block: Any) -> NDArray[Any] | None:
        """(T, …) values of frames that are arrays themselves; None if the figure is optional and absent."""
        values = self.value_of(block)
        if values is None:
            return None
        return self._in_memory(np.broadcast_to(values, (len(block), *self.shape_for(body))))

    def _in_memory(self, values: NDArray[Any]) -> NDArray[Any]:
        if self.step is not None:
            values = np.round(values / self.step) * self.step
        return values.astype(self.dtype, copy=False)

    def to_file(self, body: Body, values: NDArray[Any]) -> NDArray[Any]:
        """(T, …) in the representation of the file."""
        if self.names is not None and np.issubdtype(self.dtype, np.signedinteger):
            values = np.where(values < 0, len(self.names(body)) - 1, values)
        if self.scale is not None:
            values = values.astype(np.float64) * self.scale
        return values.astype(self.stored, copy=False)

    def from_file(self, body: Body, stored: NDArray[Any]) -> NDArray[Any]:
        """(T, …) in memory, converted from the file. The values of a damaged file are arbitrary."""
        values = stored.reshape(len(stored), *self.shape_for(body))
        if self.names is not None and np.issubdtype(self.dtype, np.signedinteger):
            values = np.where(values == len(self.names(body)) - 1, -1, values)
        if self.scale is not None:
            values = values.astype(np.float64) / self.scale  # not in float16
            if np.issubdtype(self.dtype, np.integer):
                values = np.rint(values)
        return values.astype(self.dtype, copy=False)

    def in_arrow(self, body: Body, values: NDArray[Any]) -> pa.Array:
        """The values of :meth:`to_file` as a flat Arrow array."""
        flat = pa.array(np.ascontiguousarray(values).ravel())
        if self.names is None:
            return flat
        return pa.DictionaryArray.from_arrays(flat, _dictionary(self.names(body)))

    def checked(self, body: Body, values: NDArray[Any]) -> NDArray[Any]:
        """(T, …) as covered by a checksum: real numbers as stored, integers as in memory."""
        if np.issubdtype(self.dtype, np.floating):
            return self.to_file(body, values)
        return values.astype(np.uint8) if self.dtype is np.bool_ else values


def per_frame(
    dtype: type[np.generic],
    shape: tuple[int, ...],
    entity: str,
    component: str,
    stored: type[np.generic],
    value: str | Callable[[Any], Any],
    **more: Any,
) -> Any:
    """Declares an attribute of a dataclass as a :class:`FrameField`; same arguments."""
    spec = FrameField(dtype, shape, entity, component, stored, value, **more)
    metadata = {"frame_field": spec}
    return field(default=None, metadata=metadata) if spec.optional else field(kw_only=True, metadata=metadata)


def frame_fields(table: Iterable[Any]) -> dict[str, FrameField]:
    """The figures among the fields of a dataclass, by name, in declaration order."""
    return {f.name: f.metadata["frame_field"] for f in table if "frame_field" in f.metadata}


def no_joint_or_joint(body: Body) -> tuple[str, ...]:
    """Names for joint indices, with a last name for -1 (none)."""
    return (*body.joints, "none")


def state_names(body: Body) -> tuple[str, ...]:
    """Names of tracking states, the same for all bodies."""
    del body
    return layout.STATE_NAMES


@cache
def _dictionary(names: tuple[str, ...]) -> pa.Array:
    return pa.array(names)
