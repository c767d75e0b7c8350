"""A person's movement as a function of time: control channels, keyframes, footsteps and inverse kinematics.

A movement defines the pelvis, the trunk, the head, the wrists and the toes. Elbows and knees follow by
inverse kinematics of two bones. Toes stay where they are planted, so feet do not slide. A movement begins
with the start-up pose, standing still, so that the program can calibrate, unless it has ``startup=False``.
Then it repeats its loop.
"""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from devices.simulated.person import anatomy
from devices.simulated.person.anatomy import Pose, along, bow, lean, length, offset, turn, two_bones
from devices.simulated.person.footsteps import ARRIVE_AT_EASE, Footsteps, smooth
from fusion.support.types import Array

STARTUP_SECONDS = 2.5
"""Duration of the start-up pose."""
_BLEND_SECONDS = 1.2

Frame = dict[str, ArrayLike]
Values = Mapping[str, ArrayLike]
_POSES = tomllib.loads((Path(__file__).parent / "poses.toml").read_text(encoding="utf-8"))
STANDING: Frame = _POSES["standing"]
"""Standing at ease with hanging arms; all channels."""
STARTUP: Frame = STANDING | _POSES["startup"]
"""Arms and legs apart: every joint is visible. The bone lengths of eq. 13 are measured in this pose."""
CHANNELS: dict[str, slice] = {}
_COUNT = 0
for _name, _values in STANDING.items():
    CHANNELS[_name] = slice(_COUNT, _COUNT := _COUNT + np.size(_values))


def channels(values: Values) -> Array:
    """Converts named values to (C,) channels; all names are required."""
    row = np.empty(_COUNT)
    for name, where in CHANNELS.items():
        row[where] = values[name]
    return row


def keyframes(period: float, *frames: tuple[float, Values]) -> Callable[[Array], Array]:
    """Makes a periodic movement through keyframes (time, values that differ from STANDING), the first at time
    0. It is twice continuously differentiable.
    """
    times = [time for time, _ in frames]
    rows = [channels(STANDING | dict(values)) for _, values in frames]
    spline = CubicSpline([*times, period], [*rows, rows[0]], bc_type="periodic", axis=0)
    return lambda t: np.asarray(spline(np.mod(t, period)))


@dataclass(frozen=True, eq=False)
class Motion:
    """The joints of one person as a function of time."""

    name: str
    period: float  # duration of the loop, seconds
    loop: Callable[[Array], Array]
    """(T,) seconds since the first start of the loop → (T, C) channels; periodic except at its start."""
    footsteps: Footsteps = field(default_factory=Footsteps)
    """Footsteps of the loop; they end at their initial stance."""
    first_footsteps: Footsteps | None = None  # footsteps of the first round of the loop, if they differ
    arrive: Footsteps = ARRIVE_AT_EASE
    """Steps from the start-up stance to that of the loop, in seconds since the end of the start-up pose."""
    startup: bool = True  # whether the movement begins with the start-up pose
    speeds_up: bool = False  # whether the loop starts from rest: its time advances slowly at first
    bent: float = anatomy.BENT  # of the legs

    @property
    def begins(self) -> float:
        """Start time of the loop, seconds."""
        return STARTUP_SECONDS + _BLEND_SECONDS if self.startup else 0.0

    def landmarks(self, times: ArrayLike, height: float = anatomy.REFERENCE_HEIGHT) -> Array:
        """Returns (T, N, 3) all landmarks in the world, metres, of a person of this stature."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        return self.pose(t).landmarks() * (height / anatomy.REFERENCE_HEIGHT)

    def pose(self, t: Array) -> Pose:
        """Converts (T,) seconds to poses at reference height."""
        c = self.loop(self._phase(t))
        if self.startup:
            moving = smooth((t - STARTUP_SECONDS) / _BLEND_SECONDS)[:, None]
            c = (1.0 - moving) * channels(STARTUP) + moving * c
        return follow(c + _sway(t), *self.feet(t), self.bent)

    def feet(self, t: Array) -> tuple[Array, Array, Array]:
        """Converts (T,) seconds to toes, yaw and pitch of both feet; see :func:`walk_feet`."""
        phase = self._phase(t)
        rounds = [
            (t < self.begins, self.arrive, t - STARTUP_SECONDS),
            (phase < self.period, self.first_footsteps or self.footsteps, phase),
            (np.full(t.shape, True), self.footsteps, np.mod(phase, self.period)),
        ]
        toes, yaw, pitch = np.zeros((len(t), 2, 3)), np.zeros((len(t), 2)), np.zeros((len(t), 2))
        left = np.full(t.shape, True)
        for applies, footsteps, time in rounds[0 if self.startup else 1 :]:
            here = left & applies
            if here.any():
                toes[here], yaw[here], pitch[here] = footsteps.at(time[here])
            left &= ~applies
        return toes, yaw, pitch

    def _phase(self, t: Array) -> Array:
        u = t - self.begins
        if not self.speeds_up:
            return u
        x = np.clip(u, 0.0, 1.0)  # the integral of smooth(u)
        return x**4 * (2.5 + x * (x - 3.0)) + np.maximum(u - 1.0, 0.0)


def _sway(t: Array) -> Array:
    """Returns (T, C) breathing and balance: a few millimetres at frequencies without a common period."""
    c = np.zeros((len(t), _COUNT))
    c[:, CHANNELS["place"]] = np.stack(
        (0.004 * np.sin(2.1 * t) + 0.003 * np.sin(0.83 * t), 0.004 * np.sin(1.7 * t + 1)), axis=1
    )
    c[:, CHANNELS["spine"]] = np.stack(
        (0.008 * np.sin(1.55 * t), 0.006 * np.sin(0.97 * t), 0.01 * np.sin(0.61 * t)), axis=1
    )
    c[:, CHANNELS["head"]] = np.stack(
        (0.02 * np.sin(0.71 * t), 0.01 * np.sin(0.53 * t), 0.04 * np.sin(0.37 * t)), axis=1
    )
    for k, hand in enumerate(("left", "right")):
        c[:, CHANNELS[hand]] = 0.006 * np.sin(np.outer(t, (1.3, 1.1, 0.9 + 0.1 * k)) + k)
    return c


def follow(c: Array, toes: Array, yaw: Array, pitch: Array, bent: float = anatomy.BENT) -> Pose:
    """Computes poses from (T, C) channels and the feet of :func:`walk_feet`."""

    def of(name: str) -> Array:
        return c[:, CHANNELS[name]]

    rotations: dict[str, Array] = {}
    heading = turn(of("heading")[:, 0])
    rotations["pelvis"] = heading @ bow(of("pelvis")[:, 0]) @ lean(of("pelvis")[:, 1])
    bowed, leaning, turned = of("spine").T
    rotations["trunk"] = rotations["pelvis"] @ turn(turned) @ lean(leaning) @ bow(bowed)
    bowed, leaning, turned = of("head").T
    rotations["head"] = rotations["trunk"] @ turn(turned) @ bow(bowed) @ lean(leaning)

    foot_rotations = [turn(yaw[:, f]) @ bow(pitch[:, f]) for f in (0, 1)]
    jump = np.maximum(of("hop"), 0.0)
    hop = jump**2 / (jump + 0.02) * (0.0, -1.0, 0.0)
    ankles = [
        toes[:, f] + hop - foot_rotations[f] @ offset(f"FOOT_{s}") for f, s in enumerate(("LEFT", "RIGHT"))
    ]
    pelvis = np.stack((of("place")[:, 0], -of("height")[:, 0], of("place")[:, 1]), axis=1) + hop
    pelvis[:, 1] = _within_reach(pelvis, rotations["pelvis"], ankles, bent)

    forward = heading @ np.array((0.0, 0.0, -1.0))
    for f, (side, sign) in enumerate((("LEFT", 1.0), ("RIGHT", -1.0))):
        hip = pelvis + rotations["pelvis"] @ offset(f"HIP_{side}")
        ahead = foot_rotations[f] @ np.array((0.15 * sign, 0.0, -1.0))
        knee, ankle, _ = two_bones(
            ankles[f] - hip, ahead + 0.5 * forward, length(f"KNEE_{side}"), length(f"ANKLE_{side}"), bent
        )
        rotations[f"thigh_{side}"] = along(knee, -ahead)
        rotations[f"shin_{side}"] = along(ankle - knee, -ahead)
        rotations[f"foot_{side}"] = foot_rotations[f]
        _bend_arm(rotations, side, sign, c)
    return Pose(pelvis, rotations)


def _bend_arm(rotations: dict[str, Array], side: str, sign: float, c: Array) -> None:
    upper, fore = length(f"ELBOW_{side}"), length(f"WRIST_{side}")
    to_trunk = np.array((sign, -1.0, -1.0))  # out, up, front → x, y, z
    target = c[:, CHANNELS[side.lower()]] * to_trunk * (upper + fore)
    pole = anatomy.unit(c[:, CHANNELS[f"{side.lower()}_elbow"]] * to_trunk)
    elbow, wrist, axis = two_bones(target, pole, upper, fore)
    trunk = rotations["trunk"]
    # The reference axis rotates with the bend, so it is never parallel to the forearm.
    rotations[f"upper_arm_{side}"] = trunk @ along(elbow, np.cross(axis, elbow))
    rotations[f"forearm_{side}"] = trunk @ along(wrist - elbow, np.cross(axis, wrist - elbow))
    bent = c[:, CHANNELS["wrists"]][:, 0 if side == "LEFT" else 1]
    rotations[f"hand_{side}"] = rotations[f"forearm_{side}"] @ lean(sign * bent)


def _within_reach(pelvis: Array, rotation: Array, ankles: list[Array], bent: float) -> NDArray[np.float64]:
    """Returns (T,) the pelvis's y, lowered smoothly until the legs reach both planted feet."""
    lowest = [pelvis[:, 1]]
    for ankle, side in zip(ankles, ("LEFT", "RIGHT"), strict=True):
        reach = (1.0 - 0.5 * bent) * (length(f"KNEE_{side}") + length(f"ANKLE_{side}"))
        hip = rotation @ offset(f"HIP_{side}")
        across = np.sum((ankle - pelvis - hip)[:, (0, 2)] ** 2, axis=1)
        lowest.append(ankle[:, 1] - hip[:, 1] - np.sqrt(np.maximum(reach**2 - across, 0.01)))
    # Metres over which the limits are smoothed. The knee's angle is as the square root of the missing length.
    sharpness = 0.012 * np.sqrt(bent / anatomy.BENT)
    y = np.stack(lowest)
    top = y.max(axis=0)
    return np.asarray(top + sharpness * np.log(np.exp((y - top) / sharpness).sum(axis=0)))
