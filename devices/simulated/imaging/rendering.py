"""Renders depth images of a person, a floor and a wall, with the errors of a time-of-flight sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from devices.simulated.imaging.rays import cast
from devices.simulated.person.anatomy import Array
from fusion.compiling.kernels import njit
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform

WALL_Z = 1.5
"""The wall behind the person is the plane z = 1.5 m of the world. The floor is y = 0."""
NOTHING, FLOOR, WALL = -1, -2, -3
"""Labels of pixels without a capsule: no surface at all, the floor, the wall."""


@dataclass(frozen=True)
class DepthErrors:
    """The errors of a depth image.

    Attributes:
        noise: Standard deviation of a pixel at 0 m, metres.
        noise_growth: Growth of the noise with the square of the distance, metres per square metre.
        grazing: Smallest cosine between ray and surface normal at which there is a reading.
        edge_loss: Share of pixels without a reading at depth discontinuities.
        nearest, farthest: Range of readings, metres. The specified range ends at 3.86 m, but the sensor
            measures bright surfaces farther away.
    """

    noise: float = 0.0008
    noise_growth: float = 0.0004
    grazing: float = 0.08
    edge_loss: float = 0.5
    nearest: float = 0.25
    farthest: float = 5.5

    @staticmethod
    def none() -> DepthErrors:
        """Returns no errors but the rounding of the image to millimetres."""
        return DepthErrors(0.0, 0.0, 0.0, 0.0, 0.0, 65.0)


def halved(intrinsics: Intrinsics) -> Intrinsics:
    """Returns the intrinsics of the same camera with 2 × 2 binning."""
    return replace(
        intrinsics,
        width=intrinsics.width // 2,
        height=intrinsics.height // 2,
        fx=intrinsics.fx / 2,
        fy=intrinsics.fy / 2,
        cx=(intrinsics.cx - 0.5) / 2,
        cy=(intrinsics.cy - 0.5) / 2,
    )


def surface(
    shapes: Array, sensor_from_world: RigidTransform, intrinsics: Intrinsics
) -> tuple[NDArray[np.float32], NDArray[np.int8], NDArray[np.float32]]:
    """Computes the first surface on each pixel's ray.

    Args:
        shapes: (K, 7) capsules in the sensor's frame; see ``body_surface.capsules``.
        sensor_from_world: Transform that places the floor and the wall.
        intrinsics: Intrinsics of the camera; distortion is ignored.

    Returns:
        Three (height, width) arrays: depth z in metres, infinite without a surface; the index of the capsule,
        or FLOOR, WALL or NOTHING; and the cosine between ray and surface normal.
    """
    R, t = sensor_from_world.rotation, sensor_from_world.translation
    # Planes n·x = h in the sensor's frame: the normal is the world's y for the floor and z for the wall.
    planes = np.array([(*R[:, 1], R[:, 1] @ t), (*R[:, 2], R[:, 2] @ t + WALL_Z)])
    size = (intrinsics.height, intrinsics.width)
    z, label = np.full(size, np.inf, dtype=np.float32), np.full(size, NOTHING, dtype=np.int8)
    cosine = np.zeros(size, dtype=np.float32)
    lens = (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy)
    cast(np.ascontiguousarray(shapes), planes, *lens, z, label, cosine)
    return z, label, cosine


def depth_image(
    z: NDArray[np.float32], cosine: NDArray[np.float32], errors: DepthErrors, random: np.random.Generator
) -> NDArray[np.uint16]:
    """Converts the result of :func:`surface` to (height, width) uint16 millimetres; 0 without a reading."""
    normal = random.standard_normal(z.shape, dtype=np.float32)
    uniform = random.random(z.shape, dtype=np.float32)
    image = np.zeros(z.shape, dtype=np.uint16)
    _read_out(
        z, cosine, normal, uniform, errors.noise, errors.noise_growth, errors.grazing, errors.edge_loss,
        errors.nearest, errors.farthest, image,
    )  # fmt: skip
    return image


@njit(nogil=True)
def _read_out(  # type: ignore[no-untyped-def]
    z, cosine, normal, uniform, noise, growth, grazing, edge_loss, nearest, farthest, image
):
    height, width = z.shape
    for v in range(height):
        for u in range(width):
            here = z[v, u]
            if not nearest <= here <= farthest or cosine[v, u] < grazing:
                continue
            jump = 0.04 * here
            edge = (
                (u > 0 and abs(z[v, u - 1] - here) > jump)
                or (u + 1 < width and abs(z[v, u + 1] - here) > jump)
                or (v > 0 and abs(z[v - 1, u] - here) > jump)
                or (v + 1 < height and abs(z[v + 1, u] - here) > jump)
            )
            if edge and uniform[v, u] < edge_loss:
                continue
            spread = (noise + growth * here * here) / max(cosine[v, u], 0.25)
            image[v, u] = np.uint16(min(max(1000.0 * (here + spread * normal[v, u]) + 0.5, 0.0), 65535.0))
