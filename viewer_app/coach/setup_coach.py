"""Advice while two sensors are set up. Each advice names its figure and its threshold.

The coach is pure: its input is the loop's data, its clock is the pairs' time, and it neither waits nor
prints.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.capture.causes import Cause
from devices.depth.camera import in_image, project
from devices.sensor import SensorFrame
from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.facing.handedness import mirrored_share
from fusion.intrinsics import Intrinsics
from fusion.skeleton import Skeleton
from recordings.appearance.floor import CAMERA_HEIGHT
from recordings.data.session_arrays import SessionFrame
from recordings.quality.limits import FARTHEST_PERSON, nearest
from viewer_app.coach.advice import Advice, placement
from viewer_app.coach.standing_spot import standing_spot

UNSEEN = 1.0
"""Seconds without a person before the coach reports it."""
MOST = 0.5
"""Share of the last second from which on something counts: a foot outside the image, or someone else."""
HOLD = 3.0
"""Seconds to hold the start-up pose; the paper asks for a few seconds."""
RATE = 0.8
"""Lowest accepted frame rate, as a share of the nominal rate."""
SKEW = 0.5
"""Largest accepted skew, as a share of the frame interval; above it another frame would match better."""
MOVED = 0.25
"""Drift of t in metres, median over 8 s. On real pairs a walking person shifts the 3 s median by up to
0.19 m; turning a sensor by 5° shifts it by 0.26 m at a distance of 3 m."""
WARM_UP = 2400.0
"""Seconds until an Azure Kinect's distances stay the same (Tölgyessy et al. 2021: 40 to 50 minutes)."""
DROPPED = 0.05
"""Largest accepted share of frames that this machine is too slow for, or that are lost on USB."""
_BUSY = "The body tracker needs more of this machine. Close other programs."
_SLOW = "This machine is too slow. Close other programs, or use --depth none."
_USB = "Give it its own USB controller, and light."
_NETWORK = "Check its program and the network."
_ASKED_OF_SLOW = "close other programs: this machine is too slow"
_SECOND, _RATE_WINDOW, _MIRRORED_WINDOW, _MOVED_WINDOW = 1.0, 2.0, 4.0, 8.0  # seconds
_SILENT = 0.3  # seconds; a sensor without frames for longer is gone, which its thread reports, not slow


@dataclass(frozen=True)
class Situation:
    """The state of the loop, apart from the frame."""

    calibration: Calibration
    final: bool  # whether it is kept, or only refined, from now on
    held: float  # seconds for which the start-up pose has been held
    dropped: tuple[int, int] = (0, 0)  # frames so far that the program was too slow for, of A and B
    lost: tuple[int, int] = (0, 0)  # frames so far that were lost on USB, of A and B
    step: int = 1  # both sensors use every n-th frame, so that the slower body tracker keeps up


@dataclass(frozen=True)
class _View:
    """One sensor's part of a pair."""

    time: float
    came: bool
    seen: bool
    feet_gone: bool
    cut_off: bool
    crowd: bool
    step: int


class Coach:
    """Watches the loop and gives advice.

    Args:
        warm_up: Seconds until the sensors' distances are stable.
        simulated: Whether this machine simulates the sensors, so that only it can be too slow.
        remote: The sides, of ``AB``, whose sensors are on other PCs.
    """

    def __init__(
        self,
        body: Body,
        intrinsics: tuple[Intrinsics, Intrinsics],
        rate: float = 30.0,
        warm_up: float = 0.0,
        simulated: bool = False,
        remote: str = "",
    ) -> None:
        self.body, self.intrinsics = body, intrinsics
        self._rate, self._warm_up, self._simulated, self._remote = rate, warm_up, simulated, remote
        self._feet = np.array([body.joint("ANKLE_LEFT"), body.joint("ANKLE_RIGHT")])
        self._views: tuple[deque[_View], deque[_View]] = (deque(), deque())
        self._shares: tuple[deque[tuple[float, float]], ...] = (deque(), deque())
        self._seen_at: list[float | None] = [None, None]
        self._skews: deque[tuple[float, float]] = deque()
        self._came_at, self._since = [-math.inf, -math.inf], [-math.inf, -math.inf]  # last, and again from
        self._counts: deque[tuple[float, tuple[int, int], tuple[int, int]]] = deque()
        self._shifts: deque[tuple[float, NDArray[np.float64]]] = deque()
        self._began: float | None = None
        self._calibration: Calibration | None = None
        self._overlap_of: tuple[Calibration | None, float] = (None, math.inf)

    def watch(self, frame: SessionFrame, now: Situation) -> list[Advice]:
        """All current advice with the next frame, the most urgent first."""
        time = frame.pair.time_ns * 1e-9
        self._began = time if self._began is None else self._began
        self._remember(frame, now, time)
        mirrored = any(map(self._mirrored, (0, 1)))
        advice = [
            *self._people(frame, now, time),
            # the registration of a mirror image means nothing
            *(() if mirrored else placement(now.calibration)),
            *self._sensors(time),
            *(() if mirrored else self._overlap(now.calibration)),
            *self._pose(now),
            *self._moved(now, time),
        ]
        return sorted(advice, key=lambda each: each.level != "WARN")

    def _remember(self, frame: SessionFrame, now: Situation, time: float) -> None:
        pair, skeletons = frame.pair, frame.pair.skeletons
        for k, (sensor_frame, skeleton) in enumerate(((pair.a, skeletons.a), (pair.b, skeletons.b))):
            if skeleton is not None:
                self._seen_at[k] = time
                share = mirrored_share(self.body, skeleton.positions[None])
                if share is not None:
                    self._shares[k].append((time, share))
            if sensor_frame is not None:
                if time - self._came_at[k] > _SILENT:
                    self._since[k] = time
                    if skeleton is None and self._seen_at[k] is not None:
                        self._seen_at[k] = time
                self._came_at[k] = time
            self._views[k].append(self._view(time, sensor_frame, skeleton, k, now))
            while time - self._views[k][0].time > _RATE_WINDOW:
                self._views[k].popleft()
        if pair.a is not None and pair.b is not None:
            self._skews.append((time, abs(pair.skew_ns) * 1e-6))
        self._counts.append((time, now.dropped, now.lost))
        if now.calibration is not self._calibration:
            self._calibration = now.calibration
            self._shifts.clear()
        if skeletons.a is not None and skeletons.b is not None:
            shift = self._torso_shift(skeletons.a, skeletons.b, now.calibration)
            if shift is not None:
                self._shifts.append((time, shift))
        histories: tuple[tuple[deque[Any], float], ...] = (
            (self._skews, _RATE_WINDOW),
            (self._counts, _RATE_WINDOW),
            (self._shifts, _MOVED_WINDOW),
            *((shares, _MIRRORED_WINDOW) for shares in self._shares),
        )
        for history, window in histories:
            while history and time - history[0][0] > window:
                history.popleft()

    def _view(
        self, time: float, frame: SensorFrame | None, skeleton: Skeleton | None, k: int, now: Situation
    ) -> _View:
        crowd = frame is not None and len(frame.people) > 1
        if skeleton is None:
            return _View(time, frame is not None, False, False, False, crowd, now.step)
        pixels = project(self.intrinsics[k], skeleton.positions)
        outside = np.isfinite(pixels[:, 0]) & ~in_image(self.intrinsics[k], pixels)
        # One leg often hides the other, which no better place would change; it cannot hide both feet.
        feet = bool(outside[self._feet].any() or not skeleton.tracked[self._feet].any())
        return _View(time, True, True, feet, bool(outside.any()), crowd, now.step)

    def _torso_shift(self, a: Skeleton, b: Skeleton, calibration: Calibration) -> NDArray[np.float64] | None:
        """(3,) metres from B's torso, carried to K_A's frame, to A's; None without a joint in common.

        It is by how much t of sec. 4 leaves the calibration's, with any method. An exchange of left and right
        does not change it.
        """
        common = [i for i in self.body.torso if a.states[i] and b.states[i]]
        if not common:
            return None
        carried = calibration.a_from_b.apply(b.positions[common])
        shift: NDArray[np.float64] = (a.positions[common] - carried).mean(axis=0)
        return shift

    def _sensors(self, time: float) -> Iterator[Advice]:
        assert self._began is not None
        if time - self._began < _RATE_WINDOW:
            return
        for k, side in enumerate("AB"):
            came = sum(view.came for view in self._views[k]) / _RATE_WINDOW
            # What is left out for a slow body tracker is no fault of USB or light, and is told as it begins.
            step = max(view.step for view in self._views[k])
            least = RATE * self._rate / step
            (_, *first), (_, *last) = self._counts[0], self._counts[-1]
            dropped, lost = (now[k] - then[k] for then, now in zip(first, last, strict=True))
            most = int(DROPPED * self._rate * _RATE_WINDOW)
            if time - self._came_at[k] > _SILENT:
                continue
            if came < least and time - self._since[k] >= _RATE_WINDOW:
                few = int(came)  # rounded it might be the limit itself
                slow = self._simulated or dropped > most
                remedy = _NETWORK if side in self._remote else _USB
                remedy = _BUSY if step != 1 else _SLOW if slow else remedy
                missed = f"below {least:.3g} movements are missed. {remedy}"
                text = f"Sensor {side} gives {few} frames per second; {missed}"
                label, busy = f"{few} frames per second", self._simulated or step != 1 or slow
                asks = _ASKED_OF_SLOW if busy else self._plug(side)
                yield _problem("rate", side, text, label, asks)
            elif max(dropped, lost) > most:
                cause = Cause.TOO_FAST if dropped >= lost else Cause.LOST_ON_USB
                text = cause.says(count=max(dropped, lost), label=side, seconds=_RATE_WINDOW, most=most)
                busy = cause is Cause.TOO_FAST
                asks = _ASKED_OF_SLOW if busy else self._plug(side)
                yield _problem("drops", side, text, "drops frames", asks)
        if self._skews:
            skew, limit = float(np.median([ms for _, ms in self._skews])), SKEW * 1e3 / self._rate
            if skew > limit:
                yield Advice(
                    "skew",
                    f"A and B are captured {skew:.0f} ms apart; half a frame is {limit:.0f} ms. "
                    "Connect the sync cable, or move slowly.",
                    "WARN",
                    label=f"A and B are captured {skew:.0f} ms apart",
                    step="connect the sync cable, or move slowly",
                )
        run = time - self._began
        if run < self._warm_up:
            yield Advice(
                "warm-up",
                f"The sensors have run for {run / 60.0:.0f} min; for the first {self._warm_up / 60.0:.0f} "
                "their distances drift by millimetres. Calibrate again after that if you need them.",
                figures=True,
            )

    def _plug(self, side: str) -> str:
        return f"check the {'network' if side in self._remote else 'USB port'} of {{who}}"

    def _people(self, frame: SessionFrame, now: Situation, time: float) -> Iterator[Advice]:
        assert self._began is not None
        skeletons, views = (frame.pair.skeletons.a, frame.pair.skeletons.b), (frame.pair.a, frame.pair.b)
        for k, (side, skeleton) in enumerate(zip("AB", skeletons, strict=True)):
            view, seen_at = views[k], self._seen_at[k]
            since = time - (self._began if seen_at is None else seen_at)
            comes = time - self._came_at[k] <= _SILENT
            if not now.final and self._share(k, time, "crowd") > MOST:
                text = (
                    f"Sensor {side} sees someone else. Until the calibration, only one person may be in view."
                )
                step, why = "ask them to step aside", "Someone else in view"
                yield _problem("others", side, text, "someone else in view", step, why)
            if skeleton is None:
                if not comes or (seen_at is None and view is not None and not view.people):
                    label = "no one in view" if comes else "no frames"
                    yield _remark(
                        "silent", side, label, "step into view of {who}" if comes else "wait for {who}"
                    )
                if view is not None and view.people:
                    # the person followed is hidden, or not told from others yet
                    if since >= UNSEEN:
                        yield _remark("hidden", side, "you are hidden", "step aside: {who} must see you")
                    continue
                if since >= UNSEEN and comes:
                    text = f"Sensor {side} has seen no one for {since:.0f} s (more than {UNSEEN:g} s)."
                    remedy = "Step into its view, and turn off what stands in the way."
                    step = "step into view of {who}"
                    yield _problem("person", side, f"{text} {remedy}", "no one in view", step)
                continue
            yield from self._distance(side, skeleton, self.intrinsics[k])
            if self._mirrored(k):
                step = "turn off mirroring in the driver of {who}"
                text = f"Sensor {side} gives the mirror image of a person. Turn off mirroring in its driver."
                yield _problem("mirrored", side, text, "mirror image", step, "Mirror image")
            if self._share(k, time, "feet_gone") > MOST:
                text = f"Sensor {side} does not see both feet. Tilt it down, or step back."
                step = "tilt {who} down, or step back"
                yield _problem("feet", side, text, "feet out of view", step, "Feet out of view")
            elif self._share(k, time, "cut_off") > MOST:
                yield _remark("whole", side, "a part of you out of view", "step towards the ring")

    def _mirrored(self, k: int) -> bool:
        """Whether most skeletons of the last seconds are mirror images, of those that tell."""
        return bool(self._shares[k]) and float(np.mean([share for _, share in self._shares[k]])) > MOST

    def _share(self, k: int, time: float, what: str) -> float:
        """The share of the last second's frames with a person in which something is the case."""
        lately = [getattr(view, what) for view in self._views[k] if view.seen and time - view.time <= _SECOND]
        return float(np.mean(lately)) if lately else 0.0

    def _distance(self, side: str, skeleton: Skeleton, camera: Intrinsics) -> Iterator[Advice]:
        torso = skeleton.positions[list(self.body.torso), 2]
        if not np.isfinite(torso).any():
            return
        away = float(np.nanmean(torso))
        near, far = nearest(camera), FARTHEST_PERSON[self.body.name]
        if away < near:
            limit = f"a whole person fits from {near:.1f} m on. Step back."
            text = f"Too close to sensor {side}: {away:.1f} m; {limit}"
            step, more = f"step back {_rounded_up(near - away):.1f} m", near - away
            yield _problem("distance", side, text, f"too near, {away:.1f} m", step, "Too near", more)
        elif away > far:
            text = (
                f"Too far from sensor {side}: {away:.1f} m; it measures well up to {far:.1f} m. Come closer."
            )
            step, more = f"come {_rounded_up(away - far):.1f} m closer", away - far
            yield _problem("distance", side, text, f"too far, {away:.1f} m", step, "Too far", more)

    def _overlap(self, calibration: Calibration) -> Iterator[Advice]:
        if calibration is not self._overlap_of[0]:
            self._overlap_of = calibration, math.inf
            if calibration.registration is not None:
                far = FARTHEST_PERSON[self.body.name]
                spot = standing_spot(calibration.a_from_b, self.intrinsics, far, CAMERA_HEIGHT)
                self._overlap_of = calibration, spot.room
        if (room := self._overlap_of[1]) < 0.0:
            yield Advice(
                "overlap",
                f"Nowhere do both sensors see a whole person with arms out: the best place lacks "
                f"{-room:.1f} m (0 is enough). Turn both to the same place, 2.5 m from each.",
                "WARN",
                label="A and B have no place to stand in common",
                step="aim A and B at the same place, 2.5 m from each",
            )

    def _pose(self, now: Situation) -> Iterator[Advice]:
        if now.final:
            return
        # without a count, which the card has: the headline is steady
        yield _remark(
            "pose", "", "not calibrated yet", f"in the ring: arms and legs apart, hold still {HOLD:.0f} s"
        )

    def _moved(self, now: Situation, time: float) -> Iterator[Advice]:
        if not now.final or not self._shifts or time - self._shifts[0][0] < 0.9 * _MOVED_WINDOW:
            return
        shift = float(np.linalg.norm(np.median([shift for _, shift in self._shifts], axis=0)))
        if shift > MOVED:
            yield Advice(
                "moved",
                f"One sensor was moved: the views fit {1e3 * shift:.0f} mm off their calibration (limit "
                f"{1e3 * MOVED:.0f} mm). Calibrate again: hold the start-up pose after a restart.",
                "WARN",
                "AB",
                "moved? calibrate again",
                step="restart, and hold the pose",
                why="A sensor was moved",
            )


def _problem(
    topic: str, side: str, text: str, label: str, step: str, why: str = "", urgency: float = 0.0
) -> Advice:
    """A warning about one sensor."""
    return Advice(f"{topic} {side}", text, "WARN", side, label, step, why, urgency)


def _remark(topic: str, side: str, label: str, step: str) -> Advice:
    """Something to do that is no fault: it is shown, and no event of the session."""
    return Advice(f"{topic} {side}".strip(), label, "INFO", side, label, step)


def _rounded_up(metres: float) -> float:
    """In half metres, which stay the same while a person walks."""
    return math.ceil(2.0 * metres) / 2.0
