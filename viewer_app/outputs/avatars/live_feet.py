"""Keeps the feet of S* on the floor for avatars, frame by frame; see :mod:`recordings.planted_feet`."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.support.types import Array
from recordings.appearance.floor import FloorFinder
from recordings.planted_feet import BOBS, Legs, fast, lowered, usual_heights

_FOOT, _STRIDE = 0.14, 0.7  # seconds, over which the speeds of foot and pelvis are
_STEADY = 1.3  # of the speed: a foot that stands is not let go at once
_LOST = 0.25  # metres from its place: S* was wrong there
_USUAL = 300  # frames, from which the usual heights are
_SETTLES, _LEAVES, _FOLLOWS = 0.03, 0.08, 0.1  # seconds, time constants
_FASTER = 2.0  # than hips move in recordings: feet that step down are not known before
_GAP = 0.3  # seconds


class LiveFeet:
    """Follows the feet of one person."""

    def __init__(self, body: Body) -> None:
        self._legs, self._floor = Legs(body), FloorFinder(body)
        self._found = False  # the floor
        self._heights: deque[Array] = deque(maxlen=_USUAL)  # (2, 2) above it, NaN of feet that are fast
        self._forget()

    def _forget(self) -> None:
        self._recent: deque[tuple[float, Array, Array]] = deque()  # seconds, feet, pelvis
        self._stands = np.zeros((2, 2), dtype=bool)
        self._places = np.zeros((2, 2, 3))  # of what stands, in K_A's frame: the floor's may change
        self._moves = np.zeros((2, 2, 3))
        self._shares = np.zeros((2, 2))
        self._rise = self._sink = 0.0

    def update(self, positions: Array, time_ns: int) -> Array:
        """(J, 3) S* in K_A's frame, metres, with its feet on the floor; as it is without a person, and until
        ten frames have shown the floor."""
        t = time_ns * 1e-9
        elapsed = t - self._recent[-1][0] if self._recent else 0.0
        known = bool(np.isfinite(positions).all())
        if not known or not 0.0 <= elapsed < _GAP:
            self._forget()
            elapsed = 0.0
        if not known:
            return positions
        if self._floor.add(positions[None]):
            self._found = True
            self._heights.clear()  # above the floor before
        if not self._found:
            return positions
        floor, legs = self._floor.a_from_floor, self._legs
        at = np.asarray(floor.inverse().apply(positions[None]), dtype=np.float64)
        feet = legs.feet_of(at)[0]
        slow = self._slow(t, legs.feet_of(positions[None])[0], legs.pelvis_of(positions[None])[0])
        self._heights.append(np.where(slow, -feet[..., 1], np.nan))
        heights = np.array(self._heights)
        usual = usual_heights(np.where(np.isnan(heights), 0.0, heights), np.isfinite(heights))
        places = np.asarray(floor.inverse().apply(self._places))
        near = np.linalg.norm(places - feet, axis=2) < _LOST
        stands = slow & lowered(-feet[None, ..., 1], usual)[0] & (near | ~self._stands)
        begins = stands & ~self._stands
        leaves, follows, settles = (1.0 - np.exp(-elapsed / each) for each in (_LEAVES, _FOLLOWS, _SETTLES))
        self._moves *= 1.0 - leaves
        self._shares *= 1.0 - leaves
        places[begins] = (feet + self._moves)[begins]
        places[stands, 1] += settles * (-np.broadcast_to(usual, (2, 2))[stands] - places[stands, 1])
        self._moves[stands], self._shares[stands] = (places - feet)[stands], 1.0
        self._stands, self._places = stands, np.asarray(floor.apply(places))
        rise = float(self._moves[stands, 1].mean()) if stands.any() else 0.0
        most = _FASTER * BOBS * elapsed
        self._rise += float(np.clip(follows * (rise - self._rise), -most, most))
        at[..., 1] += self._rise
        moves, shares = self._moves.copy(), self._shares
        moves[..., 1] -= shares * self._rise
        reached = legs.feet_at(at, moves[None], shares[None], usual)
        sink = float(legs.out_of_reach(at, reached)[0])
        self._sink += float(np.clip(sink - self._sink, -most, most))
        at[..., 1] += self._sink
        return np.asarray(floor.apply(legs.bent(at, reached)[0]))

    def _slow(self, t: float, feet: Array, pelvis: Array) -> NDArray[np.bool_]:
        """(2, 2) whether ankles and toes are slower than those of a foot that walks with the pelvis."""
        self._recent.append((t, feet, pelvis))
        while t - self._recent[0][0] > _STRIDE:
            self._recent.popleft()
        before, _, there = self._recent[0]
        lately, at, _ = next(each for each in self._recent if t - each[0] <= _FOOT)
        if lately == t:
            return np.zeros((2, 2), dtype=bool)
        speeds = np.linalg.norm(feet - at, axis=2) / (t - lately)
        of_pelvis = np.array([np.linalg.norm(pelvis - there) / (t - before)])
        return np.asarray(speeds < fast(of_pelvis) * np.where(self._stands, _STEADY, 1.0))
