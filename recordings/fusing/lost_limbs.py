"""Events for the intervals in which a view reports an arm or a leg at a wrong place and S* follows the other
view."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.fused_frame import FusedFrame
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from recordings.events import Event
from recordings.fusing.exchanged_sides import Told
from recordings.session_arrays import RecordedFrame

_LIMBS = {"arm": ("elbow", "wrist", "hand"), "leg": ("knee", "ankle", "foot")}
_FEWEST = 2  # joints
_OVERRULED = 0.1  # share in S* below which a view does not count
_FAR = 0.2  # metres from S*: seven times the usual distance of a view's joint
_SHORTEST_NS = 500_000_000  # a shorter spell has no event
_OVER_NS = 200_000_000  # a limb that is right for so long is found again


@dataclass
class _Spell:
    """When a limb was lost, ns, and the farthest of its joints, metres."""

    since_ns: int
    last_ns: int
    farthest: float
    told: bool = False


class LostLimbs:
    """Detects when a view loses a limb that it reports as tracked, and when it has it again.

    A limb is lost while at least two of its joints are tracked by the view, lie more than 0.2 m from S* and
    have a share below 0.1 in it. Views whose sides are exchanged are skipped: they have events of their own
    (:mod:`recordings.fusing.exchanged_sides`).

    Args:
        body: The body of both views.
    """

    def __init__(self, body: Body) -> None:
        self._limbs = {
            f"{side} {limb}": _joints_of(body, side, parts)
            for limb, parts in _LIMBS.items()
            for side in ("left", "right")
        }
        self._spells: dict[tuple[str, str], _Spell] = {}

    def observe(self, seen: SkeletonPair, fused: FusedFrame) -> list[Told]:
        """Returns the events that start or end with the next frame; a start is 0.5 s late."""
        for sensor, skeleton, weights, exchanged in (
            ("A", seen.a, fused.weights_a, fused.exchanged_a),
            ("B", seen.b, fused.weights_b, fused.exchanged_b),
        ):
            if skeleton is not None and not exchanged and fused.has_person:
                self._look(sensor, skeleton, weights, fused)
        told: list[Told] = []
        for (sensor, limb), spell in list(self._spells.items()):
            topic = f"lost_{sensor}_{limb}".lower().replace(" ", "_")
            if fused.time_ns - spell.last_ns > _OVER_NS:
                del self._spells[sensor, limb]
                if spell.told:
                    seconds = (spell.last_ns - spell.since_ns) * 1e-9
                    told.append(
                        (f"{sensor} finds the {limb} again, after {seconds:.1f} s.", "INFO", topic, "end")
                    )
            elif not spell.told and spell.last_ns - spell.since_ns >= _SHORTEST_NS:
                spell.told = True
                other = "B" if sensor == "A" else "A"
                text = f"{sensor} loses the {limb}, {spell.farthest:.1f} m off; S* follows {other}."
                told.append((text, "INFO", topic, "start"))
        return told

    def _look(self, sensor: str, skeleton: Skeleton, weights: NDArray[np.float64], fused: FusedFrame) -> None:
        overruled = (skeleton.states == TrackingState.TRACKED) & (weights < _OVERRULED)
        if np.count_nonzero(overruled) < _FEWEST:
            return
        at = skeleton.positions if sensor == "A" else fused.a_from_b.apply(skeleton.positions)
        off = np.linalg.norm(at - fused.positions, axis=1)
        wrong = overruled & (off > _FAR)
        for limb, joints in self._limbs.items():
            if np.count_nonzero(wrong[joints]) < _FEWEST:
                continue
            farthest = float(off[joints][wrong[joints]].max())
            spell = self._spells.setdefault((sensor, limb), _Spell(fused.time_ns, fused.time_ns, farthest))
            spell.last_ns, spell.farthest = fused.time_ns, max(spell.farthest, farthest)


def _joints_of(body: Body, side: str, parts: tuple[str, ...]) -> NDArray[np.int64]:
    names = [name.lower() for name in body.joints]
    return np.array(
        [j for j, name in enumerate(names) if side in name and any(part in name for part in parts)]
    )


def limb_events(body: Body, frames: Iterable[RecordedFrame], first_ns: int) -> list[Event]:
    """Returns the events of frames in time order; ``first_ns`` is the time of the session's first pair."""
    limbs = LostLimbs(body)
    return [
        Event(number, frame.fused.time_ns - first_ns, *told)
        for number, frame in enumerate(frames)
        for told in limbs.observe(frame.pair.skeletons, frame.fused)
    ]
