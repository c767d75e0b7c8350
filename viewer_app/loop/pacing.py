"""Plays recorded frames to a sink at the times at which they were recorded."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from fusion.setup import FusionSetup
from recordings.events import Event
from recordings.session_arrays import RecordedFrame
from viewer_app.sinks.sink import Sink


def played(
    frames: Iterable[RecordedFrame],
    sink: Sink,
    setups: Mapping[int, FusionSetup],
    events: Sequence[Event],
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], object] = time.sleep,
) -> Iterator[RecordedFrame]:
    """Gives each frame to the sink when it is due, then yields it. A frame that comes late is not skipped.

    Args:
        frames: In time order.
        sink: Receives frames, recalibrations and events.
        setups: By the number of the first frame that they apply to.
        events: In the order of their frames.
        clock: Returns seconds.
        wait: Waits so many seconds.
    """
    begin = first_ns = None
    at = 0
    for number, frame in enumerate(frames):
        time_ns = frame.pair.time_ns
        if begin is None or first_ns is None:
            begin, first_ns = clock(), time_ns
        left = begin + (time_ns - first_ns) * 1e-9 - clock()
        if left > 0.0:
            wait(left)
        if number and number in setups:
            sink.recalibrated(setups[number])
        sink.write(frame)
        while at < len(events) and events[at].frame <= number:
            event = events[at]
            sink.event(event.text, event.level, event.topic, event.phase)
            at += 1
        yield frame
    sink.finish()
