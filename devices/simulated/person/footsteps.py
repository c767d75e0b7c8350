"""Footsteps: where the feet are planted, and how they move between those places."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

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
    rolls: bool = False  # whether the foot rolls, as in walking; lift and heel have no effect then


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
            if step.rolls:
                _roll(toes[:, foot], yaw[:, foot], pitch[:, foot], (t - step.start) / span, stance, step.to)
                stance = step.to
                continue
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


def _about_heel(pitch: Array) -> tuple[Array, Array]:
    """Returns how far the toes of a flat foot rise and come back, metres, if it turns about its heel."""
    _, drop, ahead = offset("FOOT_LEFT") - offset("HEEL_LEFT")
    gone = 1.0 - np.cos(pitch)
    return ahead * np.sin(pitch) + drop * gone, drop * np.sin(pitch) - ahead * gone


_LANDS = np.radians(-15.0)
_ROLL = PchipInterpolator(
    (-0.5, -0.22, 0.0, 0.1, 0.5, 0.75, 0.9, 1.0, 1.3),
    (*np.radians((0.0, 6.5, 32.5, 45.0, 21.0, 1.5, -10.5)), _LANDS, 0.0),
)
"""Radians, toes down, of a foot that walks, over time as a share of that off the floor. The heel rises at
0.43 of the stride, and the foot is flat at 0.11."""
_RISE = PchipInterpolator(
    (0.0, 0.12, 0.3, 0.5, 0.75, 0.9, 1.0),
    (0.0, 0.016, 0.028, 0.015, 0.021, 0.047, float(_about_heel(_LANDS)[0])),
)
"""Metres, of its toes: least in the middle, most before the heel lands (Winter 1992)."""


def _roll(toes: Array, yaw: Array, pitch: Array, x: Array, before: Stance, after: Stance) -> None:
    """Adds a step that rolls over the toes, swings and lands on the heel, at shares x of its time."""
    rolled = np.where((x > _ROLL.x[0]) & (x < _ROLL.x[-1]), _ROLL(x), 0.0)
    swung = np.clip(x, 0.0, 1.0)
    moved = np.clip((x - 0.01) / 0.99, 0.0, 1.0)  # the foot is lifted before it moves
    done = moved * (0.25 + 0.75 * moved * (3.0 - 2.0 * moved))  # it leaves and lands at a speed
    rise, back = _about_heel(np.minimum(rolled, 0.0))
    toes[:, 1] -= np.where(x < 1.0, _RISE(swung), rise)
    pitch += rolled
    yaw += done * (after.yaw - before.yaw)
    toes[:, 0] += done * (after.x - before.x) - back * np.sin(yaw)
    toes[:, 2] += done * (after.z - before.z) + back * np.cos(yaw)


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
