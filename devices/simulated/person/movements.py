"""The movements by name. Most are tables of keyframes and footsteps in ``movements.toml``."""

import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from devices.simulated.person.footsteps import (
    ARRIVE_AT_EASE,
    FEET_APART,
    FEET_AT_EASE,
    Footsteps,
    Stance,
    Step,
    arrive,
)
from devices.simulated.person.gait import walking
from devices.simulated.person.motion import STARTUP, Frame, Motion, keyframes


def _tables() -> Iterator[Motion]:
    tables = tomllib.loads((Path(__file__).parent / "movements.toml").read_text(encoding="utf-8"))
    for name, of in tables.items():
        poses: dict[str, Frame] = {"": {}}
        for pose, values in of.get("poses", {}).items():
            poses[pose] = poses[values.pop("as", "")] | values
        frames = [
            (t, poses[pose] | {k: v for more in others for k, v in more.items()})
            for t, pose, *others in of["keyframes"]
        ]
        left, right = (Stance(*stance) for stance in of["feet"]) if "feet" in of else FEET_AT_EASE
        steps = tuple(
            Step(foot, start, end, Stance(*to), *how) for foot, start, end, to, *how in of.get("steps", ())
        )
        arriving = arrive((left, right)) if "feet" in of else ARRIVE_AT_EASE
        loop = keyframes(of["seconds"], *frames)
        yield Motion(
            name,
            of["seconds"],
            loop,
            Footsteps((left, right), steps),
            arrive=arriving,
            startup=of.get("startup", True),
        )


def _startup() -> Motion:
    loop = keyframes(60.0, (0.0, STARTUP), (30.0, STARTUP))
    return Motion("startup", 60.0, loop, Footsteps(FEET_APART), arrive=Footsteps(FEET_APART))


def _turn() -> Motion:
    """Turning on the spot in eighths: one full turn to the left, then one back."""
    seconds, eighth = 0.62, np.pi / 4
    frames: list[tuple[float, Frame]] = [(0.0, {}), (0.5, {})]
    steps: list[Step] = []
    angles = [*range(1, 9), *range(7, -1, -1)]
    start = 0.5
    for k, n in enumerate(angles):
        leftwards = k < 8
        start = 0.5 + k * seconds * 1.5 + (1.0 if not leftwards else 0.0)
        if k == 8:
            frames.append((start, {"heading": 8 * eighth}))
        frames.append((start + 1.25 * seconds, {"heading": n * eighth}))
        for order, foot in enumerate((0, 1) if leftwards else (1, 0)):
            begin = start + 0.15 + order * 0.55 * seconds
            steps.append(Step(foot, begin, begin + 0.5 * seconds, _turned(foot, n * eighth), 0.04, 0.15))
    period = start + 1.5 * seconds + 1.0
    return Motion("turn", period, keyframes(period, *frames), Footsteps(FEET_AT_EASE, tuple(steps)))


def _steps() -> Motion:
    """Steps to the sides, to the front and to the back, at a constant heading."""
    aside = ((0.45, 0.0), (-0.45, 0.0), (0.0, -0.5), (0.0, 0.4))
    offsets = [place for to in aside for place in ((0.0, 0.0), to)]
    seconds = 1.5
    frames: list[tuple[float, Frame]] = []
    steps: list[Step] = []
    for k, (x, z) in enumerate(offsets):
        to = offsets[(k + 1) % len(offsets)]
        begin = k * seconds + 0.22
        frames += [(k * seconds, {"place": (x, z)}), (k * seconds + 1.3, {"place": to})]
        lead = 0 if to[0] > x or (to[0] == x and k % 2) else 1
        for order, foot in enumerate((lead, 1 - lead)):
            stance = FEET_AT_EASE[foot]
            there = Stance(stance.x + to[0], stance.z + to[1], stance.yaw)
            steps.append(Step(foot, begin + 0.55 * order, begin + 0.55 * order + 0.48, there, 0.06, 0.25))
    period = seconds * len(offsets)
    return Motion("steps", period, keyframes(period, *frames), Footsteps(FEET_AT_EASE, tuple(steps)))


def _turned(foot: int, left: float) -> Stance:
    stance = FEET_AT_EASE[foot]
    return Stance(
        float(stance.x * np.cos(left) - stance.z * np.sin(left)),
        float(stance.x * np.sin(left) + stance.z * np.cos(left)),
        stance.yaw + left,
    )


MOTIONS = {
    motion.name: motion
    for motion in (
        _startup(),
        walking("walk", length=8.4, strides=10),
        _steps(),
        _turn(),
        *_tables(),
    )
}
"""Every movement by name."""
