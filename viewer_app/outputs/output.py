"""The base of all outputs: a bounded queue and a thread, so that no receiver holds up the loop."""

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from fusion.fused_frame import FusedFrame
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from viewer_app.errors import UsageError
from viewer_app.flags import in_flags
from viewer_app.outputs.even_samples import EvenSamples
from viewer_app.sinks.item_queue import DropOldest, Item, ItemQueue, QueuedFrame
from viewer_app.sinks.queued_sink import QueuedSink
from viewer_app.sinks.requested_files import Requests

LATE_NS = 33_333_333
"""A frame that is sent later than this after its fusion is late: the next one is there already."""
_SILENT_S = 1.0  # without a frame, after which receivers are told
_LEFT_NS = 500_000_000  # without a person, after which they have left
_HALF_TRUSTED = 0.05  # metres of standard deviation
_PREDICTED = 0.25  # confidence of a joint without data, for methods without standard deviations


@dataclass(frozen=True)
class OutputCounts:
    """Counts of an output."""

    sent: int = 0  # frames handed to the network; to each receiver, if the output knows its receivers
    dropped: int = 0  # frames that were not sent, because a newer one was there or the network refused them
    late: int = 0  # frames that were sent more than 33 ms after their fusion


class _Presence:
    """Whether the person is there, from one frame to the next."""

    def __init__(self) -> None:
        self._seen_ns: int | None = None
        self._left = False

    def news(self, frame: QueuedFrame) -> Event | None:
        """That the person has left or is there again, at the frame's time."""
        text = ""
        if frame.fused.has_person:
            text, self._left, self._seen_ns = "person returned" if self._left else "", False, frame.time_ns
        elif self._seen_ns is not None and frame.time_ns - self._seen_ns >= _LEFT_NS and not self._left:
            text, self._left = "person left", True
        return Event(text, topic="person", time_ns=frame.time_ns) if text else None


class LiveOutput(QueuedSink):
    """Sends frames on a thread of its own. When the queue is full, the oldest frame is dropped.

    A subclass opens its socket, then calls :meth:`start`. Its ``send_…`` methods run on the thread.

    Args:
        name: Name for messages, with the receiver: ``VMC to 127.0.0.1:39539``.
        keep: Length of the queue. 1 for receivers that show the newest pose, more for those that record.
        clock: Returns ns; tests inject their own.

    Attributes:
        failure: Why it stopped before the end; None if it did not.
        page: Address of a web page that shows it; empty for none.
        note: What the user should know about it before it starts.
        warning: What the user should know about it at the end.
        even: Sends S* at a constant rate; None: once per frame. Set it before the first frame.
        keeps: Whether it is a file, so that the command fails where it does.
        requests: Who may ask there for session files; None for nobody.
        closes_within: Seconds in which it sends what is queued at its end; None: as long as that takes.
    """

    even: EvenSamples | None = None
    keeps = False
    requests: Requests | None = None
    closes_within: float | None = 2.0

    def __init__(self, name: str, keep: int = 1, clock: Callable[[], int] = time.perf_counter_ns) -> None:
        self._drop_oldest = DropOldest(keep)
        super().__init__(ItemQueue(self._drop_oldest), clock)
        thread_name = f"output {name.partition(' ')[0].lower()}"
        self._thread = threading.Thread(target=self._run, name=thread_name, daemon=True)
        self.name = name
        self.failure: str | None = None
        self.page = self.note = self.warning = ""
        self._closed = False
        self._sent = self._late = self._not_sent = 0
        self._presence = _Presence()
        self._newest: QueuedFrame | None = None  # since which there was no silence
        self._newest_ns = 0  # on the clock

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    @property
    def counts(self) -> OutputCounts:
        """The counts so far."""
        return OutputCounts(self._sent, self._drop_oldest.dropped + self._not_sent, self._late)

    def figures(self) -> dict[str, object]:
        """Where it sent and its counts, as plain data for a report."""
        return {"to": self.name, **asdict(self.counts)}

    def recalibrated(self, setup: FusionSetup) -> None:
        """Takes the setup of the following frames, which is an event, too."""
        super().recalibrated(setup)
        self.event(Event("calibration changed", topic="calibration"))

    def allow_requests(self) -> None:
        """Lets its page ask for session files, if it has one; before it is announced."""

    def coach(self, page: CoachPage) -> None:
        """Has no effect: outputs do not show the coach's page."""

    def close(self) -> None:
        """Sends what is queued, then closes. Closing twice has no effect."""
        if self._closed:
            return
        self._closed = True
        self._queue.end()
        if self._thread.is_alive():
            self._thread.join(self.closes_within)
        self.shut()

    def send_frame(self, frame: QueuedFrame) -> int | None:
        """Sends a frame on the output's thread.

        Returns:
            Number of receivers; 0 if the network refused it, None if there is no receiver.

        Raises:
            OSError: It could not be sent; it counts as dropped.
        """
        raise NotImplementedError

    def send_silence(self, time_ns: int) -> None:
        """Says on the output's thread that no frames come any more; the next frame ends it.

        Args:
            time_ns: Since the first frame.
        """

    def send_event(self, event: Event) -> None:
        """Sends an event on the output's thread."""

    def send_setup(self, setup: FusionSetup) -> None:
        """Sends the setup of the following frames on the output's thread."""

    def shut(self) -> None:
        """Releases sockets, after the thread's end."""

    def _run(self) -> None:
        try:
            while True:
                wait_s = None if self._newest is None else _SILENT_S
                if self.even is not None and (due_s := self.even.wait_s(self._clock())) is not None:
                    wait_s = due_s
                items: Sequence[Item] = self._queue.take(wait_s, most=1)
                if not items and self._queue.ended:
                    self._end_frames("")
                    break
                self._look_for_silence(items)
                if self.even is not None:
                    items = self.even.passed_on(items, self._clock())
                for item in items:
                    self._send(item)
        except Exception as fault:  # an output must not end the session
            said = str(fault) if isinstance(fault, UsageError) else f"{type(fault).__name__}: {fault}"
            self.failure = said if self.keeps else f"{self.name} stopped: {said}"
            self._queue.end()
            self._unsent(sum(isinstance(item, QueuedFrame) for item in self._queue.take(0.0)))

    def _look_for_silence(self, items: Sequence[Item]) -> None:
        now_ns = self._clock()
        for item in items:
            if isinstance(item, QueuedFrame):
                self._newest, self._newest_ns = item, now_ns
        if now_ns - self._newest_ns >= 1e9 * _SILENT_S:
            self._end_frames(f"no frames for {_SILENT_S:g} s")

    def _end_frames(self, text: str) -> None:
        """Tells receivers that no frames come, once, with a warning if there is a text."""
        last, self._newest = self._newest, None
        if last is None:
            return
        time_ns = last.time_ns + self._clock() - self._newest_ns
        with suppress(OSError):  # as of a frame, but it is none that counts
            self.send_silence(time_ns)
        if text:
            self._send(Event(text, "WARN", "frames", time_ns=time_ns))

    def _send(self, item: Item) -> None:
        try:
            match item:
                case QueuedFrame():
                    if (news := self._presence.news(item)) is not None:
                        self.send_event(news)
                    self._count(self.send_frame(item), item.written_ns)
                case Event():
                    self.send_event(replace(item, text=in_flags(item.text)))
                case FusionSetup():
                    self.send_setup(item)
        except OSError:
            self._unsent(isinstance(item, QueuedFrame))

    def _count(self, receivers: int | None, written_ns: int) -> None:
        if receivers == 0:
            self._unsent(1)
        elif receivers is not None:
            self._sent += receivers
            self._late += self._clock() - written_ns > LATE_NS

    def _unsent(self, frames: int) -> None:
        with self._queue.changed:
            self._not_sent += frames


def confidence(fused: FusedFrame) -> NDArray[np.float64]:
    """(J,) how far each joint can be trusted, 0 to 1; 0 without a person.

    It is s² / (s² + σ²) with s = 50 mm and the joint's standard deviation σ. Methods without σ have 1 for a
    joint with data and 0.25 for one without.
    """
    if not fused.has_person:
        return np.zeros(len(fused.positions))
    if fused.sigma is None:
        return np.where(fused.predicted, _PREDICTED, 1.0)
    return np.asarray(_HALF_TRUSTED**2 / (_HALF_TRUSTED**2 + fused.sigma**2))
