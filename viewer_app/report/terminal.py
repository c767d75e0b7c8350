"""The report in the terminal."""

import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from devices.events import Event
from recordings.quality.figures import Figures
from recordings.session import Session
from viewer_app.report.events import ListedEvent, event_in_words, list_events, seconds_of, shortest_list
from viewer_app.report.words import BONE_HEAD, Line, bone_rows, detail_lines, lead_lines
from viewer_app.viewer.display import has_display

_LABEL_WIDTH = 13
_MOST_EVENTS = 10


def print_lines(console: Console, lines: Iterable[Line]) -> None:
    """Prints lines with aligned texts. The label is bold, a warning yellow; neither carries the meaning."""
    for line in lines:
        grid = Table.grid()
        grid.add_column(width=max(_LABEL_WIDTH, len(line.label) + 1), no_wrap=True)
        grid.add_column(overflow="fold")
        grid.add_row(Text(line.label, "bold"), Text(line.text, "yellow" if line.warning else ""))
        console.print(grid)


def print_summary(
    console: Console, figures: Figures, events: Iterable[Event] = (), verbose: bool = False
) -> None:
    """Prints the summary of a session; of `events`, the warnings."""
    print_lines(console, lead_lines(figures))
    warned = [each.event for each in list_events(events) if each.event.level != "INFO"]
    if warned:
        more = f" ({len(warned) - 1} more)" if len(warned) > 1 else ""
        text = f"{seconds_of(warned[0].time_ns)}: {warned[0].text}{more}"
        print_lines(console, [Line("Warning", text, warning=True)])
    if verbose:
        print_details(console, figures)


def print_details(console: Console, figures: Figures) -> None:
    """Prints what ``--verbose`` adds: all figures and every bone."""
    print_lines(console, detail_lines(figures))
    if "bones" in figures:
        title = "Bones: target, and mean ± deviation in mm"
        console.print(figure_table(title, BONE_HEAD, bone_rows(figures)))


def figure_table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    """A table of figures, on the right; the first column has names."""
    table = Table(title=title, title_justify="left", min_width=len(title))
    for k, column in enumerate(head):
        table.add_column(column, justify="right" if k else "left")
    for row in rows:
        table.add_row(*row)
    return table


def say_saved(console: Console, path: Path) -> None:
    """Prints where the session is, and the command to view it, as this program was called."""
    called = Path(sys.argv[0])
    found = shutil.which("duplex")
    on_path = found is not None and Path(found).resolve() == called.resolve()
    program = str(called) if called.name.startswith("duplex") and not on_path else "duplex"
    page = [] if has_display() else ["--html", str(path.with_suffix(".html"))]
    words = [program, "review", str(path), *page]
    command = in_shell(words)
    # a command must be copied in one piece: no wrapping
    console.print(
        f"{'Saved':{_LABEL_WIDTH}}{path}, {_in_bytes(path.stat().st_size)}. To look at it: {command}",
        markup=False,
        soft_wrap=True,
    )


def in_shell(words: Sequence[str]) -> str:
    """A command as the shell of this system takes it, with quotes where they are needed."""
    return subprocess.list2cmdline(words) if sys.platform == "win32" else shlex.join(words)


def _in_bytes(size: int) -> str:
    """A file's size as kB, MB or GB of a thousand each, with two digits at least."""
    value, unit = size * 1e-3, "kB"
    for larger in ("MB", "GB"):
        if value >= 1000.0:
            value, unit = value * 1e-3, larger
    return f"{value:.0f} {unit}" if value >= 10.0 else f"{value:.1f} {unit}"


def say_more(console: Console, others: str = "as data with --report FILE.json") -> None:
    """Prints where all other figures are: in the terminal, and `others`."""
    print_lines(console, [Line("All figures", f"with --verbose; {others}.")])


def print_damage(console: Console, session: Session) -> None:
    """Prints the damage of a file, if any."""
    if session.damage is not None:
        console.print(
            f"[bold yellow]{escape(str(session))} is not whole[/]: {escape(session.damage_in_words)}. "
            f"{len(session)} frames could be read."
        )


def print_damaged_images(console: Console, count: int) -> None:
    """Prints how many images could not be copied, if any."""
    if count:
        console.print(f"[bold yellow]{count} damaged images[/] were skipped.")


def print_events(console: Console, events: Sequence[ListedEvent], all_of_them: bool = False) -> None:
    """Prints events as a numbered list in order of time: all, or at most ten, warnings first, then spells."""
    if not events:
        console.print("No event was recorded.")
        return
    shown = list(events) if all_of_them else shortest_list(events, _MOST_EVENTS)
    grid = Table.grid(padding=(0, 2))
    grid.add_column(justify="right", no_wrap=True)
    grid.add_column(justify="right", no_wrap=True)
    grid.add_column(overflow="fold")
    for each in shown:
        style = "" if each.event.level == "INFO" else "yellow"
        grid.add_row(str(each.number), seconds_of(each.event.time_ns), Text(event_in_words(each), style))
    some = f", {len(shown)} of {len(events)}, with the numbers of --verbose and --event"
    console.print(f"[bold]Events[/]{some if len(shown) < len(events) else ''}")
    console.print(grid)
    if len(shown) < len(events):
        console.print(f"and {len(events) - len(shown)} more: --verbose.")
