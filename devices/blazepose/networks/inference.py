"""BlazePose's two networks: one finds people in an image, the other places landmarks on one person.

The layouts of the tensors are those of MediaPipe's graphs ``pose_detection`` and ``pose_landmark``.
"""

import os
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from devices.check import words_of
from devices.sensor import DeviceError
from fusion.support.types import Array

DETECTOR_SIZE, LANDMARK_SIZE = 224, 256
"""Side of the networks' input images, pixels."""
LANDMARK_COUNT = 33
"""Number of landmarks on the body; the network gives six more, of which two describe the next region."""
CENTRE, RIM = 33, 34
"""The two landmarks that describe the region: middle of the hips, and a point of the circle around it."""

_LANDMARK_OUTPUTS = (39 * 5, 64 * 64 * 39, 39 * 3, 1)  # values of: rows, heat maps, world, pose flag
_LEAST_SCORE = 0.3  # of a detection; MediaPipe takes 0.5. The landmark network rejects what is no person.
_OVERLAP = 0.3  # intersection over union at which two detections are the same person; MediaPipe's
_STRIDES = ((8, 2), (16, 2), (32, 6))  # of the detector's grids: pixels, anchors per cell
_HEATMAP_WINDOW = 3  # cells to each side of a landmark
_HEATMAP_LEAST = 0.5  # least peak of a heat map that may move its landmark; MediaPipe's
_one_at_a_time = threading.Lock()


@dataclass(frozen=True, eq=False)
class Detection:
    """A person found in an image."""

    centre: Array  # (2,) middle of the hips, pixels of the detector's input
    rim: Array  # (2,) point of the circle around the body, above the head
    score: float  # 0 to 1


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Output of the landmark network for a crop."""

    pixels: Array  # (39, 2) in pixels of the crop
    visibility: Array  # (39,) probability that the landmark is in the image and nothing covers it
    presence: Array  # (39,) probability that the landmark is in the image
    world: Array  # (33, 3) metres from the middle of the hips; x, y along the crop, z away from the camera
    score: float  # probability that the crop holds a person


class _Network:
    """One network file, loaded."""

    def __init__(self, content: bytes, threads: int = 1) -> None:
        try:
            from ai_edge_litert.interpreter import Interpreter
        except Exception as fault:  # a damaged library raises what it likes
            raise DeviceError(
                f"The body tracker's runtime ai-edge-litert cannot be imported ({words_of(fault)}). "
                "Run pip install ai-edge-litert; it has no wheel for macOS on Intel."
            ) from None
        try:
            with without_notes():
                self._interpreter: Any = Interpreter(model_content=content, num_threads=threads)
                self._interpreter.allocate_tensors()
        except (RuntimeError, ValueError) as fault:
            raise DeviceError(f"The body tracker's network cannot be loaded: {fault}.") from None
        self._input = self._interpreter.get_input_details()[0]["index"]
        self._outputs = [
            (output["index"], int(np.prod(output["shape"])))
            for output in self._interpreter.get_output_details()
        ]

    def run(self, image: NDArray[np.float32], sizes: Sequence[int]) -> list[NDArray[np.float32]]:
        """The outputs with these numbers of values, flat, for an (h, w, 3) image."""
        self._interpreter.set_tensor(self._input, np.ascontiguousarray(image[None], dtype=np.float32))
        self._interpreter.invoke()
        index_of = {size: index for index, size in self._outputs}
        return [self._interpreter.get_tensor(index_of[size]).reshape(-1) for size in sizes]


class Detector(_Network):
    """Finds people in an image."""

    def detect(self, image: NDArray[np.float32]) -> list[Detection]:
        """The people in an image, the most certain one first.

        Args:
            image: (224, 224) grey or (224, 224, 3) RGB, 0 to 1.
        """
        anchors = _anchors()
        count = len(anchors)
        boxes, logits = self.run(2.0 * _three_channels(image) - 1.0, (12 * count, count))
        scores = _sigmoid(logits)
        likely = np.flatnonzero(scores >= _LEAST_SCORE)
        likely = likely[np.argsort(-scores[likely], kind="stable")]
        points = boxes.reshape(-1, 6, 2)[likely].astype(np.float64)
        points[:, [0, 2, 3, 4, 5]] += DETECTOR_SIZE * anchors[likely, None]
        found: list[Detection] = []
        kept: list[int] = []
        for i, k in enumerate(likely):
            if all(_overlap(points[i, :2], points[j, :2]) < _OVERLAP for j in kept):
                kept.append(i)
                # a box spans pixel edges; pixel centres are half a pixel less
                found.append(Detection(points[i, 2] - 0.5, points[i, 3] - 0.5, float(scores[k])))
        return found


class LandmarkNetwork(_Network):
    """Places landmarks on the person in a crop."""

    def place(self, image: NDArray[np.float32]) -> Landmarks:
        """The landmarks of the person in a crop.

        Args:
            image: (256, 256) grey or (256, 256, 3) RGB, 0 to 1.
        """
        values, heat, world, score = self.run(_three_channels(image), _LANDMARK_OUTPUTS)
        rows = values.reshape(39, 5).astype(np.float64)
        pixels = _refined(rows[:, :2], heat.reshape(64, 64, 39))
        return Landmarks(
            pixels - 0.5,
            _sigmoid(rows[:, 3]),
            _sigmoid(rows[:, 4]),
            world.reshape(39, 3)[:LANDMARK_COUNT].astype(np.float64),
            float(score[0]),
        )


@contextmanager
def without_notes() -> Iterator[None]:
    """Drops lines that begin with ``INFO:`` from what native code writes to standard error meanwhile.

    The runtime of the networks has no setting for its notes. Other lines appear when the context ends.
    """
    with _one_at_a_time, tempfile.TemporaryFile() as caught:
        try:
            terminal = os.dup(2)
        except OSError:  # no standard error
            yield
            return
        os.dup2(caught.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(terminal, 2)
            caught.seek(0)
            kept = b"".join(line for line in caught if not line.startswith(b"INFO:"))
            if kept:
                os.write(terminal, kept)
            os.close(terminal)


def _three_channels(image: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.merge((image, image, image)), np.float32) if image.ndim == 2 else image


@cache
def _anchors() -> Array:
    """(2254, 2) centres of the detector's anchors, as shares of the image."""
    centres = []
    for stride, count in _STRIDES:
        cells = DETECTOR_SIZE // stride
        v, u = np.mgrid[:cells, :cells]
        grid = (np.stack((u, v), axis=-1).reshape(-1, 2) + 0.5) / cells
        centres.append(np.repeat(grid, count, axis=0))
    return np.concatenate(centres)


def _overlap(first: Array, second: Array) -> float:
    """Intersection over union of two boxes (2, 2): centre and size."""
    low = np.maximum(first[0] - 0.5 * first[1], second[0] - 0.5 * second[1])
    high = np.minimum(first[0] + 0.5 * first[1], second[0] + 0.5 * second[1])
    common = float(np.prod(np.maximum(high - low, 0.0)))
    union = float(np.prod(first[1]) + np.prod(second[1])) - common
    return common / union if union > 0.0 else 0.0


def _refined(pixels: Array, heat: NDArray[np.float32]) -> Array:
    """Moves each landmark to the centroid of its heat map around it, where that has a peak."""
    cells = heat.shape[0]
    step = LANDMARK_SIZE / cells
    around = np.arange(-_HEATMAP_WINDOW, _HEATMAP_WINDOW + 1)
    cell = np.floor(pixels / step).astype(np.int64)
    u, v = cell[:, 0, None] + around, cell[:, 1, None] + around
    valid = ((v >= 0) & (v < cells))[:, :, None] & ((u >= 0) & (u < cells))[:, None, :]
    last = cells - 1
    logits = heat[
        np.clip(v, 0, last)[:, :, None],
        np.clip(u, 0, last)[:, None, :],
        np.arange(len(pixels))[:, None, None],
    ]
    window = _sigmoid(logits) * valid
    total = np.maximum(window.sum(axis=(1, 2)), 1e-9)
    centroid = np.column_stack((np.einsum("jvu,ju->j", window, u), np.einsum("jvu,jv->j", window, v))) * (
        step / total[:, None]
    )
    peaked = (window.max(axis=(1, 2)) >= _HEATMAP_LEAST) & ((cell >= 0) & (cell < cells)).all(axis=1)
    return np.where(peaked[:, None], centroid, pixels)


def _sigmoid(x: NDArray[np.floating[Any]]) -> Array:
    shares: Array = 1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0).astype(np.float64)))
    return shares
