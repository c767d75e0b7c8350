"""Measures the depth image around each joint of the same sensor's skeleton: a few numbers per joint.

A body tracker places joints by a learned model; the depth image shows whether a surface is there. The numbers
are recorded with the session, so that a replay needs no images. See :mod:`fusion.witness` for their meaning.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from devices.depth.camera import lens_of, pixel
from devices.sensor import SensorFrame
from fusion.body import KINECT_V1
from fusion.compiling.kernels import compiles, inner_kernel, kernel
from fusion.intrinsics import Intrinsics
from fusion.skeleton import Skeleton
from fusion.witness import COLUMNS, REACH, SEEN_PAST

_GAP_RADIUS = 0.012  # metres: half width of the window whose median reading is the surface
_LARGEST_WINDOW = 3  # pixels to each side of the joint
_PATCH_RADIUS = 0.09  # metres: wider than any limb, narrower than two legs
_PATCH_DEPTH = 0.06  # metres: a reading farther from the surface at the joint belongs to another limb
_STEP = 0.010  # metres at the joint's depth: a finer image is read at every second or third pixel
_FEWEST = 3  # readings of a patch


def depth_witness(
    depth: NDArray[np.uint16], intrinsics: Intrinsics, skeleton: Skeleton
) -> NDArray[np.float32]:
    """Measures the image around each joint.

    Args:
        depth: (height, width) uint16 millimetres along z, 0 where there is no reading.
        intrinsics: Intrinsics of this image. The lens distortion is applied to each joint.
        skeleton: Skeleton of the same frame and sensor.

    Returns:
        (J, 4) metres; the columns are ``fusion.witness.COLUMNS``. NaN without a reading at the
        joint, for a joint without a position, and outside the image.
    """
    found = np.full((len(skeleton.states), len(COLUMNS)), np.nan, dtype=np.float32)
    positions = np.ascontiguousarray(skeleton.positions, dtype=np.float32)
    _measure(np.ascontiguousarray(depth), *lens_of(intrinsics), positions, found)
    return found.astype(np.float16).astype(np.float32)  # precision of a session, for replays


def with_witness(frame: SensorFrame, intrinsics: Intrinsics) -> SensorFrame:
    """Returns the frame with depth evidence in each skeleton that lacks it, if it has a depth image."""
    depth = frame.depth
    if depth is None or depth.shape != (intrinsics.height, intrinsics.width) or not frame.people:
        return frame
    people = {
        person: skeleton
        if skeleton.witness is not None
        else skeleton.with_witness(depth_witness(depth, intrinsics, skeleton))
        for person, skeleton in frame.people.items()
    }
    return replace(frame, people=people)


@kernel
def _measure(depth, pinhole, lens, positions, found):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    sorted_gaps = np.empty((2 * _LARGEST_WINDOW + 1) ** 2)
    for j in range(len(positions)):
        x, y, z = float(positions[j, 0]), float(positions[j, 1]), float(positions[j, 2])
        if not z > 0.1:
            continue
        centre_u, centre_v = pixel(pinhole, lens, x / z, y / z)
        if not (-0.5 <= centre_u < width - 0.5 and -0.5 <= centre_v < height - 0.5):
            continue
        u, v = int(centre_u + 0.5), int(centre_v + 0.5)  # the pixel that contains the joint
        along = math.sqrt(x * x + y * y + z * z) / z  # metres along the ray for each metre of depth
        across = pinhole[0] / z  # pixels for each metre across the ray
        gap = _gap(depth, u, v, z, along, across, sorted_gaps)
        if not math.isfinite(gap):
            continue
        found[j, 0] = gap
        found[j, 1] = _edge(depth, u, v, z, along, across, gap > SEEN_PAST)
        found[j, 2], found[j, 3] = _patch(depth, centre_u, centre_v, z, along, across, gap)


@inner_kernel
def _gap(depth, u, v, z, along, across, sorted_gaps):  # type: ignore[no-untyped-def]
    """Median of (surface - joint) along the ray in a small window; NaN without a reading."""
    height, width = depth.shape
    radius = min(_LARGEST_WINDOW, max(1, round(_GAP_RADIUS * across)))
    count = 0
    for b in range(max(0, v - radius), min(height, v + radius + 1)):
        for a in range(max(0, u - radius), min(width, u + radius + 1)):
            if depth[b, a] == 0:
                continue
            gap = (0.001 * depth[b, a] - z) * along
            i = count
            while i > 0 and sorted_gaps[i - 1] > gap:
                sorted_gaps[i] = sorted_gaps[i - 1]
                i -= 1
            sorted_gaps[i] = gap
            count += 1
    return sorted_gaps[count // 2] if count > 0 else math.nan


@inner_kernel
def _edge(depth, u, v, z, along, across, outside):  # type: ignore[no-untyped-def]
    """Signed distance to the silhouette, metres: positive inside; searched in growing squares."""
    height, width = depth.shape
    step = max(1, round(_STEP * across))
    farthest = int(REACH * across)
    nearest = float(farthest * farthest)
    k = step
    while k <= farthest and k * k < nearest:
        for i in range(-k, k + 1, step):
            for side in range(4):
                if side == 0:
                    a, b = u + i, v - k
                elif side == 1:
                    a, b = u + i, v + k
                elif side == 2:
                    a, b = u - k, v + i
                else:
                    a, b = u + k, v + i
                if not (0 <= a < width and 0 <= b < height) or depth[b, a] == 0:
                    continue
                on_body = (0.001 * depth[b, a] - z) * along < SEEN_PAST
                if on_body == outside:
                    nearest = min(nearest, float((a - u) ** 2 + (b - v) ** 2))
        k += step
    distance = min(math.sqrt(nearest) / across, REACH)
    return -distance if outside else distance


@inner_kernel
def _patch(depth, centre_u, centre_v, z, along, across, gap):  # type: ignore[no-untyped-def]
    """Offset across the ray from the joint to the centroid of the readings near its surface, metres."""
    height, width = depth.shape
    radius = _PATCH_RADIUS * across
    step = max(1, round(_STEP * across))
    sum_u = sum_v = 0.0
    count = 0
    for b in range(int(centre_v - radius), int(centre_v + radius) + 1, step):
        for a in range(int(centre_u - radius), int(centre_u + radius) + 1, step):
            du, dv = a - centre_u, b - centre_v
            if not (0 <= a < width and 0 <= b < height) or du * du + dv * dv > radius * radius:
                continue
            if depth[b, a] == 0 or abs((0.001 * depth[b, a] - z) * along - gap) > _PATCH_DEPTH:
                continue
            sum_u, sum_v, count = sum_u + du, sum_v + dv, count + 1
    if count < _FEWEST:
        return math.nan, math.nan
    return sum_u / count / across, sum_v / count / across


@compiles(_measure)
def warm_up() -> None:
    """Compiles or loads the kernel, so that a sensor's first frame does not wait for it."""
    nowhere = Skeleton.of(KINECT_V1, np.zeros((len(KINECT_V1), 3)))
    depth_witness(np.zeros((1, 1), dtype=np.uint16), Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0), nowhere)
