"""A rotation and a translation between two named frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.errors import FusionError
from fusion.support.read_only import ReadOnlyArrays, read_only

NOWHERE = read_only(np.full(3, np.nan))
"""An unknown point."""


@dataclass(frozen=True, eq=False)
class RigidTransform(ReadOnlyArrays):
    """Transforms points from a source frame to a target frame: q' = R q + t.

    Name an instance ``target_from_source``; adjacent names cancel: ``a_from_b.apply(points_b)``.

    Attributes:
        rotation: (3, 3) R, orthonormal with determinant +1.
        translation: (3,) t, metres, in the target frame.
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    @staticmethod
    def of(rotation: ArrayLike, translation: ArrayLike) -> RigidTransform:
        """A transform from a rotation matrix and a translation, both checked.

        Raises:
            FusionError: Not a rotation: a wrong shape, not finite, not orthonormal, or a reflection.
        """
        R = np.array(rotation, dtype=np.float64)
        t = np.array(translation, dtype=np.float64)
        if R.shape != (3, 3) or t.shape != (3,) or not (np.isfinite(R).all() and np.isfinite(t).all()):
            raise FusionError(
                f"A rigid transform needs a finite (3, 3) R and (3,) t; got {R.shape}, {t.shape}."
            )
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
            raise FusionError("R is not a rotation: it is not orthonormal, or it is a reflection.")
        return RigidTransform(read_only(R), read_only(t))

    @staticmethod
    def identity() -> RigidTransform:
        """The identity transform."""
        return RigidTransform.of(np.eye(3), np.zeros(3))

    def apply(self, points: ArrayLike) -> NDArray[np.float64]:
        """Transforms (…, 3) points of the source frame to the target frame."""
        return np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation

    def inverse(self) -> RigidTransform:
        """``source_from_target``."""
        return RigidTransform(self.rotation.T, -self.rotation.T @ self.translation)

    def __matmul__(self, other: RigidTransform) -> RigidTransform:
        """``a_from_b @ b_from_c`` is ``a_from_c``."""
        return RigidTransform(self.rotation @ other.rotation, self.apply(other.translation))

    def angle_to(self, other: RigidTransform) -> float:
        """The angle of the rotation between the two, in radians."""
        cosine = (np.trace(self.rotation.T @ other.rotation) - 1.0) / 2.0
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def rotation_of(vector: ArrayLike) -> NDArray[np.float64]:
    """(…, 3, 3) the rotation about each vector (…, 3) by its length in radians (Rodrigues' formula)."""
    # scipy's Rotation would do it, but loads for as long as all else of the method
    x, y, z = np.moveaxis(np.asarray(vector, dtype=np.float64), -1, 0)
    zero = np.zeros_like(x)
    K = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    angle = np.sqrt(x * x + y * y + z * z)[..., None, None]
    half = np.sinc(0.5 * angle / np.pi)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * half * half * (K @ K))


def rotation_vector(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) the axis of a rotation (3, 3), as long as its angle in radians."""
    R = rotation
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = float(np.linalg.norm(axis)), 0.5 * (float(np.trace(R)) - 1.0)
    if cosine < -0.9:  # near half a turn the axis is in the symmetric part
        columns = R + R.T - 2.0 * cosine * np.eye(3)
        longest = columns[:, np.argmax(np.diag(columns))]
        turned = longest * (-1.0 if longest @ axis < 0.0 else 1.0)
        return np.asarray(np.arctan2(sine, cosine) / np.linalg.norm(turned) * turned)
    return axis if sine == 0.0 else np.asarray(np.arctan2(sine, cosine) / sine * axis)


def through_quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) the same rotation by way of its unit quaternion, which takes rounding errors away.

    The operations are those of scipy's ``Rotation.from_matrix(…).as_matrix()``, bit for bit, on which the
    calibrations of the paper's methods depend.
    """
    R = rotation
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    largest = int(np.argmax([R[0, 0], R[1, 1], R[2, 2], trace]))
    q = np.empty(4)
    if largest == 3:
        q[:] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1.0 + trace
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q[i] = 1.0 - trace + 2.0 * R[i, i]
        q[j], q[k], q[3] = R[j, i] + R[i, j], R[k, i] + R[i, k], R[k, j] - R[j, k]
    x, y, z, w = q
    x, y, z, w = q / np.sqrt(x * x + y * y + z * z + w * w)
    xx, yy, zz, ww, xy, zw, xz, yw, yz, xw = (
        x * x, y * y, z * z, w * w, x * y, z * w, x * z, y * w, y * z, x * w
    )  # fmt: skip
    return np.array(
        [
            [xx - yy - zz + ww, 2.0 * (xy - zw), 2.0 * (xz + yw)],
            [2.0 * (xy + zw), -xx + yy - zz + ww, 2.0 * (yz - xw)],
            [2.0 * (xz - yw), 2.0 * (yz + xw), -xx - yy + zz + ww],
        ]
    )
