"""A session's events as a numbered list, and the one at which a review opens."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from devices.events import Event, Spell, spells_of
from viewer_app.flags import in_flags


@dataclass(frozen=True)
class ListedEvent:
    """An event in the list of a session, or a spell from its start to its end."""

    number: int  # its place in the list, from 1
    event: Event  # the event; of a spell, its start
    spell: Spell | None = None  # the spell that it starts; None for a single event


def list_events(events: Iterable[Event]) -> list[ListedEvent]:
    """The events in order of time, numbered from 1. A spell is one event; its end is not listed."""
    ordered = sorted(events, key=lambda event: (event.time_ns, event.frame))
    spells = {id(spell.start): spell for spell in spells_of(ordered)}
    topics = {spell.start.topic for spell in spells.values()}
    listed = [
        event
        for event in ordered
        if event.phase == "moment" or event.topic not in topics or id(event) in spells
    ]
    return [ListedEvent(number, event, spells.get(id(event))) for number, event in enumerate(listed, start=1)]


def opening_event(events: Sequence[ListedEvent], first_calibrated_frame: int = 0) -> ListedEvent | None:
    """The event at which a review opens; None where nothing happened.

    The first of: a warning or an error once the session is calibrated, a spell once it is calibrated, a
    warning, a spell. Within each kind the earliest. What is told at the first frame is about the recording
    as a whole, and counts for none of them, nor do single events without a warning, such as a calibration.
    """
    happened = [each for each in events if each.event.frame > 0]
    later = [each for each in happened if each.event.frame >= first_calibrated_frame]
    for choice in (later, happened):
        for kind in (
            [each for each in choice if each.event.level != "INFO"],
            [each for each in choice if each.spell is not None],
        ):
            if kind:
                return kind[0]
    return None


def shortest_list(events: Sequence[ListedEvent], most: int) -> list[ListedEvent]:
    """At most so many events, in order of time: warnings are kept first, then spells, then the others."""
    by_weight = sorted(events, key=lambda each: (each.event.level == "INFO", not each.spell, each.number))
    return sorted(by_weight[:most], key=lambda each: each.number)


def seconds_of(time_ns: int) -> str:
    """A time as seconds, such as ``20.59 s``."""
    return f"{time_ns * 1e-9:.2f} s"


def event_in_words(listed: ListedEvent) -> str:
    """The text of an event, with its duration, marked where it is a warning."""
    event, spell = listed.event, listed.spell
    text = in_flags(event.text)
    text = text[:1].upper() + text[1:]
    text += "" if text.endswith((".", "!", "?")) else "."
    if spell is not None:
        text += f" It lasted {_duration(event, spell.end)}."
    marks = {"INFO": "", "WARN": "Warning: ", "ERROR": "Error: "}
    return f"{marks[event.level]}{text}"


def _duration(start: Event, end: Event | None) -> str:
    if end is None:
        return "to the end"
    milliseconds = (end.time_ns - start.time_ns) * 1e-6
    return f"{milliseconds:.0f} ms" if milliseconds < 100.0 else f"{milliseconds * 1e-3:.1f} s"
