"""``duplex review``: shows a session in the viewer, prints its summary and writes a report page."""

from __future__ import annotations

from rich.console import Console

from recordings.session import Session
from viewer_app.options.sessions import ReviewOptions
from viewer_app.output_files import check_outputs, whole_file
from viewer_app.report.figures import FusionResult, print_summary, report
from viewer_app.report.session_notes import print_damage
from viewer_app.viewer.display import has_display
from viewer_app.viewer.file_window import show


def run(options: ReviewOptions) -> None:
    """Carries out the command.

    Raises:
        RecordingError, UsageError: With one line for the person who asked.
    """
    console = Console()
    check_outputs([options.html], [options.session], options.force)
    session = Session.open(options.session)
    print_damage(console, session)
    result = FusionResult(session.pairing, session.calibration, session.settings, session.rows)
    figures = report(result)
    if options.html is not None:
        from viewer_app.report.review_page import review_page

        with whole_file(options.html) as partial:
            partial.write_text(review_page(session, figures), encoding="utf-8")
    print_summary(console, result, figures)
    if options.html is not None:
        console.print(f"Wrote {options.html}.", highlight=False, markup=False)
    if not options.no_viewer and has_display():
        show(options.session)
