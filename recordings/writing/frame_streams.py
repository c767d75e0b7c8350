"""What a frame is in a session: which entities it has, and which values in which precision.

An entity's row costs 15 bytes for its number and times, and each column 4 more, whatever is in them: so
values that belong together share an entity, and where there are many of them a struct. Names are stored as
dictionaries, which are numbers for the file and words for the person who clicks a joint.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from fusion.skeleton import TrackingState
from recordings import layout
from recordings.appearance.joint_trust import details, trust_colors
from recordings.session_arrays import SessionArrays
from recordings.writing.checksums import FusedChecks, frame_checksums, fused_checksums, joint_digests

_BONES_EVERY = 2  # frames, of the plots; S_A, S_B and S* themselves are there every frame


@dataclass(frozen=True)
class FrameStream:
    """What one entity has over some frames.

    Attributes:
        entity: Its path.
        rows: The frames.
        archetype: What a viewer draws, with ``values[field]`` (T, n, …), or (T, …) where n is None.
        data: Components by name: n values for each of the T frames, one after the other.
    """

    entity: str
    rows: SessionArrays
    archetype: Any = None
    values: tuple[dict[str, NDArray[Any]], int | None] = ({}, None)
    data: dict[str, pa.Array] | None = None

    def of_first(self) -> list[Any]:
        """What is logged for the first frame."""
        logged = []
        if self.archetype is not None:
            logged.append(self.archetype(**{name: values[0] for name, values in self.values[0].items()}))
        if self.data is not None:
            each = {name: len(values) // len(self.rows) for name, values in self.data.items()}
            logged.append(rr.AnyValues(**{name: self.data[name][:n] for name, n in each.items()}))
        return logged

    def columns(self) -> list[Any]:
        """What is sent for all frames."""
        frames = len(self.rows)
        sent: list[Any] = []
        values, each = self.values
        if self.archetype is not None and each is None:
            sent += self.archetype.columns(**values)
        elif self.archetype is not None:
            flat = {name: of.reshape(-1, *of.shape[2:]) for name, of in values.items()}
            sent += self.archetype.columns(**flat).partition([each] * frames)
        for name, of in (self.data or {}).items():  # AnyValues' own way takes every value through Python
            ends = np.arange(frames + 1, dtype=np.int32) * np.int32(len(of) // frames)
            sent.append(rr.ComponentColumn(name, rr.AnyBatchValue(name, of), offsets=ends))
        return sent


def frame_streams(rows: SessionArrays, checks: FusedChecks | None = None) -> Iterator[FrameStream]:
    """Everything that is logged a frame.

    Args:
        rows: The frames, one or more.
        checks: Of S*, where `rows` have it from a file, in float32.
    """
    joints = len(rows.body)
    for side, positions in (("a", rows.positions_a), ("b", rows.positions_b)):
        yield FrameStream(layout.skeleton(side), rows, rr.Points3D, ({"positions": positions}, joints))
    # the viewer's transform is in float32: R row by row, then t, again
    placement = np.concatenate([rows.rotation.reshape(-1, 9), rows.translation], axis=1)
    yield FrameStream(
        layout.kinect("b"),
        rows,
        rr.Transform3D,
        ({"mat3x3": rows.rotation, "translation": rows.translation}, None),
        {"rotation_translation": _array(placement)},
    )
    fused: dict[str, NDArray[Any]] = {
        "positions": rows.fused.astype(np.float32),
        "colors": trust_colors(rows),
    }
    yield FrameStream(layout.FUSED_SKELETON, rows, rr.Points3D, (fused, joints), details(rows))
    if rows.truth is not None:
        truth = {"positions": rows.truth.astype(np.float32)}
        yield FrameStream(layout.TRUTH_SKELETON, rows, rr.Points3D, (truth, joints))
    yield FrameStream(layout.QUALITY, rows, data=_quality(rows, checks))
    chosen = np.flatnonzero(rows.frame % _BONES_EVERY == 0)
    plotted = rows if len(chosen) == len(rows) else rows[chosen]
    if len(plotted):
        yield FrameStream(layout.BONES, plotted, data={layout.BONE_LENGTHS: _bones(plotted)})


def _bones(rows: SessionArrays) -> pa.Array:
    """[S_A, S_B, S*, target] of every bone, in float16: 0.25 mm at a thigh's length."""
    lengths = np.concatenate([rows.bone_length_of_each, rows.bone_lengths[None]])  # (4, T, J)
    bones = {rows.body.bones[j]: lengths[:, :, j].T.astype(np.float16) for j in rows.body.bone_joints}
    # a viewer plots float16 only of a struct in which something else is a number too
    return _struct({"of": np.tile(np.arange(len(lengths), dtype=np.uint8), len(rows)), **bones})


def _quality(rows: SessionArrays, checks: FusedChecks | None) -> dict[str, pa.Array]:
    fused_crc, digests = checks or (fused_checksums(rows.fused), joint_digests(rows.fused))
    tracked = [(of == TrackingState.TRACKED).sum(axis=1) for of in (rows.states_a, rows.states_b)]
    return {
        layout.FIGURES: _struct(
            {
                "fuse_ms": rows.fuse_ms.astype(np.float32),
                "skew_ms": rows.skew_ns * 1e-6,
                "bone_error_mm": (rows.bone_error * 1e3).astype(np.float32),
                "disagreement_mm": (rows.disagreement * 1e3).astype(np.float32),
                "iterations": rows.iterations.astype(np.uint16),
                "predicted_joints": rows.predicted.sum(axis=1).astype(np.uint8),
                "frame_crc32": frame_checksums(rows),
                "fused_crc32": fused_crc,
            }
        ),
        layout.OF_EACH_SENSOR: _struct(
            {
                "captured_ns": np.stack([rows.clock_a, rows.clock_b], axis=1),
                "tracked_joints": np.stack(tracked, axis=1).astype(np.uint8),
                "stale": np.stack([rows.stale_a, rows.stale_b], axis=1),
            }
        ),
        layout.JOINT_DIGESTS: _array(digests),
    }


def _struct(of: dict[str, NDArray[Any]]) -> pa.Array:
    return pa.StructArray.from_arrays([_array(values) for values in of.values()], names=list(of))


def _array(values: NDArray[Any]) -> pa.Array:
    return pa.array(np.ascontiguousarray(values).ravel())
