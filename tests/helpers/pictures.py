"""A viewer without a screen, and pictures of its views."""

import contextlib
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from rerun.experimental import ViewerClient

from recordings.appearance.colors import Color
from tests.helpers.machine import need_viewer
from viewer_app.addresses import LOOPBACK
from viewer_app.viewer.rerun_process import start_viewer, stop


@contextlib.contextmanager
def headless_viewer(*arguments: str) -> Iterator[ViewerClient]:
    """A viewer that draws without a screen; the test is skipped where there is none."""
    need_viewer()
    process, port = start_viewer(["--headless", "--window-size", "1200x800", *arguments])
    try:
        yield ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
    finally:
        stop(process)


def pixels_near(picture: NDArray[np.uint8], color: Color, within: int = 24) -> int:
    """How many pixels have nearly this colour."""
    return int((np.abs(picture.astype(int) - color).max(axis=2) <= within).sum())
