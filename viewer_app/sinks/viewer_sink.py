"""A viewer as a sink: a hub that viewers connect to, a window, or both.

A thread feeds it; no other thread waits for it. A viewer that is too slow gets the newest frames; dropped
frames are counted. A hub that dies or hangs is replaced by a new one on the same port.
"""

from __future__ import annotations

import os
import selectors
import subprocess
import threading
import time
from collections.abc import Callable
from uuid import UUID

import rerun as rr
import rerun.blueprint as rrb

from fusion.setup import FusionSetup
from recordings import layout
from recordings.session_arrays import SessionFrame
from recordings.writing.recorder import Recorder
from viewer_app.errors import UsageError
from viewer_app.sinks.queued_sink import Item, Opening, QueuedSink, write_items
from viewer_app.sinks.viewer_images import ImageTurns
from viewer_app.viewer.rerun_process import ViewerWindow, start_window, start_window_on_pipe, stop
from viewer_app.viewer.viewer_choice import Viewing

_KEEP = 60
"""Maximum number of queued frames: two seconds; older frames are dropped."""
_SHOWN_WITHIN = 60.0  # seconds
_BEGINS_WITHIN = 1.0  # seconds
_PLOTS_EVERY = 5  # frames, a sixth of a second


class ViewerFeed(QueuedSink):
    """Feeds a process that takes a session from its standard input.

    Args:
        start: Starts the process, with a pipe as its standard input.
        stream: A stream without a sink, shared by all processes: Rerun never frees the threads and buffers of
            a stream, 5 MB each.
        begin: Writes the static data.
        keep: Maximum number of queued frames; the oldest are dropped. None: nothing is dropped.
        patience: Seconds without progress after which the process is replaced.
        restart: Whether a process that ended is replaced.
        retry: Seconds between two starts.

    Attributes:
        process: The current process, or the last one.
        starts: Number of processes started.
    """

    def __init__(
        self,
        start: Callable[[], subprocess.Popen[bytes]],
        stream: rr.RecordingStream,
        begin: Opening,
        *,
        keep: int | None = _KEEP,
        patience: float = 10.0,
        restart: bool = True,
        retry: float = 0.5,
    ) -> None:
        super().__init__("viewer feed", keep)
        self._start, self._stream, self._begin = start, stream, begin
        self._patience, self._restart, self._retry = patience, restart, retry
        self._turn_over, self._free = threading.Event(), threading.Event()
        self.process = start()
        self.starts = 1
        self._thread.start()

    def offer(self, item: Item) -> None:
        """Queues an item; the oldest frame makes room for it."""
        with self._more:
            if not self._ending:
                self._free.clear()
            super().offer(item)

    def wait_for_turn(self, seconds: float) -> None:
        """Waits until the next items are written, at most the given seconds."""
        self._turn_over.clear()
        self._turn_over.wait(seconds)

    def wait_until_free(self, seconds: float) -> bool:
        """Waits while the static data or an item is to be written, at most the given seconds.

        Returns:
            Whether everything is written, or the thread has ended.
        """
        return self._free.wait(seconds)

    def close(self, end_process: bool = True) -> None:
        """Stops feeding at once and closes the input of the process; ends the process if requested."""
        self._end()
        self._thread.join(timeout=1.0)
        if end_process:
            stop(self.process)
        elif self.process.stdin is not None:
            self.process.stdin.close()

    def _run(self) -> None:
        try:
            self._feed_each()
        finally:
            self._end()
            self._free.set()  # nobody waits for a thread that has ended
            self._stream.disconnect()

    def _feed_each(self) -> None:
        while not self._ending:
            if self.process.poll() is None:
                self._feed(self.process)
            if self._ending or not self._restart:
                return
            stop(self.process)
            with self._more:
                self._more.wait_for(lambda: self._ending, timeout=self._retry)
            if not self._ending:
                try:
                    self.process = self._start()
                    self.starts += 1
                except (UsageError, OSError):
                    continue

    def _feed(self, process: subprocess.Popen[bytes]) -> None:
        """Feeds the process until it is gone, hangs, or the feed stops."""
        encoded = rr.binary_stream(self._stream)
        recorder = self._begin(self._stream)
        try:
            while self._send(process, encoded.read() or b""):
                self._turn_over.set()
                with self._more:
                    if not self._queue:
                        self._free.set()
                items = self._take(0.2)
                if self._ending:
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
        pipe = process.stdin.fileno()
        os.set_blocking(pipe, False)
        rest = memoryview(data)
        moved = time.monotonic()
        with selectors.DefaultSelector() as ready:
            ready.register(pipe, selectors.EVENT_WRITE)
            while rest:
                if self._ending or process.poll() is not None or time.monotonic() - moved > self._patience:
                    return False
                if not ready.select(timeout=0.1):
                    continue
                try:
                    written = os.write(pipe, rest[: 1 << 20])
                except BlockingIOError:
                    continue
                except OSError:
                    return False
                rest, moved = rest[written:], time.monotonic()
        return process.poll() is None


class ViewerSink(ViewerFeed):
    """Shows a session in a viewer.

    Args:
        setup: Settings, cameras and the first calibration.
        sources: What the sensors are called, K_A first.
        blueprint: What the viewer shows.
        viewing: A hub, a window, or both.
        identity: Of the recording.
        complete: Whether the viewer gets every frame and closing waits for it. This is for recordings, whose
            frames are in memory anyway.

    Attributes:
        window: The supervised window; None if there is none.

    Raises:
        UsageError: The viewer does not start.
    """

    def __init__(
        self,
        setup: FusionSetup,
        sources: tuple[str, str],
        blueprint: rrb.Blueprint,
        viewing: Viewing,
        identity: UUID,
        complete: bool = False,
    ) -> None:
        self._setup, self._sources, self._blueprint = setup, sources, blueprint
        self._complete, self._whole = complete, False
        self._turns = ImageTurns(viewing.depth_hz)
        self._hub = viewing.hub
        self.window: ViewerWindow | None = None
        super().__init__(
            start_window_on_pipe if self._hub is None else self._hub.start,
            rr.RecordingStream(layout.APPLICATION_ID, recording_id=identity),
            self._begin_recording,
            keep=None if complete else _KEEP,
            restart=self._hub is not None,
        )
        if self._hub is None:
            return
        hub = self._hub
        try:
            hub.wait_until_listening(self.process)
        except UsageError:
            super().close()
            raise
        # While a hub takes the static data, it would hold up the first frames.
        self.wait_until_free(_BEGINS_WITHIN)
        if viewing.window:
            self.window = ViewerWindow(lambda: start_window(hub, viewing.headless))

    @property
    def window_closed(self) -> bool:
        """Whether the user closed the window; it does not reopen by itself."""
        return self.window is not None and self.window.closed

    def write(self, frame: SessionFrame) -> None:
        """Queues a frame, with the images whose turn it is."""
        super().write(self._turns.capped(frame))

    def recalibrated(self, setup: FusionSetup) -> None:
        """Queues the setup of the following frames, and keeps it for viewers that connect later."""
        self._setup = setup
        super().recalibrated(setup)

    def rest(self, seconds: float) -> None:
        """Waits until the feed has written."""
        self.wait_until_free(seconds)

    def finish(self) -> None:
        """Makes closing wait until the viewer has everything, if `complete` is set."""
        self._whole = True

    def close(self, end_process: bool | None = None) -> None:
        """Stops feeding. The window stays; a hub ends."""
        if self.window is not None:
            self.window.leave()
        if self._complete and self._whole:
            self.wait_until_free(_SHOWN_WITHIN)
        super().close(self._hub is not None if end_process is None else end_process)

    def _begin_recording(self, stream: rr.RecordingStream) -> Recorder:
        recorder = Recorder(
            stream,
            self._setup,
            self._sources,
            depth_every=1,
            start_ns=self._start_ns,
            points=True,
            plots_every=_PLOTS_EVERY,
        )
        # Sent after the timeline that it names exists, and as the active one; otherwise a viewer restores a
        # layout that it remembers.
        stream.send_blueprint(self._blueprint)
        return recorder
