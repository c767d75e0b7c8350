"""Advice for setting up two sensors, and advice derived from a calibration."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from fusion.calibration.calibration import CERTAIN_TURN_DEG, Calibration
from recordings.quality.limits import GOOD, GOOD_ANGLES, USABLE, beside, graded, spoken

Level = Literal["INFO", "WARN"]


@dataclass(frozen=True)
class Advice:
    """One piece of advice."""

    topic: str  # the subject; new advice replaces earlier advice on the same topic
    text: str  # what to do, with the figure and the threshold
    level: Level = "INFO"  # severity
    sensors: str = ""  # the sensors of ``AB`` concerned; empty if none
    label: str = ""  # a short form of the text, shown beside the sensor and in the list of problems
    step: str = ""  # what to do, in a few words with ``{who}`` for the sensors; empty: nothing is asked
    why: str = ""  # what is wrong, before the step, where the step does not tell
    urgency: float = 0.0  # among advice of one kind, how much is asked
    figures: bool = False  # whether the text has figures that matter where nothing is wrong

    @property
    def kind(self) -> str:
        """The topic without its sensor."""
        return self.topic.split()[0]


def placement(calibration: Calibration) -> Iterator[Advice]:
    """Advice on the placement of the sensors, once the registration is known.

    The angle counts once it is certain: two standard deviations outside its limits, and not provisional.
    """
    if calibration.registration is None:
        return
    angle = math.degrees(calibration.axes_angle)
    certain = 2.0 * math.degrees(calibration.registration.rotation_sd)
    low, high = GOOD_ANGLES
    if not calibration.provisional and not low - certain <= angle <= high + certain:
        way, towards = ("further apart", "away from") if angle < low else ("closer together", "towards")
        yield Advice(
            "angle",
            f"The sensors look {beside(angle, low, high)}° apart; between {low:.0f}° and {high:.0f}° (best: "
            f"90°) each sees what the other cannot. Move them {way} round the person.",
            "WARN",
            label=f"A and B look {beside(angle, low, high)}° apart",
            step=f"move B {towards} A, round you, to 90°",
            why=f"Only {angle:.0f}° apart" if angle < low else f"{angle:.0f}° apart",
        )
    yield calibration_advice(calibration)


def calibration_advice(calibration: Calibration) -> Advice:
    """Advice that rates a calibration in millimetres and names the limiting factor.

    None is good whose rotation is uncertain, as that of a single pose is.
    """
    registration = calibration.registration
    if registration is None:
        text = f"Calibration: {calibration.how}; its quality is unknown."
        return Advice("calibration", text, figures=True)
    apart = registration.residual_median * 1e3
    uncertain = math.degrees(registration.rotation_sd)
    word = graded(apart, (GOOD, USABLE))
    word = "usable" if word == "good" and uncertain > CERTAIN_TURN_DEG else word
    worst = ", ".join(f"{spoken(name)} {1e3 * off:.0f} mm" for name, off in registration.worst_joints(2))
    limit = f"limited by {worst}" if worst else "no joint was seen by both"
    if uncertain > CERTAIN_TURN_DEG:
        only = (
            f"its rotation is certain to {beside(uncertain, CERTAIN_TURN_DEG, digits=1)}° only (limit "
            f"{CERTAIN_TURN_DEG:g}°)"
        )
        # before the start-up pose the next thing to do is to hold it
        limit += f"; {only}" if calibration.provisional else f"; {only}: walk a few steps"
    frames = "of one frame" if registration.frames == 1 else f"median of {registration.frames} frames"
    begins = "Provisional calibration" if calibration.provisional else "Calibration"
    asks = not calibration.provisional and (word == "poor" or uncertain > CERTAIN_TURN_DEG)
    label = f"the views differ by {apart:.0f} mm" if word == "poor" else "you were seen in one pose only"
    return Advice(
        "calibration",
        f"{begins} {word}: the views differ by {beside(apart, GOOD, USABLE)} mm ({frames}; good below "
        f"{GOOD:.0f}, usable below {USABLE:.0f}); {limit}.",
        "WARN" if word == "poor" else "INFO",
        label=label if asks else "",
        step="walk a few steps back and forth" if asks else "",
        figures=True,
    )
