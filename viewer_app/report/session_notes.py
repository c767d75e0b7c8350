"""What commands say about a session that they have opened."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from recordings.session import Session


def print_damage(console: Console, session: Session) -> None:
    """Says what is wrong with a file, where something is."""
    if session.damage is not None:
        lost = f"; {session.frames_lost} more were written and are lost" if session.frames_lost else ""
        console.print(
            f"[bold yellow]{escape(str(session))} is not whole[/]: {escape(session.damage)}. "
            f"{len(session)} frames could be read{lost}.",
            highlight=False,
        )


def print_damaged_images(console: Console, count: int) -> None:
    """Says how many images could not be copied, where there are any."""
    if count:
        console.print(f"[bold yellow]{count} damaged images[/] were left out.", highlight=False)
