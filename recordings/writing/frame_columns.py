"""The entities of a frame in a session, with their values and precision.

A row of an entity costs 15 bytes for frame number and time, and each column 4 more bytes. Therefore related
values share an entity, and many of them share a struct. Names are stored as dictionaries: the file holds
numbers, and the viewer shows words when a joint is clicked.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import ArrayLike, NDArray

from fusion.movement.angles import ANGLES, UP, angle_sigma, joint_angles
from recordings.data import layout
from recordings.data.frame_fields import FrameField
from recordings.data.session_arrays import SessionArrays
from recordings.quality.limits import PLOTTED_DEGREES, POSSIBLE
from recordings.writing.arrow_columns import Column, converted
from recordings.writing.shown_figures import SHOWN_FIGURES

_INSIDE = 3.0  # degrees from the edge of a plot to the mark of an angle that is farther out
_EVERY = 2  # bones and angles are plotted every second frame; S_A, S_B and S* are logged every frame


def frame_columns(
    rows: SessionArrays,
    *,
    colors: NDArray[np.uint8] | None = None,
    plotted: bool = True,
    up: ArrayLike = UP,
) -> Iterator[tuple[str, SessionArrays, list[Column]]]:
    """Each entity with its frames and their columns: the recorded figures, then those for the viewer.

    Args:
        colors: (T, J, 3) of S*. None: entities that are drawn into the scene are left out.
        plotted: Whether the other entities are, see :func:`layout.is_plotted`.
        up: (3,) against gravity in K_A's frame.
    """
    body, entities = rows.body, dict[str, _EntityColumns]()
    posed = np.isfinite(rows.fused[:, body.root]).all(axis=1)
    with_pose = rows if posed.all() else rows[np.flatnonzero(posed)]

    def is_wanted(entity: str) -> bool:
        return plotted if layout.is_plotted(entity) else colors is not None

    def columns_of(entity: str) -> _EntityColumns:
        # Where the person has no place, the pelvis keeps its own, and the eye that follows it stays.
        return entities.setdefault(entity, _EntityColumns(with_pose if entity == layout.PELVIS else rows))

    components: dict[tuple[str, str], list[FrameField]] = {}
    for _, spec, _ in rows.figures():
        if is_wanted(spec.entity):
            components.setdefault((spec.entity, spec.component), []).append(spec)
    for (entity, component), specs in components.items():
        each = [spec.to_file(body, getattr(rows, spec.name)) for spec in specs]
        if len(each) > 1:
            each = [np.concatenate([values.reshape(len(rows), -1) for values in each], axis=1)]
        columns_of(entity).add(component, each[0], partial(specs[0].in_arrow, body))
    if colors is not None:
        entities[layout.FUSED_SKELETON].add("Points3D:colors", colors)
    for shown in SHOWN_FIGURES:
        of = columns_of(shown.entity) if is_wanted(shown.entity) else None
        if of is not None and (derived := shown.values(of.rows)) is not None:
            of.add(shown.component, derived)
    for entity, of in entities.items():
        if len(of.rows):
            yield entity, of.rows, of.all()
    chosen = np.flatnonzero(rows.frame % _EVERY == 0)
    if plotted and len(chosen):
        every = rows if len(chosen) == len(rows) else rows[chosen]
        yield layout.BONES, every, [Column.of_data(layout.BONE_LENGTHS, _bones(every), len(every))]
        yield from _angles(every, up)


class _EntityColumns:
    """Collects the columns of one entity; data named ``struct.field`` become fields of one struct."""

    def __init__(self, rows: SessionArrays) -> None:
        self.rows = rows
        self._columns: list[Column] = []
        self._structs: dict[str, dict[str, pa.Array]] = {}

    def add(
        self, component: str, values: NDArray[Any], flat: Callable[[NDArray[Any]], pa.Array] | None = None
    ) -> None:
        """Adds (T, …) values of ``archetype:argument``, or of a component of our own.

        Args:
            flat: Makes a flat Arrow array of the values of such a component.
        """
        frames = len(self.rows)
        archetype, colon, argument = component.partition(":")
        struct, dot, member = component.partition(".")
        if colon:
            each = len(self.rows.body) if archetype == "Points3D" else 1
            of = converted(getattr(rr, archetype), argument, values, frames * each)
            self._columns.append(Column(*of, frames))
        elif dot:
            self._structs.setdefault(struct, {})[member] = (flat or _vectors)(values)
        else:
            self._columns.append(Column.of_data(component, (flat or _vectors)(values), frames))

    def all(self) -> list[Column]:
        """All columns."""
        structs = {
            name: pa.StructArray.from_arrays(list(members.values()), names=list(members))
            for name, members in self._structs.items()
        }
        return self._columns + [Column.of_data(name, of, len(self.rows)) for name, of in structs.items()]


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


def _angles(rows: SessionArrays, up: ArrayLike) -> Iterator[tuple[str, SessionArrays, list[Column]]]:
    each = joint_angles(rows.body, rows.fused, up)
    sigma = angle_sigma(rows.body, rows.fused, rows.filled("sigma"), up)
    yield (
        layout.ANGLES,
        rows,
        [_of_angles(layout.DEGREES, each), _of_angles(layout.VARIANCES, np.minimum(sigma, 180.0) ** 2)],
    )
    low, high = np.array([POSSIBLE.get(_of_either(name), (-np.inf, np.inf)) for name in ANGLES]).T
    beyond = (each < low) | (each > high)
    at = np.flatnonzero(beyond.any(axis=1))
    if len(at):
        bottom, top = np.array(
            [PLOTTED_DEGREES.get(_of_either(name), (-np.inf, np.inf)) for name in ANGLES]
        ).T
        marked = np.where(beyond, np.clip(each, bottom + _INSIDE, top - _INSIDE), np.nan)[at]
        yield layout.ANGLES_BEYOND, rows[at], [_of_angles(layout.DEGREES, marked)]


def _of_angles(component: str, values: NDArray[Any]) -> Column:
    fields = [_array(of) for of in values.T.astype(np.float32)]
    return Column.of_data(component, pa.StructArray.from_arrays(fields, names=list(ANGLES)), len(values))


def _of_either(angle: str) -> str:
    return angle.removesuffix("_left").removesuffix("_right")


def _vectors(values: NDArray[Any]) -> pa.Array:
    """(T, J, n) values as J vectors of n per frame; all others one by one."""
    flat = _array(values)
    return flat if values.ndim < 3 else pa.FixedSizeListArray.from_arrays(flat, values.shape[2])


def _array(values: NDArray[Any]) -> pa.Array:
    return pa.array(np.ascontiguousarray(values).ravel())
