"""Relates another machine's clock to this one's by requests and replies, as NTP does.

A reply holds when the request arrived and when the reply left, by the other clock: t2 and t3. With t1 and t4
of this clock, when the request left and the reply came, the other clock is ahead by
((t2 − t1) + (t3 − t4)) / 2, wrong by at most half of the round trip (t4 − t1) − (t3 − t2) where one way takes
all of it. (D. Mills, RFC 5905, sec. 8.) The reply whose bound is the smallest now counts.
"""

from __future__ import annotations

_KEPT = 64
_DRIFT = 50e-6
"""How fast the bound of an old reply grows: two quartz clocks drift apart by at most some 50 ppm."""


class RemoteClock:
    """The offset of another machine's clock; bounded memory. One thread adds, others may read meanwhile."""

    def __init__(self) -> None:
        # when, offset, round trip; replaced as a whole, as a deque cannot be read while another thread adds
        self._replies: tuple[tuple[int, int, int], ...] = ()

    def add(self, asked_ns: int, received_ns: int, answered_ns: int, now_ns: int) -> bool:
        """Takes a reply: t1, t2, t3, t4. Returns False for an impossible one, which is ignored."""
        trip_ns = (now_ns - asked_ns) - (answered_ns - received_ns)
        if trip_ns < 0 or answered_ns < received_ns or now_ns < asked_ns:
            return False
        offset_ns = ((received_ns - asked_ns) + (answered_ns - now_ns)) // 2
        self._replies = (*self._replies, (now_ns, offset_ns, trip_ns))[-_KEPT:]
        return True

    @property
    def replies(self) -> int:
        """How many replies the estimate is based on, 64 at most."""
        return len(self._replies)

    def offset_ns(self, now_ns: int) -> int | None:
        """The other clock minus this one; None before the first reply."""
        best = self._best(now_ns)
        return None if best is None else best[1]

    def round_trip_ns(self) -> int | None:
        """The shortest of the recent round trips; None before the first."""
        return min((trip_ns for _, _, trip_ns in self._replies), default=None)

    def bound_ns(self, now_ns: int) -> int | None:
        """Largest error of the offset: half of the round trip, plus the drift since then."""
        best = self._best(now_ns)
        return None if best is None else round(_bound(best, now_ns))

    def _best(self, now_ns: int) -> tuple[int, int, int] | None:
        return min(self._replies, key=lambda reply: _bound(reply, now_ns), default=None)


def _bound(reply: tuple[int, int, int], now_ns: int) -> float:
    at_ns, _, trip_ns = reply
    return trip_ns / 2 + _DRIFT * abs(now_ns - at_ns)
