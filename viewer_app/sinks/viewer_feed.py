"""A viewer fed from a thread of its own, which nothing ever waits for.

What is offered goes into a queue. A viewer that cannot follow gets the newest frames; what it missed is
counted. A hub that dies or stands still is replaced by a new one on the same port.
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
        stream: Without a sink. All processes get the same one: Rerun never frees a stream's threads and
            buffers, 5 MB each.
        begin: Writes what is static.
        keep: How many items wait at most, the oldest give way; None: all wait, nothing is left out.
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
        self._turn_over = threading.Event()
        self.dropped = 0
        """Frames that the viewer was too slow for."""
        self.starts = 0
        """Processes started."""
        self.process = start()
        """The one fed now, or last."""
        self.starts = 1
        self._thread = threading.Thread(target=self._run, name="viewer feed", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> None:
        """Takes an item, without waiting."""
        with self._more:
            if self._stopping or not self._thread.is_alive():
                return
            if self._keep is not None and len(self._queue) >= self._keep:
                self._drop_oldest_frame()
            self._queue.append(item)
            self._more.notify()

    def wait_for_turn(self, seconds: float) -> None:
        """Waits until it is next done with what there was to write, if anything; so many seconds at most."""
        self._turn_over.clear()
        self._turn_over.wait(seconds)

    def finish(self, timeout: float) -> bool:
        """Waits until everything offered is written or the process is gone; says whether it was written."""
        deadline = time.monotonic() + timeout
        with self._more:
            self._more.notify()
        while time.monotonic() < deadline and self._thread.is_alive():
            if self._idle and not self._queue:
                return True
            time.sleep(0.005)
        return False

    def close(self, end_process: bool) -> None:
        """Stops feeding at once. The process's input ends; the process too where asked."""
        with self._more:
            self._stopping = True
            self._more.notify()
        self._thread.join(timeout=1.0)
        if end_process:
            stop(self.process)
        elif self.process.stdin is not None:
            self.process.stdin.close()

    def _drop_oldest_frame(self) -> None:
        """What is said stays: it is rare and short."""
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
        """Until the process is gone, stands still, or we stop."""
        encoded = rr.binary_stream(self._stream)
        recorder = self._begin(self._stream)
        try:
            while not self._stopping:
                if not self._send(process, encoded.read() or b""):
                    return
                self._turn_over.set()
                with self._more:
                    self._idle = not self._queue
                    if not self._queue:
                        self._more.wait(0.2)
                    items = list(self._queue)
                    self._queue.clear()
                    self._idle = self._idle and not items
                write_items(recorder, items)
        finally:
            encoded.read()  # what is left would be reported as lost

    def _send(self, process: subprocess.Popen[bytes], data: bytes) -> bool:
        """Whether all went into the pipe. It is not broken off within a message, unless for good."""
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
