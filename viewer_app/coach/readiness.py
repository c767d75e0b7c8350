"""How far the set-up is, and the one thing to do next, from all current advice."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from fusion.calibration.calibration import Calibration
from recordings.appearance.state_card import State
from viewer_app.coach.advice import Advice
from viewer_app.flags import in_flags

LASTS = 2.0
"""Seconds for which a headline stays, and for which a problem counts after it was advised last."""
_LOST = frozenset({"silent", "person"})
"""Kinds of advice about a view that shows no one: it is told at once."""
_RANKED = (
    "silent", "person", "others", "mirrored", "moved", "distance", "feet", "overlap", "angle", "calibration",
    "hidden", "whole", "pose", "rate", "drops", "skew",
)  # fmt: skip
"""Kinds of advice that ask for something, the first to follow first."""
_AT_ONCE = _LOST | {"others", "mirrored"}
"""Kinds of advice without which the others mean nothing."""
_TOLD_BY = {"whole": {"distance", "feet"}, "pose": {"calibration"}}
"""Kinds of advice that are none where another one is: of what is out of view, and of a pose that was held."""
_LESS_GOOD = frozenset({"rate", "drops", "skew"})
"""Kinds of warnings despite which a set-up is of use."""


@dataclass(frozen=True)
class Headline:
    """A state and a step."""

    state: State
    step: str  # what is wrong and what to do next, in a few words
    kind: str = ""  # of the advice; empty where nothing is to do

    @property
    def lost(self) -> bool:
        """Whether a view shows no one."""
        return self.kind in _LOST


class Readiness:
    """Watches all advice. Its headline changes at most every two seconds, or as a view is lost.

    Attributes:
        advice: That of the last two seconds, and the headline's.
    """

    def __init__(self) -> None:
        self.advice: list[Advice] = []
        self._advised: dict[str, tuple[float, Advice]] = {}
        self._since = -math.inf
        self._shown = Headline(State.NOT_YET, "")

    def watch(self, time: float, advice: Sequence[Advice], calibration: Calibration) -> Headline:
        """The headline at a time in seconds, which never falls, given all current advice."""
        lately = {topic: (at, each) for topic, (at, each) in self._advised.items() if time - at < LASTS}
        self._advised = lately | {each.topic: (time, each) for each in advice}
        counts = [each for _, each in self._advised.values()]
        wanted = headline(counts, calibration, self._shown.kind)
        at_once = wanted.lost and not self._shown.lost
        if wanted != self._shown and (at_once or time - self._since >= LASTS):
            self._shown, self._since = wanted, time
        kind = self._shown.kind
        missing = all(each.kind != kind for each in counts)
        self.advice = counts + [each for each in self.advice if missing and each.kind == kind]
        return self._shown


def headline(advice: Sequence[Advice], calibration: Calibration, kept: str = "") -> Headline:
    """The state, and the step that comes first.

    Args:
        kept: The kind of the last step, which stays first until it is done.
    """
    asked = ranked(advice)
    if not asked:
        return Headline(State.READY, f"Record now: {_precision(calibration)}whole body in both views")
    first = asked[0]
    if first[0].kind not in _AT_ONCE:
        first = next((alike for alike in asked if alike[0].kind == kept and _needed(alike[0])), first)
    state = State.NOT_YET if _needed(first[0]) else State.ALMOST
    why = first[0].why
    step = f"{why}: {step_of(first)}" if why else _capital(step_of(first))
    return Headline(state, step, first[0].kind)


def ranked(advice: Sequence[Advice]) -> list[list[Advice]]:
    """All advice that asks for something, by its kind, the first to follow first."""
    asked = [each for each in advice if each.step]
    told = {each.kind for each in asked}
    asked = [each for each in asked if not _TOLD_BY.get(each.kind, set()) & told]
    kinds = sorted({(not _needed(each), _RANKED.index(each.kind), each.kind) for each in asked})
    return [
        [each for each in asked if (not _needed(each), each.kind) == (later, kind)]
        for later, _, kind in kinds
    ]


def step_of(alike: Sequence[Advice]) -> str:
    """What to do about advice of one kind, with its sensors: what the sensor asks for that asks for most."""
    most = max(alike, key=lambda each: each.urgency)
    return most.step.format(who=named(alike))


def named(alike: Sequence[Advice]) -> str:
    """The sensors that advice is about: ``A``, ``B`` or ``A and B``."""
    return " and ".join(sorted(set("".join(each.sensors for each in alike))))


def to_markdown(advice: Sequence[Advice], said_by: Headline | None = None) -> str:
    """What is wrong, one line a problem, and the figures after it, as Markdown.

    Each thing to do is said once; that of the headline is not said again.
    """
    asked = ranked(advice)
    kind = "" if said_by is None else said_by.kind
    lines, said = [], {step_of(alike) for alike in asked if alike[0].kind == kind}
    for alike in asked:
        step = step_of(alike)
        problem = _capital(_problem(alike))
        lines.append(f"### {problem}{'' if step in said else f': {step}'}")
        said.add(step)
    figures = [in_flags(each.text) for each in advice if each.figures]
    return "\n\n".join([*lines, *figures]) + "\n"


def _needed(advice: Advice) -> bool:
    """Whether a set-up is of no use before this is done."""
    return advice.kind in _LOST or (advice.level == "WARN" and advice.kind not in _LESS_GOOD)


def _problem(alike: Sequence[Advice]) -> str:
    """What is wrong: ``A: too near, 1.3 m; B: too near, 1.1 m``."""
    of_label = {each.label: [other for other in alike if other.label == each.label] for each in alike}
    parts = (f"{named(same)}: {label}" if named(same) else label for label, same in of_label.items())
    return "; ".join(parts)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _precision(calibration: Calibration) -> str:
    """± one standard deviation of the sensors' rotation; empty where it is unknown."""
    registration = calibration.registration
    if registration is None or not math.isfinite(registration.rotation_sd):
        return ""
    return f"± {math.degrees(registration.rotation_sd):.1f}°, "
