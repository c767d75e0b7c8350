"""Detection of the start-up pose, from which R, t and the bone lengths are measured.

Sec. 4 asks for a start-up pose: at 45° to both sensors, arms and legs apart, every joint tracked, held for a
few seconds. The program recognises that pose.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.calibration import FEWEST_PAIRS
from fusion.errors import CalibrationError
from fusion.pair_arrays import Pairs
from fusion.registration.rigid_fit import NOBODY_IN_BOTH
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from fusion.support.large_arrays import parts

_SHORTEST_NS = 1_000_000_000
_SHORTEST_PARTLY_NS = 2_000_000_000
_LONGEST_NS = 3_000_000_000
_GAP_NS = 1_000_000_000  # between two pairs of both views: a longer one ends the pose
_CALM_NS = 2_000_000_000  # of the window where no pose is held
_FEWEST_SHARED = 4  # main joints that both sensors track, of a pose that each sees in part
_STILL = 0.040  # metres RMS about the window's mean; real still poses tremble by 1–20 mm a joint
_ARM_ANGLE = np.radians(25.0)  # shoulder → wrist against the trunk's axis
_LONG = 18_000  # pairs, ten minutes
_LEG_ANGLE = np.radians(12.0)  # hips' centre → one ankle against the other


class StartUpPose:
    """Detects when the start-up pose has been held long enough.

    Pairs without both skeletons are ignored: a lost frame does not end the pose, but a second without both
    views does.

    Args:
        partly: Whether a pose seen in part counts: at least four main joints are tracked by both sensors, and
            the pose is held for two seconds. Sensors far apart see no more, because one arm and one leg are
            hidden from each.
    """

    def __init__(self, body: Body, *, partly: bool = False) -> None:
        self._main = main_joints(body)
        self._body = body
        self._fewest = _FEWEST_SHARED if partly else len(self._main)
        self._shortest_ns = _SHORTEST_PARTLY_NS if partly else _SHORTEST_NS
        self._held: deque[SkeletonPair] = deque()

    @property
    def held(self) -> float:
        """Seconds for which the pose has been held so far."""
        if len(self._held) < 2:
            return 0.0
        return (self._held[-1].time_ns - self._held[0].time_ns) * 1e-9

    def watch(self, pair: SkeletonPair) -> list[SkeletonPair] | None:
        """The pairs of the held pose once it ends after a second or more, or has lasted three; else None.

        It also needs fifteen pairs: at five frames per second it must last for three seconds.

        Raises:
            BodyError: A skeleton is of another body.
        """
        pair.require(self._body)
        if pair.a is None or pair.b is None:
            return None
        gap = bool(self._held) and not 0 <= pair.time_ns - self._held[-1].time_ns <= _GAP_NS
        ended = self.end() if gap else None
        now = self._hold(pair)
        return now if ended is None else ended

    def _hold(self, pair: SkeletonPair) -> list[SkeletonPair] | None:
        if not self._holds(pair):
            return self.end()
        self._held.append(pair)
        if not self._still():
            return self.end(but_last=1)
        lasts = len(self._held) >= FEWEST_PAIRS and pair.time_ns - self._held[0].time_ns >= _LONGEST_NS
        return self.end() if lasts else None

    def end(self, but_last: int = 0) -> list[SkeletonPair] | None:
        """Ends the pose, without some last pairs; returns its pairs if it was held long enough, else None."""
        pose = list(self._held)[: len(self._held) - but_last]
        long_enough = len(pose) >= FEWEST_PAIRS and pose[-1].time_ns - pose[0].time_ns >= self._shortest_ns
        if long_enough or not but_last:
            self._held.clear()
        else:
            while len(self._held) > 1 and not self._still():  # drop the pairs before the movement
                self._held.popleft()
        return pose if long_enough else None

    def _holds(self, pair: SkeletonPair) -> bool:
        if pair.a is None or pair.b is None:
            return False
        shared = np.count_nonzero((pair.a.tracked & pair.b.tracked)[self._main])
        return bool(shared >= self._fewest and (limbs_apart(pair.a) or limbs_apart(pair.b)))

    def _still(self) -> bool:
        return max(_tremble(self._tracked(side)) for side in zip(*self._views(), strict=True)) < _STILL

    def _views(self) -> Iterator[tuple[Skeleton, Skeleton]]:
        return ((pair.a, pair.b) for pair in self._held if pair.a is not None and pair.b is not None)

    def _tracked(self, views: tuple[Skeleton, ...]) -> NDArray[np.float32]:
        """(T, M, 3) the main joints of one view; NaN where not tracked."""
        at = np.array([view.positions[self._main] for view in views])
        tracked = np.array([view.tracked[self._main] for view in views])
        return np.where(tracked[..., None], at, np.float32(np.nan))


def find_start_up_pose(body: Body, pairs: Sequence[SkeletonPair]) -> tuple[Sequence[SkeletonPair], str]:
    """Chooses the pairs of a recording to calibrate on, and describes them.

    They are the first start-up pose held for a second or more or, in a recording without one, the calmest
    two seconds in which most main joints are tracked in both views.

    Raises:
        CalibrationError: No frame shows a person to both sensors.
    """
    pairs, pose = Pairs.of(body, pairs), StartUpPose(body)
    for pair in _worth_watching(pairs):
        held = pose.end() if pair is None else pose.watch(pair)
        if held is not None:
            return held, f"start-up pose at {_seconds(pairs, held[0]):.1f} s, {len(held)} frames"
    calm = _calmest(pairs)
    return calm, (
        f"no start-up pose found; calmest window instead, at {_seconds(pairs, calm[0]):.1f} s, "
        f"{len(calm)} frames"
    )


def _worth_watching(pairs: Pairs) -> Iterator[SkeletonPair | None]:
    """The pairs in runs long enough to be a start-up pose, each run ended by None.

    This is vectorised, so that only the candidates of a long recording are examined one by one.
    """
    main, seen = main_joints(pairs.body), _seen_by_both(pairs)
    holds = np.zeros(len(seen), dtype=bool)
    for part in parts(len(seen)):
        of = pairs[seen[part]].arrays()
        tracked = (of.states_a == TrackingState.TRACKED) & (of.states_b == TrackingState.TRACKED)
        apart = _limbs_apart(pairs.body, of.a) | _limbs_apart(pairs.body, of.b)
        holds[part] = tracked[:, main].all(axis=1) & apart
    steps = np.diff(pairs.time_ns[seen])
    breaks = np.flatnonzero((holds[1:] != holds[:-1]) | (steps < 0) | (steps > _GAP_NS)) + 1
    for run in np.split(np.arange(len(seen)), breaks):
        if len(run) >= FEWEST_PAIRS and holds[run[0]]:
            yield from pairs[seen[run]]
            yield None


def _seen_by_both(pairs: Pairs) -> NDArray[np.int64]:
    """Indices of the pairs in which both sensors see the person."""
    each = (part.start + np.flatnonzero(pairs[part].seen_by_both) for part in parts(len(pairs)))
    return np.concatenate([np.zeros(0, dtype=np.int64), *each])


def main_joints(body: Body) -> NDArray[np.int64]:
    """The joints that must be seen at the start: head, and both arms and legs down to wrist and ankle."""
    limbs = ("SHOULDER", "ELBOW", "WRIST", "HIP", "KNEE", "ANKLE")
    names = ["HEAD", *(f"{joint}_{side}" for side in ("LEFT", "RIGHT") for joint in limbs)]
    return np.array([body.joint(name) for name in names], dtype=np.int64)


def limbs_apart(skeleton: Skeleton) -> bool:
    """Whether both arms are held away from the trunk and the legs stand apart."""
    return bool(_limbs_apart(skeleton.body, skeleton.positions))


def _limbs_apart(body: Body, positions: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(…) of (…, J, 3) positions; false where one that is needed is missing."""
    at = positions.astype(np.float64)

    def joint(name: str) -> NDArray[np.float64]:
        return np.asarray(at[..., body.joint(name), :])

    hips = 0.5 * (joint("HIP_LEFT") + joint("HIP_RIGHT"))
    shoulders = 0.5 * (joint("SHOULDER_LEFT") + joint("SHOULDER_RIGHT"))
    down = hips - shoulders
    left, right = (_angle(joint(f"WRIST_{s}") - joint(f"SHOULDER_{s}"), down) for s in ("LEFT", "RIGHT"))
    legs = _angle(joint("ANKLE_LEFT") - hips, joint("ANKLE_RIGHT") - hips)
    return np.asarray((left > _ARM_ANGLE) & (right > _ARM_ANGLE) & (legs > _LEG_ANGLE))


def _calmest(pairs: Pairs) -> Sequence[SkeletonPair]:
    """The calmest window; of a long recording, windows within parts of ten minutes count."""
    seen = _seen_by_both(pairs)
    if len(seen) == 0:
        raise CalibrationError(NOBODY_IN_BOTH)
    each = (_calm_windows(pairs[seen[part]]) for part in parts(len(seen), _LONG))
    found = list(chain.from_iterable(each))
    if not found:  # too short or too sparse for a choice
        return pairs[seen]
    return min(found, key=lambda window: window[:2])[2]  # the best seen, and of these the calmest


def _calm_windows(pairs: Pairs) -> Iterator[tuple[float, float, Pairs]]:
    """The best window, if there is any: its share of joints that are not seen, their tremble, its pairs."""
    main, of = main_joints(pairs.body), pairs.arrays()
    tracked = (of.states_a == TrackingState.TRACKED) & (of.states_b == TrackingState.TRACKED)
    share = tracked[:, main].mean(axis=1)
    ends = np.searchsorted(of.time_ns, of.time_ns + _CALM_NS)
    count = ends - np.arange(len(ends))
    spans = of.time_ns[ends - 1] - of.time_ns >= 0.75 * _CALM_NS
    starts = np.flatnonzero(spans & (count >= FEWEST_PAIRS))
    if len(starts):
        missing = (1.0 - _window_sums(share, starts, ends[starts]) / count[starts]).round(1)
        tremble = np.maximum(*(_window_tremble(view[:, main], starts, ends[starts]) for view in (of.a, of.b)))
        best = int(np.lexsort((tremble, missing))[0])
        yield float(missing[best]), float(tremble[best]), pairs[starts[best] : ends[starts[best]]]


def _window_sums(
    values: NDArray[np.float64], starts: NDArray[np.int64], ends: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(W, …) sums of (T, …) values over [start, end)."""
    total = np.concatenate((np.zeros_like(values[:1]), np.cumsum(values, axis=0)))
    return np.asarray(total[ends] - total[starts])


def _window_tremble(
    positions: NDArray[np.float32], starts: NDArray[np.int64], ends: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(W,) :func:`_tremble` of every window [start, end)."""
    seen = np.asarray(np.isfinite(positions).all(axis=2), dtype=bool)
    known = positions[seen].astype(np.float64)
    centre = known.mean(axis=0) if len(known) else np.zeros(3)
    at = positions.astype(np.float64) - centre
    at[~seen] = 0.0
    count = _window_sums(seen.astype(np.float64), starts, ends)  # (W, M)
    total = _window_sums(at, starts, ends)
    square = _window_sums(np.sum(at * at, axis=2), starts, ends)
    about_mean = np.maximum(square - np.sum(total * total, axis=2) / np.maximum(count, 1.0), 0.0)
    return np.asarray(
        np.where(
            count.sum(axis=1) > 0.0,
            np.sqrt(about_mean.sum(axis=1) / np.maximum(count.sum(axis=1), 1.0)),
            np.inf,
        )
    )


def _tremble(positions: NDArray[np.float32]) -> float:
    """RMS distance of (T, M, 3) joints from their own mean over the window; missing joints left out."""
    finite = np.asarray(np.isfinite(positions).all(axis=2), dtype=bool)
    if not finite.any():
        return np.inf
    at = np.where(finite[..., None], positions, 0.0).astype(np.float64)
    mean = at.sum(axis=0) / np.maximum(finite.sum(axis=0), 1)[:, None]
    square = np.sum((at - mean) ** 2, axis=2)[finite]
    return float(np.sqrt(square.mean()))


def _angle(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(u, axis=-1) * np.linalg.norm(v, axis=-1)
    cosine = np.sum(u * v, axis=-1) / np.maximum(length, 1e-9)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _seconds(pairs: Sequence[SkeletonPair], at: SkeletonPair) -> float:
    return (at.time_ns - pairs[0].time_ns) * 1e-9
