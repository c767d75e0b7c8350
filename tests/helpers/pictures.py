"""A viewer without a screen, and pictures of its views."""

import contextlib

import numpy as np
from rerun.experimental import ViewerClient

from recordings import layout
from recordings.appearance.colors import SKELETON_COLORS
from tests.helpers.machine import need_viewer
from viewer_app.addresses import LOOPBACK
from viewer_app.viewer.rerun_process import stop
from viewer_app.viewer.window import start_viewer


@contextlib.contextmanager
def headless_viewer(*arguments, size=(1200, 800)):
    """A viewer that draws without a screen; the test is skipped where there is none."""
    need_viewer()
    process, port = start_viewer(["--headless", "--window-size", "{}x{}".format(*size), *arguments])
    try:
        yield ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
    finally:
        stop(process)


def pixels_near(picture, color, within=24):
    """How many pixels have nearly this colour."""
    return int((np.abs(picture.astype(int) - color).max(axis=2) <= within).sum())


def shows_skeletons(picture):
    """Whether a picture has S_A and S_B as lines and S* as a body, which has shades; none: it has not."""
    if picture is None:
        return False
    lines = all(pixels_near(picture, SKELETON_COLORS[side]) > 50 for side in layout.SIDES)
    return lines and shows_body(picture, 50)


def shows_body(picture, pixels=1000):
    """Whether a picture has S* as a body of at least so many pixels; none: it has not."""
    return picture is not None and pixels_near(picture, SKELETON_COLORS["fused"], 70) >= pixels
