"""The frames of a session stacked into arrays, used for writing, reading and reporting."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.capture.stream_pairing import PairingFigures
from devices.pairing import FramePair
from fusion.body import Body
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.facing.labels import DOUBT_STEPS, HEADING_STEPS
from fusion.fused_frame import FusedFrame, FusedFrames
from fusion.large_arrays import GrowingArray, Rows, parts
from fusion.medians import median_of_known
from fusion.pair_arrays import View
from fusion.skeleton import Skeleton
from recordings import layout
from recordings.frame_fields import (
    JOINTS,
    FrameField,
    frame_fields,
    no_joint_or_joint,
    per_frame,
    state_names,
)


@dataclass(frozen=True)
class SessionFrame:
    """A pair, its fused frame, and how long the fusion took."""

    pair: FramePair
    fused: FusedFrame
    fuse_ns: int
    truth: NDArray[np.float64] | None = None
    """(J, 3) true joint positions in K_A's frame, metres; simulations only."""
    streams: PairingFigures | None = None
    """Figures of the two streams; live sensors only."""
    latency_ns: int | None = None
    """From the arrival of the pair's first images to S*; live sensors only. It is not recorded."""
    bone_lengths: NDArray[np.float64] | None = None
    """(J,) metres, with which S* was fused; None where the calibration tells. It is not recorded."""


class PairBlock(NamedTuple):
    """The pairs of :class:`SessionFrames` as arrays; the names are those of a ``FramePair``."""

    time_ns: NDArray[np.int64]
    skew_ns: NDArray[np.int64]
    a: View
    b: View

    @property
    def skeletons(self) -> PairBlock:
        """The positions and states of both views."""
        return self


@dataclass(frozen=True, eq=False)
class SessionFrames(Rows[SessionFrame]):
    """T pairs and their fused frames. Its attributes are those of :class:`SessionFrame`, with T rows."""

    pair: PairBlock
    fused: FusedFrames
    fuse_ns: int
    pairs: Sequence[FramePair]
    first: int  # number of the first of them among the pairs
    truth = None

    def __len__(self) -> int:
        return len(self.fused)

    def row(self, k: int) -> SessionFrame:
        return SessionFrame(self.pairs[self.first + k], self.fused[k], self.fuse_ns)


POINTS = "Points3D:positions"
_VIEW_A, _VIEW_B, _FUSED = layout.skeleton("a"), layout.skeleton("b"), layout.FUSED_SKELETON
_CAPTURED, _STALE, _PLACEMENT = "sensors.captured_ns", "sensors.stale", "rotation_translation"
_STANDARD_RATES, _STANDARD_WITHIN = (5.0, 15.0, 30.0, 60.0, 90.0), 0.05
_LONG_PAUSE = 3.0  # median intervals
_WEIGHT_STEP = 1.0 / 128.0  # finer steps are not visible


def _witness(frame: SessionFrame | SessionFrames, side: str) -> NDArray[np.float32] | None:
    """The depth evidence of a skeleton; all NaN without a person or frame, if a sensor has images.

    An optional figure that the first frame of a session lacks is absent in the whole session.
    """
    skeleton: Skeleton | View | None = getattr(frame.pair.skeletons, side)
    if isinstance(frame, SessionFrames) or (skeleton is not None and skeleton.witness is not None):
        return None if skeleton is None else skeleton.witness
    if all(seen is None or seen.depth is None for seen in (frame.pair.a, frame.pair.b)):
        return None
    return np.full((len(frame.fused.positions), 4), np.nan, dtype=np.float32)


def _witness_figure(entity: str, side: str) -> Any:
    shape = (JOINTS, 4)
    return per_frame(
        np.float32, shape, entity, "depth_witness", np.float16, lambda f: _witness(f, side), optional=True
    )


@dataclass(frozen=True, eq=False)
class SessionArrays:
    """T frames of J joints; metres, nanoseconds; NaN where data is missing.

    Each attribute declared with ``per_frame`` is one per-frame figure. The declaration states its place in
    the file. Arrays, writer, reader and checksums derive from it. Checksums cover the figures in the order of
    their declaration: add new ones at the end, with ``optional=True``.

    Attributes:
        body: The body that defines the joints.
        bone_lengths: (T, J) the target lengths each frame was fused with; 0 at the root.
        frame: (T,) number of the pair.
        time_ns: (T,) time since the first pair.
    """

    body: Body
    bone_lengths: NDArray[np.float64]
    frame: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    skew_ns: NDArray[np.int64] = per_frame(
        np.int64, (), layout.QUALITY, "figures.skew_ms", np.float64, "pair.skew_ns", scale=1e-6
    )
    """(T,) capture time of B minus capture time of A."""
    clock_a: NDArray[np.int64] = per_frame(
        np.int64, (), layout.QUALITY, _CAPTURED, np.int64, "pair.a.time_ns", absent=layout.NO_FRAME
    )
    """(T,) time on A's own clock, ns; layout.NO_FRAME where A gave no frame."""
    clock_b: NDArray[np.int64] = per_frame(
        np.int64, (), layout.QUALITY, _CAPTURED, np.int64, "pair.b.time_ns", absent=layout.NO_FRAME
    )
    """(T,) time on B's own clock, ns; layout.NO_FRAME where B gave no frame."""
    positions_a: NDArray[np.float32] = per_frame(
        np.float32, (JOINTS, 3), _VIEW_A, POINTS, np.float32, "pair.skeletons.a.positions"
    )
    """(T, J, 3) S_A in A's frame."""
    positions_b: NDArray[np.float32] = per_frame(
        np.float32, (JOINTS, 3), _VIEW_B, POINTS, np.float32, "pair.skeletons.b.positions"
    )
    """(T, J, 3) S_B in B's frame."""
    states_a: NDArray[np.uint8] = per_frame(
        np.uint8, (JOINTS,), _FUSED, layout.state("a"), np.int8, "pair.skeletons.a.states", names=state_names
    )
    """(T, J) tracking states of S_A."""
    states_b: NDArray[np.uint8] = per_frame(
        np.uint8, (JOINTS,), _FUSED, layout.state("b"), np.int8, "pair.skeletons.b.states", names=state_names
    )
    """(T, J) tracking states of S_B."""
    weights_a: NDArray[np.float32] = per_frame(
        np.float32, (JOINTS,), _FUSED, layout.weight("a"), np.float16, "fused.weights_a", step=_WEIGHT_STEP
    )
    """(T, J) w^A of eq. (11), rounded to 1/128."""
    weights_b: NDArray[np.float32] = per_frame(
        np.float32, (JOINTS,), _FUSED, layout.weight("b"), np.float16, "fused.weights_b", step=_WEIGHT_STEP
    )
    """(T, J) w^B of eq. (11), rounded to 1/128."""
    misleading: NDArray[np.int32] = per_frame(
        np.int32,
        (JOINTS,),
        _FUSED,
        "misleading_joint",
        np.int8,
        "fused.misleading_joint",
        names=no_joint_or_joint,
    )
    """(T, J) index of the mis-leading joint of sec. 3, or -1."""
    rotation: NDArray[np.float64] = per_frame(
        np.float64, (3, 3), layout.kinect("b"), _PLACEMENT, np.float64, "fused.a_from_b.rotation"
    )
    """(T, 3, 3) R, K_A ← K_B."""
    translation: NDArray[np.float64] = per_frame(
        np.float64, (3,), layout.kinect("b"), _PLACEMENT, np.float64, "fused.a_from_b.translation"
    )
    """(T, 3) t, K_A ← K_B."""
    fused: NDArray[np.float64] = per_frame(
        np.float64, (JOINTS, 3), _FUSED, POINTS, np.float32, "fused.positions"
    )
    """(T, J, 3) S* in K_A's frame."""
    predicted: NDArray[np.bool_] = per_frame(
        np.bool_, (JOINTS,), _FUSED, "predicted", np.bool_, "fused.predicted"
    )
    """(T, J) whether a joint of S* has no data."""
    iterations: NDArray[np.int64] = per_frame(
        np.int64, (), layout.QUALITY, "figures.iterations", np.uint16, "fused.iterations"
    )
    """(T,) iterations of the solver."""
    stale_a: NDArray[np.bool_] = per_frame(np.bool_, (), layout.QUALITY, _STALE, np.bool_, "fused.stale_a")
    """(T,) whether A repeated its last skeleton."""
    stale_b: NDArray[np.bool_] = per_frame(np.bool_, (), layout.QUALITY, _STALE, np.bool_, "fused.stale_b")
    """(T,) whether B repeated its last skeleton."""
    fuse_ms: NDArray[np.float64] = per_frame(
        np.float64, (), layout.QUALITY, "figures.fuse_ms", np.float32, lambda f: f.fuse_ns * 1e-6
    )
    """(T,) duration of the fusion, milliseconds."""
    truth: NDArray[np.float64] | None = per_frame(
        np.float64, (JOINTS, 3), layout.TRUTH_SKELETON, POINTS, np.float32, "truth", optional=True
    )
    """(T, J, 3) where the joints really are, in K_A's frame; simulations only."""
    sigma: NDArray[np.float32] | None = per_frame(
        np.float32, (JOINTS,), _FUSED, "sigma_mm", np.float16, "fused.sigma", optional=True, scale=1e3
    )
    """(T, J) metres, one standard deviation of S*; sessions of the method ``duplex`` only."""
    exchanged: NDArray[np.int8] | None = per_frame(
        np.int8, (2,), layout.QUALITY, "exchanged", np.int8, lambda f: _exchanged(f.fused), optional=True
    )
    """(T, 2) which sides of A and of B were exchanged, see :mod:`fusion.facing.model`; ``duplex`` only."""
    witness_a: NDArray[np.float32] | None = _witness_figure(_VIEW_A, "a")
    """(T, J, 4) depth evidence for each joint of S_A, metres; columns: ``fusion.witness.COLUMNS``."""
    witness_b: NDArray[np.float32] | None = _witness_figure(_VIEW_B, "b")
    """(T, J, 4) likewise of B."""
    side_doubt: NDArray[np.uint8] | None = per_frame(
        np.uint8, (2,), layout.QUALITY, "side_doubt", np.uint8, lambda f: _doubts(f.fused), optional=True
    )
    """(T, 2) probability that the sides of A and of B are wrong all the same, in 1/255; ``duplex`` only."""
    heading: NDArray[np.float32] | None = per_frame(
        np.float32,
        (3,),
        layout.QUALITY,
        "heading",
        np.float16,
        "fused.heading",
        optional=True,
        step=1.0 / HEADING_STEPS,
    )
    """(T, 3) horizontal direction in which the person faces, in K_A's frame; its length, from 0 to 1, is the
    confidence. ``duplex`` only."""

    @staticmethod
    def stack(
        body: Body,
        bone_lengths: NDArray[np.float64],
        frames: Sequence[SessionFrame],
        numbers: Sequence[int] | None = None,
        start_ns: int | None = None,
        like: SessionArrays | None = None,
    ) -> SessionArrays:
        """Stacks one or more turns of the loop.

        Args:
            bone_lengths: (J,) metres, or (T, J) where they change.
            numbers: Of the frames; from 0 where None.
            start_ns: When the session began; with the first of these frames where None.
            like: Earlier frames of the session: these then have the same optional figures.
        """
        figures: dict[str, Any]
        if isinstance(frames, SessionFrames):
            figures = {name: spec.of_block(body, frames) for name, spec in FRAME_FIELDS.items()}
            times = frames.pair.time_ns
        else:
            figures = {name: spec.stacked(body, frames) for name, spec in FRAME_FIELDS.items()}
            times = np.array([f.pair.time_ns for f in frames], dtype=np.int64)
        if like is not None:
            for name in (name for name, spec in FRAME_FIELDS.items() if spec.optional):
                if getattr(like, name) is None:
                    figures[name] = None
                elif figures[name] is None:
                    figures[name] = FRAME_FIELDS[name].nothing(body, len(frames))
        return SessionArrays(
            body,
            np.broadcast_to(bone_lengths, (len(frames), len(body))),
            np.array(range(len(frames)) if numbers is None else numbers, dtype=np.int64),
            times - (times[0] if start_ns is None else start_ns),
            **figures,
        )

    @staticmethod
    def joined(blocks: Iterable[SessionArrays]) -> SessionArrays:
        """Joins consecutive frames; a figure that a block lacks is absent in its frames."""
        joined: dict[str, GrowingArray] = {}
        end = 0
        for block in blocks:
            for name in (f.name for f in fields(SessionArrays) if f.name != "body"):
                if name not in joined and getattr(block, name) is not None:
                    joined[name] = GrowingArray()
                    if name in FRAME_FIELDS:
                        joined[name].append(FRAME_FIELDS[name].nothing(block.body, end))
                if name in joined:
                    joined[name].append(block.filled(name) if name in FRAME_FIELDS else getattr(block, name))
            end += len(block)
        return SessionArrays(
            body=block.body, **dict(zip(joined, GrowingArray.wholes(joined.values()), strict=True))
        )

    def figures(self) -> Iterator[tuple[str, FrameField, NDArray[Any]]]:
        """Name, declaration and values of every figure that these frames have."""
        for name, spec in FRAME_FIELDS.items():
            values = getattr(self, name)
            if values is not None:
                yield name, spec, values

    def filled(self, name: str) -> NDArray[Any]:
        """A figure by its name; its absent value in every frame where the session does not have it."""
        values: NDArray[Any] | None = getattr(self, name)
        return FRAME_FIELDS[name].nothing(self.body, len(self)) if values is None else values

    def parts(self) -> Iterator[SessionArrays]:
        """The frames in parts, for work that would need much memory for all of them."""
        return (self[part] for part in parts(len(self)))

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, frames: slice | NDArray[np.int64]) -> SessionArrays:
        """Selects frames; their numbers and times stay unchanged."""
        kept = {f.name: getattr(self, f.name) for f in fields(self)}
        per_frame = {n: v[frames] for n, v in kept.items() if n != "body" and v is not None}
        return replace(self, **per_frame)

    @property
    def b_in_a(self) -> NDArray[np.float64]:
        """(T, J, 3) S_B transformed to K_A's frame."""
        return np.asarray(
            np.einsum("tij,tkj->tki", self.rotation, self.positions_b.astype(np.float64))
            + self.translation[:, None]
        )

    @property
    def frame_rate(self) -> float:
        """Frames per second of the faster sensor without its pauses: 1 / mean interval, as 5, 15, 30, 60 or
        90 if within 5 % of it. 30 for a single frame.
        """
        rates = [30.0] if len(self) < 2 else []
        for clock in (self.clock_a, self.clock_b):
            steps = np.diff(self.time_ns[clock != layout.NO_FRAME]) * 1e-9
            if len(steps):
                rates.append(float(1.0 / steps[steps <= _LONG_PAUSE * np.median(steps)].mean()))
        fastest = max(rates, default=30.0)
        nearest = min(_STANDARD_RATES, key=lambda rate: abs(rate - fastest))
        return nearest if abs(nearest - fastest) <= _STANDARD_WITHIN * nearest else fastest

    @property
    def bone_length_of_each(self) -> NDArray[np.float64]:
        """(3, T, J) length of each bone of S_A, S_B and S*, indexed by the child joint."""
        each = (self.positions_a, self.positions_b, self.fused)
        return np.array([bone_lengths_of(self.body, positions) for positions in each])

    @property
    def bone_error(self) -> NDArray[np.float64]:
        """(T,) metres, the largest absolute error of a bone length of S*; NaN without S*."""
        error = np.abs(bone_lengths_of(self.body, self.fused) - self.bone_lengths)
        error[:, self.body.root] = 0.0  # the root has no bone
        return np.asarray(error.max(axis=1))

    @property
    def view_difference(self) -> NDArray[np.float64]:
        """(T, J) metres between p and R q + t; NaN where a joint is not in both views."""
        return np.asarray(np.linalg.norm(self.positions_a - self.b_in_a, axis=2))

    @property
    def disagreement(self) -> NDArray[np.float64]:
        """(T,) metres between p and R q + t, median over the joints that both see; NaN without any."""
        return np.concatenate([median_of_known(rows.view_difference) for rows in self.parts()])


def _exchanged(fused: FusedFrame | FusedFrames) -> NDArray[Any] | None:
    return None if fused.sigma is None else np.stack((fused.exchanged_a, fused.exchanged_b), axis=-1)


def _doubts(fused: FusedFrame | FusedFrames) -> NDArray[Any] | None:
    if fused.sigma is None:
        return None
    return np.asarray(np.rint(DOUBT_STEPS * np.stack((fused.doubt_a, fused.doubt_b), axis=-1)))


FRAME_FIELDS: Mapping[str, FrameField] = MappingProxyType(frame_fields(fields(SessionArrays)))
"""The figures of :class:`SessionArrays` by name, in the order in which checksums cover them."""
