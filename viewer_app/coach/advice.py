"""One thing to know or do while two sensors are set up, and what a calibration gives cause to say."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from fusion.calibration.calibration import Calibration

Level = Literal["INFO", "WARN"]

ANGLES = (60.0, 120.0)
"""Degrees between the sensors within which each sees most of what the other cannot."""
GOOD, USABLE = 40.0, 80.0
"""Millimetres (median) between the views, calibrated: real Kinects reach 25 to 60."""
_CERTAIN = 2.0  # degrees: half a metre from the torso that is 17 mm


@dataclass(frozen=True)
class Advice:
    """One thing to know or do.

    Attributes:
        topic: What it is about; an advice replaces the one before on its topic.
        text: What to do, with figure and threshold in words.
        level: Whether something is wrong.
        figure: What was measured; NaN where there is no number to it.
        threshold: What it is held against; likewise.
        sensors: Which of ``AB`` it is about, if it is about one.
        label: The same in a few words, to be written beside the sensor.
    """

    topic: str
    text: str
    level: Level = "INFO"
    figure: float = math.nan
    threshold: float = math.nan
    sensors: str = ""
    label: str = ""


def placement(calibration: Calibration) -> Iterator[Advice]:
    """What is to be said of the sensors' places, once they are known by registration."""
    if calibration.registration is None:
        return
    angle = math.degrees(calibration.axes_angle)
    low, high = ANGLES
    if not low <= angle <= high:
        wider = "apart" if angle < low else "together"
        yield Advice(
            "angle",
            f"The sensors look {angle:.0f}° apart; between {low:.0f}° and {high:.0f}° (best: 90°) each "
            f"sees what the other cannot. Move them further {wider} round the person.",
            "WARN",
            angle,
            low if angle < low else high,
        )
    yield verdict(calibration)


def quality(residual_mm: float) -> Literal["good", "usable", "poor"]:
    """How good a calibration is whose views differ by so many millimetres (median)."""
    return "good" if residual_mm < GOOD else "usable" if residual_mm < USABLE else "poor"


def verdict(calibration: Calibration) -> Advice:
    """How good a calibration is, in millimetres, and what limits it."""
    registration = calibration.registration
    if registration is None:
        return Advice("calibration", f"Calibration: {calibration.how}; how well it fits is not known.")
    apart = registration.residual_median * 1e3
    word = quality(apart)
    worst = ", ".join(f"{name} {1e3 * off:.0f} mm" for name, off in registration.worst_joints(2))
    limit = f"limited by {worst}" if worst else "no joint was seen by both"
    if (uncertain := math.degrees(registration.rotation_sd)) > _CERTAIN:
        limit += (
            f"; its rotation is certain to {uncertain:.1f}° only (limit {_CERTAIN:g}°): step about while it "
            "is made"
        )
    return Advice(
        "calibration",
        f"Calibration {word}: the views differ by {apart:.0f} mm (good below {GOOD:.0f}, usable below "
        f"{USABLE:.0f}); {limit}.",
        "WARN" if word == "poor" else "INFO",
        apart,
        GOOD if word == "good" else USABLE,
    )


def to_markdown(advice: Sequence[Advice]) -> str:
    """The coach's page."""
    if not advice:
        return "## All is well\n"
    marks = {"WARN": "**Mend:**", "INFO": ""}
    return "\n\n".join(f"{marks[each.level]} {each.text}".strip() for each in advice) + "\n"
