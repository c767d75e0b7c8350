"""What a session shows beside its frames: images, and people who are not followed.

Of two recordings, or none; :mod:`recordings.file.stored_images` has a file's.
"""

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from devices.depth.image_thinning import Depth
from devices.sensor import ColorImage
from devices.two_recordings import TwoRecordings
from fusion.body import Body
from fusion.large_arrays import parts
from fusion.progress import Progress, quietly

T = TypeVar("T")


class Images(Generic[T]):
    """Images of one sensor, or its other people, with their frame numbers, in order.

    A function makes them at each iteration.

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
    """The images of both sensors and the people who are not followed; none, unless a subclass has some."""

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Depth images, (height, width) millimetres each."""
        del side, frames
        return Images()

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        """Colour images, compressed as the cameras gave them."""
        del side, frames
        return Images()

    def others(self, side: str, frames: range) -> Images[NDArray[np.float32]]:
        """The people who are not followed, as :func:`drawn_bones`; of frames with some, and the next one."""
        del side, frames
        return Images()


def drawn_bones(body: Body, positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """(n, 2, 3) metres: of each known bone of people (N, J, 3), its outer end and the way to its parent."""
    ends = positions[:, body.bone_joints]
    along = positions[:, body.parent_indices[body.bone_joints]] - ends
    known = np.isfinite(along).all(axis=2)
    return np.stack((ends[known], along[known]), axis=1).astype(np.float32, copy=False)


class RecordingImages(SessionImages):
    """The depth images of two recordings, thinned, and the people who are not followed."""

    def __init__(self, read: TwoRecordings, depth: Depth, progress: Progress = quietly) -> None:
        self._read, self._depth, self._progress = read, depth, progress

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Reads the recording in a separate pass."""

        def made() -> Iterator[tuple[int, NDArray[np.uint16]]]:
            images = self._read.depth_images(side, self._depth, self._progress)
            return ((k, image) for k, image in images if k in frames)

        return Images(made)

    def others(self, side: str, frames: range) -> Images[NDArray[np.float32]]:
        """Those of the recording."""
        k = "ab".index(side)
        people = self._read.others[k]
        if people is None:
            return Images()

        def made() -> Iterator[tuple[int, NDArray[np.float32]]]:
            of_frame = self._read.pairing.pairs.skeletons.frames[:, k]
            shown = False
            for part in parts(len(frames)):
                here = np.arange(frames[part.start], frames[part.stop - 1] + 1)
                here = here[of_frame[here] >= 0]
                first, end = (np.searchsorted(people.frame, of_frame[here] + of) for of in (0, 1))
                for number, begin, stop in zip(here.tolist(), first.tolist(), end.tolist(), strict=True):
                    if shown or begin < stop:
                        yield number, drawn_bones(people.body, people.skeletons.positions[begin:stop])
                    shown = begin < stop

        return Images(made)


NO_IMAGES = SessionImages()
