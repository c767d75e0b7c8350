"""The shape of S* in the scene, one capsule per bone, and the thin bones of S_A and S_B.

Capsules and bones are placed at the recorded joints by :mod:`recordings.appearance.entity_styles`. Only their
directions and lengths are stored in addition.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body

_HEAD_RADIUS, _HEAD_LENGTH = 0.085, 0.04
"""Metres; an adult's head is 0.15 m wide and 0.23 m high, most of it about the joint HEAD."""
_RADII = {
    "lower_spine": 0.085,
    "upper_spine": 0.085,
    "neck": 0.045,
    "head": 0.045,
    "clavicle": 0.045,
    "collar": 0.045,
    "upper_arm": 0.040,
    "forearm": 0.030,
    "hand": 0.022,
    "fingers": 0.014,
    "thumb": 0.010,
    "pelvis": 0.075,
    "thigh": 0.060,
    "shin": 0.042,
    "heel": 0.030,
    "foot": 0.028,
    "nose": 0.014,
    "eye": 0.010,
    "ear": 0.014,
}
"""Metres by kind of bone: somewhat slimmer than an adult's, so that S_A and S_B are seen beside the body."""
_FACE = ("nose", "eye", "ear")
_NOSE = 0.15
"""Metres from the middle of the head to the tip of the nose."""
_ROOT_RADIUS = 0.085
_BACK = -0.9999
"""Cosine below which a direction counts as −z, about which the shortest rotation is undetermined."""
_STEP = 1.0 / 256.0
"""Metres, and of quaternions: 2 mm at the end of a thigh. Rounded values take less than half the space."""


def capsule_radii(body: Body) -> NDArray[np.float32]:
    """(J,) radius in metres of the capsule that ends in each joint; that of a sphere at the root."""
    radii = [_RADII[_kind(bone)] if bone else _ROOT_RADIUS for bone in body.bones]
    radii[body.joint("head")] = _HEAD_RADIUS
    return np.array(radii, dtype=np.float32)


def capsule_lengths(body: Body, bone_lengths: NDArray[np.floating]) -> NDArray[np.float32]:
    """(…, J) length in metres of the capsule that begins at each joint and points to its parent.

    It is the length of the bone. The root and the joints of the face get spheres, and the head a capsule
    that does not reach down to the neck.
    """
    share, most = _extent(body)
    return np.minimum(bone_lengths * share, most).astype(np.float32)


@lru_cache(maxsize=8)
def _extent(body: Body) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(J,) share of each bone that has a capsule, and the capsule's largest length in metres."""
    share = np.array([float(bone != "" and _kind(bone) not in _FACE) for bone in body.bones])
    most = np.full(len(body), np.inf)
    most[body.joint("head")] = _HEAD_LENGTH
    return share, most


def bone_vectors(body: Body, positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """(…, J, 3) metres from each joint to its parent; zero at the root and where a joint is missing."""
    at = np.asarray(positions, dtype=np.float32)
    return _rounded(np.nan_to_num(at[..., parents(body), :] - at))


def capsule_rotations(body: Body, positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """(…, J, 4) unit quaternions (x, y, z, w) that turn the z axis from each joint to its parent.

    The shortest such rotation: about (−d_y, d_x, 0) for a direction d, by half-angle formulas. A missing
    joint gets none.
    """
    at = np.asarray(positions, dtype=np.float32)
    along = np.nan_to_num(at[..., parents(body), :] - at)
    length = np.sqrt((along * along).sum(axis=-1, keepdims=True))
    z_axis = np.array([0.0, 0.0, 1.0], dtype=np.float32)
    along = np.where(length > 0.0, along / np.where(length > 0.0, length, 1.0), z_axis)
    cosine = np.sqrt(np.maximum(0.5 * (1.0 + along[..., 2]), 0.25 * (1.0 + _BACK)))  # of half the angle
    rotations = np.zeros((*along.shape[:-1], 4), dtype=np.float32)
    rotations[..., 0] = -0.5 * along[..., 1] / cosine
    rotations[..., 1] = 0.5 * along[..., 0] / cosine
    rotations[..., 3] = cosine
    rotations = _rounded(rotations)
    rotations[along[..., 2] < _BACK] = (1.0, 0.0, 0.0, 0.0)
    return rotations


def nose_vectors(body: Body, positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """(T, 1, 3) metres from the head to the tip of the nose: at right angles to shoulders and neck.

    The head is drawn as if it faced where the chest does. Zero where a joint is missing.
    """
    at = np.asarray(positions, dtype=np.float32)
    shoulders = at[:, body.joint("shoulder right")] - at[:, body.joint("shoulder left")]
    neck = at[:, body.root] - at[:, body.joint("head")]
    forward = _cross(shoulders, neck)
    length = np.linalg.norm(forward, axis=1, keepdims=True)
    forward = np.nan_to_num(forward / np.where(length > 0.0, length, 1.0))
    return _rounded(np.float32(_NOSE) * forward)[:, None]


@lru_cache(maxsize=8)
def parents(body: Body) -> NDArray[np.int64]:
    """(J,) the parent of each joint; the root itself at the root."""
    return np.where(body.parent_indices < 0, body.root, body.parent_indices)


def _cross(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """(T, 3) of (T, 3) vectors: the same bits as ``numpy.cross``, in a third of its time for one frame."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


def _rounded(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.round(values / np.float32(_STEP)) * np.float32(_STEP)


def _kind(bone: str) -> str:
    """upper_arm_left as ``upper_arm``."""
    name, _, side = bone.rpartition("_")
    return name if side in ("left", "right") else bone


def pelvis_rotations(body: Body, positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """(T, 3, 3) K_A ← pelvis: x from left to right hip, y down the spine, z forward; identity without a
    joint, or where the hips lie in one place.
    """
    at = np.asarray(positions, dtype=np.float32)
    hips = at[:, body.joint("hip right")] - at[:, body.joint("hip left")]
    spine = at[:, body.root] - at[:, body.bone("lower_spine")]
    with np.errstate(invalid="ignore", divide="ignore"):  # hips in one place
        x = hips / np.linalg.norm(hips, axis=1, keepdims=True)
        z = _cross(x, spine)
        z /= np.linalg.norm(z, axis=1, keepdims=True)
    rotations = np.stack((x, _cross(z, x), z), axis=2)
    rotations[~np.isfinite(rotations).all(axis=(1, 2))] = np.eye(3)
    return _rounded(rotations)
