"""Symmetric 3×3 matrices in plain arrays, without allocation."""

from __future__ import annotations

from fusion.compiling.kernels import inner_kernel


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
