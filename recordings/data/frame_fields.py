"""What a figure of each frame is: array in memory, component in a session's file, part of a checksum.

What is missing has two forms. A frame without a value, as ``clock_b`` where B gave no frame, has the figure's
*nothing*: its ``absent``, else NaN, else 0. A session without an *optional* figure, as ``truth`` of real
sensors, has None for all frames. Where an array is needed all the same,
:meth:`recordings.data.session_arrays.SessionArrays.filled` has nothing in every frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from fusion.body import Body
from recordings.data import layout

JOINTS = -1
"""Placeholder in a shape for the number of joints."""

Names = Callable[[Body], tuple[str, ...]]


@dataclass(frozen=True, eq=False)
class FrameField:
    """One figure of each frame.

    In memory it is an array of shape (T, *shape). In the file it is a component of an entity, or a field of
    a component that is a struct (``figures.fuse_ms``), or an argument of one of Rerun's archetypes
    (``Points3D:positions``). Figures that name the same component are stored one after the other in it.
    """

    entity: str  # place in the file
    component: str
    stored: type[np.generic]  # type in the file
    of: str = ""
    """Where a frame has its value, as attributes of attributes; empty: it is computed from other figures."""
    shape: tuple[int, ...] = ()  # shape for one frame; :data:`JOINTS` stands for the number of joints
    name: str = ""  # of the attribute of SessionArrays
    dtype: type[np.generic] = np.float64  # type in memory
    absent: int | None = None
    """Value in memory for a frame without a value; None: NaN, or 0 of a type without NaN."""
    optional: bool = False
    """Whether a session may lack the figure. Then it does not share its component with other figures."""
    step: float | None = None  # values are rounded to multiples of this, which makes a file smaller
    scale: float | None = None
    """The stored value is the value in memory times this: 1e3 stores metres as millimetres."""
    covered: bool = True  # by the checksum of its frame
    names: Names | None = None
    """Names indexed by the values; the file stores them as a dictionary. If `dtype` is signed, -1 means the
    last name."""

    def value(self, frame: Any) -> Any:
        """The value of a frame, or those of T frames; None if it has none."""
        for name in self.of.split("."):
            frame = None if frame is None else getattr(frame, name)
        return frame

    def shape_for(self, body: Body) -> tuple[int, ...]:
        """The shape for one frame of a body."""
        return tuple(len(body) if size == JOINTS else size for size in self.shape)

    def width(self, body: Body) -> int:
        """The number of values per frame of a body."""
        return int(np.prod(self.shape_for(body), dtype=np.int64))

    def nothing(self, body: Body, frames: int) -> NDArray[Any]:
        """(T, …) of absent values."""
        absent: float | None = self.absent
        if absent is None:
            absent = np.nan if np.issubdtype(self.dtype, np.floating) else 0
        return np.broadcast_to(np.array(absent, self.dtype), (frames, *self.shape_for(body)))

    def stacked(self, body: Body, values: Sequence[Any]) -> NDArray[Any] | None:
        """(T, …) from the value of each frame or None; None if it is optional and no frame has a value."""
        if self.optional and all(value is None for value in values):
            return None
        nothing = self.nothing(body, 1)[0]
        return self._in_memory(np.array([nothing if value is None else value for value in values]))

    def of_block(self, body: Body, values: Any, frames: int) -> NDArray[Any] | None:
        """(T, …) from values of T frames that are an array already, or the same in all of them."""
        if values is None:
            return None
        return self._in_memory(np.broadcast_to(values, (frames, *self.shape_for(body))))

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
