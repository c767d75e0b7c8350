"""Consecutive pairs of skeletons as arrays, which is what the kernels of all methods take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.body import Body
from fusion.compiling.kernels import inner_kernel
from fusion.skeleton import Skeleton, SkeletonPair


class PairArrays(NamedTuple):
    """T pairs; a, b in each sensor's frame."""

    time_ns: NDArray[np.int64]  # (T,) the pairs' times
    skew_ns: NDArray[np.int64]  # (T,) capture time of B minus that of A
    codes: NDArray[np.int64]
    """(T, 2) exchange codes of A and B with doubt (:func:`fusion.facing.exchange.with_doubt`) where they are
    known, -1 where the facing filter finds them."""
    a: NDArray[np.float32]  # (T, J, 3) metres; NaN where not tracked
    b: NDArray[np.float32]
    states_a: NDArray[np.uint8]  # (T, J) tracking states; all 0 where the sensor sees no one
    states_b: NDArray[np.uint8]
    witness_a: NDArray[np.float32]  # (T, J, 4) of depth images (fusion.witness); NaN without
    witness_b: NDArray[np.float32]


class PairStacker:
    """Makes arrays of pairs, always of the types for which the kernels are compiled."""

    def __init__(self, body: Body) -> None:
        self._nobody = Skeleton.of(body, np.full((len(body), 3), np.nan))
        self._no_image = np.full((len(body), 4), np.nan, dtype=np.float32)

    def of_pair(self, pair: SkeletonPair, codes: tuple[int, int] | None = None) -> PairArrays:
        """One pair; see :meth:`of_pairs`. It copies no positions."""
        a, b = pair.a or self._nobody, pair.b or self._nobody
        return PairArrays(
            np.array([pair.time_ns], dtype=np.int64),
            np.array([pair.skew_ns], dtype=np.int64),
            np.array([(-1, -1) if codes is None else codes], dtype=np.int64),
            a.positions[None],
            b.positions[None],
            a.states[None],
            b.states[None],
            self._witness(a)[None],
            self._witness(b)[None],
        )

    def of_pairs(self, pairs: Sequence[SkeletonPair], codes: ArrayLike | None = None) -> PairArrays:
        """T ≥ 1 pairs.

        Args:
            codes: (T, 2) exchange codes with doubt; unknown where None.
        """
        a, b = [pair.a or self._nobody for pair in pairs], [pair.b or self._nobody for pair in pairs]
        return PairArrays(
            np.array([pair.time_ns for pair in pairs], dtype=np.int64),
            np.array([pair.skew_ns for pair in pairs], dtype=np.int64),
            np.array([(-1, -1)] * len(pairs) if codes is None else codes, dtype=np.int64),
            _read_only(np.array([skeleton.positions for skeleton in a])),
            _read_only(np.array([skeleton.positions for skeleton in b])),
            _read_only(np.array([skeleton.states for skeleton in a])),
            _read_only(np.array([skeleton.states for skeleton in b])),
            np.array([self._witness(skeleton) for skeleton in a]),
            np.array([self._witness(skeleton) for skeleton in b]),
        )

    def _witness(self, skeleton: Skeleton) -> NDArray[np.float32]:
        """(J, 4) of its image; NaN without one."""
        if skeleton.witness is None:
            return self._no_image
        return np.array(skeleton.witness, dtype=np.float32)  # of one type, whoever made it


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array.flags.writeable = False  # as the arrays of a skeleton are
    return array


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
