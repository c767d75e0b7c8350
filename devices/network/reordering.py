"""Puts numbered messages in order. It waits a bounded time for a missing message."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

T = TypeVar("T")

LARGEST_STEP = 10_000
"""A number further from the expected one counts as damaged: that many frames are five minutes."""


@dataclass(frozen=True)
class OrderFigures:
    """Counts of the numbered messages so far.

    Attributes:
        received: Messages that were given on.
        lost: Numbers that never came in time.
        reordered: Messages that came after a later one and were put in their place.
        duplicates: Messages that had come before.
        late: Messages that came after they had been given up; they are among the lost.
        strange: Messages left out because their number was far from the expected one.
    """

    received: int = 0
    lost: int = 0
    reordered: int = 0
    duplicates: int = 0
    late: int = 0
    strange: int = 0

    def __add__(self, other: OrderFigures) -> OrderFigures:
        """The counts of both."""
        return OrderFigures(
            self.received + other.received,
            self.lost + other.lost,
            self.reordered + other.reordered,
            self.duplicates + other.duplicates,
            self.late + other.late,
            self.strange + other.strange,
        )


class ReorderBuffer(Generic[T]):
    """Gives items in the order of their numbers; an item in order is given at once.

    An item whose number is more than ``LARGEST_STEP`` away from the expected one is left out, so that one
    wrong number does not end the sequence. If the next item follows it, the sequence goes on from there.

    Args:
        patience_ns: How long an item waits for an earlier one that is missing.
        most: Most items that wait; beyond it the missing ones are given up.
    """

    def __init__(self, patience_ns: int, most: int = 16) -> None:
        self._patience_ns, self._most = patience_ns, most
        self._waiting: list[tuple[int, int, T]] = []  # number, arrival
        self._next: int | None = None
        self._given_up: set[int] = set()
        self._far: int | None = None
        self.figures = OrderFigures()

    def add(self, number: int, item: T, now_ns: int) -> list[T]:
        """Takes an item and gives those that need not wait, in order."""
        if self._next is None:
            self._next = number
        if abs(number - self._next) > LARGEST_STEP:
            if self._far is None or not 0 < number - self._far <= LARGEST_STEP:
                self._far = number
                self._count(strange=1)
                return self.poll(now_ns)
            given = self._go_on_from(number)
            return given + self.add(number, item, now_ns)
        self._far = None
        if number < self._next:
            if number in self._given_up:
                self._given_up.discard(number)
                self._count(late=1)
            else:
                self._count(duplicates=1)
        elif any(number == other for other, _, _ in self._waiting):
            self._count(duplicates=1)
        else:
            if self._waiting and number < max(other for other, _, _ in self._waiting):
                self._count(reordered=1)
            # The number alone orders the heap: it is unique.
            heapq.heappush(self._waiting, (number, now_ns, item))
        return self.poll(now_ns)

    def poll(self, now_ns: int) -> list[T]:
        """The items that need not wait at ``now_ns``, in order."""
        given: list[T] = []
        while self._waiting:
            assert self._next is not None
            number = self._waiting[0][0]
            if number != self._next:
                first_ns = min(came for _, came, _ in self._waiting)
                if now_ns - first_ns < self._patience_ns and len(self._waiting) <= self._most:
                    break
                self._give_up(self._next, number)
            given.append(heapq.heappop(self._waiting)[2])
            self._next = number + 1
            self._count(received=1)
        return given

    @property
    def due_ns(self) -> int | None:
        """When :meth:`poll` gives an item that waits now; None if none waits."""
        first_ns = min((came for _, came, _ in self._waiting), default=None)
        return None if first_ns is None else first_ns + self._patience_ns

    def _go_on_from(self, number: int) -> list[T]:
        """Gives all that wait and expects ``number`` next; a step back loses nothing."""
        given = []
        while self._waiting:
            waiting, _, item = heapq.heappop(self._waiting)
            given.append(item)
            self._next = waiting + 1
            self._count(received=1)
        assert self._next is not None
        self._count(lost=max(0, number - self._next))
        self._given_up.clear()
        self._next = number
        return given

    def _give_up(self, first: int, end: int) -> None:
        self._count(lost=end - first)
        # Only the newest are remembered: a message that late is rare, and memory is bounded.
        self._given_up = {number for number in self._given_up if number > end - 1024}
        self._given_up.update(range(max(first, end - 256), end))

    def _count(self, **more: int) -> None:
        now = {name: getattr(self.figures, name) + by for name, by in more.items()}
        self.figures = replace(self.figures, **now)
