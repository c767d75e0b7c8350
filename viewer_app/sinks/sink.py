"""The contract of the outputs of a loop: viewer, file, network."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

from devices.events import Event
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.session_arrays import RecordedFrame


class Sink:
    """Receives the output of a loop. Each method does nothing; a sink overrides those that it needs.

    The loop calls the methods on its own thread, so they must not block. A sink that may wait for a disk, a
    process or a network puts its items into a queue.
    """

    def write(self, frame: RecordedFrame) -> None:
        """Takes the next frame."""

    def event(self, event: Event) -> None:
        """Takes an event, at the time of the last frame."""

    def recalibrated(self, setup: FusionSetup) -> None:
        """Takes the setup of the following frames; a new fuser starts."""

    def coach(self, page: CoachPage) -> None:
        """Takes the coach's page, at the time of the last frame."""

    def rest(self, seconds: float) -> None:
        """Waits until the last frame is passed on, at most so long; the loop then does what is not urgent."""

    def finish(self) -> None:
        """Called when the loop has ended normally; no frame follows."""

    def close(self) -> None:
        """Writes the queued items and closes. Closing twice has no effect."""


class FanOut(Sink):
    """Passes everything on to several sinks, in their order."""

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self.sinks = tuple(sinks)

    def write(self, frame: RecordedFrame) -> None:
        """To each."""
        for sink in self.sinks:
            sink.write(frame)

    def event(self, event: Event) -> None:
        """To each."""
        for sink in self.sinks:
            sink.event(event)

    def recalibrated(self, setup: FusionSetup) -> None:
        """To each."""
        for sink in self.sinks:
            sink.recalibrated(setup)

    def coach(self, page: CoachPage) -> None:
        """To each."""
        for sink in self.sinks:
            sink.coach(page)

    def rest(self, seconds: float) -> None:
        """To each."""
        for sink in self.sinks:
            sink.rest(seconds)

    def finish(self) -> None:
        """To each."""
        for sink in self.sinks:
            sink.finish()

    def close(self) -> None:
        """Closes each sink, even if closing another one fails."""
        with ExitStack() as closing:
            for sink in reversed(self.sinks):
                closing.callback(sink.close)
