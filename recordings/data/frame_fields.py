"""The figures of a frame, one line each: array in memory, component in a session's file, part of a checksum.

Writer, reader and checksums iterate over :data:`FRAME_FIELDS`. The arrays are the attributes of
:class:`recordings.data.session_arrays.SessionArrays`, which has their descriptions.

What is missing has two forms. A frame without a value, as ``clock_b`` where B gave no frame, has the figure's
*nothing*: its ``absent``, else NaN, else 0. A session without an *optional* figure, as ``truth`` of real
sensors, has None for all frames; its first frame decides. Where an array is needed all the same,
:meth:`recordings.data.session_arrays.SessionArrays.filled` has nothing in every frame.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from fusion.body import Body
from fusion.facing.labels import HEADING_STEPS
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

    name: str  # of the attribute of SessionArrays
    dtype: type[np.generic]  # type in memory
    shape: tuple[int, ...]  # shape for one frame; :data:`JOINTS` stands for the number of joints
    entity: str  # place in the file
    component: str
    stored: type[np.generic]  # type in the file
    absent: int | None = None
    """Value in memory for a frame without a value; None: NaN, or 0 of a type without NaN."""
    optional: bool = False
    """Whether a session may lack the figure. Then it does not share its component with other figures."""
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


_QUALITY, _S, _A, _B = layout.QUALITY, layout.FUSED_SKELETON, layout.skeleton("a"), layout.skeleton("b")
_PLACE, _POINTS, _PLACEMENT = layout.kinect("b"), "Points3D:positions", "rotation_translation"
_CAPTURED, _STALE, _NO_FRAME = "sensors.captured_ns", "sensors.stale", layout.NO_FRAME
_J, _J3, _J4, _WEIGHT_STEP = (JOINTS,), (JOINTS, 3), (JOINTS, 4), 1.0 / 128.0  # finer steps are not visible
_i1, _i4, _i8, _u1, _u2, _bool = np.int8, np.int32, np.int64, np.uint8, np.uint16, np.bool_
_f2, _f4, _f8 = np.float16, np.float32, np.float64

# name; type and shape in memory; place and type in the file.
# Checksums cover the figures in this order: add new ones at the end, as optional ones.
_TABLE = (
    FrameField("skew_ns", _i8, (), _QUALITY, "figures.skew_ms", _f8, scale=1e-6),
    FrameField("clock_a", _i8, (), _QUALITY, _CAPTURED, _i8, absent=_NO_FRAME),
    FrameField("clock_b", _i8, (), _QUALITY, _CAPTURED, _i8, absent=_NO_FRAME),
    FrameField("positions_a", _f4, _J3, _A, _POINTS, _f4),
    FrameField("positions_b", _f4, _J3, _B, _POINTS, _f4),
    FrameField("states_a", _u1, _J, _S, layout.state("a"), _i1, names=state_names),
    FrameField("states_b", _u1, _J, _S, layout.state("b"), _i1, names=state_names),
    FrameField("weights_a", _f4, _J, _S, layout.weight("a"), _f2, step=_WEIGHT_STEP),
    FrameField("weights_b", _f4, _J, _S, layout.weight("b"), _f2, step=_WEIGHT_STEP),
    FrameField("misleading", _i4, _J, _S, "misleading_joint", _i1, names=no_joint_or_joint),
    FrameField("rotation", _f8, (3, 3), _PLACE, _PLACEMENT, _f8),
    FrameField("translation", _f8, (3,), _PLACE, _PLACEMENT, _f8),
    FrameField("fused", _f8, _J3, _S, _POINTS, _f4),
    FrameField("predicted", _bool, _J, _S, "predicted", _bool),
    FrameField("iterations", _i8, (), _QUALITY, "figures.iterations", _u2),
    FrameField("stale_a", _bool, (), _QUALITY, _STALE, _bool),
    FrameField("stale_b", _bool, (), _QUALITY, _STALE, _bool),
    FrameField("fuse_ms", _f8, (), _QUALITY, "figures.fuse_ms", _f4),
    FrameField("truth", _f8, _J3, layout.TRUTH_SKELETON, _POINTS, _f4, optional=True),
    FrameField("sigma", _f4, _J, _S, "sigma_mm", _f2, optional=True, scale=1e3),
    FrameField("exchanged", _i1, (2,), _QUALITY, "exchanged", _i1, optional=True),
    FrameField("witness_a", _f4, _J4, _A, "depth_witness", _f2, optional=True),
    FrameField("witness_b", _f4, _J4, _B, "depth_witness", _f2, optional=True),
    FrameField("side_doubt", _u1, (2,), _QUALITY, "side_doubt", _u1, optional=True),
    FrameField("heading", _f4, (3,), _QUALITY, "heading", _f2, optional=True, step=1.0 / HEADING_STEPS),
    FrameField("up", _f4, (3,), _QUALITY, "up", _f4, optional=True),
    FrameField("unix_ns", _i8, (), _QUALITY, "unix_ns", _i8, absent=_NO_FRAME, optional=True),
)
FRAME_FIELDS: Mapping[str, FrameField] = MappingProxyType({each.name: each for each in _TABLE})
"""The figures by name."""
