"""S* for animations: feet that stand stay where they are, as far as a turn of the leg about its hip does it.

The end of a foot, ankle or toes, stands while it is slower than 0.3 m/s even if S* errs by σ in half a
second. It then stays in its place, but for a slow return to S*, and returns soon when it does not stand any
more. The leg turns about its hip as a whole, so that the knee's angle is that of S*, and by so much at most
that the knee moves by 25 mm. What a foot would need beyond that, it slides. All else is S*.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fusion.body import Body
from fusion.support.types import Array

MOST_MOVED = 0.025  # metres, of a knee
FASTEST = 0.3  # m/s, of a foot that stands
_ERRS_S = 0.5  # seconds in which S* errs by its standard deviation
_SPAN_S = 0.1  # over which speeds are
_STEADY = 1.3  # of the speed: a foot that stands is not let go at once
_HOLDS_S, _LEAVES_S = 1.0, 0.08  # time constants of the return to S*, of feet that stand and of others
_GAP_S = 0.3


class PlantedFeet:
    """Follows the feet of one person, frame by frame, live and in files."""

    def __init__(self, body: Body) -> None:
        sides = ("Left", "Right")
        self._hips, self._knees, ankles, toes = (
            [body.joint(part + side) for side in sides] for part in ("Hip", "Knee", "Ankle", "Foot")
        )
        self._feet = np.stack([ankles, toes], axis=1)
        heels = [(k, body.find("Heel" + side)) for k, side in enumerate(sides)]
        self._heels = [(k, heel) for k, heel in heels if heel is not None]
        self._forget()

    def _forget(self) -> None:
        self._recent: deque[tuple[float, Array]] = deque()  # seconds, feet
        self._stands = np.zeros((2, 2), dtype=bool)
        self._planted = self._moves = np.zeros((2, 2, 3))

    def update(self, positions: Array, sigma: Array | None, time_ns: int) -> Array:
        """(J, 3) S* with feet that stand; as it is without a person.

        Args:
            positions: (J, 3) S*, metres; NaN without a person.
            sigma: (J,) its standard deviations, metres; None or NaN where they are not known.
        """
        t, known = time_ns * 1e-9, bool(np.isfinite(positions).all())
        elapsed = t - self._recent[-1][0] if self._recent else 0.0
        if not known or not 0.0 <= elapsed < _GAP_S:
            self._forget()
            elapsed = 0.0
        if not known:
            return positions
        feet = positions[self._feet]
        stands = self._slow(t, feet, 0.0 if sigma is None else np.nan_to_num(sigma[self._feet]))
        stays = (stands & self._stands)[..., None]
        moves = np.where(stays, self._planted - feet, self._moves)
        moves *= np.exp(-elapsed / np.where(stays, _HOLDS_S, _LEAVES_S))
        # an end that does not stand goes with the one that does
        lone = stands[:, ::-1] & ~stands
        planted = self._turned(positions, np.where(lone[..., None], moves[:, ::-1], moves))
        self._stands, self._planted = stands, planted[self._feet]
        self._moves = self._planted - feet
        return planted

    def _slow(self, t: float, feet: Array, sigma: Array | float) -> NDArray[np.bool_]:
        """(2, 2) whether ankles and toes stand."""
        self._recent.append((t, feet))
        while len(self._recent) > 2 and t - self._recent[1][0] >= _SPAN_S:
            self._recent.popleft()
        before_s, before = self._recent[0]
        speed = np.linalg.norm(feet - before, axis=2) / (t - before_s) if before_s < t else np.inf
        return np.asarray(speed + sigma / _ERRS_S < FASTEST * np.where(self._stands, _STEADY, 1.0))

    def _turned(self, positions: Array, moves: Array) -> Array:
        """(J, 3) with legs that turn to feet that are moved by (2, 2, 3)."""
        hips, knees, (ankles, toes) = positions[self._hips], positions[self._knees], positions[self._feet.T]
        leg, to_place = ankles - hips, ankles - hips + moves[:, 0]
        axes = np.cross(leg, to_place)
        sine, cosine = _length(axes), np.sum(leg * to_place, axis=1, keepdims=True)
        most = MOST_MOVED / np.maximum(_length(knees - hips), MOST_MOVED)
        angles = np.minimum(np.arctan2(sine, cosine), most)
        turns = Rotation.from_rotvec(angles * axes / np.maximum(sine, 1e-12))
        turned = positions.copy()
        turned[self._knees] = hips + turns.apply(knees - hips)
        turned[self._feet[:, 0]] = standing = hips + turns.apply(leg)
        foot = toes + moves[:, 1] - standing
        turned[self._feet[:, 1]] = standing + _length(toes - ankles) / np.maximum(_length(foot), 1e-12) * foot
        for k, heel in self._heels:
            turned[heel] += standing[k] - ankles[k]
        return turned


def _length(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1, keepdims=True))


def planted_feet(body: Body, time_ns: NDArray[np.int64], positions: Array, sigma: Array) -> Array:
    """(T, J, 3) all frames of :class:`PlantedFeet`.

    Args:
        time_ns: (T,) since the first pair, ascending.
        positions: (T, J, 3) metres; NaN without a person.
        sigma: (T, J) metres.
    """
    feet = PlantedFeet(body)
    frames = zip(positions, sigma, time_ns.tolist(), strict=True)
    return np.array([feet.update(*frame) for frame in frames]).reshape(positions.shape)
