"""The movements by name. Each is a table of keyframes and footsteps; see ``motion`` for their meaning.

Wrists and elbows are (out, up, front) from the shoulder in arm lengths; angles are radians.
"""

import numpy as np

from devices.simulated.person.footsteps import FEET_APART, FEET_AT_EASE, Footsteps, Stance, Step, arrive
from devices.simulated.person.gait import walking
from devices.simulated.person.motion import STARTUP, Frame, Motion, both_arms, keyframes
from devices.simulated.person.sports import badminton, basketball, boxing


def _startup() -> Motion:
    loop = keyframes(60.0, (0.0, STARTUP), (30.0, STARTUP))
    return Motion("startup", 60.0, loop, Footsteps(FEET_APART), arrive=Footsteps(FEET_APART))


def _idle() -> Motion:
    """A minute of waiting: shifting weight, looking around, folding the arms, scratching an ear."""
    left_leg: Frame = {"place": (0.05, 0.0), "pelvis": (0.02, 0.06), "spine": (0.02, -0.08, 0.0)}
    right_leg: Frame = {"place": (-0.05, 0.0), "pelvis": (0.02, -0.06), "spine": (0.02, 0.08, 0.0)}
    folded: Frame = {
        "left": (-0.30, -0.42, 0.36), "right": (-0.32, -0.36, 0.42),
        "left_elbow": (0.8, -0.8, 0.1), "right_elbow": (0.8, -0.8, 0.1),
    }  # fmt: skip
    scratch: Frame = {"right": (0.00, 0.30, 0.28), "right_elbow": (1.0, -0.5, 0.3), "head": (0.15, -0.1, 0.1)}
    hips = both_arms((0.25, -0.62, 0.12), (1.0, 0.1, -0.6))
    loop = keyframes(
        60.0,
        (0.0, {}), (5.0, {"head": (0.05, 0.0, 0.5)}), (8.0, left_leg),
        (13.0, left_leg | {"head": (0.1, 0.0, -0.6)}),
        (16.0, {}), (19.0, folded), (25.0, folded | left_leg), (28.0, {}), (31.0, right_leg),
        (34.0, right_leg | scratch), (35.0, right_leg | scratch), (37.0, right_leg), (41.0, {}),
        (43.5, hips), (49.0, hips | {"head": (0.0, 0.0, 0.4)}), (52.0, {}), (56.0, {"head": (0.3, 0.0, 0.0)}),
    )  # fmt: skip
    return Motion("idle", 60.0, loop, startup=False)


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


def _arms() -> Motion:
    """Arms across the trunk, folded, behind the back, overhead, hands in front of the face, clap."""
    crossed: Frame = {
        "left": (-0.52, -0.30, 0.50), "right": (-0.50, -0.22, 0.58),
        "left_elbow": (0.6, -1.0, 0.3), "right_elbow": (0.6, -1.0, 0.3),
    }  # fmt: skip
    crossed_low: Frame = {
        "left": (-0.42, -0.72, 0.42), "right": (-0.42, -0.66, 0.48),
        "left_elbow": (1.0, -0.3, 0.0), "right_elbow": (1.0, -0.3, 0.0),
    }  # fmt: skip
    behind: Frame = {
        "left": (-0.26, -0.66, -0.30), "right": (-0.26, -0.62, -0.36),
        "left_elbow": (1.0, 0.0, -0.5), "right_elbow": (1.0, 0.0, -0.5),
    }  # fmt: skip
    front = both_arms((-0.05, -0.10, 0.92), (0.6, -1.0, 0.0))
    side = both_arms((0.93, 0.0, 0.15), (0.0, -0.6, -1.0))
    face = both_arms((-0.22, 0.18, 0.52), (0.7, -1.0, 0.3))
    overhead = both_arms((0.10, 0.92, 0.10), (1.0, 0.0, -0.3))
    clap = both_arms((-0.30, -0.10, 0.68), (1.0, -0.6, 0.0))
    half = both_arms((0.45, -0.55, 0.40), (0.5, -0.4, -1.0))
    loop = keyframes(
        24.0,
        (0.0, {}), (1.2, front), (2.2, crossed), (3.7, crossed), (4.7, half), (5.8, {}),
        (6.6, both_arms((0.3, -0.85, 0.0))),
        (7.8, behind), (9.6, behind), (10.8, both_arms((0.3, -0.85, 0.0))), (12.0, side), (13.2, overhead),
        (14.2, overhead),
        (15.4, side), (16.6, face), (17.6, face), (18.4, half), (19.0, clap),
        (19.4, both_arms((0.1, -0.1, 0.75), (1.0, -0.6, 0.0))),
        (19.8, clap), (20.8, half), (21.8, crossed_low), (22.8, crossed_low),
    )  # fmt: skip
    return Motion("arms", 24.0, loop)


def _squat() -> Motion:
    """A squat every four seconds with the arms to the front; every second squat is deep."""

    def down(height: float, bowed: float) -> Frame:
        return both_arms(
            (-0.02, 0.02, 0.93), (0.6, -1.0, 0.0), height=height, pelvis=(bowed, 0.0), spine=(0.25, 0.0, 0.0),
            place=(0.0, 0.20 * (0.915 - height) / 0.4), head=(-0.3, 0.0, 0.0),
        )  # fmt: skip

    wide = (Stance(0.19, -0.15, 0.3), Stance(-0.19, -0.15, -0.3))
    loop = keyframes(
        8.0, (0.0, {}), (0.5, {}), (1.7, down(0.60, 0.45)), (2.2, down(0.60, 0.45)), (3.4, {}),
        (4.2, {}), (5.5, down(0.42, 0.55)), (6.0, down(0.42, 0.55)), (7.4, {}),
    )  # fmt: skip
    return Motion("squat", 8.0, loop, Footsteps(wide), arrive=arrive(wide))


def _sit() -> Motion:
    """Sitting down on a stool of 0.46 m, looking around with the hands on the thighs, standing up."""
    bent: Frame = both_arms(
        (0.05, -0.60, 0.60), (0.6, -0.2, -1.0), height=0.72, pelvis=(0.6, 0.0), spine=(0.35, 0.0, 0.0),
        place=(0.0, 0.16), head=(-0.5, 0.0, 0.0),
    )  # fmt: skip
    seated: Frame = both_arms(
        (0.02, -0.66, 0.50), (0.8, -0.2, -0.8), height=0.53, pelvis=(-0.05, 0.0), spine=(0.10, 0.0, 0.0),
        place=(0.0, 0.36),
    )  # fmt: skip
    phone: Frame = seated | {
        "right": (-0.20, -0.28, 0.48),
        "right_elbow": (0.7, -1.0, 0.0),
        "head": (0.4, 0.0, -0.1),
    }
    loop = keyframes(
        15.0, (0.0, {}), (0.6, {}), (1.5, bent), (2.5, seated), (4.0, seated),
        (5.5, seated | {"head": (0.0, 0.0, 0.6)}),
        (7.0, seated), (8.0, phone), (10.0, phone), (11.0, seated), (11.8, seated), (12.7, bent), (13.8, {}),
    )  # fmt: skip
    return Motion("sit", 15.0, loop)


MOTIONS = {
    motion.name: motion
    for motion in (
        _startup(),
        walking("walk", length=8.4, strides=10),
        _steps(),
        _turn(),
        _arms(),
        badminton(),
        basketball(),
        _squat(),
        _sit(),
        boxing(),
        Motion("still", 60.0, keyframes(60.0, (0.0, {}), (30.0, {})), startup=False),
        _idle(),
    )
}
"""Every movement by name."""
