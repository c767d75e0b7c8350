"""A live session on disk: readable while it grows, whole but for its last second whenever it ends."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

import rerun as rr

from devices.sensor import SensorFrame
from fusion.fuser import Fuser
from recordings import layout
from recordings.arrays import RecordedFrame
from recordings.recorder import Recorder
from recordings.rewriting import rewrite
from recordings.rrd_file import END_OF_FILE, without_footer
from recordings.session import Session

_DEPTH_WAITING = 90
"""Frames that may wait with their depth images, some 200 MB; later ones come without."""
_READ_WITHIN = 10.0


class GrowingSession:
    """Writes frames to a file from a thread of its own, a block every half second.

    A full disk stops the saving and nothing else: `failure` then says so, and `on_failure` is called.
    Closing writes the session anew in large blocks, which takes a quarter of the room, where it has no depth.

    Args:
        path: The file; it is there, and can be read, from the start.
        fuser: Whose settings, calibration and intrinsics the session keeps.
        sources: What the sensors are called, K_A first.
        blueprint: What a viewer that opens the file shows.
        depth_every: Keep the depth images of every so many pairs; 0 for none.
        about: More to say of the session's origin.
        on_failure: Told, from the thread, why saving stopped.
        period: Seconds between two blocks.
        clock: Gives seconds; for tests.

    Attributes:
        failure: Why saving stopped; None while it goes on.
        depth_dropped: Depth images left out because the disk is too slow.

    Raises:
        OSError: The file cannot be made.
    """

    def __init__(
        self,
        path: Path,
        fuser: Fuser,
        sources: tuple[str, str],
        blueprint: Any = None,
        depth_every: int = 0,
        about: Mapping[str, str | int] | None = None,
        on_failure: Callable[[str], None] | None = None,
        period: float = 0.5,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.failure: str | None = None
        self.depth_dropped = 0
        self._path, self._blueprint = path, blueprint
        self._depth_every, self._on_failure = depth_every, on_failure
        self._period, self._clock = period, clock
        self._file: BinaryIO = path.open("wb")
        self._stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4())
        self._bytes = rr.binary_stream(self._stream)
        if blueprint is not None:
            self._stream.set_sinks(self._bytes, default_blueprint=blueprint)
        self._recorder = Recorder(self._stream, fuser, sources, depth_every, about)
        self._queue: queue.SimpleQueue[RecordedFrame | Fuser | tuple[str, str] | None] = queue.SimpleQueue()
        self._closed = False
        self._flush()
        self._thread = threading.Thread(target=self._run, name="session file", daemon=True)
        self._thread.start()

    def __enter__(self) -> GrowingSession:
        """Itself."""
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Closes it, on every path."""
        self.close()

    def record(self, frame: RecordedFrame) -> None:
        """Hands a frame over; returns at once."""
        if self.failure is not None:
            return
        if self._depth_every == 0 or self._queue.qsize() > _DEPTH_WAITING:
            if self._depth_every:
                self.depth_dropped += sum(
                    s is not None and s.depth is not None for s in (frame.pair.a, frame.pair.b)
                )
            pair = replace(frame.pair, a=_without_images(frame.pair.a), b=_without_images(frame.pair.b))
            frame = replace(frame, pair=pair)
        self._queue.put(frame)

    def calibrate(self, fuser: Fuser) -> None:
        """Hands over the calibration with which the frames that follow are fused, by a new fuser."""
        if self.failure is None:
            self._queue.put(fuser)

    def event(self, text: str, level: str = "INFO") -> None:
        """Hands over what happened."""
        if self.failure is None:
            self._queue.put((text, level))

    def close(self) -> None:
        """Writes what is left and ends the session; closing twice is harmless."""
        if self._closed:
            return
        self._closed = True
        self._queue.put(None)
        self._thread.join()
        self._stream.disconnect()
        with suppress(OSError):
            if self.failure is None:
                self._file.write(END_OF_FILE)
            self._file.close()
        if self.failure is None and self._depth_every == 0:
            self._tidy()

    def _tidy(self) -> None:
        """The same session in large blocks; the file that grew stays where that does not succeed."""
        partial = self._path.with_name(f".{self._path.name}.partial")
        try:
            rewrite(Session.open(self._path), partial, self._blueprint)
            partial.replace(self._path)
        except OSError:
            pass
        finally:
            partial.unlink(missing_ok=True)

    def _run(self) -> None:
        waiting: list[RecordedFrame] = []
        due = self._clock() + self._period
        while True:
            with suppress(queue.Empty):
                item = self._queue.get(timeout=max(due - self._clock(), 0.01))
                if isinstance(item, RecordedFrame):
                    waiting.append(item)
                    if self._clock() < due:
                        continue
                self._write(waiting)
                if isinstance(item, Fuser):
                    self._recorder.calibrate(item)
                elif isinstance(item, tuple):
                    self._recorder.event(*item)
                elif item is None:
                    self._recorder.finish()
                    self._flush()
                    return
            self._write(waiting)
            self._flush()
            due = self._clock() + self._period

    def _write(self, waiting: list[RecordedFrame]) -> None:
        if waiting and self.failure is None:
            self._recorder.record_all(waiting)
        waiting.clear()

    def _flush(self) -> None:
        written = self._bytes.read(flush=True, flush_timeout_sec=_READ_WITHIN)
        if self.failure is not None or not written:
            return
        try:
            self._file.write(without_footer(written, with_header=self._file.tell() == 0))
            self._file.flush()
        except OSError as error:
            self.failure = (
                f"{self._path} is no longer saved: {error.strerror or error}. What was written before can be "
                "read; the fusion goes on."
            )
            if self._on_failure is not None:
                self._on_failure(self.failure)


def _without_images(frame: SensorFrame | None) -> SensorFrame | None:
    return None if frame is None else replace(frame, depth=None, color=None)
