"""Heel strikes, toe-offs and steps, by the coordinate method of Zeni, Richards and Higginson (2008).

A foot swings from where its ankle is farthest behind the pelvis, along the direction in which the pelvis
moves, to where it is farthest in front. It stands while it is slower than 0.75 of the pelvis: the toes
become faster at the beginning of a swing, and the ankle slower at its end. Laboratories label toe-offs and
heel strikes soon after, by force plates or by eye, and so these are. The pelvis is the middle of the hips.
Only walking counts: the person moves to where they face, and the feet strike in turn. Limits are relative to
the leg and to the person's own swings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.body import Body
from fusion.support.types import Array
from recordings.gait import SIDES, UNKNOWN, Gait, Measured, Step, Turn
from recordings.gait.parts import ERRORS_LAST, RATE, Part, parts_of, turns_of

_STANDS = 0.75  # of the pelvis' speed, of a foot between strike and toe-off
_LABELLED = 0.023
"""Seconds by which the labels of laboratories are later: on eight walks 27 ms of strikes, 19 of toe-offs."""
_LEAST_SWING = 0.06  # of the ankle's place from the pelvis, lengths of the leg
_OWN_SWING = 0.3  # the least swing, of the median of the part
_SEEN = 0.1  # the least of what is seen of a swing at an end of the part, of the same median
_SHORTEST_STEP = -0.04  # lengths of the leg; in a tight curve the inner foot lands beside the other
_BETWEEN = 0.4, 2.0  # of the median time between strikes of both feet
_LONGEST_STEP = 2.0  # seconds
_LONGEST_SWING = 2.0  # of the walk's median; that of a first step which is longer is not known
_FLIGHT = 0.1  # seconds: no toe-off of a walk lies farther before the other foot's strike
_FEWEST = 3  # strikes in turn
_MOVES_BY = 0.5  # of the lengths of the steps, for which the pelvis does on a floor that stands
_AROUND = 0.1  # seconds: errors of S* that count for an event
_DEFINITION_SD = 0.025  # seconds, between labels and what shows them
_OF_A_FRAME = 0.25  # of the time between frames, by which interpolation errs


def find_gait(
    body: Body,
    time_ns: ArrayLike,
    positions: NDArray[np.floating],
    up: ArrayLike,
    sigma: ArrayLike | None = None,
) -> Gait:
    """Finds the steps and the turns.

    Uncertainties are by linear propagation. That of an event is that of the foot's velocity relative to the
    pelvis, over its acceleration; the errors of S* are taken to last for 0.16 s. 25 ms, by which labels and
    what shows them differ, and a quarter of the time between frames are added.

    Args:
        time_ns: (T,) nanoseconds, ascending; a walk ends where a reset of a clock sets them back.
        positions: (T, J, 3) metres; NaN where unknown. Hips and ankles are needed. Ankles stand in for toes;
            hips alone tell where a person without shoulders faces.
        up: (3,) against gravity.
        sigma: (T, J) metres, one standard deviation of a joint's distance to the truth.
    """
    seconds = np.asarray(time_ns, dtype=np.float64) * 1e-9
    steps: list[Step] = []
    begun: list[tuple[float, str]] = []
    turns: list[Turn] = []
    left_out = dict.fromkeys(("not forwards", "no three strikes in turn"), 0.0)
    for part in parts_of(body, seconds, positions, np.asarray(up, dtype=np.float64), sigma):
        turns += turns_of(part)
        walking = np.zeros(len(part.t), dtype=bool)
        strikes, lifted = _strikes(part)
        for walk in _walks(strikes):
            number = steps[-1].walk + 1 if steps else 0
            steps += [step._replace(walk=number) for step in walk]
            walking |= (part.t >= walk[0].strike) & (part.t <= walk[-1].strike)
            begun += [
                (at, side)
                for at, side in lifted
                if side != walk[-1].side and 0.0 < at - walk[-1].strike < walk[-1].seconds
            ]
        for reason, of_reason in zip(left_out, (~part.forwards, part.forwards), strict=True):
            left_out[reason] += float(np.mean(part.moving & of_reason & ~walking)) * len(part.t) / RATE
    return Gait(tuple(steps), left_out, tuple(sorted(turns)), tuple(begun))


def _strikes(part: Part) -> tuple[list[Step], list[tuple[float, str]]]:
    """The heel strikes of both feet while the person walks, in time order; not yet in turn.

    Besides, seconds and side of toe-offs without a strike at the end of the part.
    """
    t, walking, direction = part.t, part.moving & part.forwards, part.direction
    way = np.cumsum(part.speed) / RATE
    heading = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))
    found, lifted = [], []
    for side in (0, 1):
        half = 0
        # how much farther the foot went than the pelvis at a part of its speed: less while the foot stands
        ankle, toes = (
            np.cumsum(np.sum(np.gradient(each[side], axis=0) * direction, axis=1)) - _STANDS * way
            for each in (part.ankles, part.toes)
        )
        errors = [np.hypot(each[side], part.pelvis_error) for each in (part.ankle_errors, part.toe_errors)]
        ahead = np.sum((part.ankles[side] - part.pelvis) * direction, axis=1)
        fronts, backs = _swings(ahead, walking, part.leg)
        for front in fronts:
            i = int(np.searchsorted(backs, front))
            before = int(backs[i - 1]) if i else 0
            k = before + int(np.argmax(ankle[before : backs[i] if i < len(backs) else len(t)]))
            at = min(k + round(_LABELLED * RATE), len(t) - 1)  # the strike
            apart = part.ankles[side, at] - part.ankles[1 - side, at]
            length = float(apart @ direction[at])
            if not 0 < k < len(t) - 1 or not walking[k] or length < _SHORTEST_STEP * part.leg:
                continue
            strike, toe_off, clearance = _turn(part, ankle, errors[0], k), UNKNOWN, UNKNOWN
            if i:
                half = (k - before) // 2
                toe_off = _toe_off(part, toes, errors[1], before, half)
                swing = slice(max(before - half, 0), k + 1)
                error = math.sqrt(2.0) * float(np.mean(part.toe_errors[side, swing]))
                risen = float(np.ptp(part.toe_heights[side, swing]))
                clearance = Measured(risen, error + 0.0 * risen)
            found.append(
                Step(
                    side=SIDES[side],
                    walk=0,
                    strike=strike.value,
                    strike_sigma=strike.sigma,
                    toe_off=toe_off.value,
                    toe_off_sigma=toe_off.sigma,
                    seconds=math.nan,
                    length=length,
                    length_sigma=math.hypot(*part.ankle_errors[:, at]),
                    width=float(apart @ (-direction[at, 1], direction[at, 0])) * (1.0 - 2.0 * side),
                    progress=float(way[at]),
                    turned=float(heading[at]),
                    clearance=clearance.value,
                    clearance_sigma=clearance.sigma,
                )
            )
        if half and backs[-1] > fronts[-1]:
            lifted.append((_toe_off(part, toes, errors[1], int(backs[-1]), half).value, SIDES[side]))
    return sorted(found, key=lambda step: step.strike), lifted


def _toe_off(part: Part, toes: Array, errors: Array, back: int, half: int) -> Measured:
    """When the toes leave the floor, within half a swing of where the ankle is farthest behind."""
    first, last = max(back - half, 0), min(back + half, len(toes) - 1)
    k = first + int(np.argmin(toes[first : last + 1]))
    if first < k < last:
        return _turn(part, toes, errors, k)
    return Measured(float(part.t[back]), half / RATE)  # toes that S* lost


def _swings(ahead: Array, walking: NDArray[np.bool_], leg: float) -> tuple[Array, Array]:
    """Where an ankle is farthest in front of the pelvis and farthest behind it, at the ends of its swings."""
    from scipy.signal import find_peaks

    # the part may begin in a swing, or end before the pelvis has passed the foot
    (fronts, swing), (backs, swing_back) = (
        (peaks - 1, np.minimum(more["prominences"], np.ptp(ahead)))
        for peaks, more in (
            find_peaks(np.pad(values, 1, constant_values=-math.inf), prominence=_LEAST_SWING * leg)
            for values in (ahead, -ahead)
        )
    )
    of_walks = swing[walking[fronts]]
    own = float(np.median(of_walks)) if len(of_walks) else 0.0
    seen = np.array([min(np.ptp(ahead[: k + 1]), np.ptp(ahead[k:])) for k in fronts])
    begun = np.array([np.ptp(ahead[k:]) for k in backs])
    return (
        fronts[(swing > _OWN_SWING * own) & (seen > _SEEN * own)],
        backs[(swing_back > _OWN_SWING * own) & (begun > _SEEN * own) & (backs > 0)],
    )


def _turn(part: Part, values: Array, errors: Array, k: int) -> Measured:
    """Seconds of the event that the vertex shows of the parabola through three values, of which the middle
    one is extreme."""
    before, middle, after = values[k - 1 : k + 2].tolist()
    bend = before - 2.0 * middle + after or 1e-9
    around = round(_AROUND * RATE)
    error = float(errors[max(k - around, 0) : k + around + 1].max())
    sigma = error / ERRORS_LAST / (abs(bend) * RATE**2)
    return Measured(
        float(part.t[k]) + 0.5 * (before - after) / bend / RATE + _LABELLED,
        math.hypot(sigma, _DEFINITION_SD, _OF_A_FRAME * part.frame_seconds),
    )


def _walks(strikes: Sequence[Step]) -> Iterator[list[Step]]:
    """Divides strikes into walks, in which the feet strike in turn."""
    between = [b.strike - a.strike for a, b in pairwise(strikes) if a.side != b.side]
    least, most = (each * float(np.median(between)) if between else 0.0 for each in _BETWEEN)
    walk: list[Step] = []
    for at in strikes:
        before = walk[-1] if walk else None
        seconds = at.strike - before.strike if before else math.inf
        in_turn = before is not None and at.side != before.side
        if not (in_turn and least < seconds < min(most, _LONGEST_STEP)):
            yield from _of_steps(walk)
            walk = []
        walk.append(at)
    yield from _of_steps(walk)


def _of_steps(walk: Sequence[Step]) -> Iterator[list[Step]]:
    """A walk with what its steps took, if they are enough and the person moves by them: no treadmill."""
    lengths = sum(step.length for step in walk[1:])
    if len(walk) >= _FEWEST and walk[-1].progress - walk[0].progress > _MOVES_BY * lengths:
        first = walk[0]._replace(progress=math.nan, turned=math.nan)
        swings = [step.strike - step.toe_off for step in walk if math.isfinite(step.toe_off)]
        if swings and first.strike - first.toe_off > _LONGEST_SWING * float(np.median(swings)):
            # the foot rested, and any moment of that may be where it was farthest behind
            first = first._replace(toe_off=math.nan, toe_off_sigma=math.nan)
        yield [first] + [
            _after(a, b)._replace(
                seconds=b.strike - a.strike, progress=b.progress - a.progress, turned=b.turned - a.turned
            )
            for a, b in pairwise(walk)
        ]


def _after(before: Step, step: Step) -> Step:
    """The step; its toe-off is unknown if it lies before the other foot's strike.

    People who walk have both feet on the floor at a strike.
    """
    if step.toe_off < before.strike - _FLIGHT:
        return step._replace(toe_off=math.nan, toe_off_sigma=math.nan)
    return step
