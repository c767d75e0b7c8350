"""A viewer without a screen, and pictures of its views."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import cv2
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


def picture_of(viewer: ViewerClient, path: Path) -> NDArray[np.uint8]:
    """(height, width, 3) RGB of the whole window."""
    viewer.save_screenshot(str(path))
    picture = cv2.imread(str(path))
    return np.asarray(picture[..., ::-1])


def pixels_near(picture: NDArray[np.uint8], color: Color, within: int = 24) -> int:
    """How many pixels have nearly this colour."""
    return int((np.abs(picture.astype(int) - color).max(axis=2) <= within).sum())


def colors_of_view(viewer: ViewerClient, view_id: object, path: Path) -> int:
    """How many colours a view shows; 0 while it is not drawn."""
    try:
        viewer.save_screenshot(str(path), view_id)
    except ConnectionError:  # the view is known before it is on the screen
        return 0
    picture = cv2.imread(str(path))
    return 0 if picture is None else len(np.unique(picture.reshape(-1, 3), axis=0))
