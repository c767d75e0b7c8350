"""The entities of a frame in a session, with their values and precision.

A row of an entity costs 15 bytes for frame number and time, and each column 4 more bytes. Therefore related
values share an entity, and many of them share a struct. Names are stored as dictionaries: the file holds
numbers, and the viewer shows words when a joint is clicked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from recordings import layout
from recordings.frame_fields import FrameField
from recordings.session_arrays import SessionArrays
from recordings.writing.arrow_columns import Column
from recordings.writing.checksums import (
    FRAME_CRC,
    FUSED_CRC,
    FusedChecks,
    frame_checksums,
    fused_checksums,
    joint_digests,
)
from recordings.writing.shown_figures import SHOWN_FIGURES

_BONES_EVERY = 2  # plot every second frame; S_A, S_B and S* are logged every frame


@dataclass(frozen=True)
class FrameStream:
    """The data of one entity over some frames.

    Attributes:
        entity: The entity path.
        rows: The frames.
        archetype: The drawn archetype, with ``values[field]`` (T, n, …), or (T, …) if n is None.
        data: Components by name: n values for each of the T frames, as a flat array.
    """

    entity: str
    rows: SessionArrays
    archetype: Any = None
    values: tuple[dict[str, NDArray[Any]], int | None] = ({}, None)
    data: dict[str, pa.Array] | None = None

    def of_first(self) -> list[Any]:
        """The data to log for the first frame."""
        logged = []
        if self.archetype is not None:
            logged.append(self.archetype(**{name: values[0] for name, values in self.values[0].items()}))
        if self.data is not None:
            each = {name: len(values) // len(self.rows) for name, values in self.data.items()}
            logged.append(rr.AnyValues(**{name: self.data[name][:n] for name, n in each.items()}))
        return logged

    def columns(self) -> list[Column]:
        """The data to send for all frames."""
        frames = len(self.rows)
        values, each = self.values
        sent = [
            Column.of_archetype(self.archetype, name, of, frames * (each or 1), frames)
            for name, of in values.items()
        ]
        return sent + [Column.of_data(name, of, frames) for name, of in (self.data or {}).items()]


PLOTTED = frozenset({layout.QUALITY, layout.BONES, layout.kinect("b")})
"""Entities that are plotted or only read back; all others are drawn into the scene."""


def frame_streams(
    rows: SessionArrays, checks: FusedChecks | None = None, *, drawn: bool = True, plotted: bool = True
) -> Iterator[FrameStream]:
    """All data logged per frame: the recorded figures, then figures derived for the viewer.

    Args:
        rows: The frames, one or more.
        checks: Checks of S* in float64, if `rows` come from a file in float32.
        drawn: Whether entities that are drawn into the scene are included.
        plotted: Whether the other entities are, see :data:`PLOTTED`.
    """

    def left_out(entity: str) -> bool:
        return not (plotted if entity in PLOTTED else drawn)

    arguments: dict[str, dict[str, NDArray[Any]]] = {}  # by entity and "archetype:argument"
    data: dict[str, dict[str, pa.Array]] = {}  # by entity and component
    flat: dict[tuple[str, str], list[tuple[FrameField, NDArray[Any]]]] = {}
    for _, spec, values in rows.figures():
        if left_out(spec.entity):
            continue
        stored = spec.to_file(rows.body, values)
        if ":" in spec.component:
            arguments.setdefault(spec.entity, {})[spec.component] = stored
        else:
            flat.setdefault((spec.entity, spec.component), []).append((spec, stored))
    for (entity, component), parts in flat.items():
        spec, stored = parts[0]
        if len(parts) > 1:
            stored = np.concatenate([values.reshape(len(rows), -1) for _, values in parts], axis=1)
        data.setdefault(entity, {})[component] = spec.in_arrow(rows.body, stored)
    for shown in SHOWN_FIGURES:
        derived = None if left_out(shown.entity) else shown.values(rows)
        if derived is None:
            continue
        if ":" in shown.component:
            arguments.setdefault(shown.entity, {})[shown.component] = derived
        else:
            data.setdefault(shown.entity, {})[shown.component] = _vectors(derived)
    if plotted:
        data[layout.QUALITY] |= _checks(rows, checks)
    for entity in dict.fromkeys([*arguments, *data]):
        yield _stream(entity, rows, arguments.get(entity, {}), data.get(entity, {}))
    chosen = np.flatnonzero(rows.frame % _BONES_EVERY == 0)
    if plotted and len(chosen):
        every = rows if len(chosen) == len(rows) else rows[chosen]
        yield FrameStream(layout.BONES, every, data={layout.BONE_LENGTHS: _bones(every)})


def _stream(
    entity: str, rows: SessionArrays, drawn: dict[str, NDArray[Any]], data: dict[str, pa.Array]
) -> FrameStream:
    """The columns of one entity; columns named ``struct.field`` become fields of one struct."""
    components: dict[str, pa.Array] = {}
    structs: dict[str, dict[str, pa.Array]] = {}
    for name, values in data.items():
        struct, dot, member = name.partition(".")
        if dot:
            structs.setdefault(struct, {})[member] = values
        else:
            components[name] = values
    for name, members in structs.items():
        components[name] = pa.StructArray.from_arrays(list(members.values()), names=list(members))
    if not drawn:
        return FrameStream(entity, rows, data=components)
    archetype = next(iter(drawn)).partition(":")[0]
    arguments = {name.partition(":")[2]: values for name, values in drawn.items()}
    each = len(rows.body) if archetype == "Points3D" else None
    return FrameStream(entity, rows, getattr(rr, archetype), (arguments, each), components or None)


def _bones(rows: SessionArrays) -> pa.Array:
    """[S_A, S_B, S*, target] lengths of each bone in float16, whose step is 0.25 mm at the length of a
    thigh."""
    lengths = np.concatenate([rows.bone_length_of_each, rows.bone_lengths[None]])  # (4, T, J)
    each = _array(lengths.transpose(2, 1, 0).astype(np.float16))  # one array, of which each bone is a part
    count = lengths.shape[0] * lengths.shape[1]
    of = _array(np.tile(np.arange(len(lengths), dtype=np.uint8), len(rows)))
    body = rows.body
    bones = [each.slice(j * count, count) for j in body.bone_joints]
    # the viewer plots float16 only if the struct has another numeric field
    return pa.StructArray.from_arrays([of, *bones], names=["of", *(body.bones[j] for j in body.bone_joints)])


def _checks(rows: SessionArrays, checks: FusedChecks | None) -> dict[str, pa.Array]:
    fused_crc, digests = checks or (fused_checksums(rows.fused), joint_digests(rows.fused))
    return {
        FRAME_CRC: _array(frame_checksums(rows)),
        FUSED_CRC: _array(fused_crc),
        layout.JOINT_DIGESTS: _array(digests),
    }


def _vectors(values: NDArray[Any]) -> pa.Array:
    """(T, J, n) values as J vectors of n per frame; all others one by one."""
    flat = _array(values)
    return flat if values.ndim < 3 else pa.FixedSizeListArray.from_arrays(flat, values.shape[2])


def _array(values: NDArray[Any]) -> pa.Array:
    return pa.array(np.ascontiguousarray(values).ravel())
