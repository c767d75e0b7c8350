"""The contract of the outputs of a loop: viewer, file, network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from devices.events import Event
from fusion.setup import FusionSetup
from recordings.data.session_arrays import SessionFrame

if TYPE_CHECKING:
    from recordings.appearance.coach_page import CoachPage


class Sink:
    """Receives the output of a loop. Each method does nothing; a sink overrides those that it needs.

    The loop calls the methods on its own thread, so they must not block. A sink that may wait for a disk, a
    process or a network puts its items into a queue.
    """

    def write(self, frame: SessionFrame) -> None:
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


def _to_each(method: str) -> Callable[..., None]:
    def call(self: Any, *arguments: object) -> None:
        for sink in self.sinks:
            getattr(sink, method)(*arguments)

    return call


class FanOut(Sink):
    """Passes everything on to several sinks, in their order."""

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self.sinks = tuple(sinks)

    write, event, recalibrated = _to_each("write"), _to_each("event"), _to_each("recalibrated")
    coach, rest, finish = _to_each("coach"), _to_each("rest"), _to_each("finish")

    def close(self) -> None:
        """Closes each sink, even if closing another one fails."""
        with ExitStack() as closing:
            for sink in reversed(self.sinks):
                closing.callback(sink.close)
