"""Whether the only bodies of two views are one person, once the sensors' placement is known."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from devices.people.room import TOLD_S, WAIT_S, Seen
from fusion.body import Body
from fusion.calibration.person_size import sizes_of
from fusion.errors import CalibrationError
from fusion.registration.rigid_fit import fit_rigid
from fusion.rigid import RigidTransform
from fusion.skeleton import TRACKED
from fusion.support.types import Array

_FAR_M = 0.6  # between two bodies that are not one person
_EVERY_NS, _KEPT, _FEWEST = 95_000_000, 60, 20  # pairs that are compared: 6 s, and 2 s at least
_TESTED_NS = 500_000_000  # between two comparisons
_FEWEST_JOINTS = 5
_ANOTHER = 0.1  # logarithm of the ratio of the sizes that two views show of one person
_MOVED_M, _LEFT = 0.1, 0.2
"""Least rms movement; largest share of its variance that one placement of the sensors leaves unexplained."""


def one_movement(body: Body, p: Array, q: Array) -> bool:
    """Whether some placement of the sensors makes one movement of two views' joints.

    Args:
        p, q: (T, J, 3) metres in each sensor's frame; NaN where unknown.
    """
    known = np.isfinite(p + q).all(axis=(0, 2))  # throughout
    ratio = np.subtract(*(sizes_of(body, of, _states_of(of), body.nominal_lengths) for of in (p, q)))
    if known.sum() < _FEWEST_JOINTS or abs(np.median(ratio)) > _ANOTHER:
        return False
    p, q = p[:, known], q[:, known]
    try:
        apart = p - fit_rigid(p.reshape(-1, 3), q.reshape(-1, 3)).apply(q)
    except CalibrationError:
        return False
    moved, left = (float(np.var(of, axis=0).sum(axis=1).mean()) for of in (p, apart))
    return moved > _MOVED_M**2 and left < _LEFT * moved


def _states_of(joints: Array) -> NDArray[np.uint8]:
    """(T, J) tracking states: tracked where a joint is known."""
    return np.where(np.isfinite(joints).all(axis=2), TRACKED, 0).astype(np.uint8)


class OnePlace:
    """Leaves out the view that sees somebody else than the person followed.

    Two bodies that the placement puts far apart are two people, and who was seen first is followed; of two at
    once, the one nearer to the axis of their sensor. They are one person before a sensor that was moved, once
    another placement makes one movement of both.

    Args:
        follow_moves: Whether a sensor that was moved is registered anew, and both views are wanted.
    """

    def __init__(self, body: Body, follow_moves: bool) -> None:
        self._body, self._follow_moves = body, follow_moves
        self._tracks, self._begun_ns = [-1, -1], [0, 0]
        self._left: int | None = None
        self._since_ns = self._last_ns = self._tested_ns = 0
        self._pairs: deque[tuple[int, NDArray[np.float32], NDArray[np.float32]]] = deque(maxlen=_KEPT)
        self._moved = self._told = False
        self._events: list[Event] = []

    def chosen(
        self, time_ns: int, seen: Sequence[Seen], picks: list[int | None], a_from_b: RigidTransform
    ) -> list[int | None]:
        """The bodies of a pair that are the person followed."""
        for view, (of, pick) in enumerate(zip(seen, picks, strict=True)):
            if pick is not None and of.tracks[pick] != self._tracks[view]:
                self._tracks[view], self._begun_ns[view] = of.tracks[pick], time_ns
        a, b = picks
        if a is None or b is None:
            if self._left is None or picks[self._left] is None or (self._moved and self._follow_moves):
                return picks
            if self._moved or time_ns - self._last_ns < WAIT_S * 1e9:
                return [None, None]
            self.end("The person is gone; the other one is followed.")
            return picks
        self._last_ns = time_ns
        apart = math.dist(seen[0].places[a], a_from_b.apply(np.array(seen[1].places[b])))
        if apart < _FAR_M:
            self.end("Both sensors see one person.")
            return picks
        if self._left is None:
            off_axis = [
                abs(math.atan2(of.places[k][0], of.places[k][2])) for of, k in zip(seen, (a, b), strict=True)
            ]
            self._left = max((0, 1), key=lambda view: (self._begun_ns[view], off_axis[view], view))
            self._since_ns = time_ns
        if not self._moved:
            self._compare(time_ns, seen[0].skeletons[a].positions, seen[1].skeletons[b].positions)
        if not self._told and time_ns - self._since_ns >= TOLD_S * 1e9:
            self._told = True
            side = "AB"[self._left]
            text = f"{side} sees somebody else, {apart:.1f} m from the person: its view is left out."
            self._events.append(Event(text, "WARN", "elsewhere", "start"))
        if self._moved and self._follow_moves:
            return picks
        return [None if view == self._left else pick for view, pick in enumerate(picks)]

    def events(self) -> list[Event]:
        """The events since the last call."""
        events, self._events = self._events, []
        return events

    def _compare(self, time_ns: int, a: NDArray[np.float32], b: NDArray[np.float32]) -> None:
        if not self._pairs or time_ns - self._pairs[-1][0] >= _EVERY_NS:
            self._pairs.append((time_ns, a, b))
        if len(self._pairs) < _FEWEST or time_ns - self._tested_ns < _TESTED_NS:
            return
        self._tested_ns = time_ns
        _, of_a, of_b = zip(*self._pairs, strict=True)
        if one_movement(self._body, np.array(of_a, np.float64), np.array(of_b, np.float64)):
            self._moved = True
            if not self._follow_moves:
                text = "A sensor was moved since the calibration: the view of B is left out. Calibrate again."
                self._left = 1
                self._events.append(Event(text, "WARN"))

    def end(self, text: str) -> None:
        """Forgets who is elsewhere, with an event if that was told."""
        if self._told:
            self._events.append(Event(text, topic="elsewhere", phase="end"))
        self._left, self._moved, self._told = None, False, False
        self._pairs.clear()
        self._tested_ns = 0
