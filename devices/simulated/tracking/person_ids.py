"""The ids that a body tracker gives to people."""

from collections.abc import Sequence

from devices.simulated.streams import Streams
from fusion.skeleton import Skeleton

PERSON, OTHER = "1", "2"
"""The tracker's ids of the person and of the other one, until it exchanges or loses them."""


class PersonIds:
    """The ids that a tracker gives to people.

    Of two, one who was out of sight comes back under a new id, or under that of the other one.
    """

    def __init__(self, streams: Streams, exchanged: float) -> None:
        self._random, self._exchanged = streams.named("ids"), exchanged
        self._taken = 0.5 if exchanged > 0.0 else 0.0
        self._ids, self._count, self._lost = [PERSON, OTHER], 2, [False, False]

    def of(self, skeletons: Sequence[Skeleton | None]) -> dict[str, Skeleton]:
        """The people of the next frame."""
        if len(skeletons) > 1 and self._random.random() < self._exchanged:
            self._ids.reverse()
        people = {}
        for k, skeleton in enumerate(skeletons):
            if skeleton is not None and self._lost[k] and len(skeletons) > 1:
                self._count += 1
                self._ids[k] = str(self._count)
                if self._random.random() < self._taken:
                    self._ids.reverse()
            self._lost[k] = skeleton is None
            if skeleton is not None:
                people[self._ids[k]] = skeleton
        return dict(sorted(people.items()))
