"""What happened in a session, at a moment or over a spell."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Phase = Literal["moment", "start", "end"]
"""Of an event: it is over at once, or a spell begins or ends with it."""


@dataclass(frozen=True)
class Event:
    """What happened.

    Attributes:
        frame: The frame it happened at; the first where it happened before that.
        time_ns: Since the first pair.
        text: What.
        level: INFO, WARN or ERROR.
        topic: What a spell is about: start and end of one have the same.
        phase: Whether a spell begins or ends here.
    """

    frame: int
    time_ns: int
    text: str
    level: str
    topic: str = ""
    phase: Phase = "moment"


@dataclass(frozen=True)
class Spell:
    """Something that lasted.

    Attributes:
        start: Its first event.
        end: Its last; None where the session ended before it.
    """

    start: Event
    end: Event | None


def spells_of(events: Iterable[Event]) -> list[Spell]:
    """The spells among events in time order, by their start. One that begins anew while it lasts is one."""
    spells: list[Spell] = []
    lasting: dict[str, int] = {}
    for event in events:
        if event.phase == "start" and event.topic not in lasting:
            lasting[event.topic] = len(spells)
            spells.append(Spell(event, None))
        elif event.phase == "end" and event.topic in lasting:
            index = lasting.pop(event.topic)
            spells[index] = Spell(spells[index].start, event)
    return spells
