"""What is wrong while two sensors are set up: figures of the last seconds, judged by the table of rules.

The coach is pure: its input is the loop's data, its clock is the pairs' time, and it neither waits nor
prints.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.capture.causes import MORE_FRAMES, Origin
from devices.depth.camera import in_image, project
from devices.findings.finding import Finding, followed, judge
from devices.findings.rules import (
    AIM,
    RING,
    RULES,
    WALK,
    Limits,
    farthest,
    nearest,
    of_error,
    of_views,
    within,
)
from devices.sensor import SensorFrame
from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.calibration.comparison import PlacementOff, RecentPlacement
from fusion.facing.handedness import mirrored_share
from fusion.facing.model import WHOLE
from fusion.intrinsics import Intrinsics
from fusion.skeleton import Skeleton, nearer
from recordings.appearance.floor import LEVEL_FLOOR
from recordings.calibration_file import is_loaded
from recordings.data.session_arrays import SessionFrame
from recordings.quality.figures import placement_figures
from recordings.quality.verdict import compared
from viewer_app.coach.standing_spot import StandingSpot, standing_spot

HOLD = 3.0
"""Seconds to hold the start-up pose; the paper asks for a few seconds."""
RATE = 0.8
"""Lowest accepted frame rate, as a share of the nominal rate."""
WARM_UP = 2400.0
"""Seconds until an Azure Kinect's distances stay the same (Tölgyessy et al. 2021: 40 to 50 minutes)."""
_NOW, _RATE_WINDOW, _LATELY = 1.0, 2.0, 4.0
"""Seconds over which shares and distances, rates, and medians are judged."""
_HANDED = 15.0
"""Seconds after which a frame counts 1/e in the share of mirror images. A driver mirrors every frame. Who
walks away from a simulated Kinect v2 looks mirrored for seconds only."""
_AIMED_M, _AIMED_DEG = 3.0, 15.0
"""Sensors that are no farther from the ring, and no more off 90°, need not be aimed anew."""
_EVIDENCE = 0.5
"""Of these: nothing is judged before a view has given frames for so long."""
_AIMS = (
    "turn {who} {turn}° to its left",
    "turn {who} {turn}° to its right",
    "tilt {who} up by {turn}°",
    "tilt {who} down by {turn}°",
)
_ROOM = 2.0
"""Degrees between the person and an edge of the image."""
_GONE = 0.3
"""Seconds without frames after which a sensor is gone, which its thread reports, not slow."""


@dataclass(frozen=True)
class Situation:
    """The state of the loop, apart from the frame."""

    calibration: Calibration
    final: bool  # whether it is kept, or only refined, from now on
    held: float  # seconds for which the start-up pose has been held
    dropped: tuple[int, int] = (0, 0)  # frames so far that the program was too slow for, of A and B
    lost: tuple[int, int] = (0, 0)  # frames so far that were lost on USB, of A and B
    step: int = 1  # both sensors use every n-th frame, so that the slower body tracker keeps up


class _View(NamedTuple):
    """One sensor's part of a pair; NaN where it shows no person."""

    came: bool
    crowd: bool
    away: float = math.nan  # metres to the torso
    feet_gone: float = math.nan
    cut_off: float = math.nan
    beyond: tuple[float, ...] = ()  # degrees by which joints are beyond the edges of the image


class _Moment(NamedTuple):
    time: float
    views: tuple[_View, _View]
    apart: float  # millimetres between the views, and the deviation of S*; NaN unless both see the person
    error: float
    dropped: tuple[int, int]
    lost: tuple[int, int]
    step: int


class _Share:
    """The share of mirror images among the frames that tell it. New frames count most; see _HANDED."""

    def __init__(self) -> None:
        self._first_s, self._last_s, self._known, self._so = math.inf, 0.0, 0.0, 0.0

    def add(self, time: float, is_so: float | None) -> None:
        """Takes what is known at a time in seconds."""
        if is_so is None:
            return
        kept = math.exp(min(self._last_s - time, 0.0) / _HANDED)  # times may be set back
        self._known, self._so = kept * self._known + 1.0, kept * self._so + is_so
        self._first_s, self._last_s = min(self._first_s, time), time

    @property
    def percent(self) -> float | None:
        """None before there is evidence."""
        enough = self._last_s - self._first_s >= _EVIDENCE * _LATELY
        return 100.0 * self._so / self._known if enough else None


class Coach:
    """Watches the loop and judges the set-up.

    Args:
        origins: Of the frames of A and of B, by which is told why some are missing.
    """

    def __init__(
        self,
        body: Body,
        intrinsics: tuple[Intrinsics, Intrinsics],
        rate: float = 30.0,
        origins: tuple[Origin, Origin] = ("sensor", "sensor"),
    ) -> None:
        self.body, self.intrinsics = body, intrinsics
        self._rate, self._origins = rate, origins
        self._feet = np.array([body.joint("ANKLE_LEFT"), body.joint("ANKLE_RIGHT")])
        self._moments: deque[_Moment] = deque()
        self._seen = np.zeros(len(body), dtype=np.bool_)  # joints that were ever seen
        self._mirrored = _Share(), _Share()
        self._together_at = -math.inf
        self._alone: set[int] = set()  # views that saw the person since both did at one time
        self._seen_at, self._came_at = [-math.inf, -math.inf], [-math.inf, -math.inf]
        self._began: float | None = None
        self._calibration: Calibration | None = None
        self._recent = RecentPlacement(body, in_steps=True)
        self.placed: Calibration | None = None
        """The calibration, before it is final with the placement that the last seconds show."""

    def watch(self, frame: SessionFrame, now: Situation) -> list[Finding]:
        """All current findings with the next frame, in the order in which to follow them."""
        time = frame.pair.time_ns * 1e-9
        self._began = time if self._began is None else self._began
        if now.calibration is not self._calibration:
            if self._calibration is None or self._calibration.provisional:
                # distances under a guess say nothing; a refinement changes them by little, and comes often
                self._moments = deque(each._replace(apart=math.nan, error=math.nan) for each in self._moments)
            self._calibration = now.calibration
        self._remember(frame, now, time)
        off = self._recent.off(now.calibration)
        self.placed, turn_sd = self._newest(now.calibration)
        found = [*self._views(frame, now, time)]
        if not now.final:
            found += judge("uncalibrated", 0, calibrated="not calibrated")
        if turn_sd is not None:
            up = np.array([0.0, -1.0, 0.0]) if frame.floor is None else -frame.floor.rotation[:, 1]
            angle, ring = math.degrees(self.placed.angle_about(up)), self.ring(frame)
            found += self._placement(self.placed, turn_sd, angle, ring, off)
            found = [self._in_ring(each, frame, ring, angle) for each in found]
        return followed(found)

    def ring(self, frame: SessionFrame) -> StandingSpot:
        """The best place to stand, as far as the sensors' placement is known."""
        known = self.placed is not None and self.placed.a_from_b.translation.any()
        a_from_b = self.placed.a_from_b if self.placed is not None and known else None
        return standing_spot(a_from_b, self.intrinsics, self.body.name, frame.floor or LEVEL_FLOOR)

    def _remember(self, frame: SessionFrame, now: Situation, time: float) -> None:
        pair, skeletons = frame.pair, frame.pair.skeletons
        views = []
        for k, (came, skeleton) in enumerate(((pair.a, skeletons.a), (pair.b, skeletons.b))):
            if came is not None:
                if time - self._came_at[k] > _GONE and self._seen_at[k] > -math.inf:
                    self._seen_at[k] = time  # the time for which it was gone does not count
                self._came_at[k] = time
            if skeleton is not None:
                self._seen_at[k] = time
                self._alone.add(k)
            views.append(self._view(came, skeleton, k, time))
        apart = error = math.nan
        if skeletons.a is not None and skeletons.b is not None:
            self._together_at = time
            self._alone.clear()
            codes = frame.fused.exchanged_a & WHOLE, frame.fused.exchanged_b & WHOLE
            self._recent.add(skeletons, codes)
            errors = now.calibration.depth_errors.tolist()
            a, b = (
                nearer(of.positions[self.body.mirror] if code == WHOLE else of.positions, error)
                for of, code, error in zip((skeletons.a, skeletons.b), codes, errors, strict=True)
            )
            each = np.linalg.norm(now.calibration.a_from_b.apply(b) - a, axis=1)
            apart = 1e3 * float(np.median(each[np.isfinite(each)])) if np.isfinite(each).any() else math.nan
        for skeleton in filter(None, (skeletons.a, skeletons.b)):
            self._seen |= skeleton.states != 0
        if frame.fused.sigma is not None and frame.fused.has_person and self._seen.any():
            error = 1e3 * float(frame.fused.sigma[self._seen].mean())
        self._moments.append(
            _Moment(time, (views[0], views[1]), apart, error, now.dropped, now.lost, now.step)
        )
        while time - self._moments[0].time > _LATELY:
            self._moments.popleft()

    def _view(self, frame: SensorFrame | None, skeleton: Skeleton | None, k: int, time: float) -> _View:
        crowd = frame is not None and len(frame.people) > 1
        if skeleton is None:
            return _View(frame is not None, crowd)
        pixels = project(self.intrinsics[k], skeleton.positions)
        outside = np.isfinite(pixels[:, 0]) & ~in_image(self.intrinsics[k], pixels)
        # One leg often hides the other, which no better place would change; it cannot hide both feet.
        below = pixels[self._feet, 1] >= self.intrinsics[k].height - 0.5
        feet = below.any() or not (skeleton.tracked | outside)[self._feet].any()
        shown = skeleton.tracked & ~outside
        mirrored = mirrored_share(self.body, np.where(shown[:, None], skeleton.positions, np.nan)[None])
        self._mirrored[k].add(time, mirrored)
        torso = skeleton.positions[list(self.body.torso), 2]
        away = float(np.nanmean(torso)) if np.isfinite(torso).any() else math.nan
        return _View(
            True,
            crowd,
            away,
            float(feet),
            float(outside.any()),
            _beyond(skeleton.positions[outside], self.intrinsics[k]) if outside.any() else (),
        )

    def _lately(self, seconds: float, figure: Callable[[_Moment], float]) -> NDArray[np.float64]:
        """The known values of a figure in the last seconds; empty before there is evidence."""
        newest = self._moments[-1].time
        known = [
            (each.time, value)
            for each in self._moments
            if newest - each.time <= seconds and math.isfinite(value := figure(each))
        ]
        if not known or known[-1][0] - known[0][0] < _EVIDENCE * seconds:
            return np.zeros(0)
        return np.array([value for _, value in known])

    def _views(self, frame: SessionFrame, now: Situation, time: float) -> Iterator[Finding]:
        """What is wrong with a view."""
        assert self._began is not None
        if not now.final and len(self._alone) == 2 and time - self._together_at > _LATELY:
            yield from judge("unseen_together", 0.0)
        for k, side in enumerate("AB"):
            view = (frame.pair.a, frame.pair.b)[k]
            skeleton = (frame.pair.skeletons.a, frame.pair.skeletons.b)[k]
            yield from judge("no_frames", time - max(self._came_at[k], self._began), side)

            def share(name: str, seconds: float = _NOW, k: int = k) -> float | None:
                values = self._lately(seconds, lambda each: getattr(each.views[k], name))
                return 100.0 * float(values.mean()) if len(values) else None

            if not now.final:
                yield from judge("others", share("crowd"), side)
            if skeleton is None and view is not None:
                since = time - max(self._seen_at[k], self._began)
                never = self._seen_at[k] == -math.inf
                if view.people:  # the person followed is hidden, or not told from others yet
                    yield from judge("hidden", since, side)
                else:
                    yield from judge("unseen", math.inf if never else since, side)
            if skeleton is not None:
                away = self._lately(_NOW, lambda each, k=k: each.views[k].away)  # type: ignore[misc]
                lens = self.intrinsics[k]
                range_m = within(nearest(lens), farthest(self.body.name, lens))
                yield from judge("distance", median_of(away), side, limits=range_m)
                yield from judge("mirrored", self._mirrored[k].percent, side)
                beyond = self._beyond(k)
                yield from judge("feet", share("feet_gone"), side, turn=_in_fives(beyond[3]))
                edge = int(np.argmax(beyond))
                aim = _AIMS[edge].format(who=side, turn=_in_fives(beyond[edge]))
                yield from judge("whole", share("cut_off"), side, aim=aim)
            yield from self._stream(k, time)

    def _beyond(self, k: int) -> NDArray[np.float64]:
        """(4,) degrees by which the person was beyond the edges lately, and some room."""
        known = [each.views[k].beyond for each in self._moments if each.views[k].beyond]
        return _ROOM + np.median(known, axis=0) if known else np.full(4, _ROOM)

    def _stream(self, k: int, time: float) -> Iterator[Finding]:
        """What is wrong with a sensor's frames in the last two seconds."""
        side = "AB"[k]
        if self._began is None or time - self._began < _RATE_WINDOW:
            return
        last = [each for each in self._moments if time - each.time <= _RATE_WINDOW]
        if time - last[0].time < _RATE_WINDOW - _GONE:  # both were gone until now
            return
        came = [each.time for each in last if each.views[k].came]
        dropped, lost = last[-1].dropped[k] - last[0].dropped[k], last[-1].lost[k] - last[0].lost[k]
        yield from judge("slow", 100.0 * dropped / max(1, dropped + len(came)), side)
        yield from judge("lost", 100.0 * lost / max(1, lost + len(came)), side)
        pauses = np.diff([last[0].time, *came, time])
        if pauses.max(initial=0.0) > _GONE:
            return
        # What is left out for a slow body tracker is no fault of USB or light.
        step, between = max(each.step for each in last), np.diff(came)
        least = RATE * self._rate / step
        cause = MORE_FRAMES["tracker" if step != 1 else self._origins[k]].format(who=side)
        yield from judge(
            "rate",
            round((len(between) - 1) / (between.sum() - between.max())),  # one pause is no lower rate
            side,
            limits=Limits((least, math.inf), (-math.inf, math.inf)),
            cause=cause,
        )

    def _newest(self, calibration: Calibration) -> tuple[Calibration, float | None]:
        """What is known of the placement, and R's deviation in radians; None if it is too little to judge."""
        registration, newest = calibration.registration, self._recent.newest
        turn_sd = None if registration is None else registration.rotation_sd
        if not calibration.provisional:
            return calibration, turn_sd or 0.0
        if newest is not None:  # B may have been moved since
            calibration, turn_sd = replace(calibration, a_from_b=newest.a_from_b), newest.rotation_sd
        seen = self._moments[-1].time - self._moments[0].time
        return calibration, turn_sd if seen >= _EVIDENCE * _LATELY else None  # as mirror images need

    def _placement(
        self,
        calibration: Calibration,
        turn_sd: float,
        angle: float,
        ring: StandingSpot,
        off: PlacementOff | None,
    ) -> Iterator[Finding]:
        """What is wrong with the sensors' placement and with S*."""
        yield from judge("angle", angle, uncertain=2.0 * math.degrees(turn_sd))
        yield from judge("overlap", -ring.room)
        if calibration.provisional:
            return
        yield from judge("precision", math.degrees(turn_sd))
        yield from compared(placement_figures(off), is_loaded(calibration))
        error = self._lately(_LATELY, lambda each: each.error)
        apart = self._lately(_LATELY, lambda each: each.apart)
        yield from judge("error", median_of(error), limits=of_error(self.body.name))
        yield from judge("views", median_of(apart), limits=of_views(self.body.name))

    def _in_ring(self, found: Finding, frame: SessionFrame, ring: StandingSpot, angle: float) -> Finding:
        """A finding that asks into the ring, if the person stands elsewhere and that may do.

        One view alone does not tell whether the other sensor is still where the ring supposes it. To aim
        sensors is not asked once they are aimed: what is left is the tracker's.
        """
        skeletons = frame.pair.skeletons
        known = skeletons.a is not None and skeletons.b is not None and ring.room >= 0.0
        if not (RULES[found.rule].by_place and frame.fused.has_person and known):
            return found
        at = np.nanmedian(frame.fused.positions[list(self.body.torso)], axis=0)
        if not ring.is_at(at[0], at[2]):
            return replace(found, step=RING)
        if found.step == AIM and ring.away <= _AIMED_M and abs(angle - 90.0) <= _AIMED_DEG:
            return replace(found, step="" if found.word == "usable" else WALK)  # B may have been moved
        return found


def _beyond(points: NDArray[np.float32], lens: Intrinsics) -> tuple[float, ...]:
    """Degrees by which (N, 3) points are at most beyond the left, right, upper and lower edge of an image."""
    x, y = np.degrees(np.arctan2(points[:, :2].T, points[:, 2]))
    left, right = np.degrees(np.arctan2((-lens.cx, lens.width - lens.cx), lens.fx))
    top, bottom = np.degrees(np.arctan2((-lens.cy, lens.height - lens.cy), lens.fy))
    edges = (left - x).max(), (x - right).max(), (top - y).max(), (y - bottom).max()
    return tuple(max(0.0, float(each)) for each in edges)


def _in_fives(degrees: float) -> str:
    return f"{5 * math.ceil(degrees / 5.0)}"


def median_of(values: NDArray[np.float64]) -> float | None:
    """None of no values."""
    return float(np.median(values)) if len(values) else None
