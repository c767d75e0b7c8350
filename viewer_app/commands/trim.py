"""``duplex trim``: saves a time range of a session as a new session."""

from devices.output_file import whole_file
from recordings.quality.figures import report
from recordings.session import Session
from viewer_app.errors import UsageError
from viewer_app.options.sessions import TrimOptions
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs
from viewer_app.report.pages.good_part import good_frames_of
from viewer_app.report.pages.session_page import session_page
from viewer_app.report.terminal import print_damage, print_damaged_images
from viewer_app.viewer.file_window import write_for_viewer


def run(options: TrimOptions) -> None:
    """Runs the command."""
    console = output_console()
    check_outputs([], [options.session], options.force, options.save)
    session = Session.open(options.session)
    print_damage(console, session)
    time = session.rows.time_ns * 1e-9
    last = time[-1] if options.end is None else options.end
    if options.end is not None and options.end < options.start:
        raise UsageError(f"--from {options.start:g} must be before --to {options.end:g}.")
    kept = (time >= options.start) & (time <= last)
    if not kept.any():
        raise UsageError(
            f"No frame from {options.start:g} s to {last:g} s; {session} runs from 0 to {time[-1]:.3f} s."
        )
    if options.good:
        kept &= good_frames_of(session, console)
    part = session.part(kept)
    with whole_file(options.save, overwrite=options.force) as hidden:
        about = f"These figures are of {session}, of which this session is a part."
        damaged = write_for_viewer(part, hidden, session_page(part.last_setup, report(session), about))
    console.print(f"Saved {options.save}: {len(part)} of {len(session)} frames.", markup=False)
    print_damaged_images(console, damaged)
