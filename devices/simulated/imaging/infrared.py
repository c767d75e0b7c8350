"""Renders active infrared images of a dressed person, lit by the sensor's own illuminator.

The brightness of a pixel is ``gain · reflectance · cos(incidence) · cos(off axis)^vignetting / distance²``: a
Lambertian surface that is lit from the camera's own place. Shot noise grows with the square root of the
brightness; read noise is constant.

The person has face, hair, clothes, hands and shoes. Depth images without infrared and the visibility of
joints use the plainer ``body_surface``, which the simulated trackers' errors are fitted to. Both surfaces lie
around the same landmarks.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.simulated.person.anatomy import (
    INDEX,
    LANDMARKS,
    REFERENCE_HEIGHT,
    carrier,
    rest_positions,
)
from fusion.intrinsics import Intrinsics
from fusion.support.types import Array


class Material(IntEnum):
    """What a surface is made of."""

    FLOOR = 0
    WALL = 1
    SKIN = 2
    LIPS = 3
    HAIR = 4
    DARK = 5
    """Eyes, which absorb infrared, in their sockets."""
    SHIRT = 6
    TROUSERS = 7
    SHOES = 8


# At 850 nm, rounded. Skin reflects about 0.6 there, lips less; dark hair 0.1 to 0.2. Most dyes
# hide little: cotton and denim 0.3 to 0.8, rubber less. A painted wall 0.7, a wooden floor 0.4.
REFLECTANCE = np.array([0.40, 0.70, 0.60, 0.40, 0.15, 0.10, 0.45, 0.30, 0.20], dtype=np.float32)
"""(M,) reflectance of each :class:`Material`."""


@dataclass(frozen=True)
class InfraredModel:
    """The illuminator and the infrared camera.

    Gain, vignetting and noise were estimated from one real capture of an Azure Kinect (NFOV_UNBINNED): the
    brightness of its brightest surfaces times distance², how that falls with the angle off the axis, and the
    standard deviation of second differences between neighbouring pixels by brightness.
    """

    gain: float = 2000.0
    """Counts of a surface of reflectance 1 that faces the sensor at 1 m on the optical axis."""
    vignetting: float = 3.5  # power of the cosine of the angle off the optical axis
    read_noise: float = 8.0  # standard deviation of a dark pixel, counts
    shot_noise: float = 0.65  # variance per count of brightness, counts

    def binned(self) -> InfraredModel:
        """Returns the model of the same camera with 2 × 2 binning: the mean of four pixels has less noise."""
        return replace(self, read_noise=self.read_noise / 2.0, shot_noise=self.shot_noise / 4.0)

    def illumination(self, intrinsics: Intrinsics) -> NDArray[np.float32]:
        """Returns (height, width) counts of a surface of reflectance 1 that faces the sensor at z = 1 m."""
        v, u = np.mgrid[: intrinsics.height, : intrinsics.width]
        x, y = (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
        squared_distance = 1.0 + x**2 + y**2  # at z = 1 m; its inverse is the squared cosine off the axis
        return np.asarray(self.gain * squared_distance ** (-1.0 - 0.5 * self.vignetting), dtype=np.float32)


def infrared_image(
    z: NDArray[np.float32],
    label: NDArray[np.int8],
    cosine: NDArray[np.float32],
    materials: NDArray[np.int8],
    illumination: NDArray[np.float32],
    model: InfraredModel,
    random: np.random.Generator,
) -> NDArray[np.uint16]:
    """Converts the (height, width) arrays of ``rendering.surface`` to uint16 counts, as the Azure Kinect's
    ``ir16``; `materials` has (K,) the material of each capsule.
    """
    # Labels are -1 nothing, -2 floor, -3 wall, then capsules: shifted by three they index one table.
    by_label = np.zeros(len(materials) + 3, dtype=np.float32)
    by_label[:2] = REFLECTANCE[[Material.WALL, Material.FLOOR]]
    by_label[3:] = REFLECTANCE[materials]
    normal = random.standard_normal(z.shape, dtype=np.float32)
    counts = (by_label[label + 3] * cosine * illumination / (z * z)).astype(np.float64)
    noisy = counts + np.sqrt(model.read_noise**2 + model.shot_noise * counts) * normal
    return np.clip(noisy + 0.5, 0.0, 65535.0).astype(np.uint16)


class _Rows(NamedTuple):
    """The table: each end as a weighted sum of landmarks, which rotates with the segment that carries it."""

    ends: Array
    """(2K, N) weights of the landmarks: first the K first ends, then the K second ones."""
    radii: Array
    materials: NDArray[np.int8]


def clothed_capsules(landmarks: Array, height: float = REFERENCE_HEIGHT) -> Array:
    """(K, 7) the capsules of the dressed person, as :func:`.body_surface.capsules`."""
    rows = _rows()
    ends = rows.ends @ landmarks
    count = len(rows.radii)
    radii = rows.radii[:, None] * (height / REFERENCE_HEIGHT)
    return np.concatenate((ends[:count], ends[count:], radii), axis=1)


def materials() -> NDArray[np.int8]:
    """Returns (K,) the material of each capsule, values of ``Material``."""
    return _rows().materials


@cache
def _rows() -> _Rows:
    first, second, radii, kinds = [], [], [], []
    table = (Path(__file__).parent / "clothed_person.txt").read_text(encoding="utf-8")
    for line in table.splitlines()[3:]:
        for side in ("LEFT", "RIGHT") if "_S " in f"{line} " else ("",):
            material, radius, *words = re.sub(r"_S\b", f"_{side}", line).split()
            start, end = _ends(words)
            first.append(_weights(*start, mirrored=side == "RIGHT"))
            second.append(_weights(*end, mirrored=side == "RIGHT"))
            radii.append(float(radius))
            kinds.append(Material[material.upper()])
    return _Rows(np.array(first + second), np.array(radii), np.array(kinds, dtype=np.int8))


def _ends(words: list[str]) -> list[tuple[str, Array]]:
    ends: list[tuple[str, list[float]]] = []
    for word in words:
        if word in INDEX:
            ends.append((word, []))
        else:
            ends[-1][1].append(float(word))
    return [(name, np.array(offset or (0.0, 0.0, 0.0))) for name, offset in ends]


def _weights(landmark: str, offset: Array, *, mirrored: bool) -> Array:
    """Returns (N,) weights, of sum 1, of the landmarks of one rigid segment that give a point of it."""
    weights = np.zeros(len(LANDMARKS))
    if not offset.any():
        weights[INDEX[landmark]] = 1.0
        return weights
    rest = rest_positions()
    point = rest[INDEX[landmark]] + offset * ((-1.0 if mirrored else 1.0), 1.0, 1.0)
    rigid = carrier(landmark)
    equations = np.vstack((rest[rigid].T, np.ones(len(rigid))))
    wanted = np.append(point, 1.0)
    weights[rigid] = np.linalg.lstsq(equations, wanted, rcond=1e-9)[0]
    if np.abs(equations @ weights[rigid] - wanted).max() > 1e-9:
        raise ValueError(f"The landmarks of its segment do not determine the point {offset} from {landmark}.")
    return weights
