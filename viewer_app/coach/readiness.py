"""How far the set-up is, and the one thing to do next, from all current findings."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from devices.findings.finding import Finding, capital, followed
from devices.findings.rules import RULES, WALK
from fusion.calibration.calibration import Calibration
from recordings.appearance.state_card import State
from viewer_app.flags import in_flags

LASTS = 2.0
"""Seconds for which a headline stays, and for which a problem counts after it was found last."""
_DONE_AT_ONCE = "uncalibrated"  # a calibration is there at once; a figure swings about its limit
_PLACES = tuple(RULES)[tuple(RULES).index("distance") : tuple(RULES).index("uncalibrated")]
"""Rules about where person and sensors are."""
_STATES = {"usable": State.ALMOST, "unknown": State.ALMOST, "poor": State.NOT_YET}


@dataclass(frozen=True)
class Headline:
    """A state and a step."""

    state: State
    step: str  # what is wrong and what to do next, in a few words
    kind: str = ""  # the rule that fired; empty where nothing is to do
    side: str = ""  # the sensor that it is about, if one

    @property
    def lost(self) -> bool:
        """Whether a view shows no one."""
        return bool(self.kind) and RULES[self.kind].lost


class Readiness:
    """Watches all findings. Its headline lasts for two seconds, unless a view is lost, or B is placed.

    Attributes:
        findings: Those of the last two seconds, and the headline's.
    """

    def __init__(self) -> None:
        self.findings: list[Finding] = []
        self._found: dict[tuple[str, str], tuple[float, Finding]] = {}
        self._since = -math.inf
        self._shown = Headline(State.NOT_YET, "")

    def watch(self, time: float, findings: Sequence[Finding], calibration: Calibration) -> Headline:
        """The headline at a time in seconds, which never falls, given all current findings."""
        now = {(each.rule, each.side): (time, each) for each in findings}
        self._found = {
            key: (at, each)
            for key, (at, each) in (self._found | now).items()
            if time - at < LASTS and (key in now or key[0] != _DONE_AT_ONCE)
        }
        counts = followed(each for _, each in self._found.values())
        wanted = headline(counts, calibration, self._shown)
        done = self._shown.kind == _DONE_AT_ONCE != wanted.kind
        at_once = done or (wanted.lost and not self._shown.lost)
        if wanted != self._shown and (at_once or time - self._since >= LASTS):
            self._shown, self._since = wanted, time
        kind = self._shown.kind
        missing = all(each.rule != kind for each in counts)
        self.findings = counts + [each for each in self.findings if missing and each.rule == kind]
        return self._shown


def headline(findings: Sequence[Finding], calibration: Calibration, kept: Headline | None = None) -> Headline:
    """The state, and the step that comes first, of findings as :func:`followed` orders them.

    Who is asked to walk about is asked into place before: a sensor that is moved afterwards undoes the walk.

    Args:
        kept: The last one, whose step stays first until it is done, of the same sensor if it can.
    """
    asked = [each for each in findings if each.step]
    if not asked:
        return Headline(State.READY, f"Record now: {_precision(calibration)}whole body in both views")
    first, word = asked[0], asked[0].word
    if RULES[first.rule].live == WALK:
        first = next((each for each in asked if each.rule in _PLACES), first)
    if kept is not None and not RULES[first.rule].first:
        alike = [each for each in asked if each.rule == kept.kind and each.word == word]
        first = next((each for each in alike if each.side == kept.side), next(iter(alike), first))
    said = in_flags(capital(f"{first.what}: {first.step}"))
    return Headline(_STATES[word], said, first.rule, first.side)


def to_markdown(
    findings: Sequence[Finding], notes: Sequence[str] = (), said_by: Headline | None = None
) -> str:
    """What is wrong, a line each, and notes after it, as Markdown; without what the headline says."""
    said = "" if said_by is None else said_by.step
    lines = [in_flags(capital(f"{each.what}: {each.step}")) for each in findings]
    return "\n\n".join([*(f"### {line}" for line in lines if line != said), *notes]) + "\n"


def _precision(calibration: Calibration) -> str:
    """± one standard deviation of the sensors' rotation; empty where it is unknown."""
    registration = calibration.registration
    if registration is None or not math.isfinite(registration.rotation_sd):
        return ""
    return f"± {math.degrees(registration.rotation_sd):.1f}°, "
