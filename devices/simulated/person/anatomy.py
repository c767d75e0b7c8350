"""The rigid segments and landmarks of a person, which include the joints of every Kinect body.

World frame: x to the person's left at heading zero, y down, z backwards; the floor is y = 0. A sensor that
looks along +z at a person of heading zero has the same axes. At rest every segment has the identity rotation:
the person stands upright with hanging arms and palms inwards.

Segments rotate only about joints that all bodies have. Every bone of every body therefore has a
constant length. The upper trunk, from the navel to the shoulders and the neck, is one segment.
"""

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.support.types import Array

REFERENCE_HEIGHT = 1.75
"""The stature, in metres, of the tables in this package. They are scaled to the stature of a person."""

# segment: (parent segment, landmark that it rotates about)
_SEGMENTS: dict[str, tuple[str, str]] = {
    "pelvis": ("", "PELVIS"),
    "trunk": ("pelvis", "SPINE_NAVEL"),
    "head": ("trunk", "NECK"),
}
for _side in ("LEFT", "RIGHT"):
    _SEGMENTS |= {
        f"upper_arm_{_side}": ("trunk", f"SHOULDER_{_side}"),
        f"forearm_{_side}": (f"upper_arm_{_side}", f"ELBOW_{_side}"),
        f"hand_{_side}": (f"forearm_{_side}", f"WRIST_{_side}"),
        f"thigh_{_side}": ("pelvis", f"HIP_{_side}"),
        f"shin_{_side}": (f"thigh_{_side}", f"KNEE_{_side}"),
        f"foot_{_side}": (f"shin_{_side}", f"ANKLE_{_side}"),
    }
SEGMENTS = tuple(_SEGMENTS)

_Landmark = tuple[str, str, tuple[float, float, float]]
"""The segment that carries a landmark, the landmark that it is measured from, and the offset at rest."""


def _landmark_table() -> dict[str, _Landmark]:
    tables = tomllib.loads((Path(__file__).parent / "landmarks.toml").read_text(encoding="utf-8"))
    table = {name: (segment, origin, tuple(at)) for name, (segment, origin, at) in tables["middle"].items()}
    for side, sign in (("LEFT", 1.0), ("RIGHT", -1.0)):
        for name, (segment, origin, (x, y, z)) in tables["left"].items():
            sided_segment = segment if segment in _SEGMENTS else f"{segment}_{side}"
            sided_origin = f"{origin}_{side}" if origin in tables["left"] else origin
            table[f"{name}_{side}"] = (sided_segment, sided_origin, (sign * x, y, z))
    return table


_LANDMARKS = _landmark_table()
LANDMARKS = tuple(_LANDMARKS)
INDEX = {name: i for i, name in enumerate(LANDMARKS)}
FOOT_HEIGHT = 0.020
"""Height of the FOOT landmark above the floor when the foot is flat, metres at reference height."""

# Only joints whose spelling differs from Azure's by more than case and underscores.
_SYNONYMS = {
    "hipcenter": "PELVIS",
    "spine": "SPINE_NAVEL",
    "shouldercenter": "NECK",
    "spinebase": "PELVIS",
    "spinemid": "SPINE_NAVEL",
    "spineshoulder": "SPINE_SHOULDER",
}


@cache
def landmarks_of(body: Body) -> NDArray[np.int64]:
    """Returns (J,) the landmark index of each joint."""
    plain = {name.replace("_", "").lower(): i for name, i in INDEX.items()}
    plain |= {synonym: INDEX[name] for synonym, name in _SYNONYMS.items()}
    return np.array([plain[joint.replace("_", "").lower()] for joint in body.joints], dtype=np.int64)


def offset(name: str) -> Array:
    """Returns (3,) a landmark's rest offset from its reference landmark, metres."""
    return np.array(_LANDMARKS[name][2])


@cache
def rest_positions() -> Array:
    """Returns (N, 3) the landmarks at rest, from the pelvis, metres at reference height."""
    at_rest = {segment: np.eye(3)[None] for segment in SEGMENTS}
    rest: Array = Pose(np.zeros((1, 3)), at_rest).landmarks()[0]
    return rest


def carrier(name: str) -> NDArray[np.int64]:
    """Returns the landmarks that move rigidly with one: those of its segment and the segment's pivot."""
    segment = _LANDMARKS[name][0]
    pivot = _SEGMENTS[segment][1]
    with_it = [other for other, (carried_by, _, _) in _LANDMARKS.items() if carried_by == segment]
    return np.array(sorted({INDEX[other] for other in (*with_it, pivot)}), dtype=np.int64)


def length(name: str) -> float:
    """Returns the distance of a landmark from its reference landmark, metres."""
    return float(np.linalg.norm(offset(name)))


@dataclass(frozen=True, eq=False)
class Pose:
    """T poses of one person at reference height."""

    pelvis: Array  # (T, 3) positions of the pelvis in the world, metres
    rotations: dict[str, Array]  # (T, 3, 3) ``world_from_segment`` of each segment

    def landmarks(self, names: tuple[str, ...] = LANDMARKS) -> Array:
        """Returns (T, N, 3) the landmarks in the world, metres."""
        at: dict[str, Array] = {"PELVIS": self.pelvis}
        for name, (segment, origin, rest) in _LANDMARKS.items():
            if name != "PELVIS" and origin in at and segment in self.rotations:
                at[name] = at[origin] + self.rotations[segment] @ np.array(rest)
        return np.stack([at[name] for name in names], axis=1)


# --- rotations: (T,) angles to (T, 3, 3), in the world frame of the module docstring ---


def turn(left: Array) -> Array:
    """Returns rotations to the person's left by an angle."""
    c, s, o, i = np.cos(left), np.sin(left), np.zeros_like(left), np.ones_like(left)
    return _matrix((c, o, -s), (o, i, o), (s, o, c))


def bow(forward: Array) -> Array:
    """Returns rotations that move the upper end forwards by an angle (of a foot: toes down)."""
    c, s, o, i = np.cos(forward), np.sin(forward), np.zeros_like(forward), np.ones_like(forward)
    return _matrix((i, o, o), (o, c, -s), (o, s, c))


def lean(left: Array) -> Array:
    """Returns rotations that move the upper end to the person's left by an angle."""
    c, s, o, i = np.cos(left), np.sin(left), np.zeros_like(left), np.ones_like(left)
    return _matrix((c, -s, o), (s, c, o), (o, o, i))


def _matrix(*rows: tuple[Array, Array, Array]) -> Array:
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def unit(vectors: Array) -> Array:
    """Returns (…, 3) the vectors normalized to length one."""
    norms: Array = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(norms, 1e-12)


def along(down: Array, back: Array) -> Array:
    """Returns (T, 3, 3) rotations with the long axis (y) along ``down`` and z closest to ``back``."""
    y = unit(down)
    z = unit(back - y * np.sum(back * y, axis=-1, keepdims=True))
    return np.stack((np.cross(y, z), y, z), axis=-1)


BENT = 0.03
"""Share of a straight limb's length that is missing when its reach begins to saturate."""


def two_bones(
    target: Array, pole: Array, first: float, second: float, bent: float = BENT
) -> tuple[Array, Array, Array]:
    """Solves the inverse kinematics of two bones from the origin to a target (law of cosines).

    The reach saturates smoothly below the length of the straight limb, because the derivative of the bend by
    the distance is infinite at full stretch.

    Args:
        target: (T, 3) desired end of the second bone.
        pole: (T, 3) direction towards which the middle joint bends.
        bent: See :data:`BENT`.

    Returns:
        (T, 3) the middle joint, (T, 3) the end, and (T, 3) the unit rotation axis of the middle joint.
    """
    reach = first + second
    soft, hard = (1.0 - bent) * reach, (1.0 - bent / 15.0) * reach
    wanted = np.linalg.norm(target, axis=-1, keepdims=True)
    over = np.maximum(wanted - soft, 0.0)
    d = np.where(wanted <= soft, wanted, soft + (hard - soft) * -np.expm1(-over / (hard - soft)))
    d = np.maximum(d, abs(first - second) + 0.05 * reach)
    ahead = unit(target)
    aside = unit(pole - ahead * np.sum(pole * ahead, axis=-1, keepdims=True))
    x = (d**2 + first**2 - second**2) / (2.0 * d)
    middle = ahead * x + aside * np.sqrt(np.maximum(first**2 - x**2, 0.0))
    return middle, ahead * d, np.cross(ahead, aside)
