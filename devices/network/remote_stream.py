"""Messages of a remote sensor → its frames on this machine's clock, counted. Pure: time is passed in.

Zenoh gives each message of a publisher at most once and in order, over TCP and over UDP; it leaves out a
datagram that was overtaken. What is missing shows in the sequence numbers.

The clocks are related by requests and replies, as NTP does. A reply holds when the request arrived and when
the reply left, by the other clock: t2 and t3. With t1 and t4 of this clock, when the request left and the
reply came, the other clock is ahead by ((t2 − t1) + (t3 − t4)) / 2, wrong by at most half of the round trip
(t4 − t1) − (t3 − t2) where one way takes all of it. (D. Mills, RFC 5905, sec. 8.) The reply whose bound is
the smallest now counts.
"""

from collections import deque
from dataclasses import replace

from devices.network.messages import (
    ClockMessage,
    ForeignError,
    MalformedError,
    SensorMessage,
    decode_clock,
    decode_frame,
    encode_clock,
)
from devices.sensor import LinkFigures, SensorFrame

_KEPT = 64
_DRIFT = 100e-6
"""How fast the bound of an old reply grows: each of the two quartz clocks is off by at most some 50 ppm."""
_ASKED = 64
"""Requests whose replies are still known: more than are sent while Zenoh waits for a reply."""
_SETTLED_NS = 100_000_000
"""How long after another run's reply the followed run may still answer, before it counts as ended."""


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


class RemoteStream:
    """The frames of one remote sensor, over all runs of the program that publishes them.

    Attributes:
        doubled: How many requests were answered by two programs: both publish under this key.
        strange: Whether a frame came from another run, so that a clock request is useful now.
        foreign: What comes instead of frames of this version and of the body described; empty if nothing
            does.
    """

    def __init__(self) -> None:
        self._session: int | None = None
        self._expected: int | None = None  # number of the next frame
        self._clock = RemoteClock()
        self._asked: deque[int] = deque(maxlen=_ASKED)
        self._answered: deque[tuple[int, int]] = deque(maxlen=_ASKED)  # request, session
        self._received = self._lost = self._malformed = self._restarts = 0
        self._now_ns = 0
        self._other_since_ns: int | None = None
        self.doubled = 0
        self.strange = False
        self.foreign = ""

    @property
    def figures(self) -> LinkFigures:
        """Counts over all runs, and the present relation of the clocks."""
        clock = self._clock
        return LinkFigures(
            self._received,
            self._lost,
            self._malformed,
            self._restarts,
            clock.round_trip_ns(),
            clock.bound_ns(self._now_ns),
        )

    @property
    def replies(self) -> int:
        """How many clock replies the relation of the clocks is based on."""
        return self._clock.replies

    def restarted(self, now_ns: int) -> bool:
        """Whether another run of the program replies, and the current one does not."""
        return self._other_since_ns is not None and now_ns - self._other_since_ns >= _SETTLED_NS

    def begin(self, sensor: SensorMessage) -> None:
        """Follows the run that described itself so; another run than before counts as a restart."""
        if sensor.session != self._session:
            self._restarts += self._session is not None
            self._expected, self._clock = None, RemoteClock()
        self._session, self._body = sensor.session, sensor.body
        self._other_since_ns = None
        self.strange, self.foreign = False, ""

    def receive(self, data: bytes, now_ns: int) -> SensorFrame | None:
        """Takes a message that arrived at ``now_ns``; None if it is no frame of the current run."""
        self._now_ns = now_ns
        try:
            message = decode_frame(data, self._body)
        except MalformedError as fault:
            self._refuse(fault)
            return None
        if message.session != self._session:
            self.strange = True  # of a past run, or of a new one: a reply will tell
            return None
        if self._expected is not None:
            self._lost += max(0, message.sequence - self._expected)
        self._expected, self.foreign = message.sequence + 1, ""
        self._received += 1
        offset_ns = self._clock.offset_ns(now_ns)
        captured_ns = message.frame.host_ns or message.sent_ns
        host_ns = now_ns if offset_ns is None else min(captured_ns - offset_ns, now_ns)
        return replace(message.frame, host_ns=host_ns)

    def clock_request(self, now_ns: int) -> bytes:
        """A request for the other machine's time, to be sent now."""
        self._asked.append(now_ns)
        return encode_clock(ClockMessage(0, now_ns))

    def clock_reply(self, data: bytes, now_ns: int) -> bool:
        """Takes a reply that arrived at ``now_ns``; returns whether it is one of the current run."""
        self._now_ns = now_ns
        try:
            reply = decode_clock(data)
        except MalformedError as fault:
            self._refuse(fault)
            return False
        sessions = {session for asked_ns, session in self._answered if asked_ns == reply.asked_ns}
        if reply.asked_ns not in self._asked or reply.session in sessions:
            self._malformed += 1
            return False
        self._answered.append((reply.asked_ns, reply.session))
        self.doubled += bool(sessions)
        if reply.session != self._session:
            # Where the current run has answered the same request, it goes on: the key is used twice.
            if self._other_since_ns is None and self._session not in sessions:
                self._other_since_ns = now_ns
            return False
        self._other_since_ns = None
        return self._clock.add(reply.asked_ns, reply.received_ns, reply.answered_ns, now_ns)

    def _refuse(self, fault: MalformedError) -> None:
        self._malformed += 1
        if isinstance(fault, ForeignError):
            self.foreign = str(fault)
