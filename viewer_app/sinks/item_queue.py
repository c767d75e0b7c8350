"""A queue between the loop and one thread, with a policy for what does not fit."""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from devices.events import Event
from fusion.fused_frame import FusedFrame
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.data.session_arrays import SessionFrame

_KEPT_OTHERS = 256
"""Maximum number of queued items besides frames; events are rare."""


@dataclass(frozen=True, eq=False)
class QueuedFrame:
    """A frame in a queue."""

    number: int  # from 0, of the frames that the loop made
    frame: SessionFrame
    time_ns: int  # since the first frame
    written_ns: int  # when the loop had it, on the sink's clock

    @property
    def fused(self) -> FusedFrame:
        """S*."""
        return self.frame.fused


Item = QueuedFrame | Event | FusionSetup | CoachPage
T = TypeVar("T")
Policy = Callable[[deque[T], T], T | None]
"""Makes room among the queued items for another one; returns what is queued for it, None for nothing."""


class DropOldest:
    """The policy that drops the oldest frame where `keep` are queued, and counts these.

    Of events, setups and pages the newest 256 are kept.
    """

    def __init__(self, keep: int) -> None:
        self._keep, self.dropped = keep, 0

    def __call__(self, queued: deque[Item], item: Item) -> Item:
        is_frame = isinstance(item, QueuedFrame)
        most = self._keep if is_frame else _KEPT_OTHERS
        if len(queued) >= most:
            alike = [k for k, other in enumerate(queued) if isinstance(other, QueuedFrame) is is_frame]
            if len(alike) >= most:
                del queued[alike[0]]
                self.dropped += is_frame
        return item


class ItemQueue(Generic[T]):
    """Takes items from any thread, without waiting, until it is ended; one thread takes them out.

    Attributes:
        changed: Its lock, which the policy is called with.
        ended: Whether no more items are taken; what is queued can still be taken out.
    """

    def __init__(self, policy: Policy[T]) -> None:
        self._policy, self._items = policy, deque[T]()
        self.changed, self.ended = threading.Condition(), False

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[T]:
        return iter(self._items)

    def put(self, item: T) -> None:
        """Queues an item as the policy wants; once ended, the policy only learns of it."""
        with self.changed:
            admitted = self._policy(self._items, item)
            if admitted is not None and not self.ended:
                self._items.append(admitted)
                self.changed.notify()

    def take(self, seconds: float | None, most: int | None = None) -> list[T]:
        """Takes out the queued items, at most `most`; waits so long for the first one or the end."""
        with self.changed:
            self.changed.wait_for(lambda: self._items or self.ended, seconds)
            count = len(self) if most is None else min(most, len(self))
            return [self._items.popleft() for _ in range(count)]

    def end(self) -> None:
        """Takes no more items, and wakes the thread."""
        with self.changed:
            self.ended = True
            self.changed.notify_all()

    def has_time(self, seconds: float) -> bool:
        """Waits so long, or until it is ended; whether it was not ended before."""
        ended = self.ended
        self.wait_for_end(seconds)
        return not ended

    def wait_for_end(self, seconds: float) -> bool:
        """Waits until it is ended, at most so long; whether it is."""
        with self.changed:
            return self.changed.wait_for(lambda: self.ended, seconds)
