"""Events of a session: single events, and spells with a start and an end."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Phase = Literal["moment", "start", "end"]
"""Phase of an event: a single event, or the start or end of a spell."""


@dataclass(frozen=True)
class Event:
    """One event.

    Attributes:
        frame: The frame of the event; the first frame for an earlier event.
        time_ns: Time since the first pair.
        text: What happened.
        level: INFO, WARN or ERROR.
        topic: The subject of a spell, the same for its start and end.
        phase: Whether a spell starts or ends here.
    """

    frame: int
    time_ns: int
    text: str
    level: str
    topic: str = ""
    phase: Phase = "moment"


@dataclass(frozen=True)
class Spell:
    """A condition that lasted for some time.

    Attributes:
        start: The event that starts the spell.
        end: The event that ends it; None if the session ended first.
    """

    start: Event
    end: Event | None


def spells_of(events: Iterable[Event]) -> list[Spell]:
    """The spells of events given in time order, sorted by start. A repeated start does not open a second
    spell."""
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
