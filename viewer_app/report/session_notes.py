"""Messages about an opened session."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from recordings.session import Session
from viewer_app.report.event_list import ListedEvent, event_in_words, seconds_of, shortest_list

_MOST_EVENTS = 10


def print_damage(console: Console, session: Session) -> None:
    """Prints the damage of a file, if any."""
    if session.damage is not None:
        lost = f"; {session.frames_lost} more were written and are lost" if session.frames_lost else ""
        console.print(
            f"[bold yellow]{escape(str(session))} is not whole[/]: {escape(session.damage)}. "
            f"{len(session)} frames could be read{lost}.",
            highlight=False,
        )


def print_damaged_images(console: Console, count: int) -> None:
    """Prints how many images could not be copied, if any."""
    if count:
        console.print(f"[bold yellow]{count} damaged images[/] were skipped.", highlight=False)


def print_events(console: Console, events: Sequence[ListedEvent], all_of_them: bool = False) -> None:
    """Prints events as a numbered list in order of time.

    Args:
        console: Receives the output.
        events: Of :func:`viewer_app.report.event_list.list_events`.
        all_of_them: Whether to print all; if not, at most ten: first warnings, then spells, then the others.
    """
    if not events:
        console.print("No event was recorded.")
        return
    shown = list(events) if all_of_them else shortest_list(events, _MOST_EVENTS)
    grid = Table.grid(padding=(0, 2))
    grid.add_column(justify="right", no_wrap=True)
    grid.add_column(justify="right", no_wrap=True)
    grid.add_column(overflow="fold")
    for event in shown:
        style = "" if event.level == "INFO" else "yellow"
        grid.add_row(str(event.number), seconds_of(event.time_ns), Text(event_in_words(event), style))
    console.print("[bold]Events[/]")
    console.print(grid, highlight=False)
    if len(shown) < len(events):
        console.print(f"and {len(events) - len(shown)} more: --verbose.", highlight=False)
