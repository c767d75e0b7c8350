"""Messages of a remote sensor → its frames: in order, on this machine's clock, counted.

Pure: time is passed in, nothing waits.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from devices.network.messages import (
    ClockMessage,
    MalformedError,
    SensorMessage,
    decode_clock,
    decode_frame,
    encode_clock,
)
from devices.network.remote_clock import RemoteClock
from devices.network.reordering import OrderFigures, ReorderBuffer
from devices.sensor import LinkFigures, SensorFrame

PATIENCE_NS = 40_000_000
"""How long a frame waits for an earlier one: longer than one frame, shorter than for its partner."""
_ASKED = 64
"""Requests whose replies are still known: more than are sent while Zenoh waits for a reply."""
_SETTLED_NS = 100_000_000
"""How long after another run's reply the followed run may still answer, before it counts as ended."""


class RemoteStream:
    """The frames of one remote sensor, over all runs of the program that publishes them.

    Args:
        patience_ns: How long a frame waits for an earlier one that is missing.

    Attributes:
        restarted: Whether a reply came from another run of the program than the current one.
        doubled: How many requests were answered by two programs: both publish under this key.
        strange: Whether a frame came from another run, so that a clock request is useful now.
    """

    def __init__(self, patience_ns: int = PATIENCE_NS) -> None:
        self._patience_ns = patience_ns
        self._session: int | None = None
        self._past = OrderFigures()
        self._order: ReorderBuffer[SensorFrame] = ReorderBuffer(patience_ns)
        self._clock = RemoteClock()
        self._asked: deque[int] = deque(maxlen=_ASKED)
        self._answered: deque[tuple[int, int]] = deque(maxlen=_ASKED)  # request, session
        self._malformed = self._restarts = 0
        self._now_ns = 0
        self._other_since_ns: int | None = None
        self.doubled = 0
        self.strange = False

    @property
    def figures(self) -> LinkFigures:
        """Counts over all runs, and the present relation of the clocks."""
        order = self._past + self._order.figures
        return LinkFigures(
            order.received,
            order.lost,
            order.reordered,
            order.duplicates,
            self._malformed + order.strange,
            self._restarts,
            self._clock.round_trip_ns(),
            self._clock.bound_ns(self._now_ns),
        )

    @property
    def restarted(self) -> bool:
        """Whether another run of the program replies, and the current one does not."""
        since_ns = self._other_since_ns
        return since_ns is not None and self._now_ns - since_ns >= _SETTLED_NS

    @property
    def replies(self) -> int:
        """How many clock replies the relation of the clocks is based on."""
        return self._clock.replies

    @property
    def due_ns(self) -> int | None:
        """When :meth:`poll` gives a frame that waits now; None if none waits."""
        return self._order.due_ns

    def begin(self, sensor: SensorMessage) -> None:
        """Follows the run that described itself so; another run than before counts as a restart."""
        if self._session is not None and sensor.session != self._session:
            self._restarts += 1
        if sensor.session != self._session:
            self._past += self._order.figures
            self._order = ReorderBuffer(self._patience_ns)
            self._clock = RemoteClock()
        self._session = sensor.session
        self._other_since_ns = None
        self.strange = False

    def receive(self, data: bytes, now_ns: int) -> list[SensorFrame]:
        """Takes a frame message that arrived at ``now_ns``; gives the frames that need not wait, in order."""
        self._now_ns = now_ns
        try:
            message = decode_frame(data)
        except MalformedError:
            self._malformed += 1
            return self.poll(now_ns)
        if message.session != self._session:
            self.strange = True  # of a past run, or of a new one: a reply will tell
            return self.poll(now_ns)
        frame = message.frame
        offset_ns = self._clock.offset_ns(now_ns)
        captured_ns = frame.host_ns or message.sent_ns
        host_ns = now_ns if offset_ns is None else min(captured_ns - offset_ns, now_ns)
        return self._order.add(message.sequence, replace(frame, host_ns=host_ns), now_ns)

    def poll(self, now_ns: int) -> list[SensorFrame]:
        """The frames that need not wait any longer at ``now_ns``, in order."""
        self._now_ns = now_ns
        return self._order.poll(now_ns)

    def clock_request(self, now_ns: int) -> bytes:
        """A request for the other machine's time, to be sent now."""
        self._asked.append(now_ns)
        return encode_clock(ClockMessage(0, now_ns))

    def clock_reply(self, data: bytes, now_ns: int) -> bool:
        """Takes a reply that arrived at ``now_ns``; returns whether it is one of the current run."""
        self._now_ns = now_ns
        try:
            reply = decode_clock(data)
        except MalformedError:
            self._malformed += 1
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
