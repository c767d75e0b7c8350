"""``duplex info``: prints the contents of a session."""

from typing import Any

from rich.markup import escape
from rich.table import Table

from recordings import layout
from recordings.images import Images
from recordings.session import Session
from viewer_app.options.sessions import InfoOptions
from viewer_app.output_console import output_console
from viewer_app.report.events import list_events
from viewer_app.report.figures import calibration_figures
from viewer_app.report.terminal import print_events
from viewer_app.report.words import calibration_in_words


def run(options: InfoOptions) -> None:
    """Runs the command."""
    session = Session.open(options.session)
    rows = session.rows
    seconds = float(rows.time_ns[-1] - rows.time_ns[0]) * 1e-9
    size = options.session.stat().st_size
    table = Table(show_header=False, box=None)

    def row(name: str, value: object) -> None:
        table.add_row(f"[bold]{name}[/]", escape(str(value)))

    row("session", session)
    about = session.about["session"]
    row("written by", f"{about['written_by'][0]}, layout {about['layout_version'][0]}")
    row("body", f"{session.body.name}, {len(session.body)} joints")
    row("sensors", f"A {session.sources[0]}, B {session.sources[1]}")
    if session.tracker:
        row("body tracker", session.tracker)
    row(
        "frames",
        f"{len(session)} in {seconds:.2f} s; the faster sensor gives {session.frame_rate:.3g} per second",
    )
    row("without S*", int(rows.predicted.all(axis=1).sum()))
    row("settings", ", ".join(f"{k} {v[0]}" for k, v in session.about["settings"].items()))
    for k, line in enumerate(calibration_in_words(calibration_figures(session.calibration))):
        row("" if k else "calibration", line)
    images: dict[str, dict[str, Images[Any]]] = {
        "depth": {side: session.depth(side) for side in layout.SIDES},
        "colour": {side: session.color(side) for side in layout.SIDES},
    }
    damage = [] if session.damage is None else [f"{session.damage}; {session.frames_lost} frames lost"]
    for kind, of_sides in images.items():
        counts = {side: reader.count() for side, reader in of_sides.items()}
        if kind == "depth" or any(counts.values()):
            row(f"{kind} images", ", ".join(f"{side.upper()} {count}" for side, count in counts.items()))
        damage += [
            f"{reader.damaged} damaged {kind} images of {side.upper()}"
            for side, reader in of_sides.items()
            if reader.damaged
        ]
    row("size", f"{size / 1e6:.1f} MB, {size / max(seconds, 1e-9) * 60 / 1e6:.1f} MB a minute")
    events = list_events(session.events)
    row("events", len(events))
    row("whole", f"no: {', '.join(damage)}" if damage else "yes")
    console = output_console()
    console.print(table)
    if events:
        print_events(console, events, all_of_them=True)
