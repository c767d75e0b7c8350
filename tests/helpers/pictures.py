"""A viewer without a screen, and what can be seen in it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rerun.experimental import ViewerClient

from recordings import layout
from viewer_app.errors import UsageError
from viewer_app.viewer.rerun_process import LOOPBACK, start_viewer, stop


@contextlib.contextmanager
def headless_viewer(*arguments: str) -> Iterator[ViewerClient]:
    """A viewer that draws without a screen; the test is skipped where there is none."""
    try:
        process, port = start_viewer(["--headless", "--window-size", "1200x800", *arguments])
    except UsageError:
        pytest.skip("no headless viewer here; it needs a Vulkan driver (Debian: mesa-vulkan-drivers)")
    try:
        yield ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
    finally:
        stop(process)


def eventually(holds: Callable[[], bool], within: float = 15.0) -> bool:
    """Whether something comes true in another process within some seconds."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        if holds():
            return True
        time.sleep(0.05)
    return holds()


def picture_of(viewer: ViewerClient, path: Path) -> NDArray[np.uint8]:
    """(height, width, 3) RGB of the whole window."""
    viewer.save_screenshot(str(path))
    picture = cv2.imread(str(path))
    assert picture is not None
    return np.asarray(picture[..., ::-1])


def pixels_near(picture: NDArray[np.uint8], color: layout.Color, within: int = 24) -> int:
    """How many pixels have nearly this colour."""
    return int((np.abs(picture.astype(int) - color).max(axis=2) <= within).sum())
