"""The surface of a person and the floor in depth images, for the registration of two sensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from devices.depth.point_cloud import ray_table
from fusion.body import Body
from fusion.calibration.surface_fit import SharedSurface, Surface
from fusion.intrinsics import Intrinsics
from fusion.pair_arrays import Pairs, View
from fusion.skeleton import nearer
from fusion.support.types import Array

_HALF = 1  # pixels, to each side, of the window whose plane is a point's
_LARGEST_RANGE = 0.15  # metres, of depth in a window: more is an edge
_EDGE = 0.02  # metres, root mean square distance of the readings from the plane: more is an edge
_LEAST_COSINE = 0.17  # between the normal and the ray
_AROUND = 0.2  # metres about the joints
_REACH = 0.18  # metres: a point farther from all bones is not of the person
_ABOVE = 0.06  # metres: what is lower is the floor
_MOST = 1000  # points of a surface
_COARSE = 4  # pixels between two readings of the floor
_UPWARDS, _HEIGHT = np.cos(np.radians(20.0)), 0.25  # of readings that may be the floor: cosine, metres
_FLOOR_ALIKE, _LEAST_FLOOR = 0.03, 200  # metres; readings
_NEAREST = 3  # joints whose velocity a point has
AROUND = 3  # frames before and after a moment, from which its velocity is taken


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
    rays = [ray_table(camera) for camera in cameras]
    whole = [
        all(
            k in seen and seen[k].shape == ray.shape[:2]
            for k, seen, ray in zip(of, images, rays, strict=True)
        )
        for of in moments.frames.tolist()
    ]
    moments = moments[np.flatnonzero(whole)]
    body, floors, surfaces = moments.body, [], []
    for side, (view, seen, ray) in enumerate(zip(moments.views, images, rays, strict=True)):
        own = moments.frames[:, side].tolist()
        at = view.positions[own].astype(np.float64)
        floor = floor_plane([seen[k] for k in own], ray, body, at, offsets[side])
        seconds = (0.5e-9, -0.5e-9)[side] * moments.skew_ns
        moves = (of * velocities(view, k) for k, of in zip(own, seconds.tolist(), strict=True))
        surfaces.append([
            person_surface(seen[k], ray, skeleton, body, floor, others[side].get(k, ()), move, offsets[side])
            for k, skeleton, move in zip(own, at, moves, strict=True)
        ])  # fmt: skip
        floors.append(floor)
    pairs = [each for each in zip(*surfaces, strict=True) if all(len(of.points) for of in each)]
    return SharedSurface(pairs, (floors[0], floors[1]))


def person_surface(
    depth: NDArray[np.uint16],
    rays: NDArray[np.float32],
    skeleton: Array,
    body: Body,
    floor: Array | None = None,
    others: Sequence[Array] = (),
    move: Array | None = None,
    offset: float = 0.0,
) -> Surface:
    """The points of a depth image that are near a person's bones, with normals.

    Args:
        depth: (height, width) uint16 millimetres, 0 where there is no reading.
        rays: (height, width, 3) of the camera; see :func:`devices.depth.point_cloud.ray_table`.
        skeleton: (J, 3) metres in the sensor's frame; NaN where not tracked.
        floor: (4,) the plane of the floor, if known: n, h.
        others: (J, 3) of other people; a point that is nearer to one of them is not the person's.
        move: (J, 3) metres by which each joint moves until the moment of the surface; 0 if None.
        offset: Metres by which the camera shows all things too far away.
    """
    known = np.isfinite(skeleton[:, 0])
    if known.sum() < _NEAREST:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3)))
    low, high = skeleton[known].min(axis=0) - _AROUND, skeleton[known].max(axis=0) + _AROUND
    rows, columns = _part(rays, low, high)
    if not depth[rows, columns].size:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3)))
    points, normals = _planes(depth[rows, columns], rays[rows, columns], offset)
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
    images: Iterable[NDArray[np.uint16]],
    rays: NDArray[np.float32],
    body: Body,
    skeletons: Array,
    offset: float = 0.0,
) -> Array | None:
    """(4,) n and h of the floor n · x = h in the sensor's frame, by a robust fit; None where little is seen.

    Args:
        skeletons: (T, J, 3) of the person, who stands on it: its normal is nearly upwards, at the ankles.
    """
    of = [body.joint(f"{name}_{side}") for name in ("SHOULDER", "ANKLE") for side in ("LEFT", "RIGHT")]
    at = skeletons[:, of]
    at = at[np.isfinite(at).all(axis=(1, 2))]
    if not len(at):
        return None
    n = (at[:, :2] - at[:, 2:]).mean(axis=(0, 1))
    n = np.asarray(n / np.linalg.norm(n), dtype=np.float64)
    height, upwards = float(np.median(at[:, 2:] @ n)), n.astype(np.float32)
    coarse, seen = rays[::_COARSE, ::_COARSE], [np.zeros((0, 3))]
    for image in images:
        points, normals = _planes(np.ascontiguousarray(image[::_COARSE, ::_COARSE]), coarse, offset)
        floor = (normals @ upwards > _UPWARDS) & (np.abs(points @ upwards - height) < _HEIGHT)
        seen.append(points[floor].astype(np.float64))
    points = np.concatenate(seen)
    h = float(np.median(points @ n)) if len(points) else 0.0
    for _ in range(12):
        off = np.abs(points @ n - h)
        scale = max(1.48 * float(np.median(off)), 0.003) if len(off) else 0.003
        near = off < max(_FLOOR_ALIKE, 4.0 * scale)
        if near.sum() < _LEAST_FLOOR:
            return None
        weights = 1.0 / (1.0 + (off[near] / (2.0 * scale)) ** 2)
        middle = np.average(points[near], axis=0, weights=weights)
        spread = (points[near] - middle) * np.sqrt(weights)[:, None]
        normal = np.linalg.eigh(spread.T @ spread)[1][:, 0]
        n = normal * np.sign(normal @ n)
        h = float(middle @ n)
    return np.asarray(np.append(n, h), dtype=np.float64)


def velocities(view: View, k: int) -> Array:
    """(J, 3) metres per second of each joint in a frame of a view; 0 where unknown."""
    first, last = max(k - AROUND, 0), min(k + AROUND, len(view.time_ns) - 1)
    seconds = 1e-9 * float(view.time_ns[last] - view.time_ns[first])
    moved = view.positions[last].astype(np.float64) - view.positions[first]
    return np.asarray(np.nan_to_num(moved / max(seconds, 1e-3)), dtype=np.float64)


def _part(rays: NDArray[np.float32], low: Array, high: Array) -> tuple[slice, slice]:
    """Rows and columns of the image that show a box, with a margin for the normals."""
    z = max(float(low[2]), 0.2)
    middle = rays[rays.shape[0] // 2, :, 0], rays[:, rays.shape[1] // 2, 1]
    found = []
    for axis, ray in zip((1, 0), middle[::-1], strict=True):
        bounds = [bound / depth for bound in (low[axis], high[axis]) for depth in (z, float(high[2]))]
        seen = np.flatnonzero((ray > min(bounds)) & (ray < max(bounds)))
        found.append(slice(max(seen[0] - _HALF - 1, 0), seen[-1] + _HALF + 2) if len(seen) else slice(0, 0))
    return found[0], found[1]


def _planes(
    depth: NDArray[np.uint16], rays: NDArray[np.float32], offset: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(h, w, 3) the plane through the readings about each pixel: its point, and its normal to the sensor.

    A plane is linear in 1 / z, so that its fit is a mean and two slopes, without a bias where it is slanted.
    NaN at edges, and where a reading is missing.

    Args:
        offset: Metres that are subtracted along each ray.
    """
    import cv2  # it changes the environment; importing this package must not

    z = depth * np.float32(0.001)
    inverse = np.divide(np.float32(1.0), z, out=np.zeros_like(z), where=depth > 0)
    size = 2 * _HALF + 1
    box, ramp = np.ones((size, 1), dtype=np.float32), np.arange(-_HALF, _HALF + 1, dtype=np.float32)[:, None]
    square = float((ramp**2).mean())
    mean = cv2.boxFilter(inverse, -1, (size, size))
    along_u, along_v = (
        cv2.sepFilter2D(inverse, -1, x, y) / np.float32(size * size * square)
        for x, y in ((ramp, box), (box, ramp))
    )
    window = np.ones((size, size), dtype=np.uint8)
    nearest, farthest = cv2.erode(z, window), cv2.dilate(z, window)
    left = cv2.boxFilter(inverse * inverse, -1, (size, size)) - mean**2 - square * (along_u**2 + along_v**2)
    whole = (nearest > 0.0) & (farthest - nearest < _LARGEST_RANGE) & (left < (_EDGE * mean**2) ** 2)
    whole[:_HALF], whole[-_HALF:], whole[:, :_HALF], whole[:, -_HALF:] = False, False, False, False
    points = np.asarray(rays / np.where(whole, mean, np.float32(np.nan))[..., None], dtype=np.float32)
    steps = (
        step * mean[..., None] - rays * slope[..., None]
        for step, slope in zip(np.gradient(rays, axis=(0, 1)), (along_v, along_u), strict=True)
    )
    # Down × right is towards the sensor: y is down, z forward.
    normals: NDArray[np.float32] = np.asarray(np.cross(*steps), dtype=np.float32)
    with np.errstate(invalid="ignore", divide="ignore"):
        normals /= np.sqrt((normals * normals).sum(axis=-1, keepdims=True))
        cosine = -(normals * points).sum(axis=-1) / np.sqrt((points * points).sum(axis=-1))
    normals[~(cosine > _LEAST_COSINE)] = np.nan
    return (nearer(points, offset) if offset else points), normals


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
