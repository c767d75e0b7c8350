"""A bounded queue and a thread: the base of every sink that may wait for a disk, a process or a network."""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import rerun as rr

from devices.events import Event
from fusion.fused_frame import FusedFrame
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.session_arrays import SessionFrame
from recordings.writing.recorder import Recorder
from viewer_app.sinks.sink import Sink

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
Opening = Callable[[rr.RecordingStream], Recorder]
"""Writes the static data and returns the recorder."""


class QueuedSink(Sink):
    """Queues what it receives; a thread of its own works it off. No method but :meth:`close` waits.

    A subclass implements :meth:`_run`, which takes items until :meth:`_take` returns none and the sink is
    ending, and starts the thread when it is ready.

    Args:
        keep: Maximum number of queued frames; then the oldest is dropped. None: no limit.
        daemon: Whether the interpreter may exit while the thread runs.
    """

    def __init__(
        self,
        name: str,
        keep: int | None,
        clock: Callable[[], int] = time.perf_counter_ns,
        daemon: bool = True,
    ) -> None:
        self._keep, self._clock = keep, clock
        self._queue: deque[Item] = deque()
        self._more = threading.Condition()
        self._ending = False
        self._number = self._time_ns = 0
        self._start_ns: int | None = None
        self.dropped = 0
        """Frames dropped because the receiver was too slow."""
        self._thread = threading.Thread(target=self._run, name=name, daemon=daemon)

    def write(self, frame: SessionFrame) -> None:
        if self._start_ns is None:
            self._start_ns = frame.pair.time_ns
        self._time_ns = frame.pair.time_ns - self._start_ns
        self.offer(QueuedFrame(self._number, frame, self._time_ns, self._clock()))
        self._number += 1

    def event(self, event: Event) -> None:
        """Queues an event, at the time of the last frame."""
        self.offer(event.placed(max(self._number - 1, 0), self._time_ns))

    def recalibrated(self, setup: FusionSetup) -> None:
        self.offer(setup)

    def coach(self, page: CoachPage) -> None:
        self.offer(page)

    def offer(self, item: Item) -> None:
        """Queues an item; once the sink is ending, discards it."""
        with self._more:
            if self._ending:
                return
            admitted = self._admitted(item)
            if admitted is not None:
                self._queue.append(admitted)
                self._more.notify()

    def _admitted(self, item: Item) -> Item | None:
        """Makes room for an item; returns what is queued for it, None for nothing. Called with the lock."""
        if self._keep is not None and len(self._queue) >= self._keep:
            frames = [k for k, other in enumerate(self._queue) if isinstance(other, QueuedFrame)]
            if isinstance(item, QueuedFrame) and len(frames) >= self._keep:
                del self._queue[frames[0]]
                self.dropped += 1
            elif len(self._queue) - len(frames) >= _KEPT_OTHERS:
                self._queue.popleft()
        return item

    def _take(self, seconds: float | None, most: int | None = None) -> list[Item]:
        """The queued items, at most `most`; waits so long for the first one. Empty at the end."""
        with self._more:
            self._more.wait_for(lambda: self._queue or self._ending, seconds)
            count = len(self._queue) if most is None else min(most, len(self._queue))
            return [self._queue.popleft() for _ in range(count)]

    def _end(self) -> None:
        """Takes no more items, and wakes the thread."""
        with self._more:
            self._ending = True
            self._more.notify_all()

    def _run(self) -> None:
        raise NotImplementedError


def write_items(recorder: Recorder, items: Sequence[Item]) -> None:
    """Writes items in order; consecutive frames are written by columns."""
    for are_frames, run in groupby(items, key=lambda item: isinstance(item, QueuedFrame)):
        if are_frames:
            frames = [item for item in run if isinstance(item, QueuedFrame)]
            recorder.record_all([item.frame for item in frames], [item.number for item in frames])
            continue
        for item in run:
            match item:
                case Event():
                    recorder.event(item)
                case FusionSetup():
                    recorder.recalibrated(item)
                case CoachPage():
                    recorder.coach(item)
