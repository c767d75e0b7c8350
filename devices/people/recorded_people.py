"""The people of a recording, and which of them to fuse by id."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from devices.sensor import CableSync, DeviceError, Orientation, SensorFrame
from fusion.body import Body
from fusion.intrinsics import Intrinsics
from fusion.pair_arrays import View, view_of
from fusion.skeleton import Skeleton
from fusion.support.large_arrays import Rows

Follow = Literal["middle", "longest"]
"""Whom to follow of several people: the one nearest the middle of the views, or the one seen longest."""


@dataclass(frozen=True, eq=False, repr=False)
class RecordedPeople(Rows[SensorFrame]):
    """The frames of a recording without images, as arrays; each frame is made when it is asked for."""

    body: Body
    time_ns: NDArray[np.int64]  # (T,) the frames' times, in order
    ids: Sequence[str]  # the tracker's ids of the people
    frame: NDArray[np.int64]  # (N,) of each skeleton: number of its frame, in order
    person: NDArray[np.int64]  # (N,) index of its id
    skeletons: View  # N rows
    sets: Sequence[int] = ()  # times of the first frames after the clock was set

    @staticmethod
    def of(body: Body, frames: Iterable[SensorFrame]) -> RecordedPeople:
        """Frames in the order of time; their images are not kept."""
        numbers: dict[str, int] = {}
        times: list[int] = []
        people: list[tuple[int, int]] = []

        def skeletons() -> Iterator[Skeleton]:
            for number, frame in enumerate(frames):
                times.append(frame.time_ns)
                for name, skeleton in frame.people.items():
                    people.append((number, numbers.setdefault(name, len(numbers))))
                    yield skeleton

        seen = view_of(body, skeletons())
        frame, person = np.array(people, dtype=np.int64).reshape(-1, 2).T
        return RecordedPeople(body, np.array(times, dtype=np.int64), list(numbers), frame, person, seen)

    def __len__(self) -> int:
        return len(self.time_ns)

    def row(self, k: int) -> SensorFrame:
        first, end = np.searchsorted(self.frame, (k, k + 1)).tolist()
        people = {self.ids[self.person[i]]: self.skeletons.row(self.body, i) for i in range(first, end)}
        return SensorFrame(int(self.time_ns[k]), people)

    @property
    def crowded(self) -> bool:
        """Whether a frame has several people."""
        return bool((self.frame[1:] == self.frame[:-1]).any())

    def at(self, time_ns: NDArray[np.int64]) -> RecordedPeople:
        """The same at other times of the frames, (T,) in order."""
        skeletons = self.skeletons._replace(time_ns=time_ns[self.frame])
        return replace(self, time_ns=time_ns, skeletons=skeletons)

    def without(self, rows: NDArray[np.int64]) -> RecordedPeople | None:
        """The people whose skeletons are not these; None if there are none."""
        left = np.ones(len(self.frame), dtype=np.bool_)
        left[rows] = False
        rest = np.flatnonzero(left)
        if not len(rest):
            return None
        skeletons = self.skeletons.chosen_whole(rest)
        return replace(self, frame=self.frame[rest], person=self.person[rest], skeletons=skeletons)

    def rows_of(self, names: Sequence[str]) -> NDArray[np.int64]:
        """The skeletons that have these ids."""
        return np.flatnonzero(np.isin(self.person, [self.ids.index(name) for name in names]))

    def view(self, names: Sequence[str]) -> View:
        """The frames with one person, who has these ids one after the other."""
        return self.view_of(self.rows_of(names))

    def view_of(self, rows: NDArray[np.int64]) -> View:
        """The frames with one person, whose skeletons are these, at most one in a frame."""
        index = np.full(len(self), -1, dtype=np.int64)
        index[self.frame[rows]] = rows
        if len(rows) == len(self) == len(self.frame):
            return self.skeletons._replace(time_ns=self.time_ns)
        return self.skeletons.chosen_whole(index)._replace(time_ns=self.time_ns)

    def choose_person(self, wanted: str | None, source: str, flag: str) -> str:
        """The id of the person to follow: the one wanted, else the one seen in most frames.

        Raises:
            DeviceError: No one is in the recording, or not the person wanted.
        """
        counts = np.bincount(self.person, minlength=len(self.ids)).tolist()
        seen = Counter(dict(zip(self.ids, counts, strict=True)))
        if not seen:
            raise DeviceError(f"{source} has {len(self)} frames and no person in any of them.")
        if wanted is None:
            return max(seen, key=lambda person: (seen[person], person))
        if wanted not in seen:
            raise DeviceError(
                f"{source} has no person {wanted!r}. It has "
                f"{', '.join(f'{person!r} ({n} frames)' for person, n in seen.most_common(8))}; "
                f"choose one with {flag}."
            )
        return wanted


@dataclass(frozen=True, eq=False)
class OneRecording:
    """One recording without images, and the person to fuse."""

    name: str
    people: RecordedPeople
    sync: CableSync | None
    warnings: list[str]
    arrivals: NDArray[np.int64]
    """(T, 2) capture and arrival times, where they were recorded."""
    person: View
    wanted: str | None
    """Id of the person that the user chose."""
    option: str
    """What the user knows that choice as, for messages."""
    intrinsics: Intrinsics | None = None
    orientation: Orientation = 0
    others: RecordedPeople | None = None  # who are not followed

    @property
    def seen(self) -> View:
        """The frames in which the person is seen."""
        seen = self.person.states.any(axis=1)
        return self.person if seen.all() else self.person.chosen_whole(np.flatnonzero(seen))


@dataclass(frozen=True)
class SeenPerson:
    """One of several people in two recordings.

    Attributes:
        ids: In A and in B: the id that chooses this person; None if there is none.
        seconds: How long each sensor sees them.
    """

    ids: tuple[str | None, str | None]
    seconds: tuple[float, float]
