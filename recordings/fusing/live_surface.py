"""The registration of running sensors by the surface that both see, on a thread of its own."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.depth.surface import AROUND, shared_surface
from devices.frame_pairs import FramePair
from devices.sensor import SensorFrame
from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.calibration.offline import larger_speeds
from fusion.calibration.online import CalibrationChange, CalibrationLearner, Known
from fusion.calibration.surface_fit import FEWEST_MOMENTS, with_surface
from fusion.errors import CalibrationError
from fusion.intrinsics import Intrinsics
from fusion.pair_arrays import Pairs
from fusion.skeleton import Skeleton, SkeletonPair
from fusion.support.types import Array

_MOMENTS, _AGAIN = 12, 2  # that are kept; new ones after which R and t are fitted again
_SPACING_NS, _LATER_NS = 1_000_000_000, 10_000_000_000  # of moments, until there are so many and then
_LONGEST_NS = 500_000_000  # between two of the pairs around a moment, from which its joints' velocity comes


class _Moment(NamedTuple):
    """A pair, the pairs around it, and of A and B the depth image and the people who are not followed."""

    pairs: list[SkeletonPair]
    images: tuple[NDArray[np.uint16], ...]
    others: tuple[list[Array], ...]


class LiveSurface:
    """Fits R and t to the surface of the person in depth images, while pairs arrive.

    The stillest pair of each second is kept; later, of each ten seconds. After every second one a fit begins,
    on a thread of its own: it takes longer than a frame.

    Args:
        cameras: Of the depth images.
        offsets: Metres by which each camera shows all things too far away.
        executor: Runs the fits; a thread if None.
    """

    def __init__(
        self,
        body: Body,
        cameras: tuple[Intrinsics, Intrinsics],
        offsets: tuple[float, float] = (0.0, 0.0),
        executor: Executor | None = None,
    ) -> None:
        self._body, self._cameras, self._offsets = body, cameras, offsets
        self._executor = executor or ThreadPoolExecutor(1, "surface")
        self.forget()

    def forget(self) -> None:
        """Forgets all moments, and the fit that runs: a sensor was moved."""
        self._recent: deque[FramePair] = deque(maxlen=2 * AROUND + 1)
        self._moments: deque[_Moment] = deque(maxlen=_MOMENTS)
        self._stillest: tuple[float, _Moment] | None = None
        self._next_ns: int | None = None
        self._new = 0
        self._fit: tuple[Known, Future[Calibration]] | None = None

    def observe(self, pair: FramePair, learner: CalibrationLearner) -> list[CalibrationChange]:
        """Takes the next pair with its images; returns the change of the calibration by a fit that ended."""
        self._choose(pair)
        if self._fit is None and self._new >= _AGAIN and len(self._moments) >= FEWEST_MOMENTS:
            self._new, known = 0, learner.known
            self._fit = known, self._executor.submit(self._fitted, list(self._moments), known)
        if self._fit is None or not self._fit[1].done():
            return []
        (known, fit), self._fit = self._fit, None
        with suppress(CalibrationError, np.linalg.LinAlgError):  # the joints' registration remains
            return learner.see_surface(fit.result(), known, pair.time_ns)
        return []

    def _choose(self, pair: FramePair) -> None:
        """Keeps the middle one of the recent pairs of two views, if it is the stillest of its second."""
        if pair.skeletons.a is None or pair.skeletons.b is None:
            return
        if self._recent and not 0 < pair.time_ns - self._recent[-1].time_ns < _LONGEST_NS:
            self._recent.clear()
        self._recent.append(pair)
        if len(self._recent) <= 2 * AROUND:
            return
        pairs = [each.skeletons for each in self._recent]
        if self._next_ns is None or pair.time_ns >= self._next_ns:
            if self._stillest is not None:
                self._moments.append(self._stillest[1])
                self._new += 1
            self._stillest = None
            self._next_ns = pair.time_ns + (_SPACING_NS if len(self._moments) < _MOMENTS else _LATER_NS)
        middle = self._recent[AROUND]
        views = (middle.a, pairs[AROUND].a), (middle.b, pairs[AROUND].b)
        images = [frame.depth for frame, _ in views if frame is not None and frame.depth is not None]
        if len(images) < 2:
            return
        near = pairs[AROUND - 1 : AROUND + 2]
        a = np.array([each.a.positions for each in near if each.a is not None])
        b = np.array([each.b.positions for each in near if each.b is not None])
        (speed,) = larger_speeds(a, b, np.array([each.time_ns for each in near])).tolist()
        if np.isfinite(speed) and (self._stillest is None or speed < self._stillest[0]):
            others = tuple(_others(*view) for view in views)
            self._stillest = speed, _Moment(pairs, tuple(images), others)

    def _fitted(self, moments: Sequence[_Moment], known: Known) -> Calibration:
        """The known calibration with R and t by the surface, if enough of it is seen."""
        pairs = Pairs.of(self._body, [pair for moment in moments for pair in moment.pairs])
        chosen = pairs[AROUND :: 2 * AROUND + 1]
        images: list[dict[int, NDArray[np.uint16]]] = [{}, {}]
        others: list[dict[int, list[Array]]] = [{}, {}]
        for moment, frames in zip(moments, chosen.frames.tolist(), strict=True):
            for side, frame in enumerate(frames):
                images[side][frame], others[side][frame] = moment.images[side], moment.others[side]
        shared = shared_surface(chosen, images, self._cameras, others, self._offsets)
        return with_surface(self._body, known.evidence, known.calibration, known.fit, shared)


def _others(frame: SensorFrame | None, followed: Skeleton | None) -> list[Array]:
    """(J, 3) of each person of a frame who is not followed."""
    people = () if frame is None else frame.people.values()
    return [person.positions.astype(np.float64) for person in people if person is not followed]
