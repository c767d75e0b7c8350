"""A viewer as a sink: a hub that viewers connect to, and a window if there is a display.

A thread feeds it; no other thread waits for it. A viewer that is too slow gets the newest frames; dropped
frames are counted. A hub that dies or hangs is replaced by a new one on the same port.
"""

import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from uuid import UUID

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from devices.depth.image_thinning import pair_has_images, pair_without_images
from fusion.setup import FusionSetup
from recordings.data import layout
from recordings.data.session_arrays import SessionFrame
from recordings.writing.recorder import Recorder
from viewer_app.errors import UsageError
from viewer_app.sinks.item_queue import DropOldest, Item, ItemQueue
from viewer_app.sinks.queued_sink import Opening, QueuedSink, write_items
from viewer_app.viewer.hub import SERVER, STARTS_TRIED
from viewer_app.viewer.rerun_process import not_started, stop
from viewer_app.viewer.viewer_choice import LiveWindow, Viewing
from viewer_app.viewer.window import ViewerWindow, start_window

_KEEP = 60
"""Maximum number of queued frames: two seconds; older frames are dropped."""
_BEGINS_WITHIN = 1.0  # seconds
_WATCHED_EVERY = 0.25  # seconds
_BLOCK = 1 << 16  # bytes that are written at once: as many as a pipe holds
_PLOTTED_TOGETHER = 5  # frames, a sixth of a second
_DEPTH_HZ = 10.0  # depth images per sensor; limited by the viewer's memory for images
_PAUSED_WITHIN = 2.0  # seconds; a viewer that is farther behind reads the rest later
_EARLY = 0.9  # share of the interval: a frame that arrives slightly early still counts
_ELSEWHERE = 0.5  # metres: K_B stays in the picture if it is off by less
_HALF_NS = 16_000_000
"""Half a frame. A's images start with the second frame, B's with the third. Sending them together
would add latency."""


class ViewerFeed(QueuedSink):
    """Feeds a process that takes a session from its standard input.

    Args:
        start: Starts the process, with a pipe as its standard input.
        stream: A stream without a sink, shared by all processes: Rerun never frees the threads and buffers of
            a stream, 5 MB each.
        keep: Maximum number of queued frames; the oldest are dropped.
        patience: Seconds without progress after which the process is replaced.
        retry: Seconds between two starts.
        sample: Another recording, shown until :meth:`begin`.
    """

    def __init__(
        self,
        start: Callable[[], subprocess.Popen[bytes]],
        stream: rr.RecordingStream,
        begin: Opening,
        *,
        keep: int = _KEEP,
        patience: float = 10.0,
        retry: float = 0.5,
        sample: Path | None = None,
    ) -> None:
        super().__init__(ItemQueue(self._admitted))
        self._thread = threading.Thread(target=self._run, name="viewer feed", daemon=True)
        self._drop_oldest = DropOldest(keep)
        self._start, self._stream, self._begin = start, stream, begin
        self._patience, self._retry = patience, retry
        self._turn_over, self._free, self._ended, self._begun = (threading.Event() for _ in range(4))
        self._sample = sample
        if sample is None:
            self._begun.set()
        self._writing_since: float | None = None  # on the monotonic clock; None while nothing is written
        self.process = start()
        self.starts = 1
        self._thread.start()
        threading.Thread(target=self._watch, name="viewer watch", daemon=True).start()

    @property
    def dropped(self) -> int:
        """Frames that were not shown, because the viewer was too slow."""
        return self._drop_oldest.dropped

    def _admitted(self, queued: deque[Item], item: Item) -> Item:
        if not self._queue.ended:
            self._free.clear()
        return self._drop_oldest(queued, item)

    def begin(self) -> None:
        """Shows the session instead of the sample."""
        self._begun.set()
        self.wait_until_free(_BEGINS_WITHIN)  # the static data would hold up the first frames

    def wait_for_turn(self, seconds: float) -> None:
        """Waits until the next items are written, at most the given seconds."""
        self._turn_over.clear()
        self._turn_over.wait(seconds)

    def wait_until_free(self, seconds: float) -> bool:
        """Waits until all is written or the thread has ended, at most so long; whether it is so."""
        return self._free.wait(seconds)

    def close(self) -> None:
        """Stops feeding at once, and ends the process."""
        self._queue.end()
        stop(self.process)  # which ends a write that waits
        self._thread.join(timeout=1.0)
        stop(self.process)  # one that was just started

    def _run(self) -> None:
        try:
            self._feed_each()
        finally:
            self._queue.end()
            self._ended.set()
            self._free.set()  # nobody waits for a thread that has ended
            self._stream.disconnect()

    def _watch(self) -> None:
        """Stops a process that takes no data for too long."""
        while not self._ended.wait(_WATCHED_EVERY):
            since = self._writing_since
            if since is not None and time.monotonic() - since > self._patience:
                stop(self.process)

    def _feed_each(self) -> None:
        while not self._queue.ended:
            if self.process.poll() is None:
                self._feed(self.process)
            stop(self.process)
            if not self._queue.wait_for_end(self._retry):
                try:
                    self.process = self._start()
                    self.starts += 1
                except (UsageError, OSError):
                    continue

    def _feed(self, process: subprocess.Popen[bytes]) -> None:
        """Feeds the process until it is gone, hangs, or the feed stops."""
        if self._sample is not None and not self._begun.is_set():
            self._send(process, self._sample.read_bytes())
            while not self._begun.wait(_WATCHED_EVERY):
                if self._queue.ended or process.poll() is not None:
                    return
        encoded = rr.binary_stream(self._stream)
        recorder = self._begin(self._stream)
        try:
            while self._send(process, encoded.read() or b""):
                if recorder.unplotted >= _PLOTTED_TOGETHER:  # sent with the next frame
                    recorder.plot()
                self._turn_over.set()
                with self._queue.changed:
                    if not self._queue:
                        self._free.set()
                items = self._queue.take(0.2)
                if self._queue.ended:
                    return
                write_items(recorder, items)
                if not items:  # the session stands still: show the plots of its last frames, too
                    recorder.plot()
        finally:
            encoded.read()  # Rerun would report the rest as lost

    def _send(self, process: subprocess.Popen[bytes], data: bytes) -> bool:
        """Writes to the pipe; returns whether all data was written. A message is interrupted only when
        stopping."""
        assert process.stdin is not None
        rest = memoryview(data)
        while rest and not self._queue.ended:
            self._writing_since = time.monotonic()
            try:
                rest = rest[process.stdin.write(rest[:_BLOCK]) :]
            except (OSError, ValueError):  # it has ended, or is being stopped
                return False
            finally:
                self._writing_since = None
        return not rest and process.poll() is None


class ImageTurns:
    """Drops images, so that a viewer is not overloaded; passes images of one sensor at a time."""

    def __init__(self, rate: float) -> None:
        self._interval_ns = int(_EARLY * 1e9 / rate)
        self._next_ns: dict[str, int] = {}

    def capped(self, frame: SessionFrame) -> SessionFrame:
        """The next frame, with only the images that are due."""
        if not pair_has_images(frame.pair):
            return frame
        now = frame.pair.time_ns
        if not self._next_ns:
            self._next_ns = {"a": now + _HALF_NS, "b": now + 3 * _HALF_NS}
        shown = [side for side, due in self._next_ns.items() if now >= due]
        for side in shown:
            self._next_ns[side] = now + self._interval_ns
        left_out = "".join(self._next_ns.keys() - shown)
        return replace(frame, pair=pair_without_images(frame.pair, left_out)) if left_out else frame


class ViewerSink(ViewerFeed):
    """Shows a session in a viewer.

    Args:
        alone: Whether the session has no file: a window that does not open is an error then.
        reframed: Makes the layout of a setup in which B stands elsewhere; None: it stays.

    Raises:
        UsageError: The hub does not start, or the only window.
    """

    def __init__(
        self,
        setup: FusionSetup,
        sources: tuple[str, str],
        blueprint: rrb.Blueprint,
        viewing: Viewing,
        identity: UUID,
        alone: bool = True,
        reframed: Callable[[FusionSetup], rrb.Blueprint] | None = None,
        sample: Path | None = None,
    ) -> None:
        assert viewing.hub is not None
        self.hub = hub = viewing.hub
        self._setup, self._sources, self._blueprint = setup, sources, blueprint
        self._reframed, self._framed = reframed, setup.calibration
        self._turns = ImageTurns(_DEPTH_HZ)
        self.window: ViewerWindow | None = None
        self._no_window = ""
        super().__init__(
            hub.start,
            rr.RecordingStream(layout.APPLICATION_ID, recording_id=identity),
            self._begin_recording,
            sample=sample,
        )
        while not hub.listens(started := self.process):  # the feed starts another one if it has ended
            if self.starts >= STARTS_TRIED or started.poll() is None:
                super().close()
                raise not_started(SERVER)
            time.sleep(_WATCHED_EVERY)
        if sample is None:
            self.begin()
        if isinstance(viewing, LiveWindow):
            try:
                self.window = ViewerWindow(lambda: start_window(hub, viewing.headless))
            except UsageError as error:
                if alone:
                    super().close()
                    raise
                self._no_window = str(error)

    @property
    def window_failure(self) -> str:
        """Why no window opens, or none again; empty as long as one does."""
        return self._no_window if self.window is None else self.window.failure

    @property
    def window_closed(self) -> bool:
        """Whether the user closed the window; it does not reopen by itself."""
        return self.window is not None and self.window.closed

    def write(self, frame: SessionFrame) -> None:
        super().write(self._turns.capped(frame))

    def recalibrated(self, setup: FusionSetup) -> None:
        self._setup = setup
        super().recalibrated(setup)
        found, framed = setup.calibration, self._framed
        away = np.linalg.norm(found.a_from_b.translation - framed.a_from_b.translation)
        if self._reframed is not None and not found.provisional and away > _ELSEWHERE:
            self._framed, self._blueprint = found, self._reframed(setup)
            self._stream.send_blueprint(self._blueprint)

    def rest(self, seconds: float) -> None:
        self.wait_until_free(seconds)

    def close(self) -> None:
        """Stops feeding and ends the hub. The window stays open, at the last frame."""
        if self.window is not None:
            self.window.leave()
        super().close()
        if self.window is not None:
            self.window.pause(self._time_ns, _PAUSED_WITHIN)

    def _begin_recording(self, stream: rr.RecordingStream) -> Recorder:
        recorder = Recorder(
            stream,
            self._setup,
            self._sources,
            depth_every=1,
            start_ns=self._start_ns,
            points=True,
            plots_later=True,
        )
        # Sent after the timeline that it names exists, and as the active one; otherwise a viewer restores a
        # layout that it remembers.
        stream.send_blueprint(self._blueprint)
        return recorder
