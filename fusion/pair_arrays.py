"""Consecutive pairs of skeletons as arrays, which is what the kernels of all methods take."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.compiling.kernels import inner_kernel
from fusion.facing.labels import Labels
from fusion.skeleton import NO_FRAME, Skeleton, SkeletonPair, nobody
from fusion.support.large_arrays import PART, GrowingArray, parts
from fusion.support.read_only import read_only


class PairArrays(NamedTuple):
    """T pairs; a, b in each sensor's frame."""

    time_ns: NDArray[np.int64]  # (T,) the pairs' times
    skew_ns: NDArray[np.int64]  # (T,) capture time of B minus that of A
    labels: Labels
    a: NDArray[np.float32]  # (T, J, 3) metres; NaN where not tracked
    b: NDArray[np.float32]
    states_a: NDArray[np.uint8]  # (T, J) tracking states; all 0 where the sensor sees no one
    states_b: NDArray[np.uint8]
    witness_a: NDArray[np.float32]  # (T, J, 4) of depth images (fusion.witness); NaN without
    witness_b: NDArray[np.float32]


class View(NamedTuple):
    """One person in T frames of a sensor; a recording's may lie in a file
    (:mod:`fusion.support.large_arrays`)."""

    time_ns: NDArray[np.int64]  # (T,) in order, on the sensor's clock
    positions: NDArray[np.float32]  # (T, J, 3) metres in the sensor's frame; NaN where not tracked
    states: NDArray[np.uint8]  # (T, J) tracking states; all 0 where the person is not seen
    witness: NDArray[np.float32] | None = None  # (T, J, 4) of depth images (fusion.witness); NaN without

    def skeleton(self, body: Body, k: int) -> Skeleton | None:
        """That of frame k; None where the person is not seen."""
        return self.row(body, k) if k >= 0 and self.states[k].any() else None

    def row(self, body: Body, k: int) -> Skeleton:
        """Skeleton k."""
        witness = None if self.witness is None else self.witness[k]
        return Skeleton(body, self.positions[k], self.states[k], int(self.time_ns[k]), witness)

    def chosen(self, index: NDArray[np.int64]) -> View:
        """The frames of an index, as arrays of their own; nobody is seen where it is -1."""
        chosen: list[Any] = [None if values is None else values[index] for values in self]
        missing = index < 0
        if missing.any():
            for values, nothing in zip(chosen, (NO_FRAME, np.nan, 0, np.nan), strict=True):
                if values is not None:
                    values[missing] = nothing
        return View(*chosen)

    def chosen_whole(self, index: NDArray[np.int64]) -> View:
        """The same of a long recording."""
        if len(index) == 0:
            return self.chosen(index)
        return joined_views(self.chosen(index[part]) for part in parts(len(index)))


def joined_views(blocks: Iterable[View]) -> View:
    """Consecutive frames, at least one block."""
    time_ns, positions, states = GrowingArray(), GrowingArray(), GrowingArray()
    witness, count = None, 0
    for block in blocks:
        time_ns.append(block.time_ns)
        positions.append(block.positions)
        states.append(block.states)
        if witness is None and block.witness is not None:
            witness = GrowingArray()
            witness.append(_no_images(count, block.states.shape[1]))
        if witness is not None:
            unseen = block.witness is None
            witness.append(_no_images(*block.states.shape) if unseen else np.asarray(block.witness))
        count += len(block.time_ns)
    every = (time_ns, positions, states) if witness is None else (time_ns, positions, states, witness)
    return View(*GrowingArray.wholes(every))


def view_of(body: Body, skeletons: Iterable[Skeleton]) -> View:
    """Skeletons as arrays; a single one without joints if there are none.

    Raises:
        BodyError: One is of another body.
    """
    rest = iter(skeletons)
    first = list(islice(rest, PART)) or [nobody(body)]
    blocks = chain([first], iter(lambda: list(islice(rest, PART)), []))
    return joined_views(_block_of(body, block) for block in blocks)


def _block_of(body: Body, skeletons: list[Skeleton]) -> View:
    for skeleton in skeletons:
        body.require(skeleton.body)
    nothing = _no_images(1, len(body))[0]
    witness = [nothing if skeleton.witness is None else skeleton.witness for skeleton in skeletons]
    return View(
        np.array([skeleton.time_ns for skeleton in skeletons], dtype=np.int64),
        np.array([skeleton.positions for skeleton in skeletons]),
        np.array([skeleton.states for skeleton in skeletons]),
        np.array(witness, np.float32) if any(s.witness is not None for s in skeletons) else None,
    )


def _no_images(frames: int, joints: int) -> NDArray[np.float32]:
    return np.full((frames, joints, 4), np.nan, dtype=np.float32)


@dataclass(frozen=True, eq=False, repr=False)
class Pairs(Sequence[SkeletonPair]):
    """T pairs of recorded views; each is made when it is asked for."""

    body: Body
    views: tuple[View, View]
    time_ns: NDArray[np.int64]  # (T,) as in SkeletonPair
    skew_ns: NDArray[np.int64]
    frames: NDArray[np.int64]  # (T, 2) which frames of the views are paired; -1 for none

    def __post_init__(self) -> None:
        """Checks the views' shapes; raises BodyError."""
        for view in self.views:
            frames = view.states.shape[:1]
            self.body.require_shape(view.positions.shape, frames)
            self.body.require_shape((*view.states.shape, 3), frames)
            if view.witness is not None:
                self.body.require_shape(view.witness.shape, frames, 4)

    @staticmethod
    def of(body: Body, pairs: Sequence[SkeletonPair]) -> Pairs:
        """Any pairs of a body; the same object if they are of this class.

        Raises:
            BodyError: A skeleton is of another body.
        """
        if isinstance(pairs, Pairs):
            body.require(pairs.body, "A recording")
            return pairs
        frames = np.full((len(pairs), 2), -1, dtype=np.int64)
        views = []
        for side, skeletons in enumerate(([pair.a for pair in pairs], [pair.b for pair in pairs])):
            seen = [k for k, skeleton in enumerate(skeletons) if skeleton is not None]
            frames[seen, side] = range(len(seen))
            views.append(view_of(body, (skeleton for skeleton in skeletons if skeleton is not None)))
        times = np.array([(pair.time_ns, pair.skew_ns) for pair in pairs], dtype=np.int64).reshape(-1, 2)
        return Pairs(body, (views[0], views[1]), times[:, 0], times[:, 1], frames)

    def __len__(self) -> int:
        return len(self.time_ns)

    @overload
    def __getitem__(self, k: int) -> SkeletonPair: ...
    @overload
    def __getitem__(self, k: slice | NDArray[np.int64]) -> Pairs: ...
    def __getitem__(self, k: int | slice | NDArray[np.int64]) -> SkeletonPair | Pairs:
        """Pair k, or some of the pairs."""
        if isinstance(k, slice | np.ndarray):
            return Pairs(self.body, self.views, self.time_ns[k], self.skew_ns[k], self.frames[k])
        (i, j), (a, b) = self.frames[k].tolist(), self.views
        seen = a.skeleton(self.body, i), b.skeleton(self.body, j)
        return SkeletonPair(*seen, int(self.time_ns[k]), int(self.skew_ns[k]))

    @property
    def seen_by_both(self) -> NDArray[np.bool_]:
        """(T,) whether both sensors see the person."""
        a, b = (
            (frames >= 0) & view.states[frames].any(axis=1)
            for view, frames in zip(self.views, self.frames.T, strict=True)
        )
        return np.asarray(a & b)

    def arrays(self, labels: Labels | None = None) -> PairArrays:
        """The pairs as arrays of their own, which is what the kernels take, with labels as far as known.

        Raises:
            FusionError: The labels are not of so many pairs.
        """
        a, b = (view.chosen(self.frames[:, side]) for side, view in enumerate(self.views))
        return PairArrays(
            np.array(self.time_ns),
            np.array(self.skew_ns),
            Labels.unknown(len(self)) if labels is None else labels.of_pairs(len(self)),
            *(read_only(a.positions), read_only(b.positions)),
            *(read_only(a.states), read_only(b.states)),
            *(_no_images(*v.states.shape) if v.witness is None else v.witness for v in (a, b)),
        )


class PairStacker:
    """Makes arrays of one pair at a time, always of the types for which the kernels are compiled."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._nobody, self._unknown = nobody(body), Labels.unknown(1)
        self._no_image: NDArray[np.float32] = _no_images(1, len(body))[0]

    def of_pair(self, pair: SkeletonPair, labels: Labels | None = None) -> PairArrays:
        """One pair; see :meth:`Pairs.arrays`. It copies no positions.

        Raises:
            BodyError: A skeleton is of another body.
            FusionError: The labels are not one row.
        """
        pair.require(self._body)
        a, b = pair.a or self._nobody, pair.b or self._nobody
        return PairArrays(
            np.array([pair.time_ns], dtype=np.int64),
            np.array([pair.skew_ns], dtype=np.int64),
            self._unknown if labels is None else labels.of_pairs(1),
            a.positions[None],
            b.positions[None],
            a.states[None],
            b.states[None],
            self._witness(a)[None],
            self._witness(b)[None],
        )

    def _witness(self, skeleton: Skeleton) -> NDArray[np.float32]:
        """(J, 4) of its image; NaN without one."""
        if skeleton.witness is None:
            return self._no_image
        return np.array(skeleton.witness, dtype=np.float32)  # of one type, whoever made it


@inner_kernel
def repeats(positions, states, last, last_states):  # type: ignore[no-untyped-def]
    """Whether a sensor repeats its last skeleton; stores the new one. An empty skeleton is no repetition."""
    same, anyone = True, False
    for i in range(len(states)):
        anyone = anyone or states[i] != 0
        same = same and states[i] == last_states[i]
        last_states[i] = states[i]
        for c in range(3):
            both_nan = math.isnan(positions[i, c]) and math.isnan(last[i, c])
            same = same and (both_nan or positions[i, c] == last[i, c])
            last[i, c] = positions[i, c]
    return same and anyone


@inner_kernel
def anyone_seen(pairs, k):  # type: ignore[no-untyped-def]
    """Whether a sensor reports a person in pair k."""
    some = False
    for i in range(pairs.states_a.shape[1]):
        some = some or pairs.states_a[k, i] != 0 or pairs.states_b[k, i] != 0
    return some
