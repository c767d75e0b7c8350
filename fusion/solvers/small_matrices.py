"""Symmetric 2×2 and 3×3 matrices in closed form, unrolled for compiled loops.

In the solver a symmetric 3×3 matrix is six numbers: xx, xy, xz, yy, yz, zz.
"""

import math

from fusion.compiling.kernels import inner_kernel

_JACOBI_SWEEPS = 12


@inner_kernel
def tangent_basis(x: float, y: float, z: float) -> tuple[float, float, float, float, float, float]:
    """Two unit vectors normal to the unit vector (x, y, z) and to each other (Duff et al. 2017)."""
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    c = x * y * a
    return 1.0 + sign * x * x * a, sign * c, -sign * x, c, sign + y * y * a, -y


@inner_kernel
def absolute_inverse_2x2(
    xx: float, xy: float, yy: float, floor: float
) -> tuple[float, float, float, float, float, float]:
    """The inverse of |M|, M = [[xx, xy], [xy, yy]], with eigenvalues raised to a floor > 0.

    |M| has M's eigenvectors and the absolute values of its eigenvalues: M itself where M is safely
    positive definite.

    Returns:
        xx, xy, yy of the inverse; M's lowest eigenvalue; its unit eigenvector where the eigenvalue is
        not above the floor (zero otherwise).
    """
    mean = 0.5 * (xx + yy)
    half = 0.5 * (xx - yy)
    radius = math.sqrt(half * half + xy * xy)
    lowest = mean - radius
    if lowest > floor:
        scale = 1.0 / (xx * yy - xy * xy)
        return yy * scale, -xy * scale, xx * scale, lowest, 0.0, 0.0
    low = 1.0 / max(abs(lowest), floor)
    high = 1.0 / max(abs(mean + radius), floor)
    middle = 0.5 * (high + low)
    if radius == 0.0:
        return middle, 0.0, middle, lowest, 1.0, 0.0
    spread = 0.5 * (high - low) / radius
    if half >= 0.0:
        v1, v2 = -xy, half + radius
    else:
        v1, v2 = radius - half, -xy
    norm = math.sqrt(v1 * v1 + v2 * v2)
    return middle + spread * half, spread * xy, middle - spread * half, lowest, v1 / norm, v2 / norm


@inner_kernel
def _rotation(app: float, aqq: float, apq: float) -> tuple[float, float]:
    """Cosine and sine of the Jacobi rotation that makes a_pq vanish."""
    if apq == 0.0:
        return 1.0, 0.0
    theta = 0.5 * (aqq - app) / apq
    t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    return c, t * c


@inner_kernel
def eigen_3x3(
    xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
) -> tuple[tuple[float, float, float], tuple[tuple[float, float, float], ...]]:
    """Eigenvalues, unsorted, and unit eigenvectors of a symmetric matrix, by cyclic Jacobi rotations."""
    ux, uy, uz = 1.0, 0.0, 0.0
    vx, vy, vz = 0.0, 1.0, 0.0
    wx, wy, wz = 0.0, 0.0, 1.0
    for _ in range(_JACOBI_SWEEPS):
        off = abs(xy) + abs(xz) + abs(yz)
        if off <= 1e-18 * (abs(xx) + abs(yy) + abs(zz)):
            break
        c, s = _rotation(xx, yy, xy)
        xx, yy = c * c * xx - 2 * s * c * xy + s * s * yy, s * s * xx + 2 * s * c * xy + c * c * yy
        xy, xz, yz = 0.0, c * xz - s * yz, s * xz + c * yz
        ux, uy, uz, vx, vy, vz = (
            c * ux - s * vx, c * uy - s * vy, c * uz - s * vz,
            s * ux + c * vx, s * uy + c * vy, s * uz + c * vz,
        )  # fmt: skip
        c, s = _rotation(xx, zz, xz)
        xx, zz = c * c * xx - 2 * s * c * xz + s * s * zz, s * s * xx + 2 * s * c * xz + c * c * zz
        xz, xy, yz = 0.0, c * xy - s * yz, s * xy + c * yz
        ux, uy, uz, wx, wy, wz = (
            c * ux - s * wx, c * uy - s * wy, c * uz - s * wz,
            s * ux + c * wx, s * uy + c * wy, s * uz + c * wz,
        )  # fmt: skip
        c, s = _rotation(yy, zz, yz)
        yy, zz = c * c * yy - 2 * s * c * yz + s * s * zz, s * s * yy + 2 * s * c * yz + c * c * zz
        yz, xy, xz = 0.0, c * xy - s * xz, s * xy + c * xz
        vx, vy, vz, wx, wy, wz = (
            c * vx - s * wx, c * vy - s * wy, c * vz - s * wz,
            s * vx + c * wx, s * vy + c * wy, s * vz + c * wz,
        )  # fmt: skip
    return (xx, yy, zz), ((ux, uy, uz), (vx, vy, vz), (wx, wy, wz))


@inner_kernel
def inverse(M, into):  # type: ignore[no-untyped-def]
    """M⁻¹ of a symmetric positive definite M, from its cofactors; ``into`` may be M."""
    a, b, c, d, e, f = M[0, 0], M[0, 1], M[0, 2], M[1, 1], M[1, 2], M[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    s = 1.0 / (a * A + b * B + c * C)
    into[0, 0], into[1, 1], into[2, 2] = A * s, (a * f - c * c) * s, (a * d - b * b) * s
    into[0, 1] = into[1, 0] = B * s
    into[0, 2] = into[2, 0] = C * s
    into[1, 2] = into[2, 1] = (b * c - a * e) * s


@inner_kernel
def add_inverse(M, factor, into, room):  # type: ignore[no-untyped-def]
    """``into`` += factor M⁻¹."""
    inverse(M, room)
    for r in range(3):
        for c in range(3):
            into[r, c] += factor * room[r, c]
