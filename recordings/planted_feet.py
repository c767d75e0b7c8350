"""S* for animations: feet on the floor neither slide nor sink, and bones keep their lengths.

An ankle, or toes, stand while they are slower than 0.75 of the pelvis, as in
:mod:`recordings.gait.events`, or than 0.25 m/s, and less than 5 cm above where they usually stand. What is
between two such times in one stance of the gait counts, too: S* loses a foot for some frames. They are then
kept in the middle of their places at their usual height, and are led there and away in 0.15 s. The person
rises and sinks with the feet, and sinks by 2 cm at most where a leg would not reach its foot, both slowly:
people do not bob. Knees follow by inverse kinematics of two bones, in the planes of S*.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.support.types import Array
from recordings.gait import SIDES, Gait
from recordings.gait.parts import spans_of

Mask = NDArray[np.bool_]

SINKS = 0.02  # metres at most: a person who sinks at each step bobs, and a trailing foot may slide instead
BOBS = 0.05  # m/s at most, by which feet move the hips up or down; as much again, by which reach does
_OF_PELVIS = 0.75  # of its speed
_STILL = 0.25  # m/s
_RAISED = 0.05  # metres
_REACH = 0.998  # of a leg's length: a straighter one throws the knee about
_FOOT, _STRIDE = 0.07, 0.35  # seconds before and after, over which the speeds of foot and pelvis are
_LEAST = 0.1  # seconds of standing
_PAUSE = 0.08  # seconds, shorter than a swing
_LED = 0.15  # seconds
_FOLLOWS = 0.1  # seconds, standard deviation
_LONGEST_GAP = 0.3  # seconds without S*


def planted_feet(body: Body, seconds: Array, positions: Array, gait: Gait) -> Array:
    """The positions with feet that stand on the floor.

    Args:
        seconds: (T,) since the first pair, ascending.
        positions: (T, J, 3) metres in the floor's frame, whose y is down; NaN without a person.
        gait: Of the person.
    """
    legs, planted = Legs(body), positions.copy()
    known = np.flatnonzero(np.isfinite(positions).all(axis=(1, 2)))
    known = known[np.diff(seconds[known], prepend=-np.inf) > 0.0]
    gaps = np.flatnonzero(np.diff(seconds[known]) > _LONGEST_GAP) + 1
    parts = [part for part in np.split(known, gaps) if len(part) > 2]
    if not parts:
        return planted
    heights, slow = -legs.feet_of(positions)[..., 1], np.zeros((len(seconds), 2, 2), dtype=bool)
    for part in parts:
        slow[part] = _slow(legs, seconds[part], positions[part])
    usual = usual_heights(heights, slow)
    # NaN, where there is no gait, is no stance
    stances = np.stack([gait.contact(side, seconds) > 0.5 for side in SIDES], axis=1)
    for part in parts:
        stands = _in_stances(slow[part] & lowered(heights[part], usual), stances[part])
        planted[part] = _planted(legs, seconds[part], positions[part], stands, usual)
    return planted


class Legs:
    """The legs of a body, left and right. Positions are in the floor's frame: metres, y is down."""

    def __init__(self, body: Body) -> None:
        sides = ("Left", "Right")
        self._hips, self._knees = ([body.joint(part + side) for side in sides] for part in ("Hip", "Knee"))
        self._feet = np.array([[body.joint(part + side) for part in ("Ankle", "Foot")] for side in sides])
        heels = [(k, body.find("Heel" + side)) for k, side in enumerate(sides)]
        self._heels = [(k, heel) for k, heel in heels if heel is not None]

    def feet_of(self, positions: Array) -> Array:
        """(T, 2, 2, 3) ankle and toes of each leg, of (T, J, 3)."""
        return positions[:, self._feet]

    def pelvis_of(self, positions: Array) -> Array:
        """(T, 3) the middle of the hips."""
        return np.asarray(positions[:, self._hips].mean(axis=1))

    def feet_at(self, positions: Array, moves: Array, shares: Array, usual: Array) -> Array:
        """(T, 2, 2, 3) ankles and toes that are moved. The other end of a foot goes along.

        Args:
            positions: (T, J, 3).
            moves: (T, 2, 2, 3).
            shares: (T, 2, 2) how far an end keeps to its own move, 0 to 1.
            usual: (2,) metres, heights of ankles and toes below which none is.
        """
        feet = self.feet_of(positions) + moves + (1.0 - shares[..., None]) * moves[:, :, ::-1]
        foot = feet[:, :, 0] - feet[:, :, 1]
        now = np.linalg.norm(foot, axis=2, keepdims=True)
        own = np.linalg.norm(np.diff(self.feet_of(positions), axis=2)[:, :, 0], axis=2, keepdims=True)
        both = shares.sum(axis=2, keepdims=True)
        of_ankle = np.where(both > 0.0, shares[:, :, 1:] / np.maximum(both, 1e-9), 1.0)
        longer = (own - now) / np.maximum(now, 1e-9) * foot
        feet[:, :, 0] += of_ankle * longer
        feet[:, :, 1] -= (1.0 - of_ankle) * longer
        feet[..., 1] -= np.maximum(feet[..., 1] + usual, 0.0).max(axis=2, keepdims=True)
        return feet

    def out_of_reach(self, positions: Array, feet: Array) -> Array:
        """(T,) metres, :data:`SINKS` at most, by which the person sinks so that legs reach their feet."""
        to_ankles = feet[:, :, 0] - positions[:, self._hips]
        across = np.hypot(to_ankles[..., 0], to_ankles[..., 2])
        length = _REACH * sum(self._bones(positions))
        below = np.sqrt(np.maximum(length**2 - across**2, 0.0))
        return np.asarray((to_ankles[..., 1] - below).max(axis=1).clip(0.0, SINKS))

    def bent(self, positions: Array, feet: Array) -> Array:
        """(T, J, 3) with legs that reach to these feet, as far as they can, in their own planes."""
        bent, hips = positions.copy(), positions[:, self._hips]
        thigh, shin = (length[..., None] for length in self._bones(positions))
        to_ankle = feet[:, :, 0] - hips
        wanted = np.linalg.norm(to_ankle, axis=2, keepdims=True)
        far = wanted.clip(np.abs(thigh - shin), thigh + shin)
        along = to_ankle / np.maximum(wanted, 1e-9)
        ankles = hips + far * along
        aside = positions[:, self._knees] - hips
        aside = aside - along * np.sum(along * aside, axis=2, keepdims=True)
        aside /= np.maximum(np.linalg.norm(aside, axis=2, keepdims=True), 1e-9)
        to_knee = (far**2 + thigh**2 - shin**2) / (2.0 * far)
        bent[:, self._knees] = (
            hips + to_knee * along + np.sqrt(np.maximum(thigh**2 - to_knee**2, 0.0)) * aside
        )
        moved = ankles - positions[:, self._feet[:, 0]]
        for k, heel in self._heels:
            bent[:, heel] += moved[:, k]
        bent[:, self._feet[:, 0]] = ankles
        bent[:, self._feet[:, 1]] = ankles + feet[:, :, 1] - feet[:, :, 0]
        return bent

    def _bones(self, positions: Array) -> tuple[Array, Array]:
        hips, knees, ankles = (positions[:, each] for each in (self._hips, self._knees, self._feet[:, 0]))
        return np.linalg.norm(knees - hips, axis=2), np.linalg.norm(ankles - knees, axis=2)


def fast(pelvis: Array) -> Array:
    """(T,) m/s, from which a foot does not stand, of (T,) the pelvis' speed."""
    return np.maximum(_STILL, _OF_PELVIS * pelvis)


def lowered(heights: Array, usual: Array) -> Mask:
    """(T, 2, 2) whether ankles and toes are low enough to stand, of their heights and (2,) the usual ones."""
    return np.asarray(heights < usual + _RAISED)


def usual_heights(heights: Array, slow: Mask) -> Array:
    """(2,) metres, of ankles and toes that stand; of (T, 2, 2) heights, and whether they are slow."""
    usual = np.zeros(2)
    for k in (0, 1):
        known = heights[:, :, k][slow[:, :, k]]
        known = known if len(known) else heights[np.isfinite(heights[:, 0, k])][:, :, k]
        usual[k] = np.median(known[known < np.median(known) + _RAISED])
    return usual


def _slow(legs: Legs, t: Array, positions: Array) -> Mask:
    """(T, 2, 2) whether ankles and toes are slower than a foot that walks with the pelvis."""
    pelvis = _speed(t, legs.pelvis_of(positions)[:, [0, 2]], _STRIDE)
    feet = _speed(t, legs.feet_of(positions).reshape(len(t), 4, 3), _FOOT).reshape(len(t), 2, 2)
    return np.asarray(feet < fast(pelvis)[:, None, None])


def _speed(t: Array, points: Array, around: float) -> Array:
    """(T, …) m/s of (T, …, d), from some seconds before to as many after."""
    from scipy.interpolate import make_interp_spline

    before, after = np.maximum(t - around, t[0]), np.minimum(t + around, t[-1])
    at = make_interp_spline(t, points, k=1)
    way = np.linalg.norm(at(after) - at(before), axis=-1)
    return np.asarray((way.T / (after - before)).T)


def _planted(legs: Legs, t: Array, positions: Array, stands: Mask, usual: Array) -> Array:
    from scipy.ndimage import gaussian_filter1d

    feet = legs.feet_of(positions)
    moves, shares, frames = np.zeros_like(feet), np.zeros(feet.shape[:3]), np.arange(len(t))
    for leg, part in np.ndindex(2, 2):
        own, spans = feet[:, leg, part], spans_of(stands[:, leg, part], t, _PAUSE)
        spans = [span for span in spans if t[span[1] - 1] - t[span[0]] >= _LEAST]
        free = ~np.logical_or.reduce(
            [(frames >= begin) & (frames < end) for begin, end in spans] or [frames < 0]
        )
        for begin, end in spans:
            place = np.median(own[begin:end], axis=0)
            place[1] = -usual[part]
            led = 0.5 + 0.5 * np.cos(np.pi * (np.maximum(t[begin] - t, t - t[end - 1]) / _LED).clip(0.0, 1.0))
            led[~free & ((frames < begin) | (frames >= end))] = 0.0
            moves[:, leg, part] += led[:, None] * (place - own[frames.clip(begin, end - 1)])
            shares[:, leg, part] += led
    moves /= np.maximum(shares, 1.0)[..., None]
    shares = np.minimum(shares, 1.0)
    step = float(np.median(np.diff(t)))
    higher = moves[..., 1].sum(axis=(1, 2))
    follows = [gaussian_filter1d(each, _FOLLOWS / step) for each in (higher, shares.sum(axis=(1, 2)))]
    positions = positions.copy()
    rises = follows[0] / np.maximum(follows[1], 1e-3)
    rises = 0.5 * (_above(t, rises) - _above(t, -rises))
    positions[..., 1] += rises[:, None]
    moves[..., 1] -= shares * rises[:, None, None]
    feet = legs.feet_at(positions, moves, shares, usual)
    positions[..., 1] += _above(t, legs.out_of_reach(positions, feet))[:, None]
    return legs.bent(positions, feet)


def _above(t: Array, values: Array) -> Array:
    """(T,) the least above the values that changes by :data:`BOBS` at most."""
    way = BOBS * t
    before = np.maximum.accumulate(values + way) - way
    after = np.maximum.accumulate((values - way)[::-1])[::-1] + way
    return np.maximum(before, after)


def _in_stances(stands: Mask, stances: Mask) -> Mask:
    """(T, 2, 2) with what lies between two times in a stance, (T, 2), and toes until they leave the floor."""
    stands = stands.copy()
    for leg, part in np.ndindex(2, 2):
        for begin, end in spans_of(stances[:, leg]):
            known = begin + np.flatnonzero(stands[begin:end, leg, part])
            if len(known):
                stands[known[0] : end if part else known[-1], leg, part] = True
    return stands
