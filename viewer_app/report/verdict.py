"""The verdict on a session: the worst of its figures, the reason, and what to do about it.

=====================================================  =========  =========
figure                                                 good       usable
=====================================================  =========  =========
views agree, median over all frames since calibration  < 40 mm    < 80 mm
rotation of B certain to (standard deviation)          <= 2°      <= 4°
angle between the sensors                              60–120°    40–140°
distance of the person, of the sensor's range          within     25 % off
offset between the clocks less two standard deviations < 17 ms    < 50 ms
frames without a partner                               < 10 %     < 30 %
=====================================================  =========  =========

Anything beyond is poor, and so is a view that is the mirror image of a body.
"""

import math
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

from fusion.calibration.calibration import CERTAIN_TURN_DEG, FEWEST_PAIRS
from viewer_app.coach.advice import ANGLES, GOOD, USABLE, graded

Figures = dict[str, Any]
Word = Literal["good", "usable", "poor", "unknown"]

USABLE_ANGLES = (40.0, 140.0)
_OFFSETS = (17.0, 50.0)  # ms: half a frame, one and a half
_UNPAIRED = (0.1, 0.3)
_OUT_OF_RANGE = 0.25
_MIRRORED = 0.8
_CALIBRATE = "Calibrate: stand still for a second, arms and legs apart, where both sensors see all of you"
_ANOTHER_PART = "Calibrate on another part: duplex fuse --calibrate seconds:N"
_SAME_MOMENT = (
    "Check that both recordings show one person at the same time, and their clocks; or calibrate on another "
    "part: duplex fuse --calibrate seconds:N"
)


class Verdict(NamedTuple):
    """A word, why, and what to do; reason and remedy are empty where all is good."""

    word: Word
    reason: str = ""
    remedy: str = ""


def verdict(figures: Figures) -> Verdict:
    """The verdict on a session; of equally bad figures the first, which explains the others.

    Args:
        figures: Of :func:`viewer_app.report.figures.report`, or of a running session, which has ``streams``.
    """
    order: tuple[Word, ...] = ("poor", "unknown", "usable")
    found = [each for each in _shortcomings(figures) if each.word != "good"]
    return min(found, key=lambda each: order.index(each.word), default=Verdict("good"))


def _shortcomings(figures: Figures) -> Iterator[Verdict]:
    live = "streams" in figures
    calibration, apart = figures["calibration"], figures["views_agree_mm"]["median"]
    calibrate = _CALIBRATE if live else _ANOTHER_PART
    mirrored = [side.upper() for side, share in figures["mirrored"].items() if (share or 0.0) > _MIRRORED]
    if mirrored:
        image = "is the mirror image" if len(mirrored) == 1 else "are mirror images"
        files = "in the file of " + " and in that of ".join(mirrored)
        remedy = "Switch the mirroring off" if live else f"Change the sign of x {files}"
        yield Verdict("poor", f"{' and '.join(mirrored)} {image} of a person", remedy)
    if calibration["provisional"]:
        yield Verdict("unknown", "the calibration is provisional", calibrate)
    elif calibration["residual_mm"] is not None and calibration["frames"] < FEWEST_PAIRS:
        few = f"calibrated on {calibration['frames']} frames; at least {FEWEST_PAIRS} are needed"
        yield Verdict("unknown", few, calibrate)
    clock = figures.get("clock")
    if clock is not None:
        text = f"B captures {clock['offset_ms']:+.0f} ± {clock['sd_ms']:.0f} ms off its time stamps"
        certain = abs(clock["offset_ms"]) - 2.0 * clock["sd_ms"]
        yield Verdict(graded(certain, _OFFSETS), text, "Check the clocks")
    if apart is None:
        yield Verdict("unknown", "no joint was seen by both sensors", "Check that both see the person")
    else:
        word = graded(apart, (GOOD, USABLE))
        limit = f"good is below {GOOD:.0f}" if word == "usable" else f"usable is below {USABLE:.0f}"
        remedy = _CALIBRATE if live else _SAME_MOMENT
        text = f"the views differ by {_beyond(apart, GOOD, USABLE)} mm; {limit}"
        yield Verdict(word, text, remedy if word == "poor" else "")
    angle, (low, high), (least, most) = calibration["axes_angle_deg"], ANGLES, USABLE_ANGLES
    if calibration["residual_mm"] is not None and not low <= angle <= high:
        way = "further apart" if angle < low else "closer together"
        yield Verdict(
            "usable" if least <= angle <= most else "poor",
            f"the sensors look {angle:.0f}° apart; good is {low:.0f}° to {high:.0f}°",
            f"Move them {way} round the person" if live else f"Record with them {way}",
        )
    for side, distance in figures["distance_m"].items():
        yield from _distance(side.upper(), live, **distance)
    turn = calibration["rotation_sd_deg"]
    if turn is not None and turn > CERTAIN_TURN_DEG:
        word = "usable" if turn <= 2.0 * CERTAIN_TURN_DEG else "poor"
        text = f"B's rotation is certain to {turn:.1f}° only; good is {CERTAIN_TURN_DEG:g}°"
        yield Verdict(word, text, "Walk about while both sensors see you" if live else _ANOTHER_PART)
    share = _unpaired_share(figures)
    if share >= _UNPAIRED[0]:
        text = f"{100.0 * share:.0f} % of the frames have no partner"
        remedy = "Check the frame rates of both sensors" if live else "Check clocks and frame rates"
        yield Verdict(graded(share, _UNPAIRED), text, remedy)


def _distance(side: str, live: bool, median: float | None, near: float, far: float) -> Iterator[Verdict]:
    if median is None or near <= median <= far:
        return
    way = "further away" if median < near else "nearer"
    yield Verdict(
        "usable" if (1.0 - _OUT_OF_RANGE) * near <= median <= (1.0 + _OUT_OF_RANGE) * far else "poor",
        f"the person is {median:.2g} m from {side}; good is {near:.2g} to {far:.2g} m",
        f"Stand {way}" if live else f"Record with the person {way}",
    )


def _unpaired_share(figures: Figures) -> float:
    """Of the slower sensor: one that is faster by itself has frames that nobody can pair."""
    unpaired: int = min((figures["dropped"][side] or 0) + figures["alone"][side] for side in "ab")
    paired: int = figures["paired"]
    return unpaired / max(1, unpaired + paired)  # a live sensor's dropped ones are no frames of it


def _beyond(value: float, *limits: float) -> str:
    """A number with the digits that keep it on its side of the limits."""
    digits = next(
        (d for d in range(3) if all((round(value, d) < each) == (value < each) for each in limits)), 3
    )
    return f"{value:.{digits}f}"


def in_words(found: Verdict) -> str:
    """The verdict as a sentence."""
    if not found.reason:
        return f"{found.word}."
    return f"{found.word}: {found.reason}." + (f" {found.remedy}." if found.remedy else "")


def precision_in_words(calibration: Figures) -> str:
    """How certain a calibration is, in standard deviations, and from what."""
    turn, shift, frames = (calibration[key] for key in ("rotation_sd_deg", "translation_sd_mm", "frames"))
    if turn is None or not math.isfinite(turn):
        return "precision unknown"
    far = calibration.get("sd_at_3m_mm")
    size = "" if shift is None else f", ± {shift:.0f} mm at the person"
    size += "" if far is None else f" and ± {far:.0f} mm 3 m from there"
    return f"± {turn:.1f}°{size}, from {frames} frames"
