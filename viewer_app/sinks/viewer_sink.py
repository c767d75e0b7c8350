"""A viewer as a sink: a hub that viewers connect to, a window, or both."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from uuid import UUID

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from devices.events import Phase
from fusion.setup import FusionSetup
from recordings import layout
from recordings.appearance.coach_page import CoachPage
from recordings.session_arrays import RecordedFrame
from recordings.writing.recorder import Recorder
from viewer_app.errors import UsageError
from viewer_app.sinks.image_turns import ImageTurns
from viewer_app.sinks.queue_items import Frame, Image, Note, Page, Recalibration
from viewer_app.sinks.sink import Sink
from viewer_app.sinks.viewer_feed import ViewerFeed
from viewer_app.viewer.rerun_process import ViewerWindow, start_window, start_window_on_pipe
from viewer_app.viewer.viewer_choice import Viewing

_QUEUE = 60
"""Maximum number of queued frames: two seconds; older frames are dropped."""
_SHOWN_WITHIN = 60.0  # seconds
_BEGINS_WITHIN = 1.0  # seconds
_SHOWN_EVERY = 3  # depth images of a recording
_PLOTS_EVERY = 5  # frames, a sixth of a second


class ViewerSink(Sink):
    """Interface of a viewer sink; this base class shows nothing."""

    @property
    def dropped(self) -> int:
        """Frames that the viewer was too slow for."""
        return 0

    @property
    def window_closed(self) -> bool:
        """Whether the user closed the window; it does not reopen by itself."""
        return False

    @property
    def wait_for_turn(self) -> Callable[[float], object] | None:
        """A function that waits until the queued items are written, at most the given seconds; None without a
        viewer."""
        return None

    @property
    def wait_until_free(self) -> Callable[[float], object] | None:
        """A function that waits while a frame is being written, at most the given seconds; None without a
        viewer."""
        return None

    def depth_image(self, side: str, frame: int, time_ns: int, depth: NDArray[np.uint16]) -> None:
        """Takes a depth image of an earlier frame, for recordings only.

        Args:
            side: ``a`` or ``b``.
            frame: The frame's number.
            time_ns: Since the first pair.
            depth: (height, width) millimetres.
        """


class ShownSession(ViewerSink):
    """A session in a viewer, fed from a separate thread; the loop never waits for it.

    Args:
        setup: Settings, cameras and the first calibration.
        sources: What the sensors are called, K_A first.
        blueprint: What the viewer shows.
        viewing: A hub, a window, or both.
        identity: Of the recording.
        complete: Whether the viewer gets every frame and closing waits for it. This is for recordings, whose
            frames
        are in memory anyway.

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
        self._viewing, self._identity, self._complete = viewing, identity, complete
        self._offered = 0
        self._start_ns: int | None = None
        self._whole = False
        self._turns = ImageTurns(viewing.depth_hz)
        self.window: ViewerWindow | None = None
        """The supervised window; None if there is none."""
        hub = viewing.hub
        if hub is None:
            self.feed = self._feed_into(start_window_on_pipe, restart=False)
            return
        self.feed = self._feed_into(hub.start)
        try:
            hub.wait_until_listening(self.feed.process)
        except UsageError:
            self.feed.close(end_process=True)
            raise
        # While a hub takes the static data, it would hold up the first frames.
        self.feed.wait_until_free(_BEGINS_WITHIN)
        if viewing.window:
            self.window = ViewerWindow(lambda: start_window(hub, viewing.headless))

    def write(self, frame: RecordedFrame) -> None:
        """Takes a frame, without waiting."""
        if self._start_ns is None:
            self._start_ns = frame.pair.time_ns
        self.feed.offer(Frame(self._offered, self._turns.capped(frame)))
        self._offered += 1

    def event(self, text: str, level: str = "INFO", topic: str = "", phase: Phase = "moment") -> None:
        """Takes an event, without waiting."""
        self.feed.offer(Note(text, level, topic, phase))

    def recalibrated(self, setup: FusionSetup) -> None:
        """Takes a calibration; a viewer that connects later starts with it."""
        self._setup = setup
        self.feed.offer(Recalibration(setup))

    def coach(self, page: CoachPage) -> None:
        """Takes a page, without waiting."""
        self.feed.offer(Page(page))

    def depth_image(self, side: str, frame: int, time_ns: int, depth: NDArray[np.uint16]) -> None:
        """Takes a depth image; one of three is shown."""
        if frame % _SHOWN_EVERY == 0:
            self.feed.offer(Image(side, frame, time_ns, depth))

    def finish(self) -> None:
        """Makes closing wait until the viewer has everything, if `complete` is set."""
        self._whole = True

    def close(self) -> None:
        """Stops feeding. The window stays; a hub ends."""
        if self.window is not None:
            self.window.leave()
        if self._complete and self._whole:
            self.feed.finish(_SHOWN_WITHIN)
        self.feed.close(end_process=self._viewing.hub is not None)

    @property
    def dropped(self) -> int:
        """Frames that the viewer was too slow for."""
        return self.feed.dropped

    @property
    def window_closed(self) -> bool:
        """Whether a person closed the window."""
        return self.window is not None and self.window.closed

    @property
    def wait_for_turn(self) -> Callable[[float], object] | None:
        """Waits until the feed has written, so many seconds at most."""
        return self.feed.wait_for_turn

    @property
    def wait_until_free(self) -> Callable[[float], object] | None:
        """Waits while the feed writes, so many seconds at most."""
        return self.feed.wait_until_free

    def rest(self, seconds: float) -> None:
        """Waits until the feed has written."""
        self.feed.wait_until_free(seconds)

    def _feed_into(self, start: Callable[[], subprocess.Popen[bytes]], restart: bool = True) -> ViewerFeed:
        stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=self._identity)
        keep = None if self._complete else _QUEUE
        return ViewerFeed(start, stream, self._begin, restart=restart, keep=keep)

    def _begin(self, stream: rr.RecordingStream) -> Recorder:
        recorder = Recorder(
            *(stream, self._setup, self._sources),
            depth_every=1,
            start_ns=self._start_ns,
            points=True,
            plots_every=_PLOTS_EVERY,
        )
        # the timeline it names must be there; it is active, or a viewer would show what it remembers
        stream.send_blueprint(self._blueprint)
        return recorder


def viewer_sink(
    setup: FusionSetup,
    sources: tuple[str, str],
    blueprint: rrb.Blueprint,
    viewing: Viewing | None,
    identity: UUID,
    complete: bool = False,
) -> ViewerSink:
    """A :class:`ShownSession`, or a sink that shows nothing where `viewing` asks for no viewer."""
    if viewing is None or not (viewing.window or viewing.hub):
        return ViewerSink()
    return ShownSession(setup, sources, blueprint, viewing, identity, complete)
