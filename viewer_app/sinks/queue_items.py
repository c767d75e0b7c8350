"""What waits in a sink's queue until its thread writes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from devices.image_thinning import has_images, without_images
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.events import Phase
from recordings.session_arrays import RecordedFrame
from recordings.writing.recorder import Recorder

Opening = Callable[[rr.RecordingStream], Recorder]
"""Writes what is static, and gives the recorder to go on with."""


class Item(Protocol):
    """One thing to be written."""

    def write(self, recorder: Recorder) -> None:
        """Puts it where it belongs."""
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
        """The same with skeletons only."""
        return replace(self, frame=replace(self.frame, pair=without_images(self.frame.pair)))

    def write(self, recorder: Recorder) -> None:
        """By columns, as :func:`write_items` does with several."""
        recorder.record_all([self.frame], [self.number])


@dataclass(frozen=True, eq=False)
class Note:
    """An event.

    Attributes:
        text: What is said.
        level: How bad it is.
        topic, phase: Of a spell that begins or ends.
    """

    text: str
    level: str = "INFO"
    topic: str = ""
    phase: Phase = "moment"

    def write(self, recorder: Recorder) -> None:
        """At the time of the last frame."""
        recorder.event(self.text, self.level, self.topic, self.phase)


@dataclass(frozen=True, eq=False)
class Image:
    """A depth image of a frame that was given before.

    Attributes:
        side: Whose.
        frame: Of which frame.
        time_ns: Since the first pair.
        depth: (height, width) uint16 millimetres.
    """

    side: str
    frame: int
    time_ns: int
    depth: NDArray[np.uint16]

    def write(self, recorder: Recorder) -> None:
        """At the time of its frame."""
        recorder.record_depth(self.side, self.frame, self.time_ns, self.depth)


@dataclass(frozen=True, eq=False)
class Recalibration:
    """What the frames that follow are fused with."""

    setup: FusionSetup

    def write(self, recorder: Recorder) -> None:
        """Before those frames."""
        recorder.recalibrated(self.setup)


@dataclass(frozen=True, eq=False)
class Page:
    """The coach's page."""

    page: CoachPage

    def write(self, recorder: Recorder) -> None:
        """At the time of the last frame."""
        recorder.coach(self.page)


def write_items(recorder: Recorder, items: Sequence[Item]) -> None:
    """Writes items in order, frames that follow each other by columns."""
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
