"""The contract of everything a loop's frames go to: a viewer, a file, the network."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.events import Phase
from recordings.session_arrays import RecordedFrame


class Sink:
    """Takes what a loop makes. Each method does nothing here: a sink overrides what it has a use for.

    The loop calls the methods on its own thread and must not be held up: a sink that may wait for a disk, a
    process or a network takes its items into a queue.
    """

    def write(self, frame: RecordedFrame) -> None:
        """Takes the next frame."""

    def event(self, text: str, level: str = "INFO", topic: str = "", phase: Phase = "moment") -> None:
        """Takes what happened, at the time of the last frame.

        Args:
            text: What.
            level: How bad: INFO, WARN or ERROR.
            topic, phase: Of a spell that begins or ends; see :class:`recordings.events.Event`.
        """

    def recalibrated(self, setup: FusionSetup) -> None:
        """Takes what the frames that follow are fused with, by a new fuser."""

    def coach(self, page: CoachPage) -> None:
        """Takes what to do next, at the time of the last frame."""

    def finish(self) -> None:
        """Takes that the loop has ended as it should: no frame follows."""

    def close(self) -> None:
        """Writes what waits, and ends. Closing twice is harmless."""


class NullSink(Sink):
    """Takes everything and keeps nothing."""


class FanOut(Sink):
    """Passes everything on to several sinks, in their order."""

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self.sinks = tuple(sinks)

    def write(self, frame: RecordedFrame) -> None:
        """To each."""
        for sink in self.sinks:
            sink.write(frame)

    def event(self, text: str, level: str = "INFO", topic: str = "", phase: Phase = "moment") -> None:
        """To each."""
        for sink in self.sinks:
            sink.event(text, level, topic, phase)

    def recalibrated(self, setup: FusionSetup) -> None:
        """To each."""
        for sink in self.sinks:
            sink.recalibrated(setup)

    def coach(self, page: CoachPage) -> None:
        """To each."""
        for sink in self.sinks:
            sink.coach(page)

    def finish(self) -> None:
        """To each."""
        for sink in self.sinks:
            sink.finish()

    def close(self) -> None:
        """Closes each, whatever becomes of the others."""
        with ExitStack() as closing:
            for sink in reversed(self.sinks):
                closing.callback(sink.close)
