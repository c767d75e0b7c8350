"""Messages about an opened session."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from recordings.session import Session


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
