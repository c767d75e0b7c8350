"""Reliability of each view of a joint, eqs. (10), (11).

A joint is likely to be mis-tracked if another joint without a bone to it is near in a sensor's viewing plane.
The nearest such joint over both planes is the mis-leading one, m; the view in which i and m are further apart
is more reliable.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.skeleton import TRACKED


class ViewPixels(NamedTuple):
    """Both views of J joints in their sensors' viewing planes."""

    pixels_a: NDArray[np.float64]
    pixels_b: NDArray[np.float64]
    """(J, 2) where the joints fall in each sensor's own image; NaN where they do not."""
    states_a: NDArray[np.uint8]  # (J,) tracking states
    states_b: NDArray[np.uint8]
    usable: NDArray[np.bool_]  # (J,) scratch


@inner_kernel
def _nearest(i, pixels, usable, linked):  # type: ignore[no-untyped-def]
    """The nearest usable joint without a bone to i in a viewing plane: (squared distance, joint)."""
    least, nearest = math.inf, -1
    for j in range(len(pixels)):
        if usable[j] and not linked[i, j]:
            u, v = pixels[j, 0] - pixels[i, 0], pixels[j, 1] - pixels[i, 1]
            distance = u * u + v * v
            if distance < least:
                least, nearest = distance, j
    return least, nearest


@kernel
def weigh_views(views, linked, h, weights_a, weights_b, misleading):  # type: ignore[no-untyped-def]
    """The weights w_A, w_B of eq. (11) and the mis-leading joint of every joint, sec. 3.

    For joint i, j is the nearest joint in A's viewing plane that is neither i nor linked to it by a bone,
    k the same in B's. m = j where d_ij in A is below d_ik in B, else k. With d_A, d_B the distance of i and
    m in each plane, w̄_A = d_A / (d_A + d_B), eq. (10); times h where tracked and 1 - h where inferred, if
    the states differ; to the fourth power and normalised to w_A + w_B = 1, eq. (11).

    Only joints in both planes can mislead, because d needs both. A joint in one plane only gets weight 1
    there and 0 in the other; in neither, 0 and 0. Without a mis-leading joint, or with it on top of i in
    both planes, w̄_A = w̄_B = ½.

    Args:
        views: The joints in each sensor's image.
        linked: (J, J) whether two joints are the same or share a bone.
        h: In (0.5, 1).
        weights_a, weights_b: (J,) out: w_A, w_B.
        misleading: (J,) out: the mis-leading joint, -1 where there is none.
    """
    pixels_a, pixels_b, usable = views.pixels_a, views.pixels_b, views.usable
    states_a, states_b = views.states_a, views.states_b
    joints = len(pixels_a)
    for i in range(joints):
        usable[i] = math.isfinite(pixels_a[i, 0] + pixels_a[i, 1] + pixels_b[i, 0] + pixels_b[i, 1])
    for i in range(joints):
        misleading[i] = -1
        if not usable[i]:
            weights_a[i] = 1.0 if math.isfinite(pixels_a[i, 0] + pixels_a[i, 1]) else 0.0
            weights_b[i] = 1.0 if math.isfinite(pixels_b[i, 0] + pixels_b[i, 1]) else 0.0
            continue
        least_a, nearest_a = _nearest(i, pixels_a, usable, linked)
        least_b, nearest_b = _nearest(i, pixels_b, usable, linked)
        basic_a = basic_b = 0.5
        m = nearest_a if least_a < least_b else nearest_b
        if m >= 0:
            misleading[i] = m
            d_a = math.hypot(pixels_a[m, 0] - pixels_a[i, 0], pixels_a[m, 1] - pixels_a[i, 1])
            d_b = math.hypot(pixels_b[m, 0] - pixels_b[i, 0], pixels_b[m, 1] - pixels_b[i, 1])
            if d_a + d_b > 0.0:
                basic_a, basic_b = d_a / (d_a + d_b), d_b / (d_a + d_b)
        if states_a[i] != states_b[i]:
            basic_a *= h if states_a[i] == TRACKED else 1.0 - h
            basic_b *= h if states_b[i] == TRACKED else 1.0 - h
        power_a, power_b = basic_a**4, basic_b**4
        weights_a[i], weights_b[i] = power_a / (power_a + power_b), power_b / (power_a + power_b)
