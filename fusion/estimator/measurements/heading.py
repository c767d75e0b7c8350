"""Shoulders and hips turned towards the heading of the facing filter.

A Kinect v2 reports shoulders and hips that face it more than the person does, and from behind nearly
anywhere. This error lasts as long as the pose, so that no average over time or over the views removes it. The
facing filter (:mod:`fusion.facing`) knows that error, and has further evidence on the heading.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.facing.model import HIP, SHOULDER
from fusion.facing.whole_body import in_table

_SHORTEST = 1e-3  # metres: a shorter span across the body has no direction
_CONFIDENCES = 1e-3, 1.0 - 1e-6  # smallest and largest


@inner_kernel
def turn_girdles(facing_model, axis, sensors, views):  # type: ignore[no-untyped-def]
    """Turns shoulders and hips of each view about the body's axis through their middle.

    With δ the angle from the axis of shoulders or hips, l × u, to the heading:

        turn = w δ,    w = σ² / (σ² + s²),    s² = -2 ln ρ

    where σ is the axis's lasting error by the angle to the sensor (``axis_bias``), and ρ the length of the
    mean of the headings' unit vectors under the filter's belief: s is the standard deviation of a wrapped
    normal distribution with that mean. A body whose axes have no such error (σ = 0) is left as it is.

    Args:
        facing_model: Of the body.
        axis: (3,) the body's axis; NaN where unknown.
        sensors: (2, 3) positions of the sensors, metres.
        views: The heading, re-labelled positions, which are changed, and states.
    """
    f = views.heading
    length = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    if not length > 0.0 or math.isnan(axis[0]):  # also where there is none
        return
    variance = -2.0 * math.log(min(max(length, _CONFIDENCES[0]), _CONFIDENCES[1]))
    for v in range(2):
        for girdle in (SHOULDER, HIP):
            left, right = facing_model.pairs[girdle, 0], facing_model.pairs[girdle, 1]
            if views.states[v, left] == 0 or views.states[v, right] == 0:
                continue
            x = views.positions[v]
            cosine = _cosine_to_sensor(x, left, right, sensors[v], f, axis) / length
            sigma = in_table(facing_model.constants.axis_bias, cosine)
            if sigma > 0.0:
                _turn_pair(x, left, right, f, axis, sigma * sigma / (sigma * sigma + variance))


@inner_kernel
def _cosine_to_sensor(x, left, right, sensor, f, u):  # type: ignore[no-untyped-def]
    """Component of f, normal to u, towards the sensor, seen from the middle of two joints."""
    d0 = sensor[0] - 0.5 * (x[left, 0] + x[right, 0])
    d1 = sensor[1] - 0.5 * (x[left, 1] + x[right, 1])
    d2 = sensor[2] - 0.5 * (x[left, 2] + x[right, 2])
    height = d0 * u[0] + d1 * u[1] + d2 * u[2]
    d0, d1, d2 = d0 - height * u[0], d1 - height * u[1], d2 - height * u[2]
    distance = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    return (d0 * f[0] + d1 * f[1] + d2 * f[2]) / max(distance, _SHORTEST)


@inner_kernel
def _turn_pair(x, left, right, f, u, weight):  # type: ignore[no-untyped-def]
    d0, d1, d2 = x[left, 0] - x[right, 0], x[left, 1] - x[right, 1], x[left, 2] - x[right, 2]
    a0, a1, a2 = d1 * u[2] - d2 * u[1], d2 * u[0] - d0 * u[2], d0 * u[1] - d1 * u[0]
    if math.sqrt(a0 * a0 + a1 * a1 + a2 * a2) < _SHORTEST:
        return
    along = a0 * f[0] + a1 * f[1] + a2 * f[2]
    across = u[0] * (a1 * f[2] - a2 * f[1]) + u[1] * (a2 * f[0] - a0 * f[2]) + u[2] * (a0 * f[1] - a1 * f[0])
    angle = weight * math.atan2(across, along)
    # Rodrigues' rotation of d about u: its change is (cos - 1) h + sin (u x d), with h = u x a normal to u
    less, sine = math.cos(angle) - 1.0, math.sin(angle)
    height = d0 * u[0] + d1 * u[1] + d2 * u[2]
    h0, h1, h2 = d0 - height * u[0], d1 - height * u[1], d2 - height * u[2]
    c0, c1, c2 = less * h0 - sine * a0, less * h1 - sine * a1, less * h2 - sine * a2
    x[left, 0] += 0.5 * c0
    x[left, 1] += 0.5 * c1
    x[left, 2] += 0.5 * c2
    x[right, 0] -= 0.5 * c0
    x[right, 1] -= 0.5 * c1
    x[right, 2] -= 0.5 * c2
