"""The frames of a session stacked into arrays, used for writing, reading and reporting."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType, NoneType
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from devices.frame_pairs import FramePair, PairingFigures
from fusion.body import Body
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.facing.labels import DOUBT_STEPS, HEADING_STEPS
from fusion.fused_frame import FusedFrame, FusedFrames
from fusion.pair_arrays import View
from fusion.rigid import RigidTransform
from fusion.skeleton import nearer
from fusion.support.large_arrays import GrowingArray, Rows, parts
from fusion.support.medians import median_of_known
from fusion.support.read_only import cached_array
from recordings.data import layout
from recordings.data.checksums import fused_checksums, joint_digests
from recordings.data.corrected_sides import corrects_sides
from recordings.data.frame_fields import JOINTS, FrameField, no_joint_or_joint, state_names


class _Frame:
    """What a frame, or T frames, have of :class:`FusedFrame` and its pair in the form of the file."""

    pair: Any
    fused: Any
    fuse_ns: int
    floor: RigidTransform | None

    @property
    def skeletons(self) -> Any:
        """S_A and S_B, as ``a`` and ``b``."""
        return getattr(self.pair, "skeletons", self.pair)

    @property
    def fuse_ms(self) -> float:
        """Duration of the fusion, milliseconds."""
        return self.fuse_ns * 1e-6

    @property
    def exchanged(self) -> NDArray[Any] | None:
        """(…, 2) which sides of A and of B were exchanged."""
        of = self.fused
        return None if of.sigma is None else np.stack((of.exchanged_a, of.exchanged_b), axis=-1)

    @property
    def side_doubt(self) -> NDArray[Any] | None:
        """(…, 2) probability that the sides of A and of B are wrong, in 1/255."""
        of = self.fused
        if of.sigma is None:
            return None
        return np.asarray(np.rint(DOUBT_STEPS * np.stack((of.doubt_a, of.doubt_b), axis=-1)))

    @property
    def up(self) -> NDArray[np.float64] | None:
        """(3,) against gravity in K_A's frame."""
        return None if self.floor is None else -self.floor.rotation[:, 1]


@dataclass(frozen=True)
class SessionFrame(_Frame):
    """A pair and its fused frame.

    Attributes:
        pair: The data of both sensors, each in its own frame.
        fused: S* in K_A's frame, with its uncertainty.
        fuse_ns: Duration of the fusion.
        truth: (J, 3) true joint positions in K_A's frame, metres; simulations only.
        streams: Figures of the two streams; live sensors only.
        latency_ns: From the arrival of the pair's first images to S*; live sensors only. It is not recorded.
        bone_lengths: (J,) metres, with which S* was fused; None: those of the calibration. Not recorded.
        floor: K_A ← floor, found from earlier frames; live sensors only. Its vertical is recorded.
        unix_ns: When it was captured, since 1970 UTC; None where that is not known.
        depth_errors: (2,) metres, of the calibration; None where it states none.
    """

    pair: FramePair
    fused: FusedFrame
    fuse_ns: int
    truth: NDArray[np.float64] | None = None
    streams: PairingFigures | None = None
    latency_ns: int | None = None
    bone_lengths: NDArray[np.float64] | None = None
    floor: RigidTransform | None = None
    unix_ns: int | None = None
    depth_errors: NDArray[np.float64] | None = None


class PairBlock(NamedTuple):
    """The pairs of :class:`SessionFrames` as arrays; the names are those of a ``FramePair``."""

    time_ns: NDArray[np.int64]
    skew_ns: NDArray[np.int64]
    a: View
    b: View


@dataclass(frozen=True, eq=False)
class SessionFrames(_Frame, Rows[SessionFrame]):
    """T pairs and their fused frames. Its attributes are those of :class:`SessionFrame`, with T rows."""

    pair: PairBlock
    fused: FusedFrames
    fuse_ns: int
    pairs: Sequence[FramePair]
    first: int  # number of the first of them among the pairs
    depth_errors: NDArray[np.float64] | None = None
    truth = floor = unix_ns = None

    def __len__(self) -> int:
        return len(self.fused)

    def row(self, k: int) -> SessionFrame:
        pair = self.pairs[self.first + k]
        return SessionFrame(pair, self.fused[k], self.fuse_ns, depth_errors=self.depth_errors)


_STANDARD_RATES, _STANDARD_WITHIN = (5.0, 15.0, 30.0, 60.0, 90.0), 0.05
_LONG_PAUSE = 3.0  # median intervals


_F = FrameField
Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int64 = NDArray[np.int64]
Int32 = NDArray[np.int32]
Int8 = NDArray[np.int8]
UInt32 = NDArray[np.uint32]
UInt8 = NDArray[np.uint8]
Bools = NDArray[np.bool_]
_QUALITY, _S, _A, _B = layout.QUALITY, layout.FUSED_SKELETON, layout.skeleton("a"), layout.skeleton("b")
_PLACE, _POINTS, _PLACEMENT = layout.kinect("b"), "Points3D:positions", "rotation_translation"
_CAPTURED, _STALE, _WITNESS = "sensors.captured_ns", "sensors.stale", "depth_witness"
_J, _J3, _J4, _WEIGHT_STEP = (JOINTS,), (JOINTS, 3), (JOINTS, 4), 1.0 / 128.0  # finer steps are not visible
_i1, _i8, _u1, _u2, _u4, _bool = np.int8, np.int64, np.uint8, np.uint16, np.uint32, np.bool_
_f2, _f4, _f8 = np.float16, np.float32, np.float64


@dataclass(frozen=True, eq=False, repr=False)
class SessionArrays:
    """T frames of J joints, in metres and nanoseconds; NaN where data are missing.

    Each attribute but the first four is a figure: its line declares where a frame has it, and where and how a
    session's file does.

    Attributes:
        body: The body that defines the joints.
        bone_lengths: (T, J) the target lengths each frame was fused with; 0 at the root.
        frame: (T,) number of the pair.
        time_ns: (T,) time since the first pair.
        skew_ns: (T,) capture time of B minus capture time of A.
        clock_a, clock_b: (T,) time on the sensor's own clock, ns; layout.NO_FRAME if it gave no frame.
        positions_a, positions_b: (T, J, 3) S_A and S_B in their sensors' own frames.
        states_a, states_b: (T, J) tracking states of S_A and S_B.
        weights_a, weights_b: (T, J) each view's share of the information, rounded to 1/128; w^A and w^B of
            eq. (11) with the paper's methods.
        misleading: (T, J) index of the misleading joint of sec. 3, or -1.
        rotation, translation: (T, 3, 3) R and (T, 3) t, K_A ← K_B.
        fused: (T, J, 3) S* in K_A's frame.
        predicted: (T, J) whether a joint of S* has no data.
        iterations: (T,) iterations of the solver.
        stale_a, stale_b: (T,) whether the sensor repeated its last skeleton.
        fuse_ms: (T,) duration of the fusion, milliseconds.
        fused_checksums: (T,) checksums of S* in float64; the file stores float32.
        joint_digests: (T, J) one digest byte for each joint of S* in float64.
        truth: (T, J, 3) the true joints in K_A's frame; simulations only.
        sigma: (T, J) metres, one standard deviation of S*. Only the method ``duplex`` gives this,
            ``exchanged``, ``side_doubt`` and ``heading``.
        exchanged: (T, 2) which sides of A and of B were exchanged; see :mod:`fusion.facing.model`.
        witness_a, witness_b: (T, J, 4) depth evidence for each joint, metres; columns:
            ``fusion.witness.COLUMNS``.
        side_doubt: (T, 2) probability that the sides of A and of B are still wrong, in 1/255.
        heading: (T, 3) direction in which the person faces, normal to the line from the ankles to the
            shoulders, in K_A's frame; its length, from 0 to 1, is the confidence. Before revision 13 of
            ``duplex`` it was horizontal.
        up: (T, 3) against gravity in K_A's frame, as live outputs used it; sessions of live sensors only.
        unix_ns: (T,) times of capture since 1970 UTC, those of live outputs; sessions of live sensors only.
        depth_errors: (T, 2) metres by which A and B show joints too far away, as ``duplex`` takes it.
    """

    body: Body
    bone_lengths: Float64
    frame: Int64
    time_ns: Int64
    # Checksums cover the figures in this order: add new ones at the end, as optional ones.
    skew_ns: Annotated[Int64, _F(_QUALITY, "figures.skew_ms", _f8, "pair.skew_ns", scale=1e-6)]
    clock_a: Annotated[Int64, _F(_QUALITY, _CAPTURED, _i8, "pair.a.time_ns", absent=layout.NO_FRAME)]
    clock_b: Annotated[Int64, _F(_QUALITY, _CAPTURED, _i8, "pair.b.time_ns", absent=layout.NO_FRAME)]
    positions_a: Annotated[Float32, _F(_A, _POINTS, _f4, "skeletons.a.positions", _J3)]
    positions_b: Annotated[Float32, _F(_B, _POINTS, _f4, "skeletons.b.positions", _J3)]
    states_a: Annotated[UInt8, _F(_S, "state_a", _i1, "skeletons.a.states", _J, names=state_names)]
    states_b: Annotated[UInt8, _F(_S, "state_b", _i1, "skeletons.b.states", _J, names=state_names)]
    weights_a: Annotated[Float32, _F(_S, "weight_a", _f2, "fused.weights_a", _J, step=_WEIGHT_STEP)]
    weights_b: Annotated[Float32, _F(_S, "weight_b", _f2, "fused.weights_b", _J, step=_WEIGHT_STEP)]
    misleading: Annotated[
        Int32, _F(_S, "misleading_joint", _i1, "fused.misleading_joint", _J, names=no_joint_or_joint)
    ]
    rotation: Annotated[Float64, _F(_PLACE, _PLACEMENT, _f8, "fused.a_from_b.rotation", (3, 3))]
    translation: Annotated[Float64, _F(_PLACE, _PLACEMENT, _f8, "fused.a_from_b.translation", (3,))]
    fused: Annotated[Float64, _F(_S, _POINTS, _f4, "fused.positions", _J3)]
    predicted: Annotated[Bools, _F(_S, "predicted", _bool, "fused.predicted", _J)]
    iterations: Annotated[Int64, _F(_QUALITY, "figures.iterations", _u2, "fused.iterations")]
    stale_a: Annotated[Bools, _F(_QUALITY, _STALE, _bool, "fused.stale_a")]
    stale_b: Annotated[Bools, _F(_QUALITY, _STALE, _bool, "fused.stale_b")]
    fuse_ms: Annotated[Float64, _F(_QUALITY, "figures.fuse_ms", _f4, "fuse_ms")]
    fused_checksums: Annotated[UInt32, _F(_QUALITY, "figures.fused_crc32", _u4, covered=False)]
    joint_digests: Annotated[UInt8, _F(_QUALITY, "joint_digests", _u1, shape=_J, covered=False)]
    truth: Annotated[Float64 | None, _F(layout.TRUTH_SKELETON, _POINTS, _f4, "truth", _J3)] = None
    sigma: Annotated[Float32 | None, _F(_S, "sigma_mm", _f2, "fused.sigma", _J, scale=1e3)] = None
    exchanged: Annotated[Int8 | None, _F(_QUALITY, "exchanged", _i1, "exchanged", (2,))] = None
    witness_a: Annotated[Float32 | None, _F(_A, _WITNESS, _f2, "skeletons.a.witness", _J4)] = None
    witness_b: Annotated[Float32 | None, _F(_B, _WITNESS, _f2, "skeletons.b.witness", _J4)] = None
    side_doubt: Annotated[UInt8 | None, _F(_QUALITY, "side_doubt", _u1, "side_doubt", (2,))] = None
    heading: Annotated[
        Float32 | None, _F(_QUALITY, "heading", _f2, "fused.heading", (3,), step=1.0 / HEADING_STEPS)
    ] = None
    up: Annotated[Float32 | None, _F(_QUALITY, "up", _f4, "up", (3,))] = None
    unix_ns: Annotated[Int64 | None, _F(_QUALITY, "unix_ns", _i8, "unix_ns", absent=layout.NO_FRAME)] = None
    depth_errors: Annotated[Float32 | None, _F(_QUALITY, "depth_errors", _f4, "depth_errors", (2,))] = None

    @staticmethod
    def stack(
        body: Body,
        bone_lengths: NDArray[np.float64],
        frames: Sequence[SessionFrame],
        numbers: Sequence[int] | None = None,
        start_ns: int | None = None,
    ) -> SessionArrays:
        """Stacks the frames of one or more turns of the loop.

        Args:
            bone_lengths: (J,) metres, or (T, J) where they change.
            numbers: Of the frames; from 0 if None.
            start_ns: When the session began; with the first of these frames if None.
        """
        times: NDArray[np.int64]
        if isinstance(frames, SessionFrames):
            times = frames.pair.time_ns
            figures = {
                name: spec.of_block(body, spec.value(frames), len(frames)) for name, spec in _TAKEN.items()
            }
        else:
            times = np.array([frame.pair.time_ns for frame in frames], dtype=np.int64)
            figures = {
                name: spec.stacked(body, [spec.value(frame) for frame in frames])
                for name, spec in _TAKEN.items()
            }
        fused: Any = figures["fused"]
        whole: dict[str, Any] = figures | {
            "fused_checksums": fused_checksums(fused),
            "joint_digests": joint_digests(fused),
        }
        return SessionArrays(
            body,
            np.broadcast_to(bone_lengths, (len(frames), len(body))),
            np.array(range(len(frames)) if numbers is None else numbers, dtype=np.int64),
            times - (times[0] if start_ns is None else start_ns),
            **whole,
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
        """A figure by its name; its absent value in every frame if the session does not have it."""
        values: NDArray[Any] | None = getattr(self, name)
        return FRAME_FIELDS[name].nothing(self.body, len(self)) if values is None else values

    def parts(self) -> Iterator[SessionArrays]:
        """The frames in parts, for work that would need much memory for all of them."""
        return (self[part] for part in parts(len(self)))

    def __len__(self) -> int:
        return len(self.frame)

    def __repr__(self) -> str:
        return f"<SessionArrays: {len(self)} frames, {self.body.name}>"

    def __getstate__(self) -> dict[str, Any]:
        """The data alone: a copy would have arrays that can be written."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def __getitem__(self, frames: slice | NDArray[np.int64]) -> SessionArrays:
        """Selects frames; their numbers and times stay unchanged."""
        kept = {f.name: getattr(self, f.name) for f in fields(self)}
        per_frame = {n: v[frames] for n, v in kept.items() if n != "body" and v is not None}
        some = replace(self, **per_frame)
        some.__dict__.update((n, v[frames]) for n, v in self.__dict__.items() if n not in kept)  # computed
        return some

    @property
    def b_in_a(self) -> NDArray[np.float64]:
        """(T, J, 3) S_B transformed to K_A's frame."""
        return self._in_a(self.positions_b)

    def _in_a(self, b: NDArray[np.floating]) -> NDArray[np.float64]:
        turned = np.einsum("tij,tkj->tki", self.rotation, b.astype(np.float64))
        return np.asarray(turned + self.translation[:, None])

    @property
    def never_seen(self) -> NDArray[np.bool_]:
        """(J,) whether no sensor reports the joint in any frame: in S* its bones alone place it."""
        return np.asarray(~(self.states_a.any(axis=0) | self.states_b.any(axis=0)))

    @property
    def seen(self) -> NDArray[np.float64]:
        """(T, J, 3) S*; NaN for joints that were never seen."""
        never = self.never_seen
        return np.where(never[:, None], np.nan, self.fused) if never.any() else self.fused

    @cached_array
    def corrected(self) -> NDArray[np.bool_]:
        """(T, 2) whether A and B report left and right exchanged, and S* corrects this."""
        codes = self.filled("exchanged")
        b = self.b_in_a if codes[:, 1].any() else self.positions_b  # nobody asks where it is
        views = (self.positions_a, self.states_a), (b, self.states_b)
        sides = [corrects_sides(self.body, self.fused, *of, codes[:, k]) for k, of in enumerate(views)]
        return np.stack(sides, axis=1)

    @property
    def frame_rate(self) -> float:
        """Frames per second of the faster sensor without its pauses: 1 / mean interval, as 5, 15, 30, 60 or
        90 if within 5 % of it. 30 for a single frame.
        """
        clocks = () if len(self) < 2 else (self.clock_a, self.clock_b)
        rates = (rate_without_pauses(self.time_ns[clock != layout.NO_FRAME]) for clock in clocks)
        fastest = max((rate for rate in rates if rate is not None), default=30.0)
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
        """(T, J) metres between p and R q + t, without depth errors; NaN where a joint is not in both."""
        a, b = self.positions_a, self.positions_b
        if self.depth_errors is not None:
            errors = np.nan_to_num(self.depth_errors.astype(np.float64))[:, :, None, None]
            a, b = nearer(a.astype(np.float64), errors[:, 0]), nearer(b.astype(np.float64), errors[:, 1])
        return np.asarray(np.linalg.norm(a - self._in_a(b), axis=2))

    @cached_array
    def disagreement(self) -> NDArray[np.float64]:
        """(T,) metres between p and R q + t, median over the joints that both see; NaN without any."""
        parts = (median_of_known(rows.view_difference) for rows in self.parts())
        return np.concatenate([np.zeros(0), *parts])


def rate_without_pauses(time_ns: NDArray[np.int64]) -> float | None:
    """Frames per second at (T,) increasing times, between pauses; None if all have one time."""
    steps = np.diff(time_ns) * 1e-9
    return float(1.0 / steps[steps <= _LONG_PAUSE * np.median(steps)].mean()) if steps.any() else None


def pauses_of(time_ns: NDArray[np.int64]) -> list[tuple[float, float]]:
    """Where the pauses begin, and how long they are, in seconds from the first of (T,) increasing times."""
    steps = np.diff(time_ns)
    usual = np.median(steps) if len(steps) else 0.0
    long = np.flatnonzero(steps > _LONG_PAUSE * usual)
    return [((time_ns[k] - time_ns[0]) * 1e-9, steps[k] * 1e-9) for k in long]


def _declared() -> Iterator[FrameField]:
    """The figures in the annotations of the attributes, with the names and types of these."""
    for name, hint in get_type_hints(SessionArrays, include_extras=True).items():
        if get_origin(hint) is Annotated:
            kind, spec = get_args(hint)
            optional = NoneType in get_args(kind)
            scalar = get_args(get_args(kind)[0] if optional else kind)[-1]
            scalar, *_ = get_args(scalar) or (scalar,)  # from numpy 2.5 on without np.dtype
            yield replace(spec, name=name, dtype=scalar, optional=optional)


FRAME_FIELDS: Mapping[str, FrameField] = MappingProxyType({each.name: each for each in _declared()})
"""The figures by name, in their order. Writer, reader and checksums iterate over them."""
_TAKEN = {name: spec for name, spec in FRAME_FIELDS.items() if spec.of}
