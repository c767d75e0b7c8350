"""A viewer without a screen, and pictures of its views."""

import contextlib
import subprocess

import numpy as np
from rerun.experimental import ViewerClient

from recordings.appearance.colors import SKELETON_COLORS
from recordings.data import layout
from tests.helpers.machine import need_viewer
from viewer_app.addresses import LOOPBACK
from viewer_app.viewer.rerun_process import stop
from viewer_app.viewer.window import start_viewer


@contextlib.contextmanager
def headless_viewer(*arguments, **how):
    """A viewer that draws without a screen; the test is skipped where there is none."""
    with viewer_window("--headless", *arguments, **how) as viewer:
        yield viewer


@contextlib.contextmanager
def viewer_window(*arguments, size=(1200, 800), stdin=subprocess.DEVNULL):
    """A viewer on the display that the environment names."""
    need_viewer()
    process, port = start_viewer(["--window-size", "{}x{}".format(*size), *arguments], stdin)
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
    lines = all(pixels_near(picture, SKELETON_COLORS[side]) > 50 for side in layout.VIEWS)
    return lines and shows_body(picture, 50)


def shows_body(picture, pixels=1000):
    """Whether a picture has S* as a body of at least so many pixels; none: it has not."""
    return picture is not None and pixels_near(picture, SKELETON_COLORS["fused"], 70) >= pixels


def linear(color):
    """(3,) of sRGB without its gamma."""
    srgb = np.array(color) / 255.0
    return np.asarray(np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4))


def contrast(color, background):
    """Contrast of WCAG 2, from 1 to 21."""
    bright = sorted(float(linear(each) @ (0.2126, 0.7152, 0.0722)) + 0.05 for each in (color, background))
    return bright[1] / bright[0]
