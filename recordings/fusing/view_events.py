"""Events of the views: left and right exchanged, and limbs that a view reports at a wrong place."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from fusion.body import Body
from fusion.fused_frame import FusedFrame
from fusion.joint_kinds import of_kind
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from recordings.session_arrays import SessionFrame

_PARTS = {0: "trunk", 1: "arms", 2: "legs", 3: "whole body"}
_LIMBS = {"arm": ("elbow", "wrist", "hand", "tip"), "leg": ("knee", "ankle", "foot")}  # kinds of joints
_FEWEST = 2  # joints
_OVERRULED = 0.1  # share in S* below which a view does not count
_FAR = 0.2  # metres from S*: seven times the usual distance of a view's joint
_SHORTEST_NS = 500_000_000  # a shorter spell has no event
_OVER_NS = 200_000_000  # a limb that is right for so long is found again


@dataclass
class _LostLimb:
    """Since when a limb is lost, when it was lost last, ns, and the farthest of its joints, metres."""

    since_ns: int
    last_ns: int
    farthest: float
    reported: bool = False


class ViewEvents:
    """Detects when a view starts and stops exchanging left and right, and loses and finds a limb.

    A limb is lost while at least two of its joints are tracked by the view, lie more than 0.2 m from S* and
    have a share below 0.1 in it: S* then follows the other view. A view whose sides are exchanged loses no
    limb.

    Args:
        body: The body of both views.
    """

    def __init__(self, body: Body) -> None:
        self._limbs = {
            f"{side} {limb}": np.flatnonzero(
                of_kind(body, *kinds) & [side in name.lower() for name in body.joints]
            )
            for limb, kinds in _LIMBS.items()
            for side in ("left", "right")
        }
        self._exchanged_since_ns: dict[str, int] = {}
        self._lost: dict[tuple[str, str], _LostLimb] = {}

    def observe(self, seen: SkeletonPair, fused: FusedFrame) -> list[Event]:
        """Returns the events that start or end with the next frame; that of a lost limb starts 0.5 s late."""
        views = (
            ("A", seen.a, fused.weights_a, fused.exchanged_a),
            ("B", seen.b, fused.weights_b, fused.exchanged_b),
        )
        events: list[Event] = []
        for sensor, skeleton, weights, code in views:
            events += self._exchanges(sensor, code, fused.time_ns)
            if skeleton is not None and not code and fused.has_person:
                self._find_lost(sensor, skeleton, weights, fused)
        return events + self._losses(fused.time_ns)

    def _exchanges(self, sensor: str, code: int, time_ns: int) -> list[Event]:
        since_ns = self._exchanged_since_ns.get(sensor)
        topic = f"exchanged_{sensor.lower()}"
        if code and since_ns is None:
            self._exchanged_since_ns[sensor] = time_ns
            text = f"{sensor} reports left and right exchanged ({_PARTS[code & 3]}); S* corrects this."
            return [Event(text, "INFO", topic, "start")]
        if not code and since_ns is not None:
            del self._exchanged_since_ns[sensor]
            seconds = (time_ns - since_ns) * 1e-9
            text = f"{sensor} reports left and right correctly again, after {seconds:.1f} s."
            return [Event(text, "INFO", topic, "end")]
        return []

    def _find_lost(
        self, sensor: str, skeleton: Skeleton, weights: NDArray[np.float64], fused: FusedFrame
    ) -> None:
        overruled = (skeleton.states == TrackingState.TRACKED) & (weights < _OVERRULED)
        if np.count_nonzero(overruled) < _FEWEST:
            return
        positions = skeleton.positions if sensor == "A" else fused.a_from_b.apply(skeleton.positions)
        off = np.linalg.norm(positions - fused.positions, axis=1)
        wrong = overruled & (off > _FAR)
        for limb, joints in self._limbs.items():
            if np.count_nonzero(wrong[joints]) < _FEWEST:
                continue
            farthest = float(off[joints][wrong[joints]].max())
            lost = self._lost.setdefault((sensor, limb), _LostLimb(fused.time_ns, fused.time_ns, farthest))
            lost.last_ns, lost.farthest = fused.time_ns, max(lost.farthest, farthest)

    def _losses(self, time_ns: int) -> list[Event]:
        events: list[Event] = []
        for (sensor, limb), lost in list(self._lost.items()):
            topic = f"lost_{sensor}_{limb}".lower().replace(" ", "_")
            lasted_ns = lost.last_ns - lost.since_ns
            if time_ns - lost.last_ns > _OVER_NS:
                del self._lost[sensor, limb]
                if lost.reported:
                    text = f"{sensor} finds the {limb} again, after {lasted_ns * 1e-9:.1f} s."
                    events.append(Event(text, "INFO", topic, "end"))
            elif not lost.reported and lasted_ns >= _SHORTEST_NS:
                lost.reported = True
                other = "B" if sensor == "A" else "A"
                text = f"{sensor} loses the {limb}, {lost.farthest:.1f} m off; S* follows {other}."
                events.append(Event(text, "INFO", topic, "start"))
        return events


def watch(
    body: Body, frames: Iterable[SessionFrame], first_ns: int, events: list[Event]
) -> Iterator[SessionFrame]:
    """Passes frames on in time order and appends their events; the first pair is at ``first_ns``."""
    views = ViewEvents(body)
    for number, frame in enumerate(frames):
        found = views.observe(frame.pair.skeletons, frame.fused)
        events += [event.placed(number, frame.fused.time_ns - first_ns) for event in found]
        yield frame
