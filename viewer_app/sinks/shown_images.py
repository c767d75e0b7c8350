"""A session's depth images, passed on to the viewer as they are read."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from devices.sensor import ColorImage
from recordings.images.session_images import Images, MadeImages
from recordings.session import Session
from viewer_app.sinks.viewer_sink import ViewerSink


class ShownImages:
    """A session's images; reading a depth image shows it.

    Args:
        session: Whose images.
        viewer: Where they are shown.
    """

    def __init__(self, session: Session, viewer: ViewerSink) -> None:
        self._session, self._viewer = session, viewer

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        """Shown one by one."""

        def made() -> Iterator[tuple[int, NDArray[np.uint16]]]:
            for k, image in self._session.images.depth(side, frames):
                self._viewer.depth_image(side, k, int(self._session.time_ns[k]), image)
                yield k, image

        return MadeImages(made)

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        """Not shown."""
        return self._session.images.color(side, frames)
