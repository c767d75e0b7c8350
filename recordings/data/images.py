"""What a session shows beside its frames: images, people who are not followed, and what was logged live.

None here; :mod:`recordings.fusing.recording_images` has those of two recordings,
:mod:`recordings.file.stored_images` a session file's.
"""

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from devices.sensor import ColorImage
from fusion.body import Body

T = TypeVar("T")


class Images(Generic[T]):
    """Images of one sensor, or its other people, with their frame numbers, in order.

    Each iteration makes them anew.

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

    def logged(self) -> Iterator[tuple[str, pa.RecordBatch]]:
        """What a live capture logged beside its frames (:func:`layout.is_logged`): entity and chunk."""
        return iter(())


def drawn_bones(body: Body, positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """(n, 2, 3) metres: of each known bone of people (N, J, 3), its outer end and the way to its parent."""
    ends = positions[:, body.bone_joints]
    along = positions[:, body.parent_indices[body.bone_joints]] - ends
    known = np.isfinite(along).all(axis=2)
    return np.stack((ends[known], along[known]), axis=1).astype(np.float32, copy=False)


NO_IMAGES = SessionImages()
