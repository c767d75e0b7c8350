"""Kinds of joints: the one table of what a joint's name says about it.

Constants that depend on the kind of a joint are mappings from kinds to values (:func:`by_joint`). A new kind
is one row of :data:`KINDS`; its names are in ``_KIND_OF_NAME`` and, for a leg, its kind is in ``_LEG_KINDS``.
Until its own values are measured, it takes those of the kind that it resembles. The weights of
:mod:`fusion.facing.model`, the radii of the drawn body and the simulated errors list joints of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body

T = TypeVar("T")

KINDS: dict[str, str | None] = {
    "spine": None, "head": None, "girdle": None, "elbow": None, "wrist": None, "hand": None, "tip": None,
    "thumb": None, "knee": None, "ankle": None, "foot": None, "face": None,
}  # fmt: skip
"""Kinds of joints, by how well a tracker finds them. A kind without constants of its own takes those of the
kind named here. The girdle is hips, shoulders and clavicles."""
ARM, LEG = 1, 2
"""The limbs whose labels can be exchanged; the bits of an exchange code."""

# The first key that occurs in a joint's name decides.
_KIND_OF_NAME = {
    "handtip": "tip", "thumb": "thumb", "hand": "hand", "wrist": "wrist", "elbow": "elbow",
    "spineshoulder": "spine", "shouldercenter": "spine", "hipcenter": "spine", "shoulder": "girdle",
    "clavicle": "girdle", "hip": "girdle", "knee": "knee", "ankle": "ankle", "foot": "foot", "heel": "foot",
    "head": "head", "nose": "face", "eye": "face", "ear": "face",
}  # fmt: skip
_LEG_KINDS = ("knee", "ankle", "foot")


def kind_of(joint: str) -> str:
    """The kind of a joint, by its name in any body's spelling."""
    name = joint.replace("_", "").lower()
    return next((kind for part, kind in _KIND_OF_NAME.items() if part in name), "spine")


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


def limbs(body: Body) -> NDArray[np.int64]:
    """(J,) ``ARM`` or ``LEG`` for joints that have a left and a right side, 0 on the middle line.

    Hips belong to the legs; shoulders, clavicles, eyes and ears to the arms.
    """
    legs = [kind_of(joint) in _LEG_KINDS or "hip" in joint.lower() for joint in body.joints]
    sided = body.mirror != np.arange(len(body))
    return np.where(sided, np.where(legs, LEG, ARM), 0).astype(np.int64)


def sided_of_kind(body: Body, *kinds: str) -> NDArray[np.bool_]:
    """(J,) whether a joint is of one of these kinds and has a left and a right side."""
    of_kind = [kind_of(joint) in kinds for joint in body.joints]
    return np.asarray(of_kind & (body.mirror != np.arange(len(body))))
