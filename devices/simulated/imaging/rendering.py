"""Renders depth images of a person, a floor and a wall, with the errors of a real sensor.

All kernels that call each other are in this file: numba's cache does not detect a change in another one.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.body import KINECT_V1, Body
from fusion.compiling.kernels import njit
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from fusion.support.types import Array

WALL_Z = 1.5
"""The wall behind the person is the plane z = 1.5 m of the world. The floor is y = 0."""
NOTHING, FLOOR, WALL = -1, -2, -3
"""Labels of pixels without a capsule: no surface at all, the floor, the wall."""


@dataclass(frozen=True)
class DepthErrors:
    """The errors of a depth image: without systematic ones by default."""

    noise: float = 0.0008  # standard deviation of a pixel at 0 m, metres
    noise_growth: float = 0.0004
    """Growth of the noise with the square of the distance, metres per square metre."""
    grazing: float = 0.08  # smallest cosine between ray and surface normal at which there is a reading
    edge_loss: float = 0.5  # share of pixels without a reading at depth discontinuities
    nearest: float = 0.25
    farthest: float = 5.5
    """Range of readings, metres. The specified range ends at 3.86 m, but the sensor measures bright surfaces
    farther away."""
    offset: float = 0.0  # a sensor's own: added to all readings, metres; see :meth:`of_sensor`
    wiggle: float = 0.0
    """Amplitude of an error that oscillates with the distance, metres: the modulation is no perfect sine."""
    wiggle_metres: float = 0.75  # its period: half the wave length of the modulation, 200 MHz
    phase: float = 0.0  # of that, radians; a sensor's own
    flying: float = 0.0  # share of the readings at depth discontinuities that lie between the two surfaces
    step: float = 0.0
    """Distance of two readings at 1 m, metres; it grows with the square of the distance: of structured light,
    whose disparity has steps."""
    baseline: float = 0.0
    """Metres from the camera to the projector, on its left: what the projector does not light has no
    reading."""

    @staticmethod
    def none() -> DepthErrors:
        """Returns no errors but the rounding of the image to millimetres."""
        return DepthErrors(0.0, 0.0, 0.0, 0.0, 0.0, 65.0)

    @staticmethod
    def of(body: Body) -> DepthErrors:
        """Returns the errors of the depth camera of the sensor whose tracker reports this body."""
        return _STRUCTURED_LIGHT if body is KINECT_V1 else _TIME_OF_FLIGHT

    def of_sensor(self, random: np.random.Generator) -> DepthErrors:
        """Returns those of one sensor: its ``offset`` and ``phase`` are drawn; the offset here is their
        standard deviation."""
        return replace(
            self,
            offset=self.offset * random.standard_normal(),
            phase=self.phase + 2.0 * np.pi * random.random(),
        )


_TIME_OF_FLIGHT = DepthErrors(offset=0.004, wiggle=0.002, flying=0.3)
"""The Azure Kinect is specified to be off by less than 11 mm + 0.1 % of the distance."""
_STRUCTURED_LIGHT = DepthErrors(
    noise=0.0, noise_growth=0.0014, nearest=0.5, farthest=8.0, offset=0.004, step=0.00285, baseline=0.075
)
"""Kinect v1. K. Khoshelham, S. Oude Elberink, "Accuracy and resolution of Kinect depth data for indoor
mapping applications", Sensors 12 (2012): noise 1.4 mm, steps of 2.85 mm, both times the square of metres."""


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
    cast(np.ascontiguousarray(shapes), planes, lens, z, label, cosine)
    return z, label, cosine


def depth_image(
    z: NDArray[np.float32],
    cosine: NDArray[np.float32],
    errors: DepthErrors,
    random: np.random.Generator,
    focal: float = 0.0,
) -> NDArray[np.uint16]:
    """Converts the result of :func:`surface` to (height, width) uint16 millimetres; 0 without a reading.

    Args:
        focal: Focal length, pixels, for the shadows of the projector.
    """
    normal = random.standard_normal(z.shape, dtype=np.float32)
    uniform = random.random(z.shape, dtype=np.float32)
    image = np.zeros(z.shape, dtype=np.uint16)
    read_out(z, cosine, normal, uniform, astuple(errors), focal, image)
    return image


@njit(nogil=True)
def read_out(z, cosine, normal, uniform, errors, focal, image):  # type: ignore[no-untyped-def]
    noise, growth, grazing, edge_loss, nearest, farthest = errors[:6]
    offset, wiggle, wiggle_metres, phase, flying, step, baseline = errors[6:]
    height, width = z.shape
    for v in range(height):
        lit = -np.inf  # how far to the right the projector's rays have been stopped, as a column
        for u in range(width):
            here = z[v, u]
            if baseline > 0.0:
                column = u + focal * baseline / here
                if column < lit:
                    continue
                lit = column
            if not nearest <= here <= farthest or cosine[v, u] < grazing:
                continue
            jump = 0.04 * here
            other = here
            for k in range(4):
                v2, u2 = v + (k == 0) - (k == 1), u + (k == 2) - (k == 3)
                if 0 <= v2 < height and 0 <= u2 < width and abs(z[v2, u2] - here) > jump:
                    other = z[v2, u2]
            if other != here:
                if uniform[v, u] < edge_loss:
                    continue
                if other < farthest and uniform[v, u] < edge_loss + (1.0 - edge_loss) * flying:
                    # which share of the light comes from there: any
                    share = (uniform[v, u] - edge_loss) / max((1.0 - edge_loss) * flying, 1e-9)
                    here = here + share * (other - here)
            spread = (noise + growth * here * here) / max(cosine[v, u], 0.25)
            read = here + offset + wiggle * np.sin(2.0 * np.pi * here / wiggle_metres + phase)
            read += spread * normal[v, u]
            if step > 0.0 and read > 0.0:
                read = 1.0 / (step * max(np.rint(1.0 / (step * read)), 1.0))
            image[v, u] = np.uint16(min(max(1000.0 * read + 0.5, 0.0), 65535.0))


@njit()
def capsule_depth(dx, dy, dz, s):  # type: ignore[no-untyped-def]
    """Returns the smallest t at which the ray t·d hits capsule s; infinity if it misses."""
    bx, by, bz = s[3] - s[0], s[4] - s[1], s[5] - s[2]
    dd = dx * dx + dy * dy + dz * dz
    bb = bx * bx + by * by + bz * bz
    bd = bx * dx + by * dy + bz * dz
    ba = -(bx * s[0] + by * s[1] + bz * s[2])
    da = -(dx * s[0] + dy * s[1] + dz * s[2])
    aa = s[0] * s[0] + s[1] * s[1] + s[2] * s[2]
    a = bb * dd - bd * bd
    y = -1.0 if ba + bd * (-da / dd) <= 0.0 else bb
    if a > 1e-12:
        b = bb * da - ba * bd
        h = b * b - a * (bb * aa - ba * ba - s[6] * s[6] * bb)
        if h < 0.0:
            return np.inf
        t = (-b - np.sqrt(h)) / a
        y = ba + t * bd
        if 0.0 < y < bb:
            return t if t > 0.0 else np.inf
    end = 0 if y <= 0.0 else 3
    cx, cy, cz = s[end], s[end + 1], s[end + 2]
    b = dx * cx + dy * cy + dz * cz
    h = b * b - dd * (cx * cx + cy * cy + cz * cz - s[6] * s[6])
    if h < 0.0:
        return np.inf
    t = (b - np.sqrt(h)) / dd
    return t if t > 0.0 else np.inf


@njit()
def share_seen(joints, shapes, flesh):  # type: ignore[no-untyped-def]
    """Returns (J,) the share of nine rays around each joint that hit no surface far before it; see flesh."""
    rays = 9
    seen = np.zeros(len(joints))
    for j in range(len(joints)):
        x, y, z = joints[j]
        distance = np.sqrt(x * x + y * y + z * z)
        if z <= 0.0:
            continue
        # Two directions perpendicular to the ray.
        ux, uz = z / np.sqrt(x * x + z * z), -x / np.sqrt(x * x + z * z)
        vx, vy, vz = y * uz / distance, (z * ux - x * uz) / distance, -y * ux / distance
        before = 1.0 - (1.4 * flesh[j] + 0.03) / distance
        for k in range(rays):
            out = 0.0 if k == 0 else 0.7 * flesh[j] * (0.5 if k % 2 else 1.0)
            angle = k * 2.0 * np.pi / (rays - 1)
            p, q = out * np.cos(angle), out * np.sin(angle)
            dx, dy, dz = x + p * ux + q * vx, y + q * vy, z + p * uz + q * vz
            free = True
            for c in range(len(shapes)):
                if capsule_depth(dx, dy, dz, shapes[c]) < before:
                    free = False
                    break
            if free:
                seen[j] += 1.0
    return seen / rays


@njit()
def _span(x, z, r, f, c, size):  # type: ignore[no-untyped-def]
    """Returns the first and last pixel that a sphere can cover along one axis of the image."""
    if z - r <= 0.05:
        return 0, size - 1
    low, high = x - r, x + r
    first = f * low / (z - r if low < 0.0 else z + r) + c
    last = f * high / (z - r if high > 0.0 else z + r) + c
    return max(0, int(np.floor(first))), min(size - 1, int(np.ceil(last)))


@njit(nogil=True)
def cast(shapes, planes, lens, z, label, cosine):  # type: ignore[no-untyped-def]
    """Fills z, label and cosine with the first hit of each pixel's ray; see ``surface``."""
    fx, fy, cx, cy = lens
    height, width = z.shape
    for k in range(len(shapes)):
        s = shapes[k]
        if max(s[2], s[5]) + s[6] <= 0.0:
            continue
        u0, u1 = _span(s[0], s[2], s[6], fx, cx, width)
        u2, u3 = _span(s[3], s[5], s[6], fx, cx, width)
        v0, v1 = _span(s[1], s[2], s[6], fy, cy, height)
        v2, v3 = _span(s[4], s[5], s[6], fy, cy, height)
        for v in range(min(v0, v2), max(v1, v3) + 1):
            dy = (v - cy) / fy
            for u in range(min(u0, u2), max(u1, u3) + 1):
                t = capsule_depth((u - cx) / fx, dy, 1.0, s)
                if t < z[v, u]:
                    z[v, u] = t
                    label[v, u] = k
    for v in range(height):
        dy = (v - cy) / fy
        for u in range(width):
            dx = (u - cx) / fx
            norm = np.sqrt(dx * dx + dy * dy + 1.0)
            if label[v, u] >= 0:
                s = shapes[label[v, u]]
                t = z[v, u]
                px, py, pz = t * dx - s[0], t * dy - s[1], t - s[2]
                bx, by, bz = s[3] - s[0], s[4] - s[1], s[5] - s[2]
                share = (px * bx + py * by + pz * bz) / max(bx * bx + by * by + bz * bz, 1e-12)
                share = min(max(share, 0.0), 1.0)
                nx, ny, nz = px - share * bx, py - share * by, pz - share * bz
                cosine[v, u] = abs(nx * dx + ny * dy + nz) / (s[6] * norm)
                continue
            for p in range(len(planes)):
                facing = planes[p, 0] * dx + planes[p, 1] * dy + planes[p, 2]
                if facing == 0.0:
                    continue
                t = planes[p, 3] / facing
                if 0.0 < t < z[v, u]:
                    z[v, u] = t
                    label[v, u] = -2 - p
                    cosine[v, u] = abs(facing) / norm
