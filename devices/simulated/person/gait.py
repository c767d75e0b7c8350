"""Walking along a closed path: footsteps on the path, the pelvis above them, arms opposite to the legs."""

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline

from devices.simulated.person.footsteps import FEET_APART, FEET_AT_EASE, Footsteps, Stance, Step, smooth
from devices.simulated.person.motion import CHANNELS, STANDING, Motion, channels
from fusion.support.types import Array

_STRIDE_SECONDS = 1.15  # two steps
_SWING = 0.38  # share of a stride in which a foot is off the floor
_FIRST_STANCE = 0.44  # seconds until the body is above the left foot and the right foot leaves the floor
_HALF_WIDTH = 0.075  # half the distance between the feet, metres


def walking(name: str, length: float, strides: int) -> Motion:
    """Makes a walk of a loop to the left and one to the right; length in metres and strides are of both."""
    path, heading = _two_loops(length, strides * _STRIDE_SECONDS)
    period = strides * _STRIDE_SECONDS

    def stance(step: int) -> Stance:
        """Returns the stance of step number ``step``: beside the path at the middle of its stance phase."""
        time = _middle_of_stance(step)
        at, facing = path(np.mod(time, period)), float(heading(time))
        aside = _HALF_WIDTH * (1.0 if step % 2 == 0 else -1.0)
        ahead = 0.115  # of the toes: the ankle, 0.15 m behind them, is behind the pelvis then
        x = at[0] + aside * np.cos(facing) + ahead * np.sin(facing)
        z = at[1] + aside * np.sin(facing) - ahead * np.cos(facing)
        return Stance(float(x), float(z), facing + (0.1 if step % 2 == 0 else -0.1))

    def footstep(step: int) -> Step:
        planted = _middle_of_stance(step) - 0.5 * (1.0 - _SWING) * _STRIDE_SECONDS
        return Step(step % 2, planted - _SWING * _STRIDE_SECONDS, planted, stance(step), rolls=True)

    def loop(phase: Array) -> Array:
        rows = np.tile(channels(STANDING), (len(phase), 1))
        going = smooth(phase / 0.8)
        beat = 2.0 * np.pi * (phase - _FIRST_STANCE) / _STRIDE_SECONDS  # 0 at the middle of the left stance
        facing = heading(phase)
        sway = 0.022 * going * np.cos(beat)
        along_path = path(np.mod(phase, period))
        rows[:, CHANNELS["place"]] = along_path + sway[:, None] * np.stack(
            (np.cos(facing), np.sin(facing)), axis=1
        )
        rows[:, CHANNELS["height"].start] += going * (0.008 * np.cos(2.0 * beat - 0.5) - 0.007)
        rows[:, CHANNELS["heading"].start] = facing + 0.09 * going * np.sin(beat)
        rows[:, CHANNELS["pelvis"].start] = 0.03 * going
        rows[:, CHANNELS["pelvis"].start + 1] = -0.03 * going * np.cos(beat)
        rows[:, CHANNELS["spine"].start + 1] = 0.03 * going * np.cos(beat)
        rows[:, CHANNELS["spine"].start + 2] = -0.19 * going * np.sin(beat)
        rows[:, CHANNELS["head"].start + 2] = 0.10 * going * np.sin(beat)
        for hand, sign in (("left", 1.0), ("right", -1.0)):
            forward = going * (0.10 + 0.33 * sign * np.sin(beat - 0.2))
            rows[:, CHANNELS[hand].start + 2] += forward
            rows[:, CHANNELS[hand].start + 1] += 0.45 * forward**2 + 0.10 * going
        return rows

    numbers = range(-2, 2 * strides + 3)
    every = Footsteps((stance(-4), stance(-3)), tuple(footstep(k) for k in numbers))
    # The first round starts from standing, with the first steps that leave the floor after phase 0.
    first = tuple(s for s in map(footstep, numbers) if s.start - 0.5 * (s.end - s.start) > 0.0)
    begin = (stance(0), FEET_AT_EASE[1])
    arrive = Footsteps(
        FEET_APART, (Step(1, 0.05, 0.5, begin[1], heel=0.2), Step(0, 0.55, 1.0, begin[0], heel=0.3))
    )
    return Motion(name, period, loop, every, Footsteps(begin, first), arrive, speeds_up=True, bent=0.0025)


def _middle_of_stance(step: int) -> float:
    """Returns the time at which the body passes above step number ``step``; even steps are left."""
    return 0.5 * step * _STRIDE_SECONDS + _FIRST_STANCE


def _two_loops(length: float, period: float) -> tuple[CubicSpline, CubicSpline]:
    """Computes the path (x, z) and the heading to the left over time, heading 0 at time 0.

    The path is an oval loop to the left, then its mirror image to the right. With θ the share of a loop times
    2π, the heading is θ − ½ sin 2θ. This loop is closed, and its curvature is zero where the loops touch.
    """
    share = np.linspace(0.0, 1.0, 2001)
    theta = 2.0 * np.pi * np.where(share < 0.5, 2.0 * share, 2.0 - 2.0 * share)
    angle = theta - 0.5 * np.sin(2.0 * theta)
    x, z = (cumulative_simpson(length * way, x=share, initial=0.0) for way in (np.sin(angle), -np.cos(angle)))
    x[-1], z[-1], angle[-1] = x[0], z[0], angle[0]
    # People walk slower in curves, so that the outer foot's steps are no longer than others.
    t = period * (share - 0.1 * np.sin(8.0 * np.pi * share) / (8.0 * np.pi))
    return (
        CubicSpline(t, np.stack((x, z), axis=1), bc_type="periodic"),
        CubicSpline(t, angle, bc_type="periodic", extrapolate="periodic"),
    )
