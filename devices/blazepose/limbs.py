"""Bones of the limbs at the lengths that the person has shown.

A limb that points at the sensor has both ends in one place of the image, where the surface tells the depth of
one end at most, and a hidden end has no depth of its own. Elsewhere in the recording the same bone was seen
from the side.
"""

import math

import numpy as np
from numpy.typing import NDArray

from devices.blazepose.landmark_kinds import INDEX, LANDMARK_NAMES, LONG_BONES
from fusion.compiling.kernels import inner_kernel, kernel
from fusion.support.types import Array

_KINDS = len(LONG_BONES) // 2  # left and right have one length
_ARMS = 4  # of the limbs' bones, which come first; legs are rarely hidden
_KEPT = 600  # lengths of each kind
_FEWEST = 4  # lengths that make a median
_DEVIATION = 0.06  # of a bone's length, as a share
_SEEN_M, _HIDDEN_M = 0.025, 0.3  # metres: deviation of the depth of a seen and of a hidden landmark
_CONTRADICTED = 0.055  # metres: a seen end of an arm that moves farther has the depth of something else
_REACH, _STEP = 120, 0.005  # steps to each side, and metres of a step, of the depths that are tried
_NEAREST = 0.1  # metres


def _followers() -> NDArray[np.int64]:
    """(8, 3) the landmarks of hand or foot beyond each bone, which move with its end; -1 for none."""
    beyond = {"WRIST": ("PINKY", "INDEX", "THUMB"), "ANKLE": ("HEEL", "FOOT")}
    found = np.full((len(LONG_BONES), 3), -1)
    for b, (_, far) in enumerate(LONG_BONES):
        end, side = LANDMARK_NAMES[far].split("_")
        for k, kind in enumerate(beyond.get(end, ())):
            found[b, k] = INDEX[f"{kind}_{side}"]
    return found


_FOLLOWERS = _followers()


class LimbLengths:
    """The lengths of one person's upper arms, forearms, thighs and shanks, learned from seen landmarks.

    A length is the weighted median of the 600 seen last. The weight is the fourth power of the sine of the
    angle between the bone and the line of sight.
    """

    def __init__(self) -> None:
        self._lengths = np.zeros((_KINDS, _KEPT))
        self._weights = np.zeros((_KINDS, _KEPT))
        self._count = np.zeros(_KINDS, dtype=np.int64)

    def observe(self, points: Array, seen: NDArray[np.bool_]) -> None:
        """Takes the bones between seen landmarks, (33, 3) metres."""
        ends = points[LONG_BONES]
        bones, sights = ends[:, 1] - ends[:, 0], ends.sum(axis=1)
        squares = np.maximum((bones**2).sum(axis=1), 1e-12)
        along = (bones * sights).sum(axis=1) ** 2 / (squares * (sights**2).sum(axis=1))
        for b in np.flatnonzero(seen[LONG_BONES].all(axis=1)):
            kind = b // 2
            place = self._count[kind] % _KEPT
            self._lengths[kind, place] = np.sqrt(squares[b])
            self._weights[kind, place] = max(1e-3, 1.0 - along[b]) ** 2
            self._count[kind] += 1

    def lengths(self) -> Array:
        """(8,) length of each of the limbs' bones, metres; NaN where too few were seen."""
        found = np.full(_KINDS, np.nan)
        for kind in np.flatnonzero(self._count >= _FEWEST):
            known = slice(0, min(int(self._count[kind]), _KEPT))
            order = np.argsort(self._lengths[kind, known], kind="stable")
            weight = np.cumsum(self._weights[kind, known][order])
            found[kind] = self._lengths[kind, order[np.searchsorted(weight, 0.5 * weight[-1])]]
        return np.repeat(found, 2)


def with_lengths(
    points: Array, seen: NDArray[np.bool_], rays: Array, lengths: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Moves the far ends of the limbs' bones along their lines of sight.

    The depth of an end is the most probable one by its own depth and the bone's length, both with errors of a
    normal distribution. A bone at a right angle to the line of sight hardly moves. A seen elbow or wrist that
    moves far is hidden by what was seen there, and so is the hand beyond it.

    Args:
        points: (33, 3) metres.
        rays: (33, 2) x/z, y/z.
        lengths: (8,) of :meth:`LimbLengths.lengths`.

    Returns:
        (33, 3) the landmarks; (33,) which of them are seen.
    """
    moved, still_seen = np.ascontiguousarray(points).copy(), seen.copy()
    _move_ends(moved, still_seen, np.ascontiguousarray(rays), lengths)
    return moved, still_seen


@inner_kernel
def _offset(near, x, y, before, length, deviation, cost):  # type: ignore[no-untyped-def]
    """The most probable change of the depth of a bone's far end on the ray (x, y), metres.

    ``cost`` is scratch.
    """
    least, lowest = _REACH, np.inf
    for k in range(2 * _REACH + 1):
        offset = _STEP * (k - _REACH)
        z = before + offset
        across, down, along = x * z - near[0], y * z - near[1], z - near[2]
        gap = math.sqrt(across * across + down * down + along * along) - length
        cost[k] = (offset / deviation) ** 2 + (gap / (_DEVIATION * length)) ** 2
        if z >= _NEAREST and cost[k] < lowest:
            least, lowest = k, cost[k]
    offset = _STEP * (least - _REACH)
    if 0 < least < 2 * _REACH:  # the minimum of a parabola through three costs
        low, middle, high = cost[least - 1], cost[least], cost[least + 1]
        offset += _STEP * 0.5 * (low - high) / max(low - 2.0 * middle + high, 1e-12)
    return offset


@kernel
def _move_ends(points, seen, rays, lengths):  # type: ignore[no-untyped-def]
    """Changes points and seen in place; see :func:`with_lengths`."""
    cost = np.empty(2 * _REACH + 1)
    for b in range(len(lengths)):
        if not np.isfinite(lengths[b]):
            continue
        near, far = LONG_BONES[b]
        x, y, before = rays[far, 0], rays[far, 1], points[far, 2]
        deviation = _SEEN_M if seen[far] else _HIDDEN_M
        offset = _offset(points[near], x, y, before, lengths[b], deviation, cost)
        contradicted = b < _ARMS and seen[far] and abs(offset) > _CONTRADICTED
        if contradicted:
            seen[far] = False
        z = before + offset
        points[far, 0], points[far, 1], points[far, 2] = x * z, y * z, z
        for j in _FOLLOWERS[b]:
            if j < 0:
                continue
            if contradicted:
                seen[j] = False
            if not seen[j]:
                z = max(points[j, 2] + offset, _NEAREST)
                points[j, 0], points[j, 1], points[j, 2] = rays[j, 0] * z, rays[j, 1] * z, z
