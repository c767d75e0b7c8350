"""The evidence for registration: a bounded set of pairs from all over the volume.

Frames of a person who stands still repeat the same bias of each joint, so that few of them become keyframes.
Keyframes are stored by the person's place and heading in both views, so that the set covers the whole volume.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.body import Body
from fusion.joint_kinds import limbs
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair
from fusion.support.array_fields import new_arrays
from fusion.support.large_arrays import give_back
from fusion.support.types import Array

_SHORTEST_NS = 190_000_000
"""Between two keyframes. At usual frame rates no whole number of intervals, so that a jitter of the times
decides nothing."""
_LONGEST_NS = 1_990_000_000  # after this time a pair becomes a keyframe even without motion
_MOVED = 0.06  # metres, mean over the joints of both views: a pose that is new
_CELL = 0.5  # metres
_SECTORS = 8  # of the person's heading
_BLOCK_NS = 2_000_000_000  # frames of one block share a fold
_GIVEN_BACK = 32  # pairs far apart in a file, each of which takes half a megabyte
_WEIGHTS = np.array([0.0, 0.1, 1.0])
"""Information of a joint by its tracking state: the error of an inferred one is three times as large."""
_FAR = 0.08  # metres: a joint's disagreement beyond this counts less and less


class Evidence(NamedTuple):
    """Joints of K pairs, ready for a fit."""

    a: Annotated[Array, ("K", "J", 3)]  # metres, each in its sensor's frame; 0 where unknown
    b: Annotated[Array, ("K", "J", 3)]
    weights: Annotated[Array, ("K", "J")]
    """0 where one of the views has no position, 1 where both track the joint."""
    basis: Annotated[Array, ("K", 3)]  # 1, cos h, sin h of the person's heading h in K_A's frame
    time_ns: Annotated[NDArray[np.int64], ("K",)]  # when

    def chosen(self, index: NDArray[np.bool_] | NDArray[np.int64] | slice) -> Evidence:
        """Some of the pairs."""
        return Evidence._make(values[index] for values in self)

    def copy(self) -> Evidence:
        """The same pairs in arrays of their own."""
        return Evidence._make(values.copy() for values in self)

    @property
    def folds(self) -> NDArray[np.int64]:
        """(K,) 0 or 1: alternate blocks of two seconds, so that one half can be held out."""
        since_first = self.time_ns - self.time_ns.min(initial=np.iinfo(np.int64).max)
        return np.asarray((since_first // _BLOCK_NS) % 2, dtype=np.int64)


def relabelled(
    body: Body, positions: NDArray[np.float32], states: NDArray[np.uint8], codes: ArrayLike
) -> tuple[Array, Array]:
    """Positions and weights of a view in T frames, with left and right of its limbs exchanged back.

    Args:
        positions: (T, J, 3) metres; NaN where unknown.
        states: (T, J) tracking states.
        codes: (T,) bit 0 exchanges the arms, bit 1 the legs.

    Returns:
        (T, J, 3) positions, 0 where unknown; (T, J) weights 0, 0.1 (inferred) or 1 (tracked).
    """
    code = np.asarray(codes)[:, None]
    if code.any():
        source = np.where(limbs(body) & code, body.mirror, np.arange(len(body)))
        states = np.take_along_axis(states, source, axis=1)
        positions = np.take_along_axis(positions, source[:, :, None], axis=1)
    return np.where(states[:, :, None] != 0, positions, 0.0).astype(np.float64), _WEIGHTS[states]


class KeyframeSet:
    """Keeps at most ``capacity`` pairs, spread over places, headings and time.

    Args:
        capacity: A full set drops the oldest keyframe of its fullest cell.
        selective: Whether a pair must show something new: a pose that has moved, or two seconds later.
    """

    def __init__(self, body: Body, capacity: int = 128, *, selective: bool = True) -> None:
        self._body, self._capacity, self._selective = body, capacity, selective
        self._left, self._right = (
            [body.joint(f"{name}_{side}") for name in ("SHOULDER", "HIP")] for side in ("LEFT", "RIGHT")
        )
        self._store = new_arrays(Evidence, K=capacity, J=len(body))
        self._cells: dict[tuple[int, ...], list[int]] = {}  # the slots in each, oldest first
        self._times: list[int] = []  # of the slots
        self._newest: int | None = None

    def __len__(self) -> int:
        return len(self._times)

    @property
    def evidence(self) -> Evidence:
        """All keyframes, as views of the store, not ordered by time."""
        return self._store.chosen(slice(0, len(self)))

    def forget_before(self, time_ns: int) -> None:
        """Forgets the keyframes older than ``time_ns``."""
        keep = [k for k, of_slot in enumerate(self._times) if of_slot >= time_ns]
        for values in self._store:
            values[: len(keep)] = values[keep]
        number = {old: new for new, old in enumerate(keep)}
        self._cells = {cell: [number[k] for k in slots if k in number] for cell, slots in self._cells.items()}
        self._times = [self._times[k] for k in keep]
        self._newest = int(np.argmax(self._times)) if keep else None

    def add(self, pair: SkeletonPair, codes: tuple[int, int] = (0, 0)) -> bool:
        """Whether a pair shows something new, and became a keyframe; the caller leaves out stale ones."""
        if pair.a is None or pair.b is None or (self._selective and not self.due(pair.time_ns)):
            return False
        (a, weight_a), (b, weight_b) = (
            relabelled(self._body, view.positions[None], view.states[None], (code,))
            for view, code in zip((pair.a, pair.b), codes, strict=True)
        )
        return self.add_views((a[0], b[0]), (weight_a[0], weight_b[0]), pair.time_ns)

    def add_views(self, views: tuple[Array, Array], weights: tuple[Array, Array], time_ns: int) -> bool:
        """The same of a pair that is due, as :func:`relabelled` gives its views."""
        (a, b), (weight_a, weight_b) = views, weights
        weight = weight_a * weight_b
        if self._selective and not self._new((a, b), weight, time_ns):
            return False
        if np.count_nonzero(weight == 1.0) < len(self._body) // 3:
            return False
        heading = self._heading(a)
        slot = self._slot((*_cell(a, weight_a, heading), *_cell(b, weight_b, self._heading(b))))
        store = self._store
        store.a[slot], store.b[slot], store.weights[slot] = a, b, weight
        store.basis[slot] = 1.0, np.cos(heading), np.sin(heading)
        store.time_ns[slot] = self._times[slot] = time_ns
        self._newest = slot
        return True

    def relabel(self, a_from_b: RigidTransform) -> None:
        """Exchanges left and right of B's limbs where they then agree with A's; see :func:`match_sides`."""
        match_sides(self._body, self.evidence, a_from_b)

    def due(self, time_ns: int) -> bool:
        """Whether enough time has passed since the newest keyframe."""
        return self._newest is None or time_ns - self._times[self._newest] >= _SHORTEST_NS

    def _new(self, views: tuple[Array, Array], weight: Array, time_ns: int) -> bool:
        newest = self._newest
        if newest is None or time_ns - self._times[newest] >= _LONGEST_NS:
            return True
        both = (weight > 0.0) & (self._store.weights[newest] > 0.0)
        if not both.any():
            return True
        moved = np.array(views)[:, both] - np.array(
            (self._store.a[newest, both], self._store.b[newest, both])
        )
        return bool(np.sqrt((moved * moved).sum(axis=2)).mean() > _MOVED)

    def _heading(self, at: Array) -> float:
        across = at[self._left].sum(axis=0) - at[self._right].sum(axis=0)
        return float(np.arctan2(across[2], across[0]))

    def _slot(self, cell: tuple[int, ...]) -> int:
        slot = len(self)
        if slot < self._capacity:
            self._times.append(0)
        else:
            most = max(map(len, self._cells.values()))
            fullest = (slots for slots in self._cells.values() if len(slots) == most)
            slot = min(fullest, key=lambda slots: self._times[slots[0]]).pop(0)
        self._cells.setdefault(cell, []).append(slot)
        return slot


def _cell(at: Array, weight: Array, heading: float) -> tuple[int, int, int]:
    """The place and the sector of a person's heading in one view."""
    x, _, z = np.floor(at[weight > 0.0].mean(axis=0) / _CELL).astype(int).tolist()
    return x, z, int((heading / (2.0 * np.pi) + 0.5) * _SECTORS) % _SECTORS


def evidence_of(
    body: Body, pairs: Sequence[SkeletonPair], codes: Sequence[tuple[int, int]] | None = None
) -> Evidence:
    """All given pairs that both sensors saw, as evidence; the caller has left out stale ones."""
    every = KeyframeSet(body, capacity=max(1, len(pairs)), selective=False)
    for k, pair in enumerate(pairs):
        every.add(pair, (0, 0) if codes is None else codes[k])
        if k % _GIVEN_BACK == 0:
            give_back()
    return every.evidence


def match_sides(body: Body, evidence: Evidence, a_from_b: RigidTransform) -> NDArray[np.int64]:
    """Exchanges left and right of B's arms, and of B's legs, in pairs where they then agree better with A's.

    Registration needs only consistent labels; which of the views is mirrored does not matter.
    ``evidence.b`` and ``evidence.weights`` are changed in place. A joint is exchanged only together with the
    other joints of its kind of limb.

    Returns:
        (K,) codes of what was exchanged: bit 0 arms, bit 1 legs.
    """
    part = limbs(body)
    codes = np.zeros(len(evidence.a), dtype=np.int64)
    b_in_a = evidence.b @ a_from_b.rotation.T + a_from_b.translation
    for bit in (1, 2):
        joints = np.flatnonzero(part == bit)
        mirrored = body.mirror[joints]
        weight = np.minimum(evidence.weights[:, joints], evidence.weights[:, mirrored])
        as_is = _penalty(evidence.a[:, joints] - b_in_a[:, joints])
        exchanged = _penalty(evidence.a[:, joints] - b_in_a[:, mirrored])
        better = np.flatnonzero((weight * (exchanged - as_is)).sum(axis=1) < 0.0)
        rows = better[:, None]
        evidence.b[rows, joints] = evidence.b[rows, mirrored]
        evidence.weights[rows, joints] = weight[better]
        codes[better] |= bit
    return codes


def _penalty(apart: Array) -> Array:
    return np.asarray(np.log1p(np.sum(apart * apart, axis=-1) / _FAR**2))
