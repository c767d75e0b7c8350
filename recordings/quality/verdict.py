"""The verdict on a session: the worst of its figures, the reasons, and what to do about them.

=====================================================  =========  =========
figure                                                 good       usable
=====================================================  =========  =========
views agree, median over all frames since calibration  < 40 mm    < 80 mm
of the time the views are more than 80 mm apart        < 5 %      < 50 %
they are more than 0.5 m apart                         < 5 %
a wrist or ankle is uncertain by more than 150 mm      < 10 %     < 50 %
one view alone has the person                          < 10 %     < 50 %
rotation of B certain to (standard deviation)          <= 2°      <= 4°
angle between the sensors about the vertical           60–120°    40–140°
distance of the person, of the sensor's range          within     25 % off
offset between the clocks less two standard deviations < 17 ms    < 50 ms
frames without a partner                               < 10 %     < 30 %
=====================================================  =========  =========

Anything beyond is poor, and so is a view that is the mirror image of a body. Usable are views of which one is
upside down, or that both lack a joint. More doubtful seconds never give a better word.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from fusion.calibration.calibration import CERTAIN_TURN_DEG, FEWEST_PAIRS
from recordings.quality.doubtful_time import UNCERTAIN
from recordings.quality.limits import GOOD, GOOD_ANGLES, USABLE, beside, graded, spoken

Figures = dict[str, Any]
Word = Literal["good", "usable", "poor", "unknown"]

USABLE_ANGLES = (40.0, 140.0)
OFFSETS = (17.0, 50.0)  # ms: half a frame, one and a half
_UNPAIRED = (0.1, 0.3)
_LONG_APART = 0.05  # of the time
_OTHERS = 500.0  # mm for that time; 20 real pairs of one person are within 340 mm
DOUBTFUL = (0.1, 0.5)  # of the time
_HEAD_DOWN = 0.9
_NAMED = 3  # joints
_OUT_OF_RANGE = 0.25
_MIRRORED = 0.8
_CALIBRATE = "Calibrate: stand still for a second, arms and legs apart, where both sensors see all of you"
_ANOTHER_PART = "Calibrate on another part: duplex fuse --calibrate seconds:N"
_RECORD_AGAIN = "Record again: a second of standing still, arms and legs apart, before both sensors"
_SAME_MOMENT = "Check that both recordings show one person at the same time, and their clocks; or "


class Shortcoming(NamedTuple):
    """Why a session is not good: the word that this allows, the reason, and what to do, if anything."""

    word: Word
    reason: str
    remedy: str = ""


@dataclass(frozen=True, repr=False)
class Verdict:
    """How good a session is.

    Attributes:
        word: ``good``, ``usable``, ``poor`` or ``unknown``.
        shortcomings: What is not good, worst first; among equally bad ones, the cause of the others first.
        figures: The figures it is based on, as ``duplex fuse --report`` writes them.
    """

    word: Word
    shortcomings: tuple[Shortcoming, ...]
    figures: Figures

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the session is not good, worst first."""
        return tuple(each.reason for each in self.shortcomings)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The shortcomings in words, each with what to do, worst first; one sentence if there are none."""
        return tuple(in_words(*each) for each in self.shortcomings) or (in_words(self.word),)

    def __str__(self) -> str:
        return self.sentences[0]

    def __repr__(self) -> str:
        return f"<Verdict {self}>"


def verdict(figures: Figures) -> Verdict:
    """The verdict on a session.

    Args:
        figures: Of :func:`recordings.quality.figures.report`, or of a running session, which has ``streams``.
    """
    order: tuple[Word, ...] = ("poor", "unknown", "usable")
    found = [each for each in _shortcomings(figures) if each.word != "good"]
    found.sort(key=lambda each: order.index(each.word))
    return Verdict(found[0].word if found else "good", tuple(found), figures)


def _shortcomings(figures: Figures) -> Iterator[Shortcoming]:
    live = "streams" in figures
    calibration, apart = figures["calibration"], figures["views_agree_mm"]["median"]
    calibrate = _CALIBRATE if live else _ANOTHER_PART if _has_another_part(figures) else _RECORD_AGAIN
    mirrored = [side.upper() for side, share in figures["mirrored"].items() if (share or 0.0) > _MIRRORED]
    if mirrored:
        image = "is the mirror image" if len(mirrored) == 1 else "are mirror images"
        files = "in the file of " + " and in that of ".join(mirrored)
        remedy = "Switch the mirroring off" if live else f"Change the sign of x {files}"
        yield Shortcoming("poor", f"{' and '.join(mirrored)} {image} of a person", remedy)
    if why := not_trusted(calibration):
        yield Shortcoming("unknown", why, calibrate)
    clock = figures.get("clock")
    if clock is not None:
        text = f"B captures {clock['offset_ms']:+.0f} ± {clock['sd_ms']:.0f} ms off its time stamps"
        certain = abs(clock["offset_ms"]) - 2.0 * clock["sd_ms"]
        yield Shortcoming(graded(certain, OFFSETS), text, "Check the clocks")
    yield from _missing(figures, live)
    if apart is None:
        yield Shortcoming("unknown", "no joint was seen by both sensors", "Check that both see the person")
    else:
        yield from _views(figures, calibrate if live else _SAME_MOMENT + calibrate[0].lower() + calibrate[1:])
    yield from _doubts(figures, live)
    angle, (low, high), (least, most) = calibration["angle_deg"], GOOD_ANGLES, USABLE_ANGLES
    if calibration["residual_mm"] is not None and not low <= angle <= high:
        way = "further apart" if angle < low else "closer together"
        yield Shortcoming(
            "usable" if least <= angle <= most else "poor",
            f"the sensors look {beside(angle, low, high)}° apart; good is {low:.0f}° to {high:.0f}°",
            f"Move them {way} round the person" if live else f"Record with them {way}",
        )
    for side, distance in figures["distance_m"].items():
        yield from _distance(side.upper(), live, **distance)
    turn = calibration["rotation_sd_deg"]
    if turn is not None and turn > CERTAIN_TURN_DEG:
        word: Word = "usable" if turn <= 2.0 * CERTAIN_TURN_DEG else "poor"
        certain = beside(turn, CERTAIN_TURN_DEG, digits=1)
        text = f"B's rotation is certain to {certain}° only; good is {CERTAIN_TURN_DEG:g}°"
        walk = "Walk about while both sensors see you" if live else "Record with the person walking about"
        yield Shortcoming(word, text, walk)
    share = _unpaired_share(figures)
    if share >= _UNPAIRED[0]:
        text = f"{100.0 * share:.0f} % of the frames have no partner"
        remedy = (
            "Check the frame rates of both sensors and trackers" if live else "Check clocks and frame rates"
        )
        yield Shortcoming(graded(share, _UNPAIRED), text, remedy)


def not_trusted(calibration: Figures) -> str:
    """Why a calibration's agreement of the views proves nothing; empty if it does."""
    if calibration["provisional"]:
        return "the calibration is provisional"
    frames = calibration["frames"]
    if frames is None or frames >= FEWEST_PAIRS:
        return ""
    return f"calibrated on {frames} frame{'' if frames == 1 else 's'}; at least {FEWEST_PAIRS} are needed"


def _has_another_part(figures: Figures) -> bool:
    """Whether a recording has enough frames that it was not calibrated on; live sessions end provisional."""
    used, frames = figures["calibration"]["frames"] or 0, figures["fused_frames"]
    return not figures["calibration"]["provisional"] and not used <= frames < used + FEWEST_PAIRS


def _missing(figures: Figures, live: bool) -> Iterator[Shortcoming]:
    """Views that are upside down, and joints that neither has."""
    down = [side.upper() for side, share in figures["upside_down"].items() if (share or 0.0) > _HEAD_DOWN]
    if down:
        text = f"{' and '.join(down)} {'is' if len(down) == 1 else 'are'} upside down"
        # one file alone has no other axes than its partner, and S* needs no turning
        both = "If they are .csv files with the axes of the Kinect SDK, state `axes=kinect`"
        righted = both if len(down) == len(figures["upside_down"]) else ""
        yield Shortcoming("usable", text, "Turn the sensor round" if live else righted)
    lacking = [spoken(name) for name in figures["in_no_frame"]]
    if lacking and figures["views_agree_mm"]["median"] is not None:
        more = f" and {len(lacking) - _NAMED} more" if len(lacking) > _NAMED else ""
        which = f"{', '.join(lacking[:_NAMED])}{more}"
        yield Shortcoming("usable", f"no view has {which} in any frame, and S* predicts what is not measured")


def _views(figures: Figures, remedy: str) -> Iterator[Shortcoming]:
    """How far the views are apart, in the median and for how long."""
    apart, high = figures["views_agree_mm"]["median"], figures["views_agree_mm"]["p95"]
    if high > _OTHERS:
        text = (
            f"a twentieth of the time the views differ by more than {high:.0f} mm, as those of two people do"
        )
        yield Shortcoming("poor", text, remedy)
    word: Word = graded(apart, (GOOD, USABLE))
    limit = f"good is below {GOOD:.0f}" if word == "usable" else f"usable is below {USABLE:.0f}"
    text = f"the views differ by {beside(apart, GOOD, USABLE)} mm; {limit}"
    lasts, share = doubt(figures, "views_apart")
    if share >= _LONG_APART and word != "poor":
        long = f"more than {USABLE:.0f} mm for {lasts}"
        text = f"the views differ by {long}" if word == "good" else f"{text}, and they differ by {long}"
        word = "usable" if word == "good" else word
    yield Shortcoming(word, text, remedy if word == "poor" else "")


def _doubts(figures: Figures, live: bool) -> Iterator[Shortcoming]:
    """For how long a limb is uncertain, and a view is missing."""
    lasts, share = doubt(figures, "limb_uncertain")
    limb = figures["seconds_of"]["limb"]
    text = f"a limb, mostly the {limb}, is uncertain by more than {UNCERTAIN:.0f} mm for {lasts}"
    remedy = "Stand where a sensor sees it" if live else "Record it where a sensor sees it"
    yield Shortcoming(graded(share, DOUBTFUL), text, remedy)
    lasts, share = doubt(figures, "one_view")
    remedy = "Stay where both sensors see all of you" if live else "Record where both see all of the person"
    yield Shortcoming(graded(share, DOUBTFUL), f"one view alone has the person for {lasts}", remedy)


def doubt(figures: Figures, name: str) -> tuple[str, float]:
    """How long a doubt of ``seconds_of`` lasts, such as ``8.1 s (28 %)``, and its share of the session."""
    lasts, every = figures["seconds_of"][name] or 0.0, figures["seconds_of"]["all"]
    share = lasts / every if every > 0.0 else 0.0
    return f"{lasts:.1f} s ({100.0 * share:.0f} %)", share


def _distance(side: str, live: bool, median: float | None, near: float, far: float) -> Iterator[Shortcoming]:
    if median is None or near <= median <= far:
        return
    way = "further away" if median < near else "nearer"
    away = beside(median, near, far, digits=1)
    yield Shortcoming(
        "usable" if (1.0 - _OUT_OF_RANGE) * near <= median <= (1.0 + _OUT_OF_RANGE) * far else "poor",
        f"the person is {away} m from {side}; good is {near:.3g} to {far:.3g} m",
        f"Stand {way}" if live else f"Record with the person {way}",
    )


def _unpaired_share(figures: Figures) -> float:
    """Of the slower sensor: one that is faster by itself has frames that nobody can pair."""
    unpaired: int = min((figures["dropped"][side] or 0) + figures["alone"][side] for side in "ab")
    paired: int = figures["paired"]
    return unpaired / max(1, unpaired + paired)  # a live sensor's dropped ones are no frames of it


def in_words(word: str, reason: str = "", remedy: str = "") -> str:
    """A verdict as a sentence."""
    return (f"{word}: {reason}." if reason else f"{word}.") + (f" {remedy}." if remedy else "")
