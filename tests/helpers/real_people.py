"""Real people before a real depth camera, with joints marked by hand; see ``tests/data/README.md``.

The images are those of ``../shared/real_images``; the marks belong to the project.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fusion.intrinsics import Intrinsics
from tests.helpers.rendered_people import FRAME_NS

_MARKS = Path(__file__).parents[1] / "data" / "real_people" / "marks.csv"
CAMERA = Intrinsics(640, 480, 617.25, 617.5486, 317.3921, 245.9802)
"""Of the colour camera, to which the depth is registered."""


@dataclass(frozen=True, eq=False)
class RealImage:
    """One image of a clip."""

    frame: str  # its number in the source
    color: NDArray[np.uint8]  # (h, w, 3) RGB
    depth: NDArray[np.uint16]  # (h, w) millimetres

    @property
    def time_ns(self):
        """The source states no rate; this is its frame number at 30 fps."""
        return int(self.frame) * FRAME_NS


def clip(folder):
    """The images of a clip, in order."""
    files = sorted(folder.glob("color_*.png"))
    assert files, f"no images in {folder}"
    for file in files:
        frame = file.stem.removeprefix("color_")
        depth = cv2.imread(str(file.with_name(f"depth_{frame}.png")), cv2.IMREAD_UNCHANGED)
        yield RealImage(frame, cv2.cvtColor(cv2.imread(str(file)), cv2.COLOR_BGR2RGB), depth)


def marks(name, person):
    """The marks of a person: ``{frame: {joint: ((u, v), whether it is visible)}}``, in pixels."""
    found = {}
    with _MARKS.open(newline="") as file:
        for row in csv.DictReader(file):
            if (row["clip"], row["person"]) == (name, person):
                frame = row["frame"].zfill(5)  # as in the images' names
                at = np.array((row["u"], row["v"]), dtype=float)
                found.setdefault(frame, {})[row["joint"]] = at, row["surface"] == "visible"
    return found
