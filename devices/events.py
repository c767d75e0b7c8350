"""Events: what happens to the sensors, the calibration or the person while a session runs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

Level = Literal["INFO", "WARN", "ERROR"]
"""Severity of an event."""
Phase = Literal["moment", "start", "end"]
"""Phase of an event: a single event, or the start or end of a spell."""
_INTERRUPTION_NS = 500_000_000  # a shorter one does not end a spell


@dataclass(frozen=True)
class Event:
    """One event, from its producer to the session file.

    Attributes:
        text: What happened, and what to do, if anything.
        level: Severity.
        topic: The subject of a spell, the same for its start and end; empty for a single event.
        phase: Whether a spell starts or ends here.
        frame: The frame of the event; the first frame for an earlier event.
        time_ns: Time since the first pair. Before a session has placed the event: the producer's clock.
    """

    text: str
    level: Level = "INFO"
    topic: str = ""
    phase: Phase = "moment"
    frame: int = 0
    time_ns: int = 0

    def placed(self, frame: int, time_ns: int) -> Event:
        """The event at a frame of a session."""
        return replace(self, frame=frame, time_ns=time_ns)


@dataclass(frozen=True)
class Spell:
    """A condition that lasted for some time."""

    start: Event  # the event that starts the spell
    end: Event | None  # the event that ends it; None if the session ended first


def spells_of(events: Iterable[Event]) -> list[Spell]:
    """The spells of events given in time order, sorted by start.

    A start within half a second of the end of the same spell continues it; a repeated start does not open a
    second spell.
    """
    spells: list[Spell] = []
    newest: dict[str, int] = {}
    for event in events:
        index = newest.get(event.topic, -1)
        last = spells[index].end if index >= 0 else None
        if event.phase == "start" and (index < 0 or last is not None):
            if last is not None and event.time_ns - last.time_ns <= _INTERRUPTION_NS:
                spells[index] = Spell(spells[index].start, None)
                continue
            newest[event.topic] = len(spells)
            spells.append(Spell(event, None))
        elif event.phase == "end" and index >= 0 and last is None:
            spells[index] = Spell(spells[index].start, event)
    return spells
