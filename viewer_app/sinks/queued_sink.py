"""A sink with a queue and a thread: the base of all that may wait for a disk, a process or a network."""

import time
from collections.abc import Callable, Sequence
from itertools import groupby

import rerun as rr

from devices.events import Event
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.data.session_arrays import SessionFrame
from recordings.writing.recorder import Recorder
from viewer_app.sinks.item_queue import Item, ItemQueue, QueuedFrame
from viewer_app.sinks.sink import Sink

Opening = Callable[[rr.RecordingStream], Recorder]
"""Writes the static data and returns the recorder."""


class QueuedSink(Sink):
    """Queues what it receives, for a thread that works it off. No method but :meth:`close` waits."""

    def __init__(self, queue: ItemQueue[Item], clock: Callable[[], int] = time.perf_counter_ns) -> None:
        self._queue, self._clock = queue, clock
        self._number = self._time_ns = 0
        self._start_ns: int | None = None

    def write(self, frame: SessionFrame) -> None:
        if self._start_ns is None:
            self._start_ns = frame.pair.time_ns
        self._time_ns = frame.pair.time_ns - self._start_ns
        self._queue.put(QueuedFrame(self._number, frame, self._time_ns, self._clock()))
        self._number += 1

    def event(self, event: Event) -> None:
        """Queues an event, at the time of the last frame."""
        self._queue.put(event.placed(max(self._number - 1, 0), self._time_ns))

    def recalibrated(self, setup: FusionSetup) -> None:
        self._queue.put(setup)

    def coach(self, page: CoachPage) -> None:
        self._queue.put(page)


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
