"""A sensor at another PC, where ``duplex sensor`` publishes its skeletons over Zenoh."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

from devices.network.messages import ForeignError, MalformedError, decode_sensor
from devices.network.remote_stream import RemoteStream
from devices.network.zenoh_session import (
    LARGEST_MESSAGE,
    ZenohAddresses,
    checked_key,
    load_zenoh,
    zenoh_session,
)
from devices.sensor import AbsentError, DeviceError, LinkFigures, Sensor, SensorFrame

PREFIX = "zenoh:"
FRAMES, SENSOR, CLOCK = "frames", "sensor", "clock"
"""What is under a sensor's key: its frames (published), its description and its clock (asked for)."""

_INBOX = 64  # messages: two seconds of frames
_ASK_NS = 500_000_000
_SILENT_NS = 1_500_000_000
_REPORT_NS = 10_000_000_000
_FIRST_REPLIES, _REPLIES_S = 4, 1.0
_AGAIN_S = 2.0  # a peer that lost its connection tries again after a second at the latest
_POLL_NS = 50_000_000
_POLL_S, _ANSWER_S = _POLL_NS * 1e-9, 0.5


class RemoteSensor(Sensor):
    """Gives the frames that arrive under a key; their ``host_ns`` is on this machine's clock.

    A program that is killed or started anew raises ``AbsentError``, so that the thread that runs this sensor
    takes it back when it returns.

    Args:
        key: The key of ``duplex sensor --publish``.
        appear_s: How long opening waits for it, seconds; later openings wait 2 s.

    Attributes:
        waits_for: What opening waits for, or what comes instead of frames; else empty.
        body, intrinsics, interval_ns: As it described itself; known once it has been open.
    """

    interval_ns: int

    def __init__(
        self,
        key: str,
        addresses: ZenohAddresses,
        *,
        appear_s: float = 30.0,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self.name = PREFIX + checked_key(key)
        self.warnings: list[str] = []
        self.waits_for = ""
        self._key, self._addresses, self._clock = key, addresses, clock
        self._appear_s = appear_s
        self._described = False
        self._stream = RemoteStream()
        self._reports = _LossReports(self.name)
        self._told: deque[str] = deque(maxlen=20)
        # Beyond its length the oldest are dropped; the sequence numbers show what is missing.
        self._inbox: deque[tuple[str, bytes, int]] = deque(maxlen=_INBOX)
        self._arrival, self._interrupted = threading.Event(), threading.Event()
        self._stack = ExitStack()
        self._session: Any = None

    @property
    def missed(self) -> int:  # type: ignore[override]
        """Frames that never arrived, arrived too late, or that this program was too slow for."""
        return self._stream.figures.lost

    @property
    def link(self) -> LinkFigures:  # type: ignore[override]
        """How its messages arrive."""
        return self._stream.figures

    def take_news(self) -> list[str]:
        return [self._told.popleft() for _ in range(len(self._told))]

    def __enter__(self) -> RemoteSensor:
        """Waits for the sensor's program and relates its clock to this machine's.

        Raises:
            AbsentError: It is not there, or of another version.
            DeviceError: Zenoh is missing or an address is busy, or it reports another body than before.
        """
        self.__exit__()
        self._interrupted.clear()
        self._inbox.clear()
        try:
            self._session = self._stack.enter_context(zenoh_session(self._addresses))
            self._describe()
            key = f"{self._key}/{FRAMES}"
            self._stack.enter_context(
                self._session.declare_subscriber(key, lambda sample: self._take(FRAMES, sample.payload))
            )
            self._relate_clocks()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.waits_for = ""
        self._session = None
        self._stack.close()

    def interrupt(self) -> None:
        self._interrupted.set()
        self._arrival.set()

    def frames(self) -> Iterator[SensorFrame]:
        """The frames in order, until interrupted.

        Raises:
            AbsentError: Nothing arrives any more, or the program was started anew.
        """
        asked_ns = before_ns = self._clock()
        silent_ns = 0
        doubled_told = False
        while not self._interrupted.is_set():
            for part, data, arrived_ns in self._arrived(_POLL_S):
                if part == CLOCK:
                    heard = self._stream.clock_reply(data, arrived_ns)
                else:
                    frame = self._stream.receive(data, arrived_ns)
                    heard = frame is not None
                    if frame is not None:
                        yield frame
                # What is not understood is no silence: the reason is told once, as what it waits for.
                foreign = self._stream.foreign
                self.waits_for = f"frames that it understands: it gets {foreign}" if foreign else ""
                silent_ns = 0 if heard or foreign else silent_ns
            now_ns = self._clock()
            # A pause of this thread or of the whole program is no silence of the other one.
            silent_ns += min(now_ns - before_ns, 2 * _POLL_NS)
            before_ns = now_ns
            if self._stream.restarted(now_ns):
                raise AbsentError(f"{self.name} was started anew.")
            if silent_ns > _SILENT_NS:
                raise AbsentError(
                    f"{self.name} is silent for {_SILENT_NS * 1e-9:g} s: its program, its PC or the network "
                    f"is down."
                )
            if self._stream.doubled and not doubled_told:
                doubled_told = True
                self._told.append(
                    f"{self.name}: two programs publish under {self._key!r}; one of them is left out. Give "
                    f"each sensor its own key."
                )
            if now_ns - asked_ns > (_ASK_NS // 5 if self._stream.strange else _ASK_NS):
                asked_ns = now_ns
                self._stream.strange = False
                self._ask_clock()
            told = self._reports.observe(self._stream.figures, now_ns)
            self._told += [] if self._stream.foreign else told

    def _arrived(self, wait_s: float) -> list[tuple[str, bytes, int]]:
        """Waits for messages and returns those that have come: kind, content, and time of arrival."""
        self._arrival.wait(wait_s)
        self._arrival.clear()
        return [self._inbox.popleft() for _ in range(len(self._inbox))]

    def _take(self, part: str, payload: Any) -> None:
        """Takes a message on a thread of Zenoh: does little, never blocks, bounded memory."""
        data = payload.to_bytes() if len(payload) <= LARGEST_MESSAGE else b""  # counted as malformed
        self._inbox.append((part, data, self._clock()))
        self._arrival.set()

    def _describe(self) -> None:
        """Waits for the description; after the first opening only as long as a peer needs to connect."""
        self.waits_for = f"duplex sensor --publish {self._key}"
        until_s = time.monotonic() + (_AGAIN_S if self._described else self._appear_s)
        fault = ""
        while True:
            for reply in self._session.get(f"{self._key}/{SENSOR}", timeout=_ANSWER_S):
                if reply.ok is None:
                    continue
                try:
                    described = decode_sensor(reply.ok.payload.to_bytes()[:LARGEST_MESSAGE])
                except ForeignError as foreign:
                    raise AbsentError(f"{self.name} sends {foreign}.") from foreign
                except MalformedError as malformed:
                    fault = f" Its answer was not understood: {malformed}"
                    continue
                if self._described and described.body is not self.body:
                    raise DeviceError(
                        f"{self.name} reports {described.body.name} now and reported "
                        f"{self.body.name} before. End duplex live and start it again."
                    )
                self._described, self.body = True, described.body
                self.intrinsics, self.interval_ns = described.intrinsics, described.interval_ns
                self._stream.begin(described)
                self.waits_for = ""
                return
            if self._interrupted.is_set() or time.monotonic() >= until_s:
                where = ", ".join((*self._addresses.listen, *self._addresses.connect))
                raise AbsentError(
                    f"Nobody publishes {self._key!r} at {where}. Start duplex sensor --publish "
                    f"{self._key} on the PC of the sensor, and check the address and the firewall.{fault}"
                )
            self._interrupted.wait(0.1)

    def _relate_clocks(self) -> None:
        """Asks for the clock until a few replies have come; leaves out frames that arrive meanwhile."""
        until_s = time.monotonic() + _REPLIES_S
        while self._stream.replies < _FIRST_REPLIES and time.monotonic() < until_s:
            replies, next_s = self._stream.replies, time.monotonic() + _POLL_S
            self._ask_clock()
            while self._stream.replies == replies and (left_s := next_s - time.monotonic()) > 0.0:
                for part, data, arrived_ns in self._arrived(left_s):
                    if part == CLOCK:
                        self._stream.clock_reply(data, arrived_ns)
                if self._interrupted.is_set():
                    return

    def _ask_clock(self) -> None:
        def take(reply: Any) -> None:
            if reply.ok is not None:
                self._take(CLOCK, reply.ok.payload)

        zenoh = load_zenoh()
        request = self._stream.clock_request(self._clock())
        self._session.get(
            f"{self._key}/{CLOCK}",
            take,
            payload=request,
            timeout=_ANSWER_S,
            # Else Zenoh gives one reply of two programs that publish under the same key.
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )


class _LossReports:
    """Sentences about losses and damaged messages of a sensor, at most every ten seconds."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._since_ns: int | None = None
        self._told = LinkFigures()
        self._sound = True

    def observe(self, figures: LinkFigures, now_ns: int) -> list[str]:
        """The sentences to report now."""
        if self._since_ns is None:
            self._since_ns, self._told = now_ns, figures
            return []
        if now_ns - self._since_ns < _REPORT_NS:
            return []
        before, self._told, self._since_ns = self._told, figures, now_ns
        lost, came = figures.lost - before.lost, figures.received - before.received
        malformed = figures.malformed - before.malformed
        said = []
        if lost:
            said.append(
                f"{self._name}: frames lost or late on their way in the last 10 s: {lost} of {lost + came}. "
                f"Check the network between the two PCs; a cable is better than Wi-Fi."
            )
        elif not self._sound and came:
            said.append(f"{self._name}: all frames of the last 10 s arrived.")
        if malformed:
            said.append(
                f"{self._name}: {malformed} damaged or unknown messages were left out. Do both PCs run the "
                f"same version of duplex?"
            )
        self._sound = lost == 0
        return said
