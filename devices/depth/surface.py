"""The surface of a person and the floor in depth images, for the registration of two sensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from devices.depth.point_cloud import ray_table
from fusion.body import Body
from fusion.intrinsics import Intrinsics
from fusion.pair_arrays import Pairs, View
from fusion.registration.surface_fit import SharedSurface, Surface
from fusion.support.types import Array

_ALIKE = 0.03  # metres: neighbours farther apart in depth are not averaged
_FEWEST = 5  # of nine
_STEP = 2  # pixels, to each side, of the differences that give the normal
_EDGE = 0.02  # metres: a pixel that is farther from the middle of its neighbours lies at an edge
_LEAST_COSINE = 0.17  # between the normal and the ray
_AROUND = 0.2  # metres about the joints
_REACH = 0.18  # metres: a point farther from all bones is not of the person
_ABOVE = 0.06  # metres: what is lower is the floor
_MOST = 4000  # points of a surface
_COARSE = 4  # pixels between two readings of the floor
_UPWARDS, _HEIGHT = np.cos(np.radians(20.0)), 0.25  # of readings that may be the floor: cosine, metres
_FLOOR_ALIKE, _LEAST_FLOOR = 0.03, 200  # metres; readings
_NEAREST = 3  # joints whose velocity a point has
_MOMENT = 3  # frames to each side of which the velocity is taken


def shared_surface(
    moments: Pairs,
    images: Sequence[Mapping[int, NDArray[np.uint16]]],
    cameras: tuple[Intrinsics, Intrinsics],
    others: Sequence[Mapping[int, Sequence[Array]]] = ({}, {}),
    offsets: tuple[float, float] = (0.0, 0.0),
) -> SharedSurface:
    """The surfaces of the person in some pairs, and the floor.

    Both surfaces of a pair are moved, by the velocity of their joints, to the middle of their captures.

    Args:
        images: By number of the view's frame, A's and B's depth images.
        others: By number of the view's frame, (J, 3) of each person who is not followed.
        offsets: Expected of the cameras, metres.
    """
    body, floors, surfaces = moments.body, [], []
    both = [k for k, of in enumerate(moments.frames.tolist()) if of[0] in images[0] and of[1] in images[1]]
    for side, view in enumerate(moments.views):
        rays, frames = ray_table(cameras[side]), moments.frames[both, side].tolist()
        at = view.positions[frames].astype(np.float64)
        floor = floor_plane((images[side][k] for k in frames), rays, *upwards(body, at)) if frames else None
        half_skews = (0.5e-9 if side == 0 else -0.5e-9) * moments.skew_ns[both]
        surfaces.append(
            [
                person_surface(
                    images[side][k],
                    rays,
                    skeleton,
                    body,
                    floor,
                    others[side].get(k, ()),
                    skew * velocities(view, k),
                )
                for k, skeleton, skew in zip(frames, at, half_skews.tolist(), strict=True)
            ]
        )
        floors.append(floor)
    pairs = [each for each in zip(*surfaces, strict=True) if min(len(of.points) for of in each) > 0]
    return SharedSurface(pairs, (floors[0], floors[1]), offsets)


def person_surface(
    depth: NDArray[np.uint16],
    rays: NDArray[np.float32],
    skeleton: Array,
    body: Body,
    floor: Array | None = None,
    others: Sequence[Array] = (),
    move: Array | None = None,
) -> Surface:
    """The points of a depth image that are near a person's bones, with normals.

    Args:
        depth: (height, width) uint16 millimetres, 0 where there is no reading.
        rays: (height, width, 3) of the camera; see :func:`devices.depth.point_cloud.ray_table`.
        skeleton: (J, 3) metres in the sensor's frame; NaN where not tracked.
        floor: (4,) the plane of the floor, if known: n, h.
        others: (J, 3) of other people; a point that is nearer to one of them is not the person's.
        move: (J, 3) metres by which each joint moves until the moment of the surface; 0 if None.
    """
    known = np.isfinite(skeleton[:, 0])
    if known.sum() < _NEAREST:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3)))
    low, high = skeleton[known].min(axis=0) - _AROUND, skeleton[known].max(axis=0) + _AROUND
    rows, columns = _part(rays, low, high)
    points, normals = _normals(_smoothed(depth[rows, columns]), rays[rows, columns], _STEP)
    inside = np.isfinite(normals[..., 0]) & (points > low).all(axis=-1) & (points < high).all(axis=-1)
    points, normals = points[inside].astype(np.float64), normals[inside].astype(np.float64)
    if floor is not None:
        above = points @ floor[:3] - floor[3] > _ABOVE
        points, normals = points[above], normals[above]
    few = slice(None, None, max(1, -(-len(points) // (2 * _MOST))))
    points, normals = points[few], normals[few]
    nearest = _to_bones(points, skeleton, body)
    own = nearest < _REACH
    for other in others:
        own &= nearest < _to_bones(points, other, body)
    points, normals = points[own], normals[own]
    if move is not None and len(points):
        points = points + _moved_by(points, skeleton, move)
    return Surface(points, normals)


def floor_plane(
    images: Iterable[NDArray[np.uint16]], rays: NDArray[np.float32], up: Array, height: float
) -> Array | None:
    """(4,) n and h of the floor n · x = h in the sensor's frame; None where too little of it is seen.

    Args:
        up: (3,) the person's direction upwards.
        height: Metres along it, of the person's ankles.
    """
    coarse = rays[::_COARSE, ::_COARSE]
    seen = []
    for image in images:
        z = np.where(image > 0, image * np.float32(0.001), np.float32(np.nan))[::_COARSE, ::_COARSE]
        points, normals = _normals(z, coarse, 1)
        at = normals @ up.astype(np.float32) > _UPWARDS
        at &= np.abs(points @ up.astype(np.float32) - height) < _HEIGHT
        seen.append(points[at].astype(np.float64))
    points = np.concatenate([np.zeros((0, 3)), *seen])
    if len(points) < _LEAST_FLOOR:
        return None
    n, h = up, float(np.median(points @ up))
    for _ in range(12):
        off = points @ n - h
        scale = max(1.48 * float(np.median(np.abs(off))), 0.003)
        near = np.abs(off) < max(_FLOOR_ALIKE, 4.0 * scale)
        if near.sum() < _LEAST_FLOOR:
            return None
        weights = 1.0 / (1.0 + (off[near] / (2.0 * scale)) ** 2)
        middle = np.average(points[near], axis=0, weights=weights)
        spread = (points[near] - middle) * np.sqrt(weights)[:, None]
        n = np.linalg.eigh(spread.T @ spread)[1][:, 0]
        n = n * np.sign(n @ up)
        h = float(middle @ n)
    return np.append(n, h)


def upwards(body: Body, positions: Array) -> tuple[Array, float]:
    """(3,) the mean direction from ankles to shoulders, and the ankles' height along it, of (T, J, 3)."""
    shoulders, ankles = (
        [body.joint(f"{name}_{side}") for side in ("LEFT", "RIGHT")] for name in ("SHOULDER", "ANKLE")
    )
    top, bottom = (np.nanmean(positions[:, of], axis=1) for of in (shoulders, ankles))
    up = np.nanmean(top - bottom, axis=0)
    up = np.asarray(up / np.linalg.norm(up), dtype=np.float64)
    return up, float(np.nanmedian(bottom @ up))


def velocities(view: View, k: int) -> Array:
    """(J, 3) metres per second of each joint in a frame of a view; 0 where unknown."""
    first, last = max(k - _MOMENT, 0), min(k + _MOMENT, len(view.time_ns) - 1)
    seconds = 1e-9 * float(view.time_ns[last] - view.time_ns[first])
    moved = view.positions[last].astype(np.float64) - view.positions[first]
    return np.nan_to_num(moved / max(seconds, 1e-3))


def _part(rays: NDArray[np.float32], low: Array, high: Array) -> tuple[slice, slice]:
    """Rows and columns of the image that show a box, with a margin for the normals."""
    z = max(float(low[2]), 0.2)
    middle = rays[rays.shape[0] // 2, :, 0], rays[:, rays.shape[1] // 2, 1]
    found = []
    for axis, ray in zip((1, 0), middle[::-1], strict=True):
        bounds = [bound / depth for bound in (low[axis], high[axis]) for depth in (z, float(high[2]))]
        seen = np.flatnonzero((ray > min(bounds)) & (ray < max(bounds)))
        found.append(slice(max(seen[0] - _STEP - 1, 0), seen[-1] + _STEP + 2) if len(seen) else slice(0, 0))
    return found[0], found[1]


def _smoothed(depth: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Metres: the mean of the 3 × 3 readings that are near the middle one; NaN where there are few."""
    z = np.where(depth > 0, depth * np.float32(0.001), np.float32(np.nan))
    padded = np.pad(z, 1, constant_values=np.nan)
    total, count = np.zeros_like(z), np.zeros(z.shape, dtype=np.float32)
    for dv in range(3):
        for du in range(3):
            other = padded[dv : dv + z.shape[0], du : du + z.shape[1]]
            near = np.abs(other - z) < _ALIKE
            total += np.where(near, other, np.float32(0.0))
            count += near
    return np.where(count >= _FEWEST, total / np.maximum(count, 1.0), np.float32(np.nan))


def _normals(
    z: NDArray[np.float32], rays: NDArray[np.float32], step: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(h, w, 3) points and unit normals towards the sensor; NaN at edges and where grazed."""
    points = rays * z[..., None]
    normals = np.full_like(points, np.nan)
    if min(z.shape) <= 2 * step:
        return points, normals
    here = slice(step, -step)
    right, left = points[here, 2 * step :], points[here, : -2 * step]
    below, above = points[2 * step :, here], points[: -2 * step, here]
    middle = points[here, here]
    n = np.cross(below - above, right - left)  # towards the sensor: y is down, z forward
    with np.errstate(invalid="ignore", divide="ignore"):
        n /= np.sqrt((n * n).sum(axis=-1, keepdims=True))
        cosine = -(n * middle).sum(axis=-1) / np.sqrt((middle * middle).sum(axis=-1))
    edge = (np.abs(0.5 * (right + left) - middle)[..., 2] > _EDGE) | (
        np.abs(0.5 * (below + above) - middle)[..., 2] > _EDGE
    )
    n[edge | ~(cosine > _LEAST_COSINE)] = np.nan
    normals[here, here] = n
    return points, normals


def _to_bones(points: Array, skeleton: Array, body: Body) -> Array:
    """(N,) metres from each point to the nearest bone."""
    nearest = np.full(len(points), np.inf)
    for end in body.bone_joints:
        start, along = skeleton[body.parents[end]], skeleton[end] - skeleton[body.parents[end]]
        if not np.isfinite(start + along).all():
            continue
        off = points - start
        share = np.clip(off @ along / max(float(along @ along), 1e-9), 0.0, 1.0)
        off -= share[:, None] * along
        nearest = np.minimum(nearest, np.sqrt((off * off).sum(axis=1)))
    return nearest


def _moved_by(points: Array, skeleton: Array, move: Array) -> Array:
    """(N, 3) the movement of the nearest joints, weighted by distance."""
    known = np.flatnonzero(np.isfinite(skeleton[:, 0]))
    apart = np.linalg.norm(points[:, None] - skeleton[known], axis=2)
    nearest = np.argpartition(apart, _NEAREST - 1, axis=1)[:, :_NEAREST]
    weights = 1.0 / (np.take_along_axis(apart, nearest, axis=1) + 0.02) ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray((weights[..., None] * move[known][nearest]).sum(axis=1))
