"""Joint angles from positions, in degrees: 0 is standing upright with hanging arms, flexion is positive.

Every angle describes a direction in a frame with x forward, y along the trunk and z to a side, as the joint
coordinate systems of the International Society of Biomechanics do (Wu et al. 2002, hip; 2005, shoulder and
elbow). Axial rotations are missing: positions determine only those of bent limbs, which
:mod:`fusion.movement.joint_rotations` has.

* **Knee, elbow**: between the two bones of the limb; 0 is straight, never negative.
* **Hip**: the thigh in the frame of the trunk, by the sequence Z-X-Y: flexion about the lateral axis, then
  abduction. The long axis goes from the middle of the hips to that of the shoulders, because joints do not
  show the pelvis's tilt against the trunk. The lateral axis is the sum of the lines of hips and shoulders:
  trackers see that of the hips turned by up to 15° (RMS on simulated walks), that of the shoulders by 1°.
* **Shoulder**: the upper arm in the frame of the trunk, with the line of the shoulders as lateral axis. The
  elevation, second angle of the sequence Y-X-Y, is resolved by the plane of elevation, its first angle, into
  flexion (forwards) and abduction (outwards). In either plane alone this is what a goniometer reads.
* **Trunk**: its long axis in a frame of the vertical and the person's left, Z-X-Y. Flexion is bowing
  forwards, lean is to the right.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.body import KINECT_V1, Body
from fusion.compiling.kernels import compiles, inner_kernel, kernel

_OF_A_SIDE = (
    "knee_flexion", "hip_flexion", "hip_abduction", "elbow_flexion", "shoulder_flexion", "shoulder_abduction",
)  # fmt: skip
ANGLES = (
    *(f"{angle}_{side}" for angle in _OF_A_SIDE for side in ("left", "right")),
    "trunk_flexion",
    "trunk_lean",
)
"""Names of the K angles, in the order of the arrays."""
UP = (0.0, -1.0, 0.0)
"""Against gravity in the frame of a level sensor."""
UP_SD = 2.5
"""Standard deviation of an upward direction that is learned from a person, degrees. On 146 simulated
recordings the median of its error was 1°, 95 % were below 5.5°."""

_PARTS = ("Shoulder", "Hip", "Elbow", "Wrist", "Knee", "Ankle")
_SHOULDERS, _HIPS, _ELBOWS, _WRISTS, _KNEES, _ANKLES = range(0, 12, 2)
_STEP = 1e-6  # metres, of the numerical derivative


def joint_angles(body: Body, positions: ArrayLike, up: ArrayLike = UP) -> NDArray[np.float64]:
    """The angles of :data:`ANGLES`.

    Args:
        positions: (..., J, 3) metres, in any frame; NaN where unknown.
        up: (3,) against gravity, in the frame of the positions.

    Returns:
        (..., K) degrees; NaN where a joint that the angle needs is unknown.

    Raises:
        BodyError: The positions are of another body.
    """
    shape, joints, direction = _prepared(body, positions, up)
    angles = np.empty((len(joints), len(ANGLES)))
    _angles_of_frames(joints, _joints_of(body), direction, angles)
    return angles.reshape(*shape, len(ANGLES))


def angle_sigma(
    body: Body, positions: ArrayLike, sigma: ArrayLike, up: ArrayLike = UP, up_sd: float = UP_SD
) -> NDArray[np.float64]:
    """The uncertainty of :func:`joint_angles` by linear propagation, var = Σ |∂angle/∂joint|² σ² / 3.

    Assumes that the errors of the joints are independent and equal in all directions. Those of neighbouring
    joints are not quite, because bones have constant lengths and a view errs for a whole limb. The variance
    of the upward direction is added to the angles of the trunk.

    Args:
        sigma: (..., J) metres, one standard deviation of each joint's distance to the truth.
        up_sd: Standard deviation of ``up`` about each horizontal axis, degrees.

    Returns:
        (..., K) degrees, one standard deviation; NaN where the angle or a joint's sigma is unknown.
    """
    shape, joints, direction = _prepared(body, positions, up)
    deviations = np.ascontiguousarray(sigma, dtype=np.float64).reshape(joints.shape[:2])
    sigmas = np.empty((len(joints), len(ANGLES)))
    across = np.cross(direction, np.eye(3)[0 if abs(direction[0]) < 0.7 else 1])
    across /= np.linalg.norm(across)
    tilted = direction + _STEP * np.array((across, np.cross(direction, across)))
    ups = np.vstack((direction, tilted / np.linalg.norm(tilted, axis=1, keepdims=True)))
    _sigmas_of_frames(joints, deviations, _joints_of(body), ups, math.radians(up_sd), sigmas)
    return sigmas.reshape(*shape, len(ANGLES))


def _prepared(
    body: Body, positions: ArrayLike, up: ArrayLike
) -> tuple[tuple[int, ...], NDArray[np.float64], NDArray[np.float64]]:
    joints = np.ascontiguousarray(positions, dtype=np.float64)
    body.require_shape(joints.shape, joints.shape[:-2])
    direction = np.array(up, dtype=np.float64)
    return joints.shape[:-2], joints.reshape(-1, *joints.shape[-2:]), direction / np.linalg.norm(direction)


@cache
def _joints_of(body: Body) -> NDArray[np.int64]:
    """(12,) the joints that angles need, left and right of :data:`_PARTS`."""
    return np.array([body.joint(f"{part}{side}") for part in _PARTS for side in ("Left", "Right")])


@kernel
def _angles_of_frames(positions, joints, up, angles):  # type: ignore[no-untyped-def]
    points = np.empty((len(joints), 3))
    for t in range(len(positions)):
        _copy(positions[t], joints, points)
        _angles(points, up, angles[t])


@kernel
def _sigmas_of_frames(positions, sigmas, joints, ups, up_sd, found):  # type: ignore[no-untyped-def]
    """``ups``: (3, 3) the upward direction, and the same tilted by _STEP in two directions."""
    points = np.empty((len(joints), 3))
    here, moved = np.empty(found.shape[1]), np.empty(found.shape[1])
    for t in range(len(positions)):
        _copy(positions[t], joints, points)
        _angles(points, ups[0], here)
        for k in range(len(here)):
            found[t, k] = 0.0 * here[k]
        for i in range(len(joints)):
            for c in range(3):
                before = points[i, c]
                points[i, c] += _STEP
                _angles(points, ups[0], moved)
                points[i, c] = before
                for k in range(len(here)):
                    if moved[k] != here[k]:  # an angle that does not need the joint does not need its sigma
                        slope = (moved[k] - here[k]) / _STEP * sigmas[t, joints[i]]
                        found[t, k] += slope * slope / 3.0
        for way in range(1, 3):
            _angles(points, ups[way], moved)
            for k in range(len(here)):
                if moved[k] != here[k]:
                    found[t, k] += (up_sd * (moved[k] - here[k]) / _STEP) ** 2
        for k in range(len(here)):
            found[t, k] = math.sqrt(found[t, k])


@inner_kernel
def _copy(positions, joints, points):  # type: ignore[no-untyped-def]
    for i in range(len(joints)):
        for c in range(3):
            points[i, c] = positions[joints[i], c]


@inner_kernel
def _angles(p, up, out):  # type: ignore[no-untyped-def]
    """The angles of one frame, in the order of ANGLES, from the joints of _PARTS."""
    vertical = (up[0], up[1], up[2])
    across_shoulders = _between(p, _SHOULDERS + 1, _SHOULDERS)
    across = _sum(_between(p, _HIPS + 1, _HIPS), across_shoulders)
    trunk = _unit(_sum(_between(p, _HIPS, _SHOULDERS), _between(p, _HIPS + 1, _SHOULDERS + 1)))
    for side in range(2):
        outwards = 1.0 - 2.0 * side
        thigh, shin = _between(p, _HIPS + side, _KNEES + side), _between(p, _KNEES + side, _ANKLES + side)
        arm, forearm = (
            _between(p, _SHOULDERS + side, _ELBOWS + side),
            _between(p, _ELBOWS + side, _WRISTS + side),
        )
        out[side] = math.degrees(_angle(thigh, shin))
        ahead, down, left = _in_frame(_unit(thigh), trunk, across)
        out[2 + side] = math.degrees(math.atan2(ahead, down))
        out[4 + side] = math.degrees(math.asin(min(max(outwards * left, -1.0), 1.0)))
        out[6 + side] = math.degrees(_angle(arm, forearm))
        ahead, down, left = _in_frame(_unit(arm), trunk, across_shoulders)
        sine = math.sqrt(ahead * ahead + left * left)
        if sine < 1e-9 and down < 0.0:  # an arm exactly upwards, in no plane: as if raised forwards
            degrees, ahead = 180.0, 1.0
        else:
            degrees = math.degrees(math.atan2(sine, down)) / sine if sine > 0.0 else 0.0 * sine
        out[8 + side] = degrees * ahead
        out[10 + side] = degrees * outwards * left
    ahead, down, left = _in_frame(trunk, vertical, across)
    out[12] = math.degrees(math.atan2(ahead, -down))
    out[13] = math.degrees(math.asin(min(max(-left, -1.0), 1.0)))


@inner_kernel
def _in_frame(d, up, across):  # type: ignore[no-untyped-def]
    """A direction's parts ahead, down and to the left, in the frame of an up axis and a line to the left."""
    along = _dot(across, up)
    left = _unit((across[0] - along * up[0], across[1] - along * up[1], across[2] - along * up[2]))
    return _dot(d, _cross(left, up)), -_dot(d, up), _dot(d, left)


@inner_kernel
def _angle(u, v):  # type: ignore[no-untyped-def]
    c = _cross(u, v)
    return math.atan2(math.sqrt(_dot(c, c)), _dot(u, v))


@inner_kernel
def _between(p, i, j):  # type: ignore[no-untyped-def]
    return p[j, 0] - p[i, 0], p[j, 1] - p[i, 1], p[j, 2] - p[i, 2]


@inner_kernel
def _sum(u, v):  # type: ignore[no-untyped-def]
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@inner_kernel
def _unit(u):  # type: ignore[no-untyped-def]
    size = math.sqrt(_dot(u, u))
    return u[0] / size, u[1] / size, u[2] / size


@inner_kernel
def _dot(u, v):  # type: ignore[no-untyped-def]
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inner_kernel
def _cross(u, v):  # type: ignore[no-untyped-def]
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@compiles(_angles_of_frames, _sigmas_of_frames)
def warm_up() -> None:
    """Compiles or loads the kernels."""
    nowhere = np.full((len(KINECT_V1), 3), np.nan)
    joint_angles(KINECT_V1, nowhere)
    angle_sigma(KINECT_V1, nowhere, nowhere[:, 0])
