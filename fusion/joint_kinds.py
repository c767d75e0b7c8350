"""Kinds of joints: the one table of what a joint's name says about it.

Constants that depend on the kind of a joint are mappings from kinds to values (:func:`by_joint`); groups of
joints are kinds, too (:func:`of_kind`). A new kind is one row of :data:`KINDS` and one of ``_KIND_OF_NAME``.
Until its own values are measured, it names the kind that it resembles, and takes its values and its place in
groups. A joint whose name says no kind, and a kind without a value, are errors.
"""

from collections.abc import Mapping
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.support.read_only import read_only

T = TypeVar("T")

KINDS: dict[str, str | None] = {
    "spine": None, "head": None, "girdle": None, "elbow": None, "wrist": None, "hand": None, "tip": None,
    "thumb": None, "knee": None, "ankle": None, "foot": None, "face": None,
}  # fmt: skip
"""Kinds of joints, by how well a tracker finds them, each with the kind that it resembles. The girdle is
hips, shoulders and clavicles."""
_UNLIKE = [kind for kind, like in KINDS.items() if like is None]
ARM, LEG = 1, 2
"""The limbs whose labels can be exchanged; the bits of an exchange code."""

# The first key that occurs in a joint's name decides.
_KIND_OF_NAME = {
    "handtip": "tip", "thumb": "thumb", "hand": "hand", "wrist": "wrist", "elbow": "elbow",
    "spine": "spine", "shouldercenter": "spine", "hipcenter": "spine", "pelvis": "spine", "neck": "spine",
    "shoulder": "girdle", "clavicle": "girdle", "hip": "girdle", "knee": "knee", "ankle": "ankle",
    "foot": "foot", "heel": "foot", "head": "head", "nose": "face", "eye": "face", "ear": "face",
}  # fmt: skip


def kind_of(joint: str) -> str:
    """The kind of a joint, by its name in any body's spelling.

    Raises:
        KeyError: The name says none.
    """
    name = joint.replace("_", "").lower()
    for part, kind in _KIND_OF_NAME.items():
        if part in name:
            return kind
    raise KeyError(f"{joint} is of no kind that fusion.joint_kinds knows")


def value_of(kind: str, values: Mapping[str, T]) -> T:
    """The value of a kind, or of the kind that it resembles.

    Raises:
        KeyError: Neither has a value.
    """
    while kind not in values and (like := KINDS[kind]) is not None:
        kind = like
    return values[kind]


def by_joint(body: Body, values: Mapping[str, float]) -> NDArray[np.float64]:
    """(J,) the value of each joint's kind."""
    return np.array([value_of(kind_of(joint), values) for joint in body.joints])


def of_kind(body: Body, *kinds: str) -> NDArray[np.bool_]:
    """(J,) whether a joint is of one of these kinds, or of one that resembles it."""
    return by_joint(body, dict.fromkeys(_UNLIKE, 0.0) | dict.fromkeys(kinds, 1.0)) > 0.0


@cache
def limbs(body: Body) -> NDArray[np.int64]:
    """(J,) ``ARM`` or ``LEG`` for joints that have a left and a right side, 0 on the middle line.

    Hips belong to the legs; shoulders, clavicles, eyes and ears to the arms.
    """
    hips = ["hip" in joint.lower() for joint in body.joints]
    legs = of_kind(body, "knee", "ankle", "foot") | hips
    limb = np.where(body.sided, np.where(legs, LEG, ARM), 0).astype(np.int64)
    return read_only(limb)  # all callers share it
