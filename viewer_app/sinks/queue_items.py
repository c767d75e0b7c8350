"""Items of a sink's queue, written by the sink's thread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from devices.depth.image_thinning import has_images, without_images
from devices.events import Event, Phase
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.session_arrays import RecordedFrame
from recordings.writing.recorder import Recorder

Opening = Callable[[rr.RecordingStream], Recorder]
"""Writes the static data and returns the recorder."""


class Item(Protocol):
    """One item to write."""

    def write(self, recorder: Recorder) -> None:
        """Writes the item to the recorder."""
        ...


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame and its number."""

    number: int
    frame: RecordedFrame

    @property
    def has_images(self) -> bool:
        """Whether a sensor's frame has an image."""
        return has_images(self.frame.pair)

    def without_images(self) -> Frame:
        """The frame without images."""
        return replace(self, frame=replace(self.frame, pair=without_images(self.frame.pair)))

    def write(self, recorder: Recorder) -> None:
        """Writes the frame by columns, as :func:`write_items` does for several frames."""
        recorder.record_all([self.frame], [self.number])


@dataclass(frozen=True, eq=False)
class Note:
    """An event.

    Attributes:
        text: The message.
        level: Severity.
        topic, phase: Topic and phase of a spell.
    """

    text: str
    level: str = "INFO"
    topic: str = ""
    phase: Phase = "moment"

    def write(self, recorder: Recorder) -> None:
        """At the time of the last frame."""
        recorder.event(Event(self.text, self.level, self.topic, self.phase))  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Image:
    """A depth image of an earlier frame.

    Attributes:
        side: The sensor, ``a`` or ``b``.
        frame: The frame number.
        time_ns: Time since the first pair.
        depth: (height, width) uint16 millimetres.
    """

    side: str
    frame: int
    time_ns: int
    depth: NDArray[np.uint16]

    def write(self, recorder: Recorder) -> None:
        """Writes the image at the time of its frame."""
        recorder.record_depth(self.side, self.frame, self.time_ns, self.depth)


@dataclass(frozen=True, eq=False)
class Recalibration:
    """A new setup for the following frames."""

    setup: FusionSetup

    def write(self, recorder: Recorder) -> None:
        """Writes the calibration before these frames."""
        recorder.recalibrated(self.setup)


@dataclass(frozen=True, eq=False)
class Page:
    """The coach's page."""

    page: CoachPage

    def write(self, recorder: Recorder) -> None:
        """At the time of the last frame."""
        recorder.coach(self.page)


def write_items(recorder: Recorder, items: Sequence[Item]) -> None:
    """Writes items in order; consecutive frames are written by columns."""
    run: list[Frame] = []

    def write_run() -> None:
        if run:
            recorder.record_all([item.frame for item in run], [item.number for item in run])
            run.clear()

    for item in items:
        if isinstance(item, Frame):
            run.append(item)
        else:
            write_run()
            item.write(recorder)
    write_run()
