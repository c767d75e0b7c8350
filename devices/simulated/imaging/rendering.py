"""Depth images of a person, a floor and a wall, as a time-of-flight sensor gives them."""

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
"""The wall stands behind the person: the plane z = 1.5 m of the world. The floor is y = 0."""
BACKGROUND = -1
"""The label of a pixel that shows no capsule."""


@dataclass(frozen=True)
class DepthErrors:
    """How a depth image differs from the surface.

    Attributes:
        noise: Standard deviation of a pixel at 0 m, metres.
        noise_growth: What is added to it per square metre of distance.
        grazing: A surface seen at less than this cosine gives no reading.
        edge_loss: Share of pixels without a reading where the depth jumps.
        nearest, farthest: Range of readings, metres. The sensor is specified to 3.86 m but reads bright
            surfaces farther out.
    """

    noise: float = 0.0008
    noise_growth: float = 0.0004
    grazing: float = 0.08
    edge_loss: float = 0.5
    nearest: float = 0.25
    farthest: float = 5.5

    @staticmethod
    def none() -> DepthErrors:
        """Every surface where it is, to the millimetre of the image."""
        return DepthErrors(0.0, 0.0, 0.0, 0.0, 0.0, 65.0)


def halved(intrinsics: Intrinsics) -> Intrinsics:
    """The same camera with two by two pixels made one."""
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
    """What each pixel's ray meets first.

    Args:
        shapes: (K, 7) capsules in the sensor's frame, as ``flesh.capsules``.
        sensor_from_world: Where the floor and the wall are.
        intrinsics: An ideal lens: distortion is left out.

    Returns:
        (height, width) depth z in metres, infinite where there is nothing; the index of the capsule, or
        BACKGROUND; and the cosine between ray and surface normal.
    """
    R, t = sensor_from_world.rotation, sensor_from_world.translation
    # A plane n·x = h of the sensor's frame: the floor's normal is the world's y, the wall's is z.
    planes = np.array([(*R[:, 1], R[:, 1] @ t), (*R[:, 2], R[:, 2] @ t + WALL_Z)])
    size = (intrinsics.height, intrinsics.width)
    z, label = np.full(size, np.inf, dtype=np.float32), np.full(size, BACKGROUND, dtype=np.int8)
    cosine = np.zeros(size, dtype=np.float32)
    lens = (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy)
    cast(np.ascontiguousarray(shapes), planes, *lens, z, label, cosine)
    return z, label, cosine


def depth_image(
    z: NDArray[np.float32], cosine: NDArray[np.float32], errors: DepthErrors, random: np.random.Generator
) -> NDArray[np.uint16]:
    """(height, width) uint16 millimetres, 0 where there is no reading, from what :func:`surface` gave."""
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
