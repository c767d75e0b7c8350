"""The covariance of each measurement, from its ray, joint, tracking state and covering joint.

Two errors add up. The slow one is a bias that depends on the view and the pose and lasts for a second or
more; it is larger for an inferred joint, and larger where another joint lies before this one in the sensor's
viewing plane: the mis-leading joint of sec. 3. The fast one changes from frame to frame.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.skeleton import INFERRED

_NEAREST = 0.05  # metres along the ray: no joint is that near to a sensor
_TOUCHING = 1e-3  # metres, so that a cover on the ray itself gives a finite factor


@inner_kernel
def set_rays(model, views):  # type: ignore[no-untyped-def]
    """Computes the unit vector from each sensor to each joint that it reports."""
    for v in range(2):
        for i in range(len(model.parents)):
            if views.states[v, i] == 0:
                continue
            x, y, z = views.positions[v, i, 0], views.positions[v, i, 1], views.positions[v, i, 2]
            if v == 1:
                x, y, z = x - model.translation[0], y - model.translation[1], z - model.translation[2]
            d = 1.0 / max(math.sqrt(x * x + y * y + z * z), 1e-6)
            views.rays[v, i, 0], views.rays[v, i, 1], views.rays[v, i, 2] = x * d, y * d, z * d


@inner_kernel
def find_covers(model, views):  # type: ignore[no-untyped-def]
    """Finds the nearest covering joint of each joint in its sensor's viewing plane, and its distance.

    As in sec. 3, a joint that shares a bone cannot mislead. The distance is the one of eq. (10), in metres at
    the joint's depth rather than in pixels, so that it does not depend on how far away the person is.
    """
    for v in range(2):
        for i in range(len(model.parents)):
            views.covers[v, i], views.cover_distances[v, i] = -1, math.inf
            if views.states[v, i] == 0:
                continue
            rx, ry, rz = views.rays[v, i, 0], views.rays[v, i, 1], views.rays[v, i, 2]
            sx = sy = sz = 0.0
            if v == 1:
                sx, sy, sz = model.translation[0], model.translation[1], model.translation[2]
            px, py, pz = views.positions[v, i, 0], views.positions[v, i, 1], views.positions[v, i, 2]
            depth = (px - sx) * rx + (py - sy) * ry + (pz - sz) * rz
            least = math.inf
            for j in range(len(model.parents)):
                if views.states[v, j] == 0 or model.linked[i, j]:
                    continue
                ux = views.positions[v, j, 0] - sx
                uy = views.positions[v, j, 1] - sy
                uz = views.positions[v, j, 2] - sz
                along = ux * rx + uy * ry + uz * rz
                if along > depth or along < _NEAREST:
                    continue
                f = depth / along
                ux, uy, uz = ux * f - rx * depth, uy * f - ry * depth, uz * f - rz * depth
                square = ux * ux + uy * uy + uz * uz
                if square < least:
                    least = square
                    views.covers[v, i] = j
            views.cover_distances[v, i] = math.sqrt(least)


@inner_kernel
def set_covariances(model, state, views):  # type: ignore[no-untyped-def]
    """Computes the slow covariance C = σ² m I and the fast variance of each measurement.

    σ is the joint's slow error. m = 1 + (near / d)^power with d the distance of the covering joint, eq. (10)
    read as information: a measurement's information falls to a half where d is ``near``. An inferred joint
    has both errors multiplied.
    """
    k = model.constants
    for v in range(2):
        for i in range(len(model.parents)):
            if views.states[v, i] == 0:
                continue
            slow = k.slow_scale * model.slow[i]
            fast = k.fast_scale * model.fast[i]
            d = views.cover_distances[v, i]
            doubled = 1.0 + (k.near / (d + _TOUCHING)) ** k.near_power if d < math.inf else 1.0
            variance = slow * slow * min(doubled, k.near_limit)
            if views.states[v, i] == INFERRED:
                variance *= k.inferred_slow * k.inferred_slow
                fast *= k.inferred_fast
            vx, vy, vz = state.velocities[i, 0], state.velocities[i, 1], state.velocities[i, 2]
            by_speed = k.fast_by_speed * math.sqrt(vx * vx + vy * vy + vz * vz)
            views.fast[v, i] = fast * fast + by_speed * by_speed
            for r in range(3):
                for c in range(3):
                    views.slow[v, i, r, c] = variance if r == c else 0.0
