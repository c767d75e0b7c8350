"""Events of the views: sides exchanged, limbs that a view reports at a wrong place, times that go back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from fusion.body import Body
from fusion.fused_frame import FusedFrame
from fusion.joint_kinds import of_kind
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair, TrackingState
from recordings.data.corrected_sides import corrects_sides
from recordings.data.session_arrays import SessionFrames

Array = NDArray[Any]
_LIMBS = {"arm": ("elbow", "wrist", "hand", "tip"), "leg": ("knee", "ankle", "foot")}  # kinds of joints
_FEWEST = 2  # joints
_OVERRULED = 0.1  # share in S* below which a view does not count
_FAR = 0.2  # metres from S*: seven times the usual distance of a view's joint
_SHORTEST_NS = 500_000_000  # a shorter spell has no event
_OVER_NS = 100_000_000  # a limb that is right for so long is found again
_CORRECTED_NS = 150_000_000  # a correction that does not last for so long has no event


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
    have a share below 0.1 in it, and S* is nearer to the other view. Sides are exchanged while the view
    has an exchange code and S* is nearer to the view with left and right exchanged than to the view as
    reported. A view with an exchange code loses no limb. Where time goes back, S* starts again.
    """

    def __init__(self, body: Body) -> None:
        self._limbs = {
            f"{side} {limb}": np.flatnonzero(
                of_kind(body, *kinds) & [side in name.lower() for name in body.joints]
            )
            for limb, kinds in _LIMBS.items()
            for side in ("left", "right")
        }
        self._body = body
        self._corrected_since_ns: dict[str, int] = {}
        self._exchanged_since_ns: dict[str, int] = {}
        self._lost: dict[tuple[str, str], _LostLimb] = {}
        self._last_ns: int | None = None

    def observe(self, seen: SkeletonPair, fused: FusedFrame) -> list[Event]:
        """Returns the events that start or end with the next frame.

        That of a lost limb starts 0.5 s late, that of exchanged sides 0.15 s.
        """
        views = seen.a, seen.b
        rows = [None if view is None else (view.positions[None], view.states[None]) for view in views]
        weights = fused.weights_a[None], fused.weights_b[None]
        codes = np.array([(fused.exchanged_a, fused.exchanged_b)])
        times = np.array([fused.time_ns])
        found = self._observe(times, rows, weights, codes, fused.positions[None], fused.a_from_b)
        return [event for _, event in found]

    def observe_all(self, frames: SessionFrames) -> list[tuple[int, Event]]:
        """Returns the events of the next frames, each with the number of its frame among them."""
        fused, pair = frames.fused, frames.pair
        codes = np.stack(
            [np.broadcast_to(of, len(fused)) for of in (fused.exchanged_a, fused.exchanged_b)], axis=1
        )
        rows = [(view.positions, view.states) for view in (pair.a, pair.b)]
        a_from_b = RigidTransform(fused.a_from_b.rotation[0], fused.a_from_b.translation[:, None])
        weights = fused.weights_a, fused.weights_b
        return self._observe(fused.time_ns, rows, weights, codes, fused.positions, a_from_b)

    def _observe(
        self, times: Array, views: Sequence[Any], weights: Sequence[Array], codes: Array, fused: Array,
        a_from_b: RigidTransform,
    ) -> list[tuple[int, Event]]:  # fmt: skip
        lost: dict[int, list[tuple[str, str, float]]] = {}
        corrected = np.zeros(codes.shape, dtype=np.bool_)
        there: list[Any] = [  # in K_A's frame
            None if view is None else (a_from_b.apply(view[0]) if side else view[0])
            for side, view in enumerate(views)
        ]
        for side, view in enumerate(views):
            if view is not None:
                corrected[:, side] = corrects_sides(self._body, fused, there[side], view[1], codes[:, side])
        for side, view in enumerate(views):
            other = views[1 - side]
            if view is None or other is None:
                continue
            overruled = (view[1] == TrackingState.TRACKED) & (weights[side] < _OVERRULED)
            if np.count_nonzero(overruled) < _FEWEST:
                continue
            distance = np.linalg.norm(there[side] - fused, axis=2)
            wrong = overruled & (distance > _FAR) & (codes[:, side, None] == 0)
            labelled = there[1 - side]
            labelled = np.where(corrected[:, 1 - side, None, None], labelled[:, self._body.mirror], labelled)
            others = np.where(other[1] != 0, np.linalg.norm(labelled - fused, axis=2), np.nan)
            for limb, joints in self._limbs.items():
                lost_here = np.count_nonzero(wrong[:, joints], axis=1) >= _FEWEST
                nearer = np.nansum(others[:, joints] - distance[:, joints], axis=1) < 0.0
                for k in np.flatnonzero(lost_here & nearer).tolist():
                    farthest = float(distance[k, joints][wrong[k, joints]].max())
                    lost.setdefault(k, []).append(("AB"[side], limb, farthest))
        events: list[tuple[int, Event]] = []
        rows = zip(times.tolist(), corrected.tolist(), (codes != 0).tolist(), strict=True)
        for k, (time_ns, is_corrected, is_labelled) in enumerate(rows):
            now = [
                *self._time(time_ns),
                *self._exchanges("A", is_corrected[0], is_labelled[0], time_ns),
                *self._exchanges("B", is_corrected[1], is_labelled[1], time_ns),
            ]
            for sensor, limb, farthest in lost.get(k, ()):
                limb_lost = self._lost.setdefault((sensor, limb), _LostLimb(time_ns, time_ns, farthest))
                limb_lost.last_ns, limb_lost.farthest = time_ns, max(limb_lost.farthest, farthest)
            now += self._losses(time_ns)
            events += [(k, event) for event in now]
        return events

    def _time(self, time_ns: int) -> list[Event]:
        before, self._last_ns = self._last_ns, time_ns
        if before is None or time_ns >= before:
            return []
        self._exchanged_since_ns = dict.fromkeys(self._exchanged_since_ns, time_ns)
        self._corrected_since_ns.clear()
        self._lost.clear()
        seconds = 1e-9 * (before - time_ns)
        return [
            Event(
                f"The time goes back by {seconds:.3g} s, as after a reset of a clock; S* starts again.",
                "WARN",
            )
        ]

    def _exchanges(self, sensor: str, corrected: bool, labelled: bool, time_ns: int) -> list[Event]:
        begun_ns, topic = self._exchanged_since_ns.get(sensor), f"exchanged_{sensor.lower()}"
        if corrected and begun_ns is None:
            since_ns = self._corrected_since_ns.setdefault(sensor, time_ns)
            if time_ns - since_ns < _CORRECTED_NS:
                return []
            self._exchanged_since_ns[sensor] = since_ns
            text = f"{sensor} reports left and right exchanged (whole body); S* corrects this."
            return [Event(text, "INFO", topic, "start")]
        if corrected:
            return []
        self._corrected_since_ns.pop(sensor, None)
        if begun_ns is None:
            return []
        del self._exchanged_since_ns[sensor]
        seconds = (time_ns - begun_ns) * 1e-9
        if labelled:
            text = f"Left and right of {sensor} are uncertain, after {seconds:.1f} s."
        else:
            text = f"{sensor} reports left and right correctly again, after {seconds:.1f} s."
        return [Event(text, "INFO", topic, "end")]

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
    body: Body, blocks: Iterable[SessionFrames], first_ns: int, events: list[Event]
) -> Iterator[SessionFrames]:
    """Passes blocks on in time order and appends their events; the first pair is at ``first_ns``."""
    views, number = ViewEvents(body), 0
    for block in blocks:
        for k, event in views.observe_all(block):
            events.append(event.placed(number + k, int(block.fused.time_ns[k]) - first_ns))
        number += len(block)
        yield block
