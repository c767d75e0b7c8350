"""Renders active infrared images: what the sensor's own illuminator makes of the surface before it.

The brightness of a pixel is ``gain · reflectance · cos(incidence) · cos(off axis)^vignetting / distance²``: a
Lambertian surface that is lit from the camera's own place. Shot noise grows with the square root of the
brightness; read noise is constant.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fusion.compiling.kernels import njit
from fusion.intrinsics import Intrinsics


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
_REFLECTANCE = {
    Material.FLOOR: 0.40,
    Material.WALL: 0.70,
    Material.SKIN: 0.60,
    Material.LIPS: 0.40,
    Material.HAIR: 0.15,
    Material.DARK: 0.10,
    Material.SHIRT: 0.45,
    Material.TROUSERS: 0.30,
    Material.SHOES: 0.20,
}


def _reflectances() -> NDArray[np.float32]:
    return np.array([_REFLECTANCE[material] for material in Material], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class InfraredModel:
    """The illuminator and the infrared camera.

    Gain, vignetting and noise were estimated from one real capture of an Azure Kinect (NFOV_UNBINNED): the
    brightness of its brightest surfaces times distance², how that falls with the angle off the axis, and the
    standard deviation of second differences between neighbouring pixels by brightness.

    Attributes:
        gain: Counts of a surface of reflectance 1 that faces the sensor at 1 m on the optical axis.
        vignetting: Power of the cosine of the angle off the optical axis.
        read_noise: Standard deviation of a dark pixel, counts.
        shot_noise: Variance per count of brightness, counts.
        reflectance: (M,) reflectance of each :class:`Material`.
    """

    gain: float = 2000.0
    vignetting: float = 3.5
    read_noise: float = 8.0
    shot_noise: float = 0.65
    reflectance: NDArray[np.float32] = field(default_factory=_reflectances)

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
    """Converts the result of ``rendering.surface`` to an infrared image.

    Args:
        z, label, cosine: (height, width) the first surfaces.
        materials: (K,) the material of each capsule.
        illumination: From :meth:`InfraredModel.illumination`.
        model: Reflectances and noise.
        random: Source of the noise.

    Returns:
        (height, width) uint16 counts, as the Azure Kinect's ``ir16``.
    """
    # Labels are -1 nothing, -2 floor, -3 wall, then capsules: shifted by three they index one table.
    by_label = np.zeros(len(materials) + 3, dtype=np.float32)
    by_label[:2] = model.reflectance[[Material.WALL, Material.FLOOR]]
    by_label[3:] = model.reflectance[materials]
    normal = random.standard_normal(z.shape, dtype=np.float32)
    image = np.empty(z.shape, dtype=np.uint16)
    _expose(z, label, cosine, by_label, illumination, normal, model.read_noise, model.shot_noise, image)
    return image


@njit(nogil=True)
def _expose(z, label, cosine, by_label, illumination, normal, read, shot, image):  # type: ignore[no-untyped-def]
    height, width = z.shape
    for v in range(height):
        for u in range(width):
            counts = 0.0
            if label[v, u] != -1:
                counts = by_label[label[v, u] + 3] * cosine[v, u] * illumination[v, u] / (z[v, u] * z[v, u])
            noisy = counts + np.sqrt(read * read + shot * counts) * normal[v, u]
            image[v, u] = np.uint16(min(max(noisy + 0.5, 0.0), 65535.0))
