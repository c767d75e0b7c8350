"""Feeds a viewer from a separate thread; no other thread waits for it.

Offered items go into a queue. A viewer that is too slow gets the newest frames; dropped frames are counted. A
hub that dies or hangs is replaced by a new one on the same port.
"""

from __future__ import annotations

import os
import selectors
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable

import rerun as rr

from viewer_app.errors import UsageError
from viewer_app.sinks.queue_items import Frame, Item, Opening, write_items
from viewer_app.viewer.rerun_process import stop


class ViewerFeed:
    """Feeds a process that takes a session from its standard input.

    Args:
        start: Starts the process, with a pipe as its standard input.
        stream: A stream without a sink, shared by all processes: Rerun never frees the threads and buffers of
            a stream, 5 MB each.
        begin: Writes the static data.
        keep: Maximum queue length; the oldest items are dropped. None: no limit, nothing is dropped.
        patience: Seconds without progress after which the process is replaced.
        restart: Whether a process that ended is replaced.
        retry: Seconds between two starts.
    """

    def __init__(
        self,
        start: Callable[[], subprocess.Popen[bytes]],
        stream: rr.RecordingStream,
        begin: Opening,
        *,
        keep: int | None = 60,
        patience: float = 10.0,
        restart: bool = True,
        retry: float = 0.5,
    ) -> None:
        self._start, self._stream, self._begin = start, stream, begin
        self._patience, self._restart, self._retry = patience, restart, retry
        self._queue: deque[Item] = deque()
        self._keep = keep
        self._more = threading.Condition()
        self._stopping = False
        self._idle = False
        self._turn_over, self._free = threading.Event(), threading.Event()
        self.dropped = 0
        """Frames dropped because the viewer was too slow."""
        self.starts = 0
        """Number of processes started."""
        self.process = start()
        """The current process, or the last one."""
        self.starts = 1
        self._thread = threading.Thread(target=self._run, name="viewer feed", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> None:
        """Takes an item, without waiting."""
        with self._more:
            if self._stopping:
                return
            if self._keep is not None and len(self._queue) >= self._keep:
                self._drop_oldest_frame()
            self._queue.append(item)
            self._free.clear()
            self._more.notify()

    def wait_for_turn(self, seconds: float) -> None:
        """Waits until the queued items are written, at most the given seconds."""
        self._turn_over.clear()
        self._turn_over.wait(seconds)

    def wait_until_free(self, seconds: float) -> bool:
        """Waits while the static data or an item is to be written, at most the given seconds.

        Returns:
            Whether everything is written.
        """
        return self._free.wait(seconds)

    def finish(self, timeout: float) -> bool:
        """Waits until all items are written or the process is gone; returns whether all were written."""
        deadline = time.monotonic() + timeout
        with self._more:
            self._more.notify()
        while time.monotonic() < deadline and self._thread.is_alive():
            if self._idle and not self._queue:
                return True
            time.sleep(0.005)
        return False

    def close(self, end_process: bool) -> None:
        """Stops feeding at once and closes the input of the process; ends the process if requested."""
        with self._more:
            self._stopping = True
            self._more.notify()
        self._thread.join(timeout=1.0)
        if end_process:
            stop(self.process)
        elif self.process.stdin is not None:
            self.process.stdin.close()

    def _drop_oldest_frame(self) -> None:
        """Drops the oldest frame. Events stay: they are rare and short."""
        for index, item in enumerate(self._queue):
            if isinstance(item, Frame):
                del self._queue[index]
                self.dropped += 1
                return
        self._queue.popleft()

    def _run(self) -> None:
        try:
            self._feed_each()
        finally:
            with self._more:  # or an item that is being offered would clear the event again
                self._stopping = True
                self._free.set()  # nobody waits for a thread that has ended
            self._stream.disconnect()

    def _feed_each(self) -> None:
        while not self._stopping:
            if self.starts and self.process.poll() is None:
                self._feed(self.process)
            if self._stopping or not self._restart:
                return
            stop(self.process)
            self._sleep(self._retry)
            if not self._stopping:
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
            while not self._stopping:
                if not self._send(process, encoded.read() or b""):
                    return
                self._turn_over.set()
                with self._more:
                    self._idle = not self._queue
                    if self._idle:
                        self._free.set()
                    if not self._queue:
                        self._more.wait(0.2)
                    items = list(self._queue)
                    self._queue.clear()
                    self._idle = self._idle and not items
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
                if self._stopping or process.poll() is not None or time.monotonic() - moved > self._patience:
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

    def _sleep(self, seconds: float) -> None:
        with self._more:
            self._more.wait_for(lambda: self._stopping, timeout=seconds)
