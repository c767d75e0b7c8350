"""Footsteps: where the feet are planted, and how they move between those places."""

from dataclasses import dataclass

import numpy as np

from devices.simulated.person import anatomy
from devices.simulated.person.anatomy import offset
from fusion.support.types import Array

_FOOT_LENGTH = float(offset("HEEL_LEFT")[2] - offset("FOOT_LEFT")[2])


def smooth(x: Array) -> Array:
    """Rises from 0 at x ≤ 0 to 1 at x ≥ 1; velocity and acceleration are 0 at both ends (minimum jerk)."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 + x * (6.0 * x - 15.0))


def bump(x: Array) -> Array:
    """Rises from 0 to 1 at x = ½ and falls back to 0; velocity and acceleration are 0 at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return (4.0 * x * (1.0 - x)) ** 3


@dataclass(frozen=True)
class Stance:
    """A planted foot: position of the toes on the floor (left, back; metres) and yaw to the left, radians."""

    x: float
    z: float
    yaw: float = 0.0


@dataclass(frozen=True)
class Step:
    """A step: one foot leaves the floor and is planted elsewhere."""

    foot: int  # 0 left, 1 right
    start: float  # times between which the toes are off the floor, seconds
    end: float
    to: Stance  # stance after the step
    lift: float = 0.05  # largest height of the toes, metres
    heel: float = 0.35  # pitch of the foot as the heel rises, radians


FEET_APART = (Stance(0.25, -0.13, 0.25), Stance(-0.25, -0.13, -0.25))
FEET_AT_EASE = (Stance(0.12, -0.15, 0.15), Stance(-0.12, -0.15, -0.15))


def walk_feet(
    stances: tuple[Stance, Stance], steps: tuple[Step, ...], t: Array
) -> tuple[Array, Array, Array]:
    """(T, 2, 3) toes in the world, (T, 2) yaw to the left and (T, 2) pitch (toes down) of both feet."""
    toes, yaw, pitch = np.zeros((len(t), 2, 3)), np.zeros((len(t), 2)), np.zeros((len(t), 2))
    for foot in (0, 1):
        stance = stances[foot]
        toes[:, foot] = (stance.x, -anatomy.FOOT_HEIGHT, stance.z)
        yaw[:, foot] = stance.yaw
        for step in sorted((s for s in steps if s.foot == foot), key=lambda s: s.start):
            span = step.end - step.start
            done = smooth(((t - step.start) / span - 0.06) / 0.88)  # the foot is lifted before it moves
            toes[:, foot, 0] += done * (step.to.x - stance.x)
            toes[:, foot, 2] += done * (step.to.z - stance.z)
            toes[:, foot, 1] -= step.lift * bump((t - step.start) / span)
            yaw[:, foot] += done * (step.to.yaw - stance.yaw)
            # The heel leaves the floor before the toes and lands before them.
            toes_up = 0.5 * step.heel * bump((t - step.start - 0.4 * span) / span)
            pitch[:, foot] += step.heel * bump((t - step.start + 0.4 * span) / span) - toes_up
            toes[:, foot, 1] -= _FOOT_LENGTH * np.sin(toes_up)
            stance = step.to
    return toes, yaw, pitch


@dataclass(frozen=True, eq=False)
class Footsteps:
    """A series of steps and the stance of both feet before it."""

    stances: tuple[Stance, Stance] = FEET_AT_EASE
    steps: tuple[Step, ...] = ()

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Converts (T,) seconds to toes, yaw and pitch; see :func:`walk_feet`."""
        return walk_feet(self.stances, self.steps, t)


def arrive(to: tuple[Stance, Stance]) -> Footsteps:
    """Short steps from the start-up stance; seconds since the end of the start-up pose."""
    return Footsteps(FEET_APART, (Step(0, 0.1, 0.45, to[0], 0.03, 0.1), Step(1, 0.6, 0.95, to[1], 0.03, 0.1)))


ARRIVE_AT_EASE = Footsteps(
    FEET_APART,
    (Step(1, 0.05, 0.55, FEET_AT_EASE[1], heel=0.2), Step(0, 0.6, 1.05, FEET_AT_EASE[0], heel=0.2)),
)
"""Steps from the start-up stance to standing at ease; seconds since the end of the start-up pose."""
