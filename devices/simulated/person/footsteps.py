"""Where the feet are planted, and how they get from one place to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from devices.simulated.person import anatomy
from devices.simulated.person.anatomy import Array, offset

_FOOT_LENGTH = float(offset("HEEL_LEFT")[2] - offset("FOOT_LEFT")[2])


def smooth(x: Array) -> Array:
    """From 0 at x ≤ 0 to 1 at x ≥ 1 with no velocity or acceleration at either end (minimum jerk)."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 + x * (6.0 * x - 15.0))


def bump(x: Array) -> Array:
    """From 0 to 1 at x = ½ and back, with no velocity or acceleration at either end."""
    x = np.clip(x, 0.0, 1.0)
    return (4.0 * x * (1.0 - x)) ** 3


@dataclass(frozen=True)
class Stance:
    """A planted foot: its toes in the plane (to the left, to the back; metres) and its yaw to the left."""

    x: float
    z: float
    yaw: float = 0.0


@dataclass(frozen=True)
class Step:
    """One foot taken off the floor and planted elsewhere.

    Attributes:
        foot: 0 left, 1 right.
        start, end: Seconds; the toes are off the floor in between.
        to: Where it is planted.
        lift: How high the toes are lifted, metres.
        heel: How far the heel rises as the foot leaves, radians.
    """

    foot: int
    start: float
    end: float
    to: Stance
    lift: float = 0.05
    heel: float = 0.35


FEET_APART = (Stance(0.25, -0.13, 0.25), Stance(-0.25, -0.13, -0.25))
FEET_AT_EASE = (Stance(0.12, -0.15, 0.15), Stance(-0.12, -0.15, -0.15))


def walk_feet(
    stances: tuple[Stance, Stance], steps: tuple[Step, ...], t: Array
) -> tuple[Array, Array, Array]:
    """Both feet over time.

    Returns:
        (T, 2, 3) toes in the world, (T, 2) yaw to the left, (T, 2) pitch (toes down).
    """
    toes, yaw, pitch = np.zeros((len(t), 2, 3)), np.zeros((len(t), 2)), np.zeros((len(t), 2))
    for foot in (0, 1):
        stance = stances[foot]
        toes[:, foot] = (stance.x, -anatomy.FOOT_HEIGHT, stance.z)
        yaw[:, foot] = stance.yaw
        for step in sorted((s for s in steps if s.foot == foot), key=lambda s: s.start):
            span = step.end - step.start
            done = smooth(((t - step.start) / span - 0.06) / 0.88)  # lifted first, then moved
            toes[:, foot, 0] += done * (step.to.x - stance.x)
            toes[:, foot, 2] += done * (step.to.z - stance.z)
            toes[:, foot, 1] -= step.lift * bump((t - step.start) / span)
            yaw[:, foot] += done * (step.to.yaw - stance.yaw)
            # The heel leaves before the toes; the toes land after the heel.
            toes_up = 0.5 * step.heel * bump((t - step.start - 0.4 * span) / span)
            pitch[:, foot] += step.heel * bump((t - step.start + 0.4 * span) / span) - toes_up
            toes[:, foot, 1] -= _FOOT_LENGTH * np.sin(toes_up)
            stance = step.to
    return toes, yaw, pitch


@dataclass(frozen=True, eq=False)
class Footsteps:
    """Where the feet stand before a series of steps, and the steps."""

    stances: tuple[Stance, Stance] = FEET_AT_EASE
    steps: tuple[Step, ...] = ()

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """(T,) seconds → toes, yaw, pitch, as :func:`walk_feet`."""
        return walk_feet(self.stances, self.steps, t)


ARRIVE_AT_EASE = Footsteps(
    FEET_APART,
    (Step(1, 0.05, 0.55, FEET_AT_EASE[1], heel=0.2), Step(0, 0.6, 1.05, FEET_AT_EASE[0], heel=0.2)),
)
"""From the start-up stance to standing at ease, in seconds since the end of the start-up pose."""
