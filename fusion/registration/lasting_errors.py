"""Errors of trackers that last as long as a pose, so that no number of its frames takes them away.

**Turn.** A tracker shows a person more frontal than he stands. Two views of one pose then put the sensors too
close together round the person. With u_A and u_B the unit vectors from the person to the sensors, B's view is
turned about the person by κ (u_A × u_B) more than it should be, with a rest of standard deviation ``sd``
about that axis. Views of a person who walks about determine R by the path, which has no such error.

Between sensors that face each other, u_A × u_B has no direction, and the turn goes either way.

**Depth.** Each sensor sees the skin and not the joint. The error is common to all joints. Sensors that face
each other see opposite sides of the skin, so that both errors add up.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fusion.body import KINECT_V1, KINECT_V2, Body
from fusion.rigid import RigidTransform, rotation_of
from fusion.support.types import Array

if TYPE_CHECKING:
    from fusion.registration.keyframes import Evidence

COMMON_SD = 0.025
"""Metres, the depth error of one pose between sensors that look at the same side."""


class FrontalTurn(NamedTuple):
    """How much closer together one pose puts the sensors."""

    turn: float  # κ, radians: the turn between sensors 90° apart round the person
    sd: float  # radians, of what remains

    @staticmethod
    def of(body: Body) -> FrontalTurn:
        """The turn of a body's tracker.

        Kinect v2: fitted to the calmest two seconds of 19 real recordings of five people against R of the
        same set-up from their walks and steps. It leaves 2.6° (rms, each person by the others). The angles of
        :class:`fusion.facing.model.FacingConstants` leave 3.9°. For the Kinect v1, of which no such
        recordings are known, half of it is assumed; for networks (Azure Kinect, BlazePose) none.
        """
        return _TURNS.get(body.name, _UNKNOWN)

    def sd_where(self, sine: float, cosine: float, *, known: bool = True) -> float:
        """Radians, standard deviation of a pose's R at an angle between the sensors round the person.

        Args:
            known: Whether R allows for the turn.
        """
        left = 2.0 * max(0.0, -cosine) if known else math.hypot(sine, 2.0 * max(0.0, -cosine))
        return math.hypot(self.sd, self.turn * left)


_TURNS = {
    KINECT_V2.name: FrontalTurn(np.radians(8.5), np.radians(3.0)),
    KINECT_V1.name: FrontalTurn(np.radians(4.0), np.radians(4.0)),
}
_UNKNOWN = FrontalTurn(0.0, np.radians(2.0))


def turned_back(evidence: Evidence, a_from_b: RigidTransform, turn: float) -> Evidence:
    """The evidence with B's views turned by ``turn`` (u_B × u_A), each about the person's middle.

    Args:
        a_from_b: R and t, to some degrees: where the sensors are.
        turn: Radians; κ takes the expected error of a pose away.
    """
    total = np.maximum(evidence.weights.sum(axis=1), 1e-9)[:, None]
    middle = np.einsum("kj,kjc->kc", evidence.weights, evidence.b, optimize=False) / total
    axis = np.cross(*_towards_sensors(middle, a_from_b.inverse().translation, np.zeros(3)))
    turns = rotation_of(-turn * axis)
    b = middle[:, None] + np.einsum("kxy,kjy->kjx", turns, evidence.b - middle[:, None], optimize=False)
    return evidence._replace(b=b)


def turned_apart(a_from_b: RigidTransform, middle: Array, turn: float) -> RigidTransform:
    """``a_from_b`` turned by ``turn`` (u_A × u_B) about the person's middle (3,), in K_A's frame."""
    R = rotation_of(turn * _axis(a_from_b, middle))
    return RigidTransform.of(R, middle - R @ middle) @ a_from_b


def opposition(a_from_b: RigidTransform, middle: Array) -> tuple[float, float]:
    """Sine and cosine of the angle between the sensors round the person's middle (3,), in K_A's frame."""
    u_a, u_b = _towards_sensors(middle, np.zeros(3), a_from_b.translation)
    return float(np.linalg.norm(np.cross(u_a, u_b))), float(u_a @ u_b)


def common_variance(a_from_b: RigidTransform, middle: Array, sd: float = COMMON_SD) -> float:
    """m², along each axis, of the depth error that all joints have in common."""
    _, cosine = opposition(a_from_b, middle)
    return sd**2 * (1.0 + 8.0 * (0.5 - 0.5 * cosine) ** 4)


def _axis(a_from_b: RigidTransform, middle: Array) -> Array:
    return np.cross(*_towards_sensors(middle, np.zeros(3), a_from_b.translation))


def _towards_sensors(middle: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """Unit vectors from points (…, 3) to both sensors."""
    u_a, u_b = (
        to / np.maximum(np.linalg.norm(to, axis=-1, keepdims=True), 1e-9) for to in (a - middle, b - middle)
    )
    return u_a, u_b
