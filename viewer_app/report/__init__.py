"""The figures of a session, in words, plots, pages and files."""

from pathlib import Path

from recordings.quality.figures import Figures
from recordings.session import Session
from viewer_app.output_files import save_report


def save_session_report(path: Path | None, figures: Figures, session: Session | None, force: bool) -> None:
    """Writes a report, if there is a path, with the figures of the session's gait; null without a session."""
    if path is not None:
        from viewer_app.report.walking import gait_figures

        gait = None if session is None else gait_figures(session.gait)
        save_report(path, figures | {"gait": gait}, force)
