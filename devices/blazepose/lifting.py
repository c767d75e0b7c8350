"""Lifts landmarks of an image to landmarks in space by its depth.

The network states a whole body in metres, with the right shape and a doubtful place: the image fixes the
direction of each landmark, the depth image the distance of what is seen there. The body is laid onto the seen
surface, and then decides which readings are its own: what lies before it covers it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.blazepose.landmark_kinds import EARS, FACE, LONG_BONE_LENGTHS, LONG_BONES, column, opposite
from devices.depth.camera import in_image, rays
from fusion.compiling.kernels import kernel
from fusion.errors import CalibrationError
from fusion.intrinsics import Intrinsics
from fusion.registration.rigid_fit import fit_rigid
from fusion.support.types import Array

_SMALLEST, _LARGEST = 0.45, 1.5
"""Sizes of a person relative to the network's mean person, who is about 1.65 m tall: 0.75 to 2.5 m."""
_FEWEST = 5  # seen landmarks that make a person, and that a body is laid onto
_TRUSTED = 0.7  # visibility of a landmark that the body is laid onto
_WITHIN = (0.20, 0.12)  # metres between body and surface of such a landmark, at first and then
_SURFACE_RADIUS = 0.022  # metres: half width of the window that is read, narrower than a wrist
_LARGEST_WINDOW = 8  # pixels to each side
_OWN_SHARE = 0.4  # least share of a window's readings that are the landmark's own
_SHORTEST, _LONGEST = 0.5, 1.6  # of a limb's bone, times that of an adult of the person's size
_MARGIN = 0.1  # of the image's larger side: a landmark farther outside has no position

_BENEATH = column("beneath")
_VISIBILITY = column("visibility")
_TURNED = column("turned")
_FRONT = column("front")
_BACK = column("back")
_OPPOSITE = opposite()


@dataclass(frozen=True, eq=False)
class Lifted:
    """Landmarks in space."""

    positions: Array  # (33, 3) metres, sensor frame
    seen: NDArray[np.bool_]  # (33,) whether a depth reading of the landmark's own surface gave its position
    known: NDArray[np.bool_]
    """(33,) whether it has a position: seen, or stated by the network, near the image, where the lens images
    points."""
    size: float  # the person's size relative to the network's mean person


class BodyLandmarks(NamedTuple):
    """The network's landmarks of one person."""

    pixels: Array  # (33, 2) pixels of the depth image
    visibility: Array  # (33,) probability that nothing covers a landmark
    presence: Array  # (33,) probability that it is in the image
    world: Array  # (33, 3) metres, hip-centred, along the axes of the image


def lift(landmarks: BodyLandmarks, depth: NDArray[np.uint16], camera: Intrinsics) -> Lifted | None:
    """Places the landmarks in space; None if the depth shows no person of possible size.

    Args:
        depth: (h, w) millimetres along z, 0 without a reading.
    """
    pixels, visibility, _, _ = landmarks
    laid = lay_body(landmarks, depth, camera)
    if laid is None:
        return None
    body, size, _ = laid
    at = rays(camera, pixels)
    imaged = np.isfinite(at[:, 0])
    inside = imaged & in_image(camera, pixels)
    image = np.ascontiguousarray(depth)
    expected, reach = body[:, 2] - size * _BENEATH, camera.fx * _SURFACE_RADIUS
    reading, share = _surfaces(image, pixels, inside, reach, expected - _FRONT, expected + _BACK)
    seen = inside & (share >= _OWN_SHARE) & (visibility >= _VISIBILITY) & (_outward(body) <= _TURNED)
    z = np.where(seen, reading + size * _BENEATH, np.maximum(body[:, 2], 0.1))
    points = np.column_stack((np.where(imaged[:, None], at * z[:, None], body[:, :2]), z))
    seen[LONG_BONES[~_possible_bones(points, size), 1]] = False
    if np.count_nonzero(seen) < _FEWEST:
        return None
    near = imaged & in_image(camera, pixels, _MARGIN * max(camera.width, camera.height))
    return Lifted(points, seen, near, size)


def lay_body(
    landmarks: BodyLandmarks, depth: NDArray[np.uint16], camera: Intrinsics
) -> tuple[Array, float, Array] | None:
    """Lays the network's body onto the depth image. The arguments are those of :func:`lift`.

    Returns:
        (33, 3) the body's landmarks, metres, sensor frame; its size; (33,) the depth read at each landmark,
        metres. None if the depth shows no person of possible size.
    """
    pixels, visibility, presence, world = landmarks
    at = rays(camera, pixels)
    imaged = np.isfinite(at[:, 0])
    at = np.where(imaged[:, None], at, 0.0)  # without weight
    inside = imaged & in_image(camera, pixels)
    trust = visibility * presence * inside
    image = np.ascontiguousarray(depth)
    body = world + _placement(at, world, np.where(imaged, trust + 1e-3, 0.0))
    reach = camera.fx * _SURFACE_RADIUS
    reading, _ = _surfaces(image, pixels, inside, reach, np.zeros(len(at)), np.full(len(at), np.inf))
    usable = np.isfinite(reading) & (trust > 0.3) & (body[:, 2] > 0.1)
    if np.count_nonzero(usable) < _FEWEST:
        return None
    size = float(np.median((reading[usable] + _BENEATH[usable]) / body[usable, 2]))
    if not _SMALLEST <= size <= _LARGEST:
        return None
    body = body * size
    turned = _outward(body)
    surface = reading + size * _BENEATH
    for within in _WITHIN:
        used = usable & (visibility > _TRUSTED) & (turned < 0.2) & (np.abs(surface - body[:, 2]) < within)
        if np.count_nonzero(used) < _FEWEST:
            break
        seen = np.column_stack((at[used] * surface[used, None], surface[used]))
        try:
            body = fit_rigid(seen, body[used], visibility[used]).apply(body)
        except CalibrationError:  # all on one line
            break
    return body, size, reading


def _placement(at: Array, world: Array, trust: Array) -> Array:
    """(3,) the translation that brings the network's landmarks onto the rays, by weighted least squares.

    A point W + T lies on the ray (x, y) where W_x + T_x = x (W_z + T_z), likewise for y: linear in T.
    """
    rows = np.zeros((2, len(at), 3))
    rows[0, :, 0] = rows[1, :, 1] = 1.0
    rows[:, :, 2] = -at.T
    wanted = at.T * world[:, 2] - world[:, :2].T
    weighted = rows * trust[:, None]
    normal = np.einsum("kni,knj->ij", weighted, rows) + 1e-9 * np.eye(3)
    return np.asarray(np.linalg.solve(normal, np.einsum("kni,kn->i", weighted, wanted)))


def _outward(body: Array) -> Array:
    """(33,) component of each landmark's outward direction along its line of sight; -1 where it has none."""
    outward = body - body[_OPPOSITE]
    outward[FACE] = body[FACE] - 0.5 * (body[EARS[0]] + body[EARS[1]])
    length = np.linalg.norm(outward, axis=1) * np.linalg.norm(body, axis=1)
    component = np.einsum("ij,ij->i", outward, body)
    return np.where(length > 1e-9, component / np.maximum(length, 1e-9), -1.0)


def _possible_bones(points: Array, size: float) -> NDArray[np.bool_]:
    """(8,) whether the limbs' bones have a possible length: a limb that leaves the view is folded into it."""
    ends = points[LONG_BONES]
    ratio = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / (size * LONG_BONE_LENGTHS)
    possible: NDArray[np.bool_] = (ratio > _SHORTEST) & (ratio < _LONGEST)
    return possible


@kernel
def _surfaces(depth, pixels, inside, reach, near, far):  # type: ignore[no-untyped-def]
    """(33,) median reading between two depths around each landmark, metres or NaN; (33,) their share."""
    height, width = depth.shape
    reading, share = np.full(len(pixels), np.nan), np.zeros(len(pixels))
    own = np.empty((2 * _LARGEST_WINDOW + 1) ** 2)
    for j in range(len(pixels)):
        if not inside[j]:
            continue
        u, v = int(pixels[j, 0] + 0.5), int(pixels[j, 1] + 0.5)
        z = 0.001 * depth[v, u]
        if z == 0.0:
            z = 0.5 * (near[j] + min(far[j], near[j] + 6.0))
        radius = int(min(max(1.0, reach / max(z, 0.1)), 1.0 * _LARGEST_WINDOW))
        count = total = 0
        for b in range(max(0, v - radius), min(height, v + radius + 1)):
            for a in range(max(0, u - radius), min(width, u + radius + 1)):
                if depth[b, a] == 0:
                    continue
                total += 1
                here = 0.001 * depth[b, a]
                if near[j] <= here <= far[j]:
                    i = count
                    while i > 0 and own[i - 1] > here:
                        own[i] = own[i - 1]
                        i -= 1
                    own[i] = here
                    count += 1
        if count >= 3:
            reading[j] = own[count // 2]
            share[j] = count / total
    return reading, share
