"""A session's images: of two recordings, or none. :mod:`recordings.file.stored_images` has a file's."""

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from devices.depth.image_thinning import Depth
from devices.sensor import ColorImage
from devices.two_recordings import TwoRecordings
from fusion.progress import Progress, quietly

T = TypeVar("T")


class Images(Generic[T]):
    """Images of one sensor with their frame numbers, in order; made by a function at each iteration.

    Attributes:
        damaged: Number of images that the last iteration skipped because their checksums do not match.
    """

    def __init__(self, made: Callable[[], Iterator[tuple[int, T]]] = lambda: iter(())) -> None:
        self._made, self.damaged = made, 0

    def __iter__(self) -> Iterator[tuple[int, T]]:
        return self._made()

    def count(self) -> int:
        """Counts the whole images."""
        return sum(1 for _ in self)


class SessionImages:
    """The images of both sensors; none, unless a subclass has some."""

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Depth images, (height, width) millimetres each."""
        del side, frames
        return Images()

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        """Colour images, compressed as the cameras gave them."""
        del side, frames
        return Images()


class RecordingImages(SessionImages):
    """The depth images of two recordings, thinned."""

    def __init__(self, read: TwoRecordings, depth: Depth, progress: Progress = quietly) -> None:
        self._read, self._depth, self._progress = read, depth, progress

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Reads the recording in a separate pass."""

        def made() -> Iterator[tuple[int, NDArray[np.uint16]]]:
            images = self._read.depth_images(side, self._depth, self._progress)
            return ((k, image) for k, image in images if k in frames)

        return Images(made)


NO_IMAGES = SessionImages()
