"""Where a loop's frames go while it runs: a file, a viewer, both or neither. It never waits for either."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from uuid import uuid4

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from fusion.setup import FusionSetup
from recordings import layout
from recordings.appearance.coach_page import CoachPage
from recordings.session_arrays import RecordedFrame
from recordings.writing.recorder import Recorder
from viewer_app.errors import UsageError
from viewer_app.loop.image_thinning import has_images, without_images
from viewer_app.sinks.session_file import SessionFile
from viewer_app.sinks.viewer_feed import Image, Item, Note, ViewerFeed
from viewer_app.viewer.rerun_process import Hub, start_window, start_window_on_pipe, stop

_VIEWER_QUEUE = 60
"""Frames that wait for the viewer at most: two seconds, then it is shown the newest."""
_EARLY = 0.9  # of an interval: a frame that comes a little early is not put off for the next one
_HALF_NS = 16_000_000
"""Half a frame. A's images begin with the second frame, B's with the third: together, or with the matrix of
trust, whose seconds begin with the first, they would make everyone wait."""
_DEPTH_HZ = 10.0  # what a viewer's memory of images stands
_WINDOW_LOOKED_AFTER_EVERY = 0.5  # seconds
_SHOWN_WITHIN = 60.0
_IMAGES_WAITING = 30
_SHOWN_EVERY = 3  # depth images of a recording, to a viewer


@dataclass(frozen=True)
class Viewing:
    """How a session is looked at while it is made.

    Attributes:
        window: Whether a window opens.
        hub: Where viewers connect to; None where there is only a window, which then outlives the program.
        depth_hz: Depth images a second and sensor at most, in the viewer.
        headless: Whether the window is drawn without a screen, for tests.
        why_not: Why nothing is looked at, where something was to be.
    """

    window: bool = False
    hub: Hub | None = None
    depth_hz: float = _DEPTH_HZ
    headless: bool = False
    why_not: str = ""


class LiveSession:
    """Takes what a :class:`~recordings.writing.recorder.Recorder` takes; its own threads write it.

    File and viewer each have a thread and a recording stream of the same recording id. Use it as a context
    manager.

    Args:
        setup: Settings, cameras and the first calibration.
        sources: What the sensors are called, K_A first.
        blueprint: What the viewer shows.
        file: The file to write; None for none. It can be read while it grows.
        overwrite: Whether a file of that name may be replaced.
        viewing: The viewer; None for none.
        complete: Whether the viewer too gets every frame, and closing waits for that: for recordings, whose
            frames stay in memory anyway. Their file is written to be read afterwards.

    Raises:
        UsageError: The viewer does not start.
    """

    def __init__(
        self,
        setup: FusionSetup,
        sources: tuple[str, str],
        blueprint: rrb.Blueprint,
        *,
        file: Path | None = None,
        overwrite: bool = False,
        viewing: Viewing | None = None,
        complete: bool = False,
    ) -> None:
        self._setup, self._sources, self._blueprint = setup, sources, blueprint
        self._id = uuid4()
        self._complete = complete
        self._count = 0
        self._whole = self._saved = False
        self._start_ns: int | None = None
        self._path = file
        self._viewing = viewing or Viewing()
        self._next_image_ns: dict[str, int] = {}
        self._file: SessionFile | None = None
        self._feed: ViewerFeed | None = None
        self._window: _Window | None = None
        hub = self._viewing.hub
        if hub is not None:
            self._feed = self._feed_into(hub.start)
            try:
                hub.wait_until_listening(self._feed.process)
            except UsageError:
                self._feed.close(end_process=True)
                raise
            if self._viewing.window:
                self._window = _Window(lambda: start_window(hub, self._viewing.headless))
        elif self._viewing.window:
            self._feed = self._feed_into(start_window_on_pipe, restart=False)
        if file is not None:
            self._file = SessionFile(
                file,
                self._stream,
                lambda of: self._with_blueprint(of, Recorder(of, setup, sources, depth_every=1)),
                growing=not complete,
                overwrite=overwrite,
                turn=None if self._feed is None else self._feed.wait_for_turn,
                on_failure=self._tell_failure,
            )

    def record(self, frame: RecordedFrame) -> None:
        """Takes a frame."""
        if self._start_ns is None:
            self._start_ns = frame.pair.time_ns
        number, self._count = self._count, self._count + 1
        if self._file is not None:
            self._file.offer((number, frame))
        if self._feed is not None:
            self._feed.offer((number, self._capped(frame)))

    def record_all(self, frames: Sequence[RecordedFrame]) -> None:
        """Takes frames in time order."""
        for frame in frames:
            self.record(frame)

    def record_depth(self, side: str, frame: int, time_ns: int, depth: NDArray[np.uint16]) -> None:
        """Takes a depth image of a frame that was taken before, for recordings only: it waits for the disk.

        Args:
            side: ``a`` or ``b``.
            frame: The frame's number.
            time_ns: Since the first pair.
            depth: (height, width) millimetres.
        """
        image = Image(side, frame, time_ns, depth)
        if self._file is not None:
            self._file.offer(image)
            while self._file.waiting > _IMAGES_WAITING:
                time.sleep(0.01)
        if self._feed is not None and frame % _SHOWN_EVERY == 0:
            self._feed.offer(image)

    def event(self, text: str, level: str = "INFO") -> None:
        """Takes what happened, at the time of the last frame."""
        self._say(Note(text, level))

    def coach(self, page: CoachPage) -> None:
        """Takes what to do next, at the time of the last frame."""
        self._say(page)

    def recalibrated(self, setup: FusionSetup) -> None:
        """Takes what the frames that follow are fused with."""
        self._setup = setup
        self._say(setup)

    @property
    def dropped(self) -> int:
        """Frames that the viewer was too slow for."""
        return 0 if self._feed is None else self._feed.dropped

    @property
    def lost(self) -> int:
        """Frames that the file lacks, because the disk stood still for a minute."""
        return 0 if self._file is None else self._file.lost

    @property
    def without_images(self) -> int:
        """Frames that the file has without their images, because the disk was too slow for those."""
        return 0 if self._file is None else self._file.without_images

    @property
    def saves(self) -> bool:
        """Whether a file is being written."""
        return self._file is not None and self._file.failure is None

    @property
    def failure(self) -> str | None:
        """Why a live session's file lacks the end of it, in a sentence; None where it does not."""
        return None if self._file is None else self._file.failure

    @property
    def saved(self) -> int:
        """Frames in a live session's file."""
        return 0 if self._file is None else self._file.saved

    @property
    def saved_bytes(self) -> int:
        """The file's size so far."""
        try:
            return self._path.stat().st_size if self._path is not None and self.saved else 0
        except OSError:
            return 0

    @property
    def window_closed(self) -> bool:
        """Whether a person closed the window; it does not come back by itself."""
        return self._window is not None and self._window.closed

    def finish(self) -> None:
        """Says that the session is whole, as :meth:`Recorder.finish` does."""
        self._whole = True

    def save(self) -> None:
        """Writes what waits for the file, and closes it; what comes later only the viewer gets.

        Raises:
            OSError: Not everything of a recording has reached the file.
        """
        if self._file is not None and not self._saved:
            self._saved = True
            self._file.close(self._whole)

    def __enter__(self) -> LiveSession:
        """Is open already."""
        return self

    def __exit__(self, failed: type[BaseException] | None, *exc_info: object) -> None:
        """Saves everything; what the viewer has not seen yet it sees only of a recording that went well."""
        try:
            self.save()
        finally:
            if self._window is not None:
                self._window.leave()
            if self._feed is not None:
                if self._complete and failed is None:
                    self._feed.finish(_SHOWN_WITHIN)
                self._feed.close(end_process=self._viewing.hub is not None)

    def _tell_failure(self, why: str) -> None:
        if self._feed is not None:
            self._feed.offer(Note(why, "ERROR"))

    def _say(self, item: Item) -> None:
        for taker in (self._file, self._feed):
            if taker is not None:
                taker.offer(item)

    def _capped(self, frame: RecordedFrame) -> RecordedFrame:
        """The frame for the viewer: with images only as often as it stands them, of one sensor at a time."""
        if not has_images(frame.pair):
            return frame
        now = frame.pair.time_ns
        if not self._next_image_ns:
            self._next_image_ns = {"a": now + _HALF_NS, "b": now + 3 * _HALF_NS}
        shown = [side for side, due in self._next_image_ns.items() if now >= due]
        for side in shown:
            self._next_image_ns[side] = now + int(_EARLY * 1e9 / self._viewing.depth_hz)
        left_out = "".join(self._next_image_ns.keys() - shown)
        return replace(frame, pair=without_images(frame.pair, left_out)) if left_out else frame

    def _feed_into(self, start: Callable[[], subprocess.Popen[bytes]], restart: bool = True) -> ViewerFeed:
        return ViewerFeed(
            start,
            self._stream(),
            self._begin,
            restart=restart,
            keep=None if self._complete else _VIEWER_QUEUE,
        )

    def _stream(self) -> rr.RecordingStream:
        return rr.RecordingStream(layout.APPLICATION_ID, recording_id=self._id)

    def _begin(self, stream: rr.RecordingStream) -> Recorder:
        return self._with_blueprint(
            stream,
            Recorder(stream, self._setup, self._sources, depth_every=1, start_ns=self._start_ns, points=True),
        )

    def _with_blueprint(self, stream: rr.RecordingStream, recorder: Recorder) -> Recorder:
        """The timeline it names must be there; it is active, or a viewer would show what it remembers."""
        stream.send_blueprint(self._blueprint)
        return recorder


class _Window:
    """A viewer's window that comes back when it crashes, and stays away when a person closes it."""

    def __init__(self, start: Callable[[], subprocess.Popen[bytes]]) -> None:
        self._start = start
        self._leaving = threading.Event()
        self.process = start()
        self.starts = 1
        self.closed = False
        self._thread = threading.Thread(target=self._look_after, name="viewer window", daemon=True)
        self._thread.start()

    def leave(self) -> None:
        """Stops looking after it. The window stays open, with what it has."""
        self._leaving.set()
        self._thread.join(timeout=1.0)

    def _look_after(self) -> None:
        while not self._leaving.wait(_WINDOW_LOOKED_AFTER_EVERY):
            if self.process.poll() is None:
                continue
            if self.process.returncode == 0:
                self.closed = True
                return
            try:
                self.process = self._start()
                self.starts += 1
            except UsageError:
                continue
            if self._leaving.is_set():
                stop(self.process)
