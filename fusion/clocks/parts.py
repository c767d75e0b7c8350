"""The times of two recordings whose clocks were set while they recorded.

A clock that is set cuts its recording into parts, and what the times lack between two parts is unknown. The
sensors stay where they are, so one placement of B in A's frame counts for all parts. It is found from the
longest piece of time without a cut. From there outwards, each part gets the times at which its joints are
where the other view has them. Where the views are in different places then, they are of different moments.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.clocks import Times, median_interval, rhythm
from fusion.clocks.search import (
    FEWEST,
    GRID_NS,
    agreement,
    is_better,
    placed_costs,
    placement_at,
    refined_offset,
    vertex,
)
from fusion.pair_arrays import View
from fusion.support.types import Array

_JUMP, _MOST = 2.5, 8  # frame intervals that may be a set clock, and how many are asked for
_REACH_NS = 30_000_000_000  # of what the times may lack
_FINE_NS, _FINE = 8_333_333, 12  # steps of the last search
_ELSEWHERE = 0.35  # of the way from the mean penalty of the longest piece to that of other moments
_TOLD = 1.5  # times its penalty: if those of other moments are less, the movement tells nothing
_BEFORE, _AFTER = -(1 << 62), 1 << 62


class Cut(NamedTuple):
    """Where a clock may have been set."""

    side: int
    first: int  # frame after it
    certain: bool  # times that went back, or an hour ahead; else it may be a pause


class Joined(NamedTuple):
    """Times of both recordings that go on."""

    times: tuple[Times, Times]
    moved: tuple[tuple[Cut, int], ...] = ()  # what was added to the step of the times at a cut, ns
    unsure: Cut | None = None  # beside it, the views are of different moments


def parts_joined(body: Body, a: View, b: View, sets: Sequence[Sequence[int]]) -> Joined:
    """The times of the frames of both recordings, as if no clock had been set.

    They are as recorded up to the first cut of each, so an offset of the clocks as a whole remains.

    Args:
        a, b: The person in all frames.
        sets: The times of the first frames, in A and in B, after a clock was certainly set.
    """
    times = a.time_ns, b.time_ns
    seen = [np.flatnonzero(view.states.any(axis=1)) for view in (a, b)]
    cuts = _cuts(times, sets)
    if not cuts or min(map(len, seen)) < FEWEST:
        return Joined(times)
    return _Parts(body, (a, b), seen, cuts).joined()


def _cuts(times: Sequence[Times], sets: Sequence[Sequence[int]]) -> list[Cut]:
    """The certain ones, and the longest steps in which the other recording has frames."""
    found, steps = [], []
    for side, (own, other) in enumerate((times, times[::-1])):
        certain = np.searchsorted(own, np.array(sets[side], dtype=np.int64)).tolist()
        found += [Cut(side, first, certain=True) for first in certain]
        step = np.diff(own)
        for k in np.flatnonzero(step > _JUMP * median_interval(own)).tolist():
            first, end = np.searchsorted(other, own[k : k + 2])
            if end - first > _JUMP and k + 1 not in certain:
                steps.append((int(step[k]), Cut(side, k + 1, certain=False)))
    return found + [cut for _, cut in sorted(steps, reverse=True)[:_MOST]]


class _Parts:
    def __init__(
        self, body: Body, views: tuple[View, View], seen: list[NDArray[np.int64]], cuts: list[Cut]
    ) -> None:
        self._body, self._seen, self._cuts = body, seen, cuts
        self._views = [view.chosen(rows) for view, rows in zip(views, seen, strict=True)]
        self._recorded = [view.time_ns for view in views]
        self._times = [view.time_ns.copy() for view in views]  # B's on A's clock
        self._moved: dict[Cut, int] = {}

    def joined(self) -> Joined:
        self._times[1] += agreement(self._body, *self._views)[0]
        edges = [_BEFORE, *sorted(map(self._at, self._cuts)), _AFTER]
        pieces = [self._within(*ends) for ends in pairwise(edges)]
        longest = int(np.argmax([min(len(view.time_ns) for view in piece) for piece in pieces]))
        right = [cut for cut in self._cuts if self._at(cut) > edges[longest]]
        left = [cut for cut in self._cuts if self._at(cut) <= edges[longest]]
        if not self._place(*pieces[longest]):
            return Joined((self._recorded[0], self._recorded[1]))
        for rest, sign in ((right, 1), (left, -1)):
            loose: Cut | None = None  # whose part agrees nowhere so far
            while rest and len(self._cuts) <= 2 * _MOST:
                cut = min(rest, key=lambda one: sign * self._at(one._replace(first=one.first - (sign > 0))))
                rest.remove(cut)
                loose = self._join(cut, rest, sign, loose)
        unsure = self._unsure()
        a, b = (own - own[0] + was[0] for own, was in zip(self._times, self._recorded, strict=True))
        return Joined((a, b), tuple(self._moved.items()), unsure)

    def _at(self, cut: Cut) -> int:
        return int(self._times[cut.side][cut.first])

    def _view(self, side: int) -> View:
        return self._views[side]._replace(time_ns=self._times[side][self._seen[side]])

    def _within(self, begin: int, end: int) -> list[View]:
        views = self._view(0), self._view(1)
        return [v.chosen(np.flatnonzero((v.time_ns >= begin) & (v.time_ns < end))) for v in views]

    def _place(self, a: View, b: View) -> bool:
        """Finds the placement and the offset from one piece; whether it tells moments apart."""
        if min(len(a.time_ns), len(b.time_ns)) < FEWEST:
            return False
        near = agreement(self._body, a, b)[0]
        found = refined_offset(a, b._replace(time_ns=b.time_ns + near), 0, near)
        offset = near if found is None else round(found.offset_ns)
        self._times[1] += offset
        b = b._replace(time_ns=b.time_ns + offset)
        self._a_from_b, self._rhythm = placement_at(a, b), rhythm(a.time_ns, b.time_ns)
        shifts = np.linspace(-0.75, 0.75, 17) * float(np.ptp(a.time_ns))  # 0 is the middle one
        costs = self._costs(1, b, a, np.rint(shifts).astype(np.int64))
        here, elsewhere = float(np.nanmean(costs[8])), float(np.nanmean(np.delete(costs, 8, axis=0)))
        self._limit = here + _ELSEWHERE * (elsewhere - here)
        return elsewhere > _TOLD * here

    def _costs(self, side: int, own: View, other: View, shifts_ns: NDArray[np.int64]) -> Array:
        place = self._a_from_b if side else self._a_from_b.inverse()
        return placed_costs(self._body, own, other, place, shifts_ns)

    def _join(self, cut: Cut, rest: list[Cut], sign: int, loose: Cut | None) -> Cut | None:
        """Puts the part after a cut (sign 1), or before it (-1), to where the other view agrees.

        Args:
            rest: The cuts beyond it, whose parts have no place yet.
            loose: The last cut, if its part agrees nowhere: it can give way.

        Returns:
            The cut, if its part agrees nowhere.
        """
        times, rows, other = self._times[cut.side], self._seen[cut.side], self._view(1 - cut.side)
        others = [one for one in rest if one.side != cut.side]
        if sign > 0:
            end = min((int(self._times[one.side][one.first - 1]) for one in others), default=_AFTER)
            placed, alone_ns = other.time_ns <= end, end - int(times[cut.first - 1])
            beyond = np.flatnonzero(rows >= cut.first)
        else:
            begin = max(map(self._at, others), default=_BEFORE)
            placed, alone_ns = other.time_ns >= begin, int(times[cut.first]) - begin
            beyond = np.flatnonzero(rows < cut.first)[::-1]
        ends = (int((rows[beyond] - one.first < 0).sum()) for one in rest if one.side == cut.side)
        ends = (count if sign > 0 else len(beyond) - count for count in ends)
        part = beyond[: min((count for count in ends if count >= 2 * FEWEST), default=len(beyond))][::sign]
        from_cut = np.abs(times[rows[part]] - times[cut.first - (sign < 0)])
        near = part[from_cut < alone_ns], other.chosen(np.flatnonzero(placed))
        loose = loose if loose is not None and loose.side != cut.side else None
        for frames, seen in (near, (part, other)):  # beside what has its place, then beside all
            if min(len(frames), len(seen.time_ns)) >= FEWEST:
                found = self._lacking(cut, self._view(cut.side).chosen(frames), seen, sign, loose is not None)
                if found is not None:
                    by_ns, too_early_ns = found
                    self._shift(cut, by_ns, sign)
                    if loose is not None:
                        self._shift(loose, too_early_ns, sign)
                    return None
        return cut

    def _lacking(self, cut: Cut, part: View, other: View, sign: int, loose: bool) -> tuple[int, int] | None:
        """What to add to the step of the times at a cut, ns, and to that at a loose one.

        Returns:
            None if the part agrees nowhere.
        """

        def costs(by_ns: NDArray[np.int64]) -> Array:
            return self._costs(cut.side, part, other, sign * by_ns)

        def gains(by_ns: NDArray[np.int64]) -> Array:  # negative; 0 of frames without a partner
            return np.nan_to_num(costs(by_ns) - self._limit)

        usual = median_interval(part.time_ns)
        last, first = self._times[cut.side][[cut.first - 1, cut.first]].tolist()
        least = last + usual - first  # with which the times go on
        as_it_is, *others = gains(np.array([0, least, -2 * usual, 2 * usual]))
        nowhere = np.zeros_like(as_it_is)
        good = np.count_nonzero(as_it_is) > 0.9 * len(as_it_is) and is_better(as_it_is, nowhere)
        if good and not (cut.certain or any(is_better(one, as_it_is) for one in others)):
            return 0, 0
        grid = np.arange(least - _REACH_NS * loose, _REACH_NS, GRID_NS)
        of_grid = gains(grid)
        best = int(np.argmin(of_grid.mean(axis=1)))
        if not is_better(of_grid[best], nowhere):
            return None
        by = int(grid[best]) if is_better(of_grid[best], as_it_is) else 0
        if not cut.certain and abs(by) < usual:
            return 0, 0
        fine = by + _FINE_NS * np.arange(-_FINE, _FINE + 1)
        of_fine = costs(fine)
        always = np.isfinite(of_fine).all(axis=0)
        if always.sum() >= FEWEST:
            means = of_fine[:, always].mean(axis=1)
            k = int(np.argmin(means))
            by = round(fine[k] + _FINE_NS * vertex(-means[max(k - 1, 0) : k + 2]))
        by += self._to_rhythm(cut.side, part.time_ns + sign * by, other, sign)
        least -= usual // 2
        return max(by, least), max(least - by, 0)

    def _to_rhythm(self, side: int, moved: Times, other: View, sign: int) -> int:
        """What to add, so that frames are as far from their partners as in the longest piece."""
        usual = median_interval(moved)
        near = other.time_ns[(other.time_ns > moved[0] - usual) & (other.time_ns < moved[-1] + usual)]
        if len(near) < FEWEST:
            return 0
        skew, known = rhythm(*((near, moved) if side else (moved, near)))
        late = float(np.nan_to_num(skew - self._rhythm[0]))
        if not (known and self._rhythm[1]):
            late = (late + usual / 2) % usual - usual / 2
        return sign * round(-late if side else late)

    def _shift(self, cut: Cut, by_ns: int, sign: int = 1) -> None:
        if by_ns:
            self._moved[cut] = self._moved.get(cut, 0) + by_ns
            part = slice(cut.first, None) if sign > 0 else slice(cut.first)
            self._times[cut.side][part] += sign * by_ns

    def _unsure(self) -> Cut | None:
        """A cut beside which the views are of different moments.

        Between a cut of A and one of B, no frame needs a partner: then both parts after them come later.
        """
        cuts = sorted(self._cuts, key=self._at)
        for before, after in pairwise(cuts):
            if before.side != after.side and (self._is_set(before) or self._is_set(after)):
                apart_ns = self._at(after) - self._at(before)
                if self._differ(before, after):
                    for cut in (before, after):
                        self._shift(cut, apart_ns + median_interval(self._times[0]))
        cuts = [cut for cut in cuts if self._is_set(cut)]
        beside = zip([None, *cuts], [*cuts, None], strict=True)
        return next((before or after for before, after in beside if self._differ(before, after)), None)

    def _is_set(self, cut: Cut) -> bool:
        return cut.certain or cut in self._moved

    def _differ(self, before: Cut | None, after: Cut | None) -> bool:
        """Whether the views are of different moments between two cuts."""
        begin = _BEFORE if before is None else self._at(before)
        a, b = self._within(begin, _AFTER if after is None else self._at(after))
        if min(len(a.time_ns), len(b.time_ns)) < 2:
            return False
        costs = self._costs(0, a, b, np.zeros(1, np.int64))
        return bool(np.isfinite(costs).any() and np.nanmean(costs) > self._limit)
