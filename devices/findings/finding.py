"""A finding: a rule that fired, with its figure, in words; and the order in which findings are followed."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from devices.findings.rules import RULES, Limits, Rule

Word = Literal["good", "usable", "unknown", "poor"]
WORDS: tuple[Word, ...] = ("good", "usable", "unknown", "poor")
"""From best to worst."""


@dataclass(frozen=True)
class Finding:
    """A rule that fired.

    Attributes:
        rule: Its name in :data:`devices.findings.rules.RULES`.
        word: The best word that this allows: ``usable``, ``unknown`` or ``poor``.
        what: What is wrong, with the figure.
        limit: What is good, or empty.
        step: What to do, or empty.
        side: The sensor concerned, ``A`` or ``B``; empty if none.
        beyond: How far the figure is outside what is good.
    """

    rule: str
    word: Word
    what: str
    limit: str = ""
    step: str = ""
    side: str = ""
    beyond: float = 0.0

    @property
    def reason(self) -> str:
        """What is wrong, and what is good."""
        return f"{self.what}; {self.limit}" if self.limit else self.what

    @property
    def sentence(self) -> str:
        """The finding with its word, and what to do."""
        return in_words(self.word, self.reason, self.step)


def in_words(word: str, reason: str = "", remedy: str = "") -> str:
    """A verdict as a sentence."""
    return (f"{word}: {reason}." if reason else f"{word}.") + (f" {capital(remedy)}." if remedy else "")


def word_of(rule: Rule, value: float) -> Word:
    """The word that a figure allows; ``good`` if it is not a number."""
    (low, high), (least, most) = rule.limits
    if math.isnan(value) or low <= value <= high:
        return "good"
    return "usable" if least <= value <= most else rule.beyond


def judge(
    name: str,
    value: float | None,
    side: str = "",
    *,
    live: bool = True,
    limits: Limits | None = None,
    uncertain: float = 0.0,
    **fields: str,
) -> Iterator[Finding]:
    """The finding of a figure, if its rule fires.

    Args:
        value: The figure; None or NaN if it is unknown.
        live: Whether the sensors run, so that something can be done at once.
        limits: Those of the tracker or camera, in place of the rule's.
        uncertain: By how much the figure may be wrong, which the limits allow it.
        fields: What the rule's words name besides.
    """
    rule = RULES[name] if limits is None else replace(RULES[name], limits=limits)
    value = math.nan if value is None else value
    (low, high), usable = rule.limits
    word = word_of(rule, value + uncertain if value < low else value - uncertain if value > high else value)
    if word == "good" or low - uncertain <= value <= high + uncertain:
        return
    beyond = max(low - value, value - high)
    known: Mapping[str, str] = {
        "value": beside(value, low, high, *usable, digits=rule.digits),
        "signed": f"{value:+.{rule.digits}f}",
        "low": f"{-_rounded_down(-low, rule.digits):g}",
        "high": f"{_rounded_down(high, rule.digits):g}",
        "by": f"{math.ceil(2.0 * beyond) / 2.0:.1f}" if math.isfinite(beyond) else "",
        "you_are": "you are" if live else "the person is",
        "who": side,
        **fields,
    }
    step = rule.live if live else rule.files
    if not isinstance(step, str):
        step = step[value > high]
    what, limit, step = (text.format(**known) for text in (rule.what, rule.limit, step))
    yield Finding(name, word, what, limit, step, side, beyond)


def followed(findings: Iterable[Finding]) -> list[Finding]:
    """The findings in the order in which to follow them: by their word, then by the table, then by sensor.

    What is a consequence of another one is not said, but its word counts for the other.
    """
    found, rank = list(findings), list(RULES)
    while consequence := next((each for each in found if _causes(each, found)), None):
        cause = min(_causes(consequence, found), key=lambda each: rank.index(each.rule))
        found.remove(consequence)
        found[found.index(cause)] = replace(cause, word=worse(cause.word, consequence.word))
    return sorted(
        found, key=lambda each: (-WORDS.index(each.word), rank.index(each.rule), -each.beyond, each.side)
    )


def _causes(finding: Finding, found: Iterable[Finding]) -> list[Finding]:
    """Those that tell a finding: of its sensor, if each is of one."""
    told_by = RULES[finding.rule].told_by
    return [
        each
        for each in found
        if each.rule in told_by and (not each.side or not finding.side or each.side == finding.side)
    ]


def worse(one: Word, other: Word) -> Word:
    """The worse one of two words."""
    return max(one, other, key=WORDS.index)


def beside(value: float, *limits: float, digits: int = 0) -> str:
    """A number with so many digits, or as many more as keep it on its side of the limits."""
    sides = [np.sign(value - each) for each in limits]
    return next(
        text
        for more in range(digits, 18)
        for text in [f"{value:.{more}f}"]
        if more == 17 or [np.sign(float(text) - each) for each in limits] == sides
    )


def _rounded_down(limit: float, digits: int) -> float:
    """A limit with as many digits as the figure, or with those that it has."""
    step = 10.0**-digits
    return math.floor(limit / step + 1e-9) * step if digits and math.isfinite(limit) else limit


def spoken(joint: str) -> str:
    """A joint's name as one says it: "left hand" for HAND_LEFT and HandLeft."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", joint).replace("_", " ").lower().split()
    return " ".join(sorted(words, key=lambda word: word not in ("left", "right")))


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]
