"""A session's events as a numbered list, and the one at which a review opens."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from devices.events import Event, Spell, spells_of
from fusion.calibration.calibration import PROVISIONAL
from recordings.session import Session


@dataclass(frozen=True)
class ListedEvent:
    """An event, or a spell from its start to its end.

    Attributes:
        number: Its place in the list, from 1.
        frame: The frame at which it happens or starts.
        time_ns: The same as time since the first pair.
        text: What happened.
        level: INFO, WARN or ERROR.
        lasted_ns: How long a spell lasted; None for a single event or a spell that the session cuts off.
        spell: Whether it is a spell.
    """

    number: int
    frame: int
    time_ns: int
    text: str
    level: str
    lasted_ns: int | None = None
    spell: bool = False


def list_events(events: Iterable[Event]) -> list[ListedEvent]:
    """The events in order of time, numbered from 1. A spell is one event; its end is not listed."""
    ordered = sorted(events, key=lambda event: (event.time_ns, event.frame))
    spells = {id(spell.start): spell for spell in spells_of(ordered)}
    ends = {id(spell.end) for spell in spells.values()}
    told = [event for event in ordered if id(event) not in ends]
    return [_listed(number, event, spells.get(id(event))) for number, event in enumerate(told, start=1)]


def opening_event(events: Sequence[ListedEvent], settled_frame: int = 0) -> ListedEvent | None:
    """The event at which a review opens; None where nothing happened.

    The first of: a warning or an error once the session is calibrated, a spell once it is calibrated, a
    warning, a spell. Within each kind the earliest. What is told at the first frame is about the recording
    as a whole, and counts for none of them, nor do single events without a warning, such as a calibration.

    Args:
        events: Of :func:`list_events`.
        settled_frame: The frame from which the session is calibrated.
    """
    happened = [event for event in events if event.frame > 0]
    later = [event for event in happened if event.frame >= settled_frame]
    for choice in (later, happened):
        for kind in (
            [event for event in choice if event.level != "INFO"],
            [event for event in choice if event.spell],
        ):
            if kind:
                return kind[0]
    return None


def settled_frame(session: Session) -> int:
    """The first frame fused with a calibration that is not provisional; 0 where all are."""
    return next((first for first, one in session.calibrations if not one.how.startswith(PROVISIONAL)), 0)


def shortest_list(events: Sequence[ListedEvent], most: int) -> list[ListedEvent]:
    """At most so many events, in order of time: warnings are kept first, then spells, then the others."""
    by_weight = sorted(events, key=lambda event: (event.level == "INFO", not event.spell, event.number))
    return sorted(by_weight[:most], key=lambda event: event.number)


def seconds_of(time_ns: int) -> str:
    """A time as seconds, such as ``20.59 s``."""
    return f"{time_ns * 1e-9:.2f} s"


def event_in_words(event: ListedEvent) -> str:
    """The text of an event, with its duration, marked where it is a warning."""
    text = event.text[:1].upper() + event.text[1:]
    text += "" if text.endswith((".", "!", "?")) else "."
    if event.lasted_ns is not None:
        text += f" It lasted {event.lasted_ns * 1e-9:.1f} s."
    elif event.spell:
        text += " It lasted to the end."
    marks = {"INFO": "", "WARN": "Warning: ", "ERROR": "Error: "}
    return f"{marks.get(event.level, '')}{text}"


def _listed(number: int, event: Event, spell: Spell | None) -> ListedEvent:
    if spell is None:
        return ListedEvent(number, event.frame, event.time_ns, event.text, event.level)
    lasted_ns = None if spell.end is None else spell.end.time_ns - event.time_ns
    return ListedEvent(number, event.frame, event.time_ns, event.text, event.level, lasted_ns, True)
