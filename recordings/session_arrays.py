"""The frames of a session stacked into arrays: what is written, read back, and reported on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from devices.live.sensor_pair import StreamFigures
from devices.pairing import FramePair
from devices.sensor import SensorFrame
from fusion.body import Body
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.fuser import FusedFrame
from fusion.skeleton import Skeleton
from recordings import layout


@dataclass(frozen=True)
class RecordedFrame:
    """One turn of the loop: a pair, what came of it, and how long the fusion took."""

    pair: FramePair
    fused: FusedFrame
    fuse_ns: int
    truth: NDArray[np.float64] | None = None
    """(J, 3) where the joints really are, in K_A's frame; simulations only."""
    streams: StreamFigures | None = None
    """How the two streams go; live sensors only."""


@dataclass(frozen=True, eq=False)
class SessionArrays:
    """T frames of J joints; metres, nanoseconds; NaN where there is nothing.

    Attributes:
        body: Which joints these are.
        bone_lengths: (T, J) the target lengths each frame was fused with; 0 at the root.
        frame: (T,) number of the pair.
        time_ns: (T,) since the first pair.
        skew_ns: (T,) capture time of B less that of A.
        clock_a, clock_b: (T,) each sensor's own time, ns; layout.NO_FRAME where it gave no frame.
        positions_a, positions_b: (T, J, 3) float32, each in its sensor's frame.
        states_a, states_b: (T, J) uint8 tracking states.
        weights_a, weights_b: (T, J) float32, eq. (11), to 1/128: a session keeps what an eye can tell apart.
        misleading: (T, J) int32, the mis-leading joint of sec. 3, or -1.
        rotation, translation: (T, 3, 3) and (T, 3), K_A ← K_B.
        fused: (T, J, 3) float64, S* in K_A's frame.
        predicted: (T, J) whether a joint of S* has no data.
        iterations: (T,) of the solver.
        stale_a, stale_b: (T,) whether the sensor repeated its last skeleton.
        fuse_ms: (T,) what the fusion took.
        truth: (T, J, 3) where the joints really are, in K_A's frame; None where no one knows.
    """

    body: Body
    bone_lengths: NDArray[np.float64]
    frame: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    skew_ns: NDArray[np.int64]
    clock_a: NDArray[np.int64]
    clock_b: NDArray[np.int64]
    positions_a: NDArray[np.float32]
    positions_b: NDArray[np.float32]
    states_a: NDArray[np.uint8]
    states_b: NDArray[np.uint8]
    weights_a: NDArray[np.float32]
    weights_b: NDArray[np.float32]
    misleading: NDArray[np.int32]
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    fused: NDArray[np.float64]
    predicted: NDArray[np.bool_]
    iterations: NDArray[np.int64]
    stale_a: NDArray[np.bool_]
    stale_b: NDArray[np.bool_]
    fuse_ms: NDArray[np.float64]
    truth: NDArray[np.float64] | None = None

    @staticmethod
    def stack(
        body: Body,
        bone_lengths: NDArray[np.float64],
        frames: Sequence[RecordedFrame],
        numbers: Sequence[int] | None = None,
        start_ns: int | None = None,
    ) -> SessionArrays:
        """Stacks one or more turns of the loop.

        Args:
            body: The body of all frames.
            bone_lengths: (J,) metres, or (T, J) where they change.
            frames: In time order, at least one.
            numbers: Of the frames; from 0 where None.
            start_ns: When the session began; with the first of these frames where None.
        """
        pairs = [f.pair.skeletons for f in frames]
        fused = [f.fused for f in frames]
        start = frames[0].pair.time_ns if start_ns is None else start_ns
        nowhere = np.full((len(body), 3), np.nan, dtype=np.float32)
        unseen = np.zeros(len(body), dtype=np.uint8)

        def positions(skeletons: list[Skeleton | None]) -> NDArray[np.float32]:
            return np.array([nowhere if s is None else s.positions for s in skeletons])

        def states(skeletons: list[Skeleton | None]) -> NDArray[np.uint8]:
            return np.array([unseen if s is None else s.states for s in skeletons])

        a, b = [p.a for p in pairs], [p.b for p in pairs]
        return SessionArrays(
            body=body,
            bone_lengths=np.broadcast_to(bone_lengths, (len(frames), len(body))),
            frame=np.array(range(len(frames)) if numbers is None else numbers, dtype=np.int64),
            time_ns=np.array([f.pair.time_ns for f in frames], dtype=np.int64) - start,
            skew_ns=np.array([f.pair.skew_ns for f in frames], dtype=np.int64),
            clock_a=np.array([_clock(f.pair.a) for f in frames], dtype=np.int64),
            clock_b=np.array([_clock(f.pair.b) for f in frames], dtype=np.int64),
            positions_a=positions(a),
            positions_b=positions(b),
            states_a=states(a),
            states_b=states(b),
            weights_a=_to_128ths([f.weights_a for f in fused]),
            weights_b=_to_128ths([f.weights_b for f in fused]),
            misleading=np.array([f.misleading for f in fused], dtype=np.int32),
            rotation=np.array([f.a_from_b.rotation for f in fused]),
            translation=np.array([f.a_from_b.translation for f in fused]),
            fused=np.array([f.positions for f in fused]),
            predicted=np.array([f.predicted for f in fused]),
            iterations=np.array([f.iterations for f in fused], dtype=np.int64),
            stale_a=np.array([f.stale_a for f in fused]),
            stale_b=np.array([f.stale_b for f in fused]),
            fuse_ms=np.array([f.fuse_ns for f in frames]) * 1e-6,
            truth=None
            if frames[0].truth is None
            else np.array([nowhere if f.truth is None else f.truth for f in frames]),
        )

    def __len__(self) -> int:
        """The number of frames T."""
        return len(self.frame)

    def __getitem__(self, frames: slice | NDArray[np.int64]) -> SessionArrays:
        """Some of the frames, with their numbers and times as they are."""
        kept = {f.name: getattr(self, f.name) for f in fields(self)}
        per_frame = {n: v[frames] for n, v in kept.items() if n != "body" and v is not None}
        return replace(self, **per_frame)

    @property
    def b_in_a(self) -> NDArray[np.float64]:
        """(T, J, 3) S_B laid into K_A's frame."""
        return np.asarray(
            np.einsum("tij,tkj->tki", self.rotation, self.positions_b.astype(np.float64))
            + self.translation[:, None]
        )

    @property
    def bone_length_of_each(self) -> NDArray[np.float64]:
        """(3, T, J) length of every bone of S_A, S_B and S*, by the joint at its far end."""
        each = (self.positions_a, self.positions_b, self.fused)
        return np.array([bone_lengths_of(self.body, positions) for positions in each])

    @property
    def bone_error(self) -> NDArray[np.float64]:
        """(T,) metres, the largest difference of a bone of S* from its length; NaN without S*."""
        error = np.abs(bone_lengths_of(self.body, self.fused) - self.bone_lengths)
        error[:, self.body.root] = 0.0  # has no bone
        return np.asarray(error.max(axis=1))

    @property
    def view_difference(self) -> NDArray[np.float64]:
        """(T, J) metres between p and R q + t; NaN where a joint is not in both views."""
        return np.asarray(np.linalg.norm(self.positions_a - self.b_in_a, axis=2))

    @property
    def disagreement(self) -> NDArray[np.float64]:
        """(T,) metres between p and R q + t, the median over joints both see; NaN where there are none."""
        nearest = np.sort(self.view_difference, axis=1)  # NaN comes last
        seen = np.count_nonzero(~np.isnan(nearest), axis=1)
        frame = np.arange(len(nearest))
        return np.asarray((nearest[frame, (seen - 1) // 2] + nearest[frame, seen // 2]) / 2.0)


def _to_128ths(weights: list[NDArray[np.float64]]) -> NDArray[np.float32]:
    return (np.round(np.array(weights) * 128.0) / 128.0).astype(np.float32)


def _clock(frame: SensorFrame | None) -> int:
    return layout.NO_FRAME if frame is None else frame.time_ns
