"""The base of all outputs: a bounded queue and a thread, so that no receiver holds up the loop."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from devices.events import Phase
from fusion.fused_frame import FusedFrame
from fusion.setup import FusionSetup
from recordings.session_arrays import RecordedFrame
from viewer_app.sinks.sink import Sink

LATE_NS = 33_333_333
"""A frame that is sent later than this after its fusion is late: the next one is there already."""
_KEPT_NOTES = 256
_CLOSES_WITHIN = 2.0  # seconds
_HALF_TRUSTED = 0.05  # metres of standard deviation
_PREDICTED = 0.25  # confidence of a joint without data, for methods without standard deviations


@dataclass(frozen=True)
class OutputCounts:
    """Counts of an output.

    Attributes:
        sent: Frames handed to the network; to each receiver, if the output knows its receivers.
        dropped: Frames that were not sent, because a newer one was there or the network refused them.
        late: Frames that were sent more than 33 ms after their fusion.
    """

    sent: int = 0
    dropped: int = 0
    late: int = 0


@dataclass(frozen=True, eq=False)
class TimedFrame:
    """A frame in the queue.

    Attributes:
        number: From 0, of the frames that the loop made.
        frame: The frame.
        time_ns: Since the first frame.
        written_ns: When the loop had it, on ``time.perf_counter_ns``.
    """

    number: int
    frame: RecordedFrame
    time_ns: int
    written_ns: int

    @property
    def fused(self) -> FusedFrame:
        """S*."""
        return self.frame.fused


@dataclass(frozen=True)
class TimedNote:
    """An event in the queue, at the time of the frame before it."""

    text: str
    level: str
    time_ns: int


class LiveOutput(Sink):
    """Sends frames on a thread of its own. When the queue is full, the oldest frame is dropped.

    A subclass opens its socket, then calls :meth:`start`. Its ``send_…`` methods run on the thread.

    Args:
        name: Name for messages, with the receiver: ``VMC to 127.0.0.1:39539``.
        keep: Length of the queue. 1 for receivers that show the newest pose, more for those that record.
        clock: Returns ns; tests inject their own.
    """

    def __init__(self, name: str, keep: int = 1, clock: Callable[[], int] = time.perf_counter_ns) -> None:
        self.name = name
        self.key = name.partition(" ")[0].lower()
        self.failure: str | None = None
        """Why it stopped before the end; None if it did not."""
        self.page = ""
        """Address of a web page that shows it; empty for none."""
        self.note = ""
        """What the user should know about it before it starts."""
        self._keep, self._clock = keep, clock
        self._frames: deque[TimedFrame] = deque()
        self._notes: deque[TimedNote | FusionSetup] = deque(maxlen=_KEPT_NOTES)
        self._more = threading.Condition()
        self._ending = self._closed = False
        self._number = 0
        self._start_ns: int | None = None
        self._sent = self._dropped = self._late = 0
        self._thread = threading.Thread(target=self._run, name=f"output {self.key}", daemon=True)

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    @property
    def counts(self) -> OutputCounts:
        """The counts so far."""
        return OutputCounts(self._sent, self._dropped, self._late)

    def figures(self) -> dict[str, object]:
        """Where it sent and its counts, as plain data for a report."""
        return {"to": self.name, **asdict(self.counts)}

    def write(self, frame: RecordedFrame) -> None:
        """Takes a frame, without waiting."""
        written = self._clock()
        with self._more:
            if self._start_ns is None:
                self._start_ns = frame.pair.time_ns
            if self._ending:
                return
            self._frames.append(TimedFrame(self._number, frame, frame.pair.time_ns - self._start_ns, written))
            self._number += 1
            if len(self._frames) > self._keep:
                self._frames.popleft()
                self._dropped += 1
            self._more.notify()

    def event(self, text: str, level: str = "INFO", topic: str = "", phase: Phase = "moment") -> None:
        """Takes an event, without waiting."""
        del topic, phase
        with self._more:
            time_ns = self._frames[-1].time_ns if self._frames else self._last_ns
            self._notes.append(TimedNote(text, level, time_ns))
            self._more.notify()

    def recalibrated(self, setup: FusionSetup) -> None:
        """Takes the setup of the following frames."""
        with self._more:
            self._notes.append(setup)
            self._more.notify()

    def close(self) -> None:
        """Sends what is queued, at most for two seconds, then closes. Closing twice has no effect."""
        with self._more:
            if self._closed:
                return
            self._closed = self._ending = True
            self._more.notify()
        if self._thread.is_alive():
            self._thread.join(_CLOSES_WITHIN)
        self.shut()

    def send_frame(self, frame: TimedFrame) -> int | None:
        """Sends a frame on the output's thread.

        Returns:
            Number of receivers; 0 if the network refused it, None if there is no receiver.

        Raises:
            OSError: It could not be sent; it counts as dropped.
        """
        raise NotImplementedError

    def send_note(self, note: TimedNote) -> None:
        """Sends an event on the output's thread."""

    def send_setup(self, setup: FusionSetup) -> None:
        """Sends the setup of the following frames on the output's thread."""

    def shut(self) -> None:
        """Releases sockets, after the thread's end."""

    _last_ns = 0

    def _run(self) -> None:
        try:
            while True:
                with self._more:
                    while not (self._frames or self._notes or self._ending):
                        self._more.wait()
                    note = self._notes.popleft() if self._notes else None
                    frame = self._frames.popleft() if note is None and self._frames else None
                if isinstance(note, TimedNote):
                    self._try(self.send_note, note)
                elif note is not None:
                    self._try(self.send_setup, note)
                elif frame is not None:
                    self._last_ns = frame.time_ns
                    self._send(frame)
                else:
                    return
        except Exception as fault:  # an output must not end the session
            self.failure = f"{self.name} stopped: {type(fault).__name__}: {fault}"
            with self._more:
                self._ending = True
                self._dropped += len(self._frames)
                self._frames.clear()

    def _send(self, frame: TimedFrame) -> None:
        try:
            receivers = self.send_frame(frame)
        except OSError:
            receivers = 0
        if receivers is None:
            return
        if receivers:
            self._sent += receivers
            if self._clock() - frame.written_ns > LATE_NS:
                self._late += 1
        else:
            self._unsent()

    def _unsent(self) -> None:
        with self._more:
            self._dropped += 1

    def _try(self, send: Callable[..., None], item: object) -> None:
        try:
            send(item)
        except OSError:
            return


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
