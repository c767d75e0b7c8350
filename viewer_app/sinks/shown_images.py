"""Passes the depth images of a session to the viewer while they are read."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from devices.sensor import ColorImage
from recordings.images import Images, MadeImages
from recordings.session import Session
from viewer_app.sinks.viewer_sink import ViewerSink


class ShownImages:
    """The images of a session; each depth image is shown when it is read.

    Args:
        session: The session.
        viewer: The viewer that shows the depth images.
    """

    def __init__(self, session: Session, viewer: ViewerSink) -> None:
        self._session, self._viewer = session, viewer

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Returns depth images that are shown one by one while they are read."""

        def made() -> Iterator[tuple[int, NDArray[np.uint16]]]:
            for k, image in self._session.images.depth(side, frames):
                self._viewer.depth_image(side, k, int(self._session.time_ns[k]), image)
                yield k, image

        return MadeImages(made)

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        """Returns colour images without showing them."""
        return self._session.images.color(side, frames)
