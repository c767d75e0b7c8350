"""The images of two recordings that are fused, and the people in them who are not followed."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from devices.depth.image_thinning import Depth
from devices.recorded.two_recordings import TwoRecordings
from fusion.support.large_arrays import parts
from fusion.support.progress import Progress, quietly
from recordings.data.images import Images, SessionImages, drawn_bones


class RecordingImages(SessionImages):
    """The depth images of two recordings, thinned, and the people who are not followed."""

    def __init__(self, read: TwoRecordings, depth: Depth, progress: Progress = quietly) -> None:
        self._read, self._depth, self._progress = read, depth, progress

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Reads the recording in a separate pass; not even its times where it has no images."""
        if self._read.images["ab".index(side)] is None:
            return Images()

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
