"""The verdict on a session: its figures, judged by :data:`devices.findings.rules.RULES`."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from devices.findings.finding import Finding, Word, followed, in_words, judge, spoken
from devices.findings.rules import RULES, of_error, of_views, within
from fusion.calibration.calibration import FEWEST_PAIRS

Figures = dict[str, Any]

_ARTEFACT_SD_MS = 15.0
"""Of an offset between clocks that run in step: on real pairs it is found within twice this of 0."""
_NAMED = 3  # joints
_TURNED_DEG, _SHIFTED_MM = 2.2, 50.0  # of B against its calibration: what 3° or 60 mm may be measured as
_ANOTHER_PART = "calibrate on another part: duplex fuse --calibrate seconds:N"
_RECORD_AGAIN = "record again: a second of standing still, arms and legs apart, before both sensors"
DOUBT_WORDS = {
    "one_view": "one view alone has the person",
    "limb_uncertain": "a limb, mostly the {limb}, is uncertain",
    "uncertain": "S* is uncertain",
}
"""What lasts, by its name in :data:`recordings.quality.doubtful_time.DOUBTS`."""


@dataclass(frozen=True, repr=False)
class Verdict:
    """How good a session is.

    Attributes:
        word: ``good``, ``usable``, ``poor`` or ``unknown``.
        findings: What is not good, worst first; among equally bad ones, the cause of the others first.
        figures: The figures it is based on, as ``duplex fuse --report`` writes them.
    """

    word: Word
    findings: tuple[Finding, ...]
    figures: Figures

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the session is not good, worst first."""
        return tuple(each.reason for each in self.findings)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The findings in words, each with what to do, worst first; one sentence if there are none."""
        return tuple(each.sentence for each in self.findings) or (in_words(self.word),)

    def __str__(self) -> str:
        return self.sentences[0]

    def __repr__(self) -> str:
        return f"<Verdict {self}>"


def verdict(figures: Figures) -> Verdict:
    """The verdict on a session.

    Args:
        figures: Of :func:`recordings.quality.figures.report`, or of a running session, which has ``streams``.
    """
    found = tuple(followed(_findings(figures, "streams" in figures)))
    return Verdict(found[0].word if found else "good", found, figures)


def _findings(figures: Figures, live: bool) -> Iterator[Finding]:
    calibration, agree, body = figures["calibration"], figures["views_agree_mm"], figures["body"]
    calibrate = _ANOTHER_PART if _has_another_part(figures) else _RECORD_AGAIN
    for side, share in figures["mirrored"].items():
        yield from judge("mirrored", 100.0 * (share or 0.0), side.upper(), live=live)
    yield from untrusted(calibration, calibrate, live)
    yield from clocks_apart(figures.get("clock"), live)
    yield from compared(figures["placement"], calibration["loaded"], live)
    yield from _missing(figures, live)
    yield from judge("unseen_together", 0.0 if agree["median"] is None else 1.0, live=live)
    yield from judge("two_people", agree["p95"], live=live)
    yield from judge("views", agree["median"], live=live, calibrate=calibrate, limits=of_views(body))
    yield from judge("error", figures["expected_error_mm"], live=live, limits=of_error(body))
    yield from _doubts(figures, live)
    turn_sd = calibration["rotation_sd_deg"]
    if not calibration["provisional"]:
        uncertain = 2.0 * (turn_sd or 0.0)
        yield from judge("angle", calibration["angle_deg"], live=live, uncertain=uncertain)
    for side, of in figures["distance_m"].items():
        yield from judge(
            "distance", of["median"], side.upper(), live=live, limits=within(of["near"], of["far"])
        )
    yield from judge("precision", turn_sd, live=live)
    yield from _streams(figures, live)


def untrusted(calibration: Figures, calibrate: str = "", live: bool = False) -> Iterator[Finding]:
    """Whether the agreement of the views proves nothing, by the figures of a calibration."""
    frames = 0 if calibration["provisional"] else calibration["frames"]
    count = f"calibrated on {frames} frame{'' if frames == 1 else 's'}"
    text = f"{count}; at least {FEWEST_PAIRS} are needed" if frames else "the calibration is provisional"
    yield from judge("uncalibrated", frames, live=live, calibrated=text, calibrate=calibrate)


def compared(off: Figures | None, loaded: bool, live: bool = True) -> Iterator[Finding]:
    """Whether B's own placement contradicts the calibration, or does not confirm one from a file.

    What the program found itself is contradicted by what is certain only.
    """
    turn_sd = math.inf if off is None else off["turn_sd_deg"]
    if loaded:
        yield from judge("unconfirmed", turn_sd, live=live)
    if off is not None:
        turn, shift = off["turn_deg"], off["shift_mm"]
        allowed = 0.0 if loaded and turn_sd <= RULES["unconfirmed"].limits.good[1] else 2.0 * turn_sd
        value = 0.0 if turn < allowed else max((turn - allowed) / _TURNED_DEG, shift / _SHIFTED_MM)
        again = "restart without the calibration file" if loaded else "walk a few steps"
        yield from judge(
            "moved",
            value,
            live=live,
            off=f"{turn:.1f}° and {shift:.0f} mm",
            most=f"{_TURNED_DEG:g}° and {_SHIFTED_MM:.0f} mm",
            again=again,
        )


def clocks_apart(clock: Figures | None, live: bool = False) -> Iterator[Finding]:
    """Whether B's clock is off, beyond what its measurement may be."""
    if clock is not None:
        sd = math.hypot(clock["sd_ms"], _ARTEFACT_SD_MS)
        offset, of = f"{clock['offset_ms']:+.0f}", f"{clock['sd_ms']:.0f}"
        off_ms = abs(clock["offset_ms"])
        yield from judge("clock", off_ms, live=live, uncertain=2.0 * sd, offset=offset, sd=of)


def _has_another_part(figures: Figures) -> bool:
    """Whether a recording has enough frames that it was not calibrated on; live sessions end provisional."""
    used, frames = figures["calibration"]["frames"] or 0, figures["fused_frames"]
    return not figures["calibration"]["provisional"] and not used <= frames < used + FEWEST_PAIRS


def _missing(figures: Figures, live: bool) -> Iterator[Finding]:
    """Views that are upside down, and joints that neither has."""
    for side, share in figures["upside_down"].items():
        yield from judge("upside_down", 100.0 * (share or 0.0), side.upper(), live=live)
    lacking = [spoken(name) for name in figures["in_no_frame"]]
    more = f" and {len(lacking) - _NAMED} more" if len(lacking) > _NAMED else ""
    if figures["views_agree_mm"]["median"] is not None:
        yield from judge("lacking", len(lacking), which=f"{', '.join(lacking[:_NAMED])}{more}")


def _doubts(figures: Figures, live: bool) -> Iterator[Finding]:
    """For how long S* is doubtful, of the time in which somebody is seen, and for how long nobody is."""
    of = figures["seconds_of"]
    first = max(DOUBT_WORDS, key=lambda name: of[name] or 0.0)
    lasts, share = doubt(of["doubtful"], of["seen"])
    doubted = DOUBT_WORDS[first].format(limb=of["limb"])
    yield from judge("doubtful", 100.0 * share, live=live, doubt=doubted, lasts=lasts)
    lasts, share = doubt(of["all"] - of["seen"], of["all"])
    yield from judge("nobody", 100.0 * share, live=live, lasts=lasts)


def doubt(seconds: float, every: float) -> tuple[str, float]:
    """How long a doubt lasts, such as ``8.1 s (28 %)``, and its share of a time."""
    share = seconds / every if every > 0.0 else 0.0
    return f"{seconds:.1f} s ({100.0 * share:.0f} %)", share


def _streams(figures: Figures, live: bool) -> Iterator[Finding]:
    """Frames that are missing, by their cause. An empty room has nothing to miss."""
    streams, paired = figures.get("streams", {}), figures["paired"] - figures["without_person"]["both"]
    for name, of in (("slow", "too_slow_for"), ("lost", "lost_on_usb")):
        for side, count in streams.get(of, {}).items():
            yield from judge(name, 100.0 * count / max(1, count + paired), side.upper(), live=live)
    # of the slower sensor: one that is faster by itself has frames that nobody can pair
    unpaired = min((figures["dropped"][side] or 0) + figures["alone"][side] for side in "ab")
    yield from judge("unpaired", 100.0 * unpaired / max(1, unpaired + paired), live=live)
