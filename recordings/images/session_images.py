"""Where the images of a session come from: its file, the frames it was made of, or nowhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from devices.image_thinning import Depth
from devices.pairing import FramePair
from devices.sensor import ColorImage, SensorFrame
from devices.two_recordings import Progress, TwoRecordings, quietly
from recordings.images.color_images import read_color
from recordings.images.depth_images import read_depth

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class Images(Protocol[T_co]):
    """Images of one sensor with the numbers of their frames, in their order; read while iterating."""

    @property
    def damaged(self) -> int:
        """How many the last reading left out because they do not fit their checksums."""
        ...

    def __iter__(self) -> Iterator[tuple[int, T_co]]:
        """Reads them one by one."""
        ...

    def count(self) -> int:
        """How many whole images there are."""
        ...


class SessionImages(Protocol):
    """The images of both sensors."""

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """(height, width) millimetres each."""
        ...

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        """As the cameras compressed them."""
        ...


class FileImages:
    """The images in a session's file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Read from the file."""
        return read_depth(self._path, side, frames)

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        """Read from the file."""
        return read_color(self._path, side, frames)


class PairImages:
    """The images that pairs in memory have.

    Args:
        pairs: In order.
        every: Of every so many pairs; 0 for none.
    """

    def __init__(self, pairs: Sequence[FramePair], every: int = 1) -> None:
        self._pairs, self._every = pairs, every

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Of the sensor's frames."""
        return MadeImages(lambda: self._of(side, frames, lambda frame: frame.depth))

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        """Of the sensor's frames."""
        return MadeImages(lambda: self._of(side, frames, lambda frame: frame.color))

    def _of(
        self, side: str, frames: range, image_of: Callable[[SensorFrame], T | None]
    ) -> Iterator[tuple[int, T]]:
        if self._every == 0:
            return
        for k in range(frames.start, min(frames.stop, len(self._pairs))):
            frame: SensorFrame | None = getattr(self._pairs[k], side)
            image = None if frame is None or k % self._every else image_of(frame)
            if image is not None:
                yield k, image


class RecordingImages:
    """The depth images of two recordings, thinned.

    Args:
        read: The recordings.
        depth: How much of each image.
        progress: Shows how far reading is.
    """

    def __init__(self, read: TwoRecordings, depth: Depth, progress: Progress = quietly) -> None:
        self._read, self._depth, self._progress = read, depth, progress

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Read from the recording, in a pass of its own."""

        def made() -> Iterator[tuple[int, NDArray[np.uint16]]]:
            images = self._read.depth_images(side, self._depth, self._progress)
            return ((k, image) for k, image in images if k in frames)

        return MadeImages(made)

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        """There are none."""
        del side, frames
        return MadeImages(lambda: iter(()))


class MadeImages(Images[T]):
    """Images that a function gives anew each time; none is damaged."""

    def __init__(self, made: Callable[[], Iterator[tuple[int, T]]]) -> None:
        self._made = made

    @property
    def damaged(self) -> int:
        """None is."""
        return 0

    def __iter__(self) -> Iterator[tuple[int, T]]:
        """Calls the function."""
        return self._made()

    def count(self) -> int:
        """Goes through all."""
        return sum(1 for _ in self._made())


NO_IMAGES: SessionImages = PairImages((), 0)
"""Of a session without any."""
