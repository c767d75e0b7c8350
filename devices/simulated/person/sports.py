"""Sports: badminton, basketball, boxing. See ``movements`` for the meaning of the tables."""

import numpy as np

from devices.simulated.person.footsteps import Footsteps, Stance, Step, arrive
from devices.simulated.person.motion import Frame, Motion, both_arms, keyframes


def badminton() -> Motion:
    """Ready, overhead clear, ready, lunge to the net, backhand. The racket is in the right hand."""
    ready: Frame = {
        "height": 0.80, "spine": (0.22, 0.0, 0.0), "pelvis": (0.12, 0.0), "head": (-0.15, 0.0, 0.0),
        "right": (0.10, -0.22, 0.62), "left": (0.12, -0.32, 0.52),
        "right_elbow": (0.7, -1.0, -0.1), "left_elbow": (0.7, -1.0, -0.1),
    }  # fmt: skip
    wind_up: Frame = ready | {
        "height": 0.84, "heading": -0.9, "place": (-0.03, 0.08), "pelvis": (-0.05, -0.06),
        "spine": (-0.12, -0.15, -0.5), "head": (-0.3, 0.0, 0.9),
        "right": (0.35, 0.28, -0.22), "right_elbow": (1.0, 0.3, -0.5),
        "left": (0.35, 0.70, 0.50), "left_elbow": (1.0, -0.6, -0.2), "wrists": (0.0, -0.6),
    }  # fmt: skip
    hit: Frame = ready | {
        "height": 0.88, "heading": 0.1, "spine": (0.08, 0.12, 0.25), "head": (-0.25, 0.0, -0.2),
        "right": (0.12, 0.90, 0.30), "right_elbow": (1.0, 0.0, 0.1),
        "left": (0.15, -0.30, 0.42), "wrists": (0.0, 0.3),
    }  # fmt: skip
    through: Frame = ready | {
        "heading": 0.35, "spine": (0.40, 0.05, 0.40), "right": (-0.40, -0.45, 0.62),
        "right_elbow": (1.0, -0.3, 0.0),
        "left": (0.30, -0.60, 0.10), "wrists": (0.0, 0.7),
    }  # fmt: skip
    lunge: Frame = ready | {
        "height": 0.66, "place": (-0.10, -0.30), "heading": -0.25, "pelvis": (0.20, 0.0),
        "spine": (0.30, 0.0, -0.15),
        "right": (0.05, -0.12, 0.92), "right_elbow": (0.3, -1.0, -0.2),
        "left": (0.70, -0.15, -0.50), "left_elbow": (0.2, -0.5, -1.0), "wrists": (0.0, -0.4),
    }  # fmt: skip
    backhand_back: Frame = ready | {
        "heading": 0.5, "spine": (0.25, 0.0, 0.45), "right": (-0.42, 0.02, 0.55),
        "right_elbow": (0.8, 0.3, 0.9),
        "wrists": (0.0, 0.6),
    }  # fmt: skip
    backhand_hit: Frame = ready | {
        "heading": -0.1, "spine": (0.12, 0.0, -0.15), "right": (0.72, 0.10, 0.55),
        "right_elbow": (0.2, -1.0, -0.3),
        "wrists": (0.0, -0.5), "left": (0.45, -0.55, 0.0),
    }  # fmt: skip
    wide = (Stance(0.24, -0.16, 0.2), Stance(-0.24, -0.16, -0.2))
    back, front = Stance(-0.30, 0.22, -1.1), Stance(-0.20, -0.78, -0.25)
    steps = (
        Step(1, 0.55, 0.95, back, 0.05, 0.25), Step(1, 1.55, 1.95, wide[1], 0.06, 0.3),
        Step(1, 3.35, 3.85, front, 0.08, 0.3), Step(1, 4.45, 4.95, wide[1], 0.06, 0.3),
    )  # fmt: skip
    loop = keyframes(
        8.0,
        (0.0, ready), (0.4, ready), (1.1, wind_up), (1.35, wind_up), (1.6, hit), (1.85, through),
        (2.5, ready),
        (3.2, ready), (3.9, lunge), (4.3, lunge), (5.0, ready), (5.7, ready), (6.3, backhand_back),
        (6.7, backhand_hit),
        (7.3, ready),
    )  # fmt: skip
    return Motion("badminton", 8.0, loop, Footsteps(wide, steps), arrive=arrive(wide))


def basketball() -> Motion:
    """Dribble with the right hand, change to the left, gather, jump shot."""
    low: Frame = {
        "height": 0.78, "pelvis": (0.22, 0.0), "spine": (0.28, 0.0, 0.05), "head": (-0.35, 0.0, 0.0),
        "left": (0.30, -0.55, 0.45), "right": (0.22, -0.60, 0.50),
        "left_elbow": (0.8, -0.3, -0.8), "right_elbow": (0.7, -0.2, -1.0),
    }  # fmt: skip
    up, down = (0.22, -0.38, 0.52), (0.24, -0.78, 0.46)
    frames: list[tuple[float, Frame]] = []
    for k in range(5):  # the right hand
        frames += [(0.56 * k, low | {"right": up, "wrists": (0.1, -0.3)})]
        frames += [
            (0.56 * k + 0.26, low | {"right": down, "wrists": (0.1, 0.5), "heading": 0.1 * np.sin(1.3 * k)})
        ]
    across: Frame = {"right": (-0.35, -0.72, 0.50), "left": (-0.05, -0.62, 0.55), "spine": (0.36, 0.0, 0.25)}
    frames += [(2.9, low | across)]
    for k in range(3):  # the left hand
        frames += [(3.3 + 0.56 * k, low | {"left": up, "wrists": (-0.3, 0.1)})]
        frames += [(3.56 + 0.56 * k, low | {"left": down, "wrists": (0.5, 0.1)})]
    gather = low | both_arms((-0.12, -0.45, 0.50), (0.8, -0.5, -0.3), height=0.70)
    shot_start: Frame = {
        "height": 0.86, "head": (-0.25, 0.0, 0.0), "right": (-0.05, 0.32, 0.38), "left": (-0.15, 0.25, 0.42),
        "right_elbow": (0.4, -1.0, 0.5), "left_elbow": (1.0, -0.5, 0.3), "wrists": (0.0, -0.8),
    }  # fmt: skip
    release: Frame = {
        "height": 0.93, "head": (-0.35, 0.0, 0.0), "right": (0.02, 0.84, 0.42), "left": (0.05, 0.55, 0.50),
        "right_elbow": (0.9, -0.3, 0.2), "left_elbow": (1.0, -0.5, 0.3), "wrists": (0.0, 0.9),
    }  # fmt: skip
    frames += [(5.3, gather), (5.65, gather), (6.0, shot_start | {"hop": 0.0}),
    (6.2, release | {"hop": 0.16}),
               (6.42, release | {"hop": 0.15}), (6.65, release | {"hop": 0.0, "height": 0.86}),
               (6.95, low | {"height": 0.80}), (7.6, low)]  # fmt: skip
    wide = (Stance(0.20, -0.20, 0.2), Stance(-0.20, -0.12, -0.2))
    ahead = (Stance(0.22, -0.45, 0.15), Stance(-0.18, -0.38, -0.2))
    steps = (
        Step(0, 1.0, 1.35, ahead[0], 0.05, 0.2), Step(1, 1.45, 1.8, ahead[1], 0.05, 0.2),
        Step(1, 3.6, 3.95, wide[1], 0.05, 0.2), Step(0, 4.1, 4.45, wide[0], 0.05, 0.2),
    )  # fmt: skip
    place = {0.0: 0.0, 2.0: -0.24, 3.4: -0.24, 4.6: 0.0}
    placed = [(t, f | {"place": (0.0, float(np.interp(t, [*place], [*place.values()])))}) for t, f in frames]
    return Motion("basketball", 8.2, keyframes(8.2, *placed), Footsteps(wide, steps), arrive=arrive(wide))


def boxing() -> Motion:
    """Guard, jab, cross, hook, duck."""
    guard: Frame = {
        "height": 0.83, "heading": -0.55, "pelvis": (0.06, 0.0), "spine": (0.18, 0.0, -0.1),
        "head": (0.0, 0.0, 0.55),
        "left": (-0.12, 0.02, 0.56), "right": (-0.20, 0.06, 0.42),
        "left_elbow": (0.5, -1.0, 0.0), "right_elbow": (0.5, -1.0, 0.0),
    }  # fmt: skip
    jab = guard | {"left": (-0.25, 0.10, 0.93), "spine": (0.20, 0.0, -0.30), "place": (0.0, -0.05)}
    cross = guard | {
        "right": (-0.20, 0.12, 0.94), "heading": 0.15, "spine": (0.22, 0.0, 0.35), "head": (0.0, 0.0, -0.3),
        "place": (0.0, -0.08),
    }  # fmt: skip
    hook_back = guard | {
        "left": (0.40, 0.0, 0.42),
        "left_elbow": (1.0, -0.4, -0.4),
        "spine": (0.18, 0.0, 0.35),
    }
    hook = guard | {"left": (-0.42, 0.06, 0.58), "left_elbow": (1.0, 0.1, 0.1), "spine": (0.18, 0.0, -0.55)}
    duck = guard | {
        "height": 0.66,
        "pelvis": (0.25, 0.0),
        "spine": (0.35, -0.15, -0.1),
        "head": (-0.3, 0.0, 0.5),
    }
    stand = (Stance(0.12, -0.34, -0.15), Stance(-0.20, 0.10, -0.85))
    loop = keyframes(
        7.0, (0.0, guard), (0.6, guard), (0.85, jab), (1.15, guard), (1.5, jab), (1.75, guard),
        (2.05, cross), (2.4, guard),
        (3.0, guard), (3.3, hook_back), (3.6, hook), (4.0, guard), (4.5, guard), (5.0, duck), (5.5, guard),
        (6.2, guard),
    )  # fmt: skip
    return Motion("boxing", 7.0, loop, Footsteps(stand), arrive=arrive(stand))
