"""How the SDK's pipeline makes sets of frames, for the stand-in: ``FrameAggregator.cpp`` of OrbbecSDK_v2.

Read in July 2026. Without frame sync, a set holds the oldest frame of each stream, once all have one, or the
oldest of those streams that have three; with the mode DISABLE each frame is a set at once. With frame sync,
which a pipeline begins with, frames half a period apart belong together; a stream waits for the others until
it has half a second of frames.
"""

from collections import deque

from tests.helpers.orbbec.standin_values import FrameSet, OBFrameAggregateOutputMode, OBFrameType

_UNSYNCED, _SYNCED_S = 3, 0.5
_MODES = OBFrameAggregateOutputMode


class Aggregator:
    """Makes sets of the frames of a pipeline's streams.

    Attributes:
        sync: Whether frame sync is on.
    """

    def __init__(self, sync):
        self.sync = sync
        self._queues, self._mode, self._fps = {}, None, 30

    def start(self, kinds, mode, fps):
        """Begins anew, with streams of these ``OBFrameType``."""
        self._queues, self._mode, self._fps = {kind: deque() for kind in kinds}, mode, fps

    def push(self, frame):
        """Takes a frame; returns the sets that are now complete."""
        self._queues[frame.get_type()].append(frame)
        made = self._synced(frame.get_type()) if self.sync and len(self._queues) > 1 else self._unsynced()
        return [found for found in made if self._goes_out(found)]

    def _unsynced(self):
        most = 1 if self._mode is _MODES.DISABLE else _UNSYNCED
        complete = all(self._queues.values())
        fronts = [queue.popleft() for queue in self._queues.values() if complete or len(queue) >= most]
        return [_set_of(fronts)] if fronts else []

    def _synced(self, kind):
        overflows = len(self._queues[kind]) >= 1 + int(_SYNCED_S * self._fps)
        made = []
        while all(self._queues.values()) or overflows:
            first_us = min(queue[0].get_timestamp_us() for queue in self._queues.values() if queue)
            together = [
                queue
                for queue in self._queues.values()
                if queue and queue[0].get_timestamp_us() - first_us <= 0.5e6 / self._fps
            ]
            overflows = overflows and not any(queue is self._queues[kind] for queue in together)
            made.append(_set_of([queue.popleft() for queue in together]))
        return made

    def _goes_out(self, found):
        if self._mode is _MODES.FULL_FRAME_REQUIRE:
            return found.get_count() == len(self._queues)
        return self._mode is not _MODES.COLOR_FRAME_REQUIRE or found.get_color_frame() is not None


def _set_of(frames):
    found = FrameSet()
    for frame in frames:
        found.push_frame(frame)
    return found


KINDS = {
    "DEPTH_SENSOR": OBFrameType.DEPTH_FRAME,
    "IR_SENSOR": OBFrameType.IR_FRAME,
    "LEFT_IR_SENSOR": OBFrameType.LEFT_IR_FRAME,
    "COLOR_SENSOR": OBFrameType.COLOR_FRAME,
}
"""The frames of each camera."""
